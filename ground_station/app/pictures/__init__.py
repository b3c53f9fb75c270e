"""Pictures of plans. matplotlib is imported only here."""
