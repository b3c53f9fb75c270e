"""Dispatch decisions: assignment from the depot, rules of a day with a truck, re-planning."""
