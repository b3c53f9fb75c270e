"""The roles of a fleet's members; imports nothing, so that a command line can list them."""

from enum import Enum


class Role(Enum):
    """The role of a member."""

    DESK = "desk"
    ROUTER = "router"
    VEHICLE = "vehicle"
    TRUCK = "truck"
    STATION = "station"
    SUPERVISOR = "supervisor"
    DISPATCHER = "dispatcher"
    VIEWER = "viewer"
    NEIGHBOUR = "neighbour"


COMMANDERS = frozenset({Role.DESK, Role.SUPERVISOR, Role.DISPATCHER})
"""Roles whose commands a vehicle accepts."""

WIND_PUBLISHERS = frozenset({Role.DESK})
"""Roles whose winds, as measured by others, a vehicle accepts: a desk checks all of them."""

STATE_PUBLISHERS = frozenset({Role.VEHICLE, Role.TRUCK})
"""Roles with a state, events, results and a track."""

WIND_STATIONS = frozenset({Role.STATION})
"""Roles that publish the wind of a fixed site, and nothing else."""

NEIGHBOURS = frozenset({Role.NEIGHBOUR})
"""Another fleet's desk, under that fleet's name: it receives this fleet's tracks and nothing else,
and this fleet's vehicles may receive that fleet's tracks.
"""

SERVERS = frozenset({Role.DESK, Role.ROUTER})
"""Roles to which other members connect: only their certificates are valid for a server."""
