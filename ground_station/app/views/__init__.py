"""What commands print: the live view, the day's report, plans."""
