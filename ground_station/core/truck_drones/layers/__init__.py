"""The separation rule in the search: pads, layers, and airborne sorties in a changed plan."""
