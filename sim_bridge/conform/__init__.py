"""A conformance suite over MAVLink that observes the behaviour of a vehicle at any endpoint.

Its client uses pymavlink and shares no code with this project's simulated autopilots or companion,
so it tests both, and real autopilots, in the same way.
"""
