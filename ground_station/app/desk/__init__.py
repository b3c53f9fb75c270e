"""The running desk: exchange with the fleet, a dispatcher, re-planning beside it."""
