"""The outside world: files, the store, zenoh, MAVSDK, an LLM, the clock."""
