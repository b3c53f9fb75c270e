"""Separation from neighbours: safety filter, tracks, learned actor. Imports base only."""
