"""Flight logs: one reader for each format (`open_log` picks it), and the writers of a run."""
