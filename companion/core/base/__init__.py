"""What every room uses: errors, geodesy, documents, array types. Imports nothing of ours."""
