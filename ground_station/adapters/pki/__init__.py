"""Public key infrastructure of a fleet: its authority, and the folder of each member."""
