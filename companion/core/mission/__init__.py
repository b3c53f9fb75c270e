"""Events, actions, flight file, mission items. Imports separation and what is below it."""
