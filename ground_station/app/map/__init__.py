"""The live map's feed: fleet messages and store content, as one picture for the page."""
