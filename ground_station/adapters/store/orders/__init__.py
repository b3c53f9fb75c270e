"""What people change of an order, and its history."""
