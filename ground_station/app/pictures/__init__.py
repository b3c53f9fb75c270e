"""Pictures of plans. Only this package imports matplotlib."""
