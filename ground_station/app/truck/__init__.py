"""The truck's side: its member of the fleet, and the driver's terminal."""
