"""Files of the public benchmark sets."""
