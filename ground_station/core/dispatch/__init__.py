"""What to do next: assignment from the depot, rules of a day with a truck, re-planning."""
