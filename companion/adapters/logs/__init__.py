"""Flight logs: one reader for each format (`read_log_of_any_format` picks it), and the writers of a
run.
"""
