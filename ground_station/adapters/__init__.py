"""I/O of the ground station: files, the store, zenoh, MAVSDK, an LLM, the clock."""
