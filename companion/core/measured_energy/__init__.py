"""What recorded flights drew beside what was predicted: tracks, phases, times, scatter by day."""
