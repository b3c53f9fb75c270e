"""A wind process fitted to wind recordings. What flies never imports this room."""
