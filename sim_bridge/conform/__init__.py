"""What a vehicle does, asked over MAVLink: a conformance suite for any endpoint.

A client of its own on pymavlink. It knows neither our simulated autopilots nor our companion, so
that it tells the truth about both and about real autopilots alike.
"""
