"""Feasibility of deliveries by the energy model of the vehicle."""
