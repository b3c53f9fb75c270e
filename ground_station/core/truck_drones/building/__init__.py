"""Plans to begin a search with, and changes at large: priced tours, insertion, rebuilds."""
