"""Who does something at the desk, and the record of what was done."""
