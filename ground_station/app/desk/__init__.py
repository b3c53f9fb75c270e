"""The running desk: exchange with the fleet, a dispatcher, re-planning in a separate process."""
