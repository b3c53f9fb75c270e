"""Routes on the waypoint graph and the energy of their legs. Imports wind and below."""
