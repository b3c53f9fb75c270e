"""Golden decisions: the base commit and the working tree decide the same, run side by side."""
