"""The roles of a fleet's members; loads nothing, so that a command line can list them."""

from enum import Enum


class Role(Enum):
    """What a member may do."""

    DESK = "desk"
    ROUTER = "router"
    VEHICLE = "vehicle"
    TRUCK = "truck"
    STATION = "station"
    SUPERVISOR = "supervisor"
    DISPATCHER = "dispatcher"
    VIEWER = "viewer"
    NEIGHBOUR = "neighbour"


COMMANDS = frozenset({Role.DESK, Role.SUPERVISOR, Role.DISPATCHER})
"""Whose commands a vehicle takes."""

TELLS_WIND = frozenset({Role.DESK})
"""Whose word of the winds that others feel a vehicle takes: a desk hears and checks them all."""

SPEAKS = frozenset({Role.VEHICLE, Role.TRUCK})
"""Who has a state, events, results and a track of its own."""

MEASURES = frozenset({Role.STATION})
"""Who tells the wind of a fixed place, and nothing else."""

NEIGHBOURS = frozenset({Role.NEIGHBOUR})
"""Another fleet's desk, under that fleet's name: it hears our vehicles' tracks and nothing else,
and our vehicles may hear that fleet's tracks.
"""

LISTENS = frozenset({Role.DESK, Role.ROUTER})
"""Whom the others call: only their certificates are for a server."""
