"""Common base: errors, geodesy, documents, array types. Imports no other project package."""
