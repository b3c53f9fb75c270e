"""The wind over a site, from what all members feel. Imports wind and base."""
