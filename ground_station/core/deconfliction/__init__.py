"""Separation by plan (safety rule 7): pads, layers, operational volumes."""
