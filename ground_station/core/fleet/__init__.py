"""The members of the fleet as the desk sees them, and the interface of their network."""
