"""Golden decisions: checks that the working tree decides as the base commit does."""
