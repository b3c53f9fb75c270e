"""Files that people write or that outlive a run: parameters, checkpoints, plans."""
