"""Routes on the waypoint graph and what their legs cost. Imports wind and below."""
