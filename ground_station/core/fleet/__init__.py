"""The members of the fleet as the desk receives them, and the interface of their network."""
