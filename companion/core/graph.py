"""Row 4: the directed waypoint graph of one site, and what its edges cost in wind."""

from dataclasses import dataclass

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from companion.core.geo import LocalFrame, Ned, ObstacleMap

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SiteMap:
    """The site in the local frame. Ground points: down is minus the ground's height."""

    frame: LocalFrame
    depot_ned_m: Ned
    customer_ned_m: Ned
    rally_ned_m: tuple[tuple[str, Ned], ...]
    obstacles: ObstacleMap


@dataclass(frozen=True, slots=True)
class WaypointGraph:
    """Vertices (n, 3) NED at cruise height; directed edges as index arrays.

    `depot`, `customer` and `rally` are vertex indices (rally in the site's order).
    """

    vertices_ned_m: FloatArray
    tail: NDArray[np.int64]
    head: NDArray[np.int64]
    depot: int
    customer: int
    rally: tuple[int, ...]

    def to_networkx(self) -> "nx.DiGraph[int]":
        """The same graph with `length_m` on its edges, to check and to draw."""
        raise NotImplementedError


def build_graph(site: SiteMap, cruise_height_m: float, leg_length_m: float) -> WaypointGraph:
    """Waypoints no further than `leg_length_m` apart that keep clear of every obstacle.

    Raises LeewayError when depot or customer stand inside an obstacle's clearance.
    """
    raise NotImplementedError
