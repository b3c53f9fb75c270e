"""Separation from other vehicles: safety filter, tracks, learned actor. Imports base only."""
