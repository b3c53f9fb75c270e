"""Flight programs on the vehicle: loop, standby, recorder. No import of `companion.analysis`."""
