"""The dispatcher's desk. `core` decides, `adapters` move bytes, `app` puts them together."""
