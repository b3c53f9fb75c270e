"""Row 2 and 11: paths that a vehicle with a turn radius and climb limits can fly, in steady wind."""
