"""What is asked: the behaviours, by family."""
