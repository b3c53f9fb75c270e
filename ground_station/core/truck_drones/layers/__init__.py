"""The separation rule inside the search: pads, layers, and who is in the air in a changed plan."""
