"""Recorded flights through the estimators and the gate. What flies never imports this room."""
