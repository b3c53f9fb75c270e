"""The live map's page in a headless browser: its picture for the documents, its frame rate."""
