"""A past day on the map: any moment, rebuilt from the store's times and the flights' records."""
