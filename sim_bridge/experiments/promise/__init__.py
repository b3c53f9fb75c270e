"""Is the promise kept? Missions through recorded wind (evaluation.md, 10; docs/promise.md)."""
