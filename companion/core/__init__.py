"""The pure core: events and state in, actions out; no I/O, no clock, no threads.

Rooms, each importing only those below it: pilot, mission, separation, return_budget, routing, wind,
vehicle, base. Above the pilot, for what looks back at flights: replay, calibration, wind_fit.
"""
