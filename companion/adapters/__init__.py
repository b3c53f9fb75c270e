"""Bytes and files in and out: foreign types stop here. Imports the core, not fleet or app."""
