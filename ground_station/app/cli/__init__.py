"""The commands: arguments in, text out. What they do is elsewhere."""
