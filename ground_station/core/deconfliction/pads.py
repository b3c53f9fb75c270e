"""Pads of drones at a stop: rings around the truck, each drone on the side that it flies to."""

import math
from dataclasses import dataclass, field

import shapely

from companion.core.base.geo import Ned, ObstacleMap

PAD_APART_M = 21.0
"""Two drones may climb and descend at once: 20 m between them, and 1 m for placing a pad by
hand."""
RING_PADS = 8
LEAST_RADIUS_M = 15.0
"""Least distance from the truck, where people work."""
RINGS = 3


def ring_radius_m() -> float:
    """The first ring's radius: neighbours stand `PAD_APART_M` apart."""
    return max(LEAST_RADIUS_M, PAD_APART_M / (2.0 * math.sin(math.pi / RING_PADS)))


def pad_places(stop_ned_m: Ned, obstacles: ObstacleMap) -> list[Ned]:
    """Places for pads, nearest ring first, clear of all obstacles around the stop."""
    grown = obstacles.grown_at(0.0)
    found: list[Ned] = []
    for ring in range(RINGS):
        radius_m = ring_radius_m() + ring * PAD_APART_M
        count = int(math.pi / math.asin(PAD_APART_M / (2.0 * radius_m)) + 1e-9)
        for number in range(count):
            angle = 2.0 * math.pi * number / count
            north = stop_ned_m[0] + radius_m * math.cos(angle)
            east = stop_ned_m[1] + radius_m * math.sin(angle)
            if not any(shapely.intersects_xy(outline, north, east) for outline in grown):
                found.append((north, east, stop_ned_m[2]))
    return found


@dataclass(slots=True)
class StopPads:
    """The pads of one stop, and which drone has which."""

    stop_ned_m: Ned
    places: list[Ned]
    of: dict[str, Ned] = field(default_factory=dict[str, Ned])

    def best(self, drone: str, to_ned_m: Ned) -> tuple[float, Ned] | None:
        """The pad that this drone has or would get, and its angle off the direct way, rad."""
        return next(iter(self.ranked(drone, to_ned_m)), None)

    def ranked(self, drone: str, to_ned_m: Ned) -> list[tuple[float, Ned]]:
        """The pads that this drone has or could get, with their angles off the direct way, rad;
        the least first.
        """
        if drone in self.of:
            return [(self._off_rad(self.of[drone], to_ned_m), self.of[drone])]
        taken = set(self.of.values())
        free = [place for place in self.places if place not in taken]
        near = free[: max(RING_PADS - len(taken), 0)] or free
        return sorted((self._off_rad(place, to_ned_m), place) for place in near)

    def _off_rad(self, pad: Ned, to_ned_m: Ned) -> float:
        """How far the way from the pad turns back over the stop and the other pads."""
        out = math.atan2(pad[1] - self.stop_ned_m[1], pad[0] - self.stop_ned_m[0])
        way = math.atan2(to_ned_m[1] - pad[1], to_ned_m[0] - pad[0])
        return abs((way - out + math.pi) % (2.0 * math.pi) - math.pi)
