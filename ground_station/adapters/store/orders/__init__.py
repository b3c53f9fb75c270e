"""What people change of an order, its history, and drones out of service."""
