"""What the desk knows and decides: no I/O, no clock, no threads."""
