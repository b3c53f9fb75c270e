"""The live map's feed: what the fleet says and the store holds, as one picture for the page."""
