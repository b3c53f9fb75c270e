"""A conformance suite over MAVLink: what the vehicle behind any endpoint does.

It has its own client on pymavlink and shares no code with our simulated autopilots or with our
companion, so that it judges both, and real autopilots, in the same way.
"""
