"""Initial plans of a search, and large changes: priced tours, insertion, rebuilds."""
