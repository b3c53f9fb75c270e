"""Output of commands: the live view, the day's report, plans."""
