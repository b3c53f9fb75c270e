"""Missions and recorded tracks as documents of other tools: text and plain values, no files."""
