"""The programs: commands, the running desk, the truck's terminal, pictures."""
