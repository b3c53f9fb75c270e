"""Pads of drones at a stop: rings around the truck, each drone on the side of its destination."""

import math
from dataclasses import dataclass, field

import shapely

from companion.core.base.geo import Ned, ObstacleMap

PAD_SPACING_M = 21.0
"""Spacing for two drones that climb and descend at once: 20 m, and 1 m for placement."""
FIRST_RING_PADS = 8
MIN_RADIUS_M = 15.0
"""Minimum distance from the truck, where people work."""
RING_COUNT = 3


def first_ring_radius_m() -> float:
    """Return the first ring's radius, at which neighbours are `PAD_SPACING_M` from each other."""
    return max(MIN_RADIUS_M, PAD_SPACING_M / (2.0 * math.sin(math.pi / FIRST_RING_PADS)))


def unobstructed_pad_positions(stop_ned_m: Ned, obstacles: ObstacleMap) -> list[Ned]:
    """Return pad positions, nearest ring first, clear of all obstacles around the stop."""
    inflated_outlines = obstacles.buffered_outlines_at(0.0)
    found: list[Ned] = []
    for ring in range(RING_COUNT):
        radius_m = first_ring_radius_m() + ring * PAD_SPACING_M
        count = int(math.pi / math.asin(PAD_SPACING_M / (2.0 * radius_m)) + 1e-9)
        for number in range(count):
            angle = 2.0 * math.pi * number / count
            north = stop_ned_m[0] + radius_m * math.cos(angle)
            east = stop_ned_m[1] + radius_m * math.sin(angle)
            if not any(
                shapely.intersects_xy(outline, north, east) for outline in inflated_outlines
            ):
                found.append((north, east, stop_ned_m[2]))
    return found


@dataclass(slots=True)
class StopPads:
    """The pads of one stop and their drones."""

    stop_ned_m: Ned
    positions: list[Ned]
    pad_by_drone: dict[str, Ned] = field(default_factory=dict[str, Ned])

    def pads_ranked_by_route_angle_rad(
        self, drone: str, destination_ned_m: Ned
    ) -> list[tuple[float, Ned]]:
        """Return the pads that this drone has or could get, with their angles off the direct route,
        rad; smallest first.
        """
        if drone in self.pad_by_drone:
            return [
                (
                    self._route_angle_off_pad_bearing_rad(
                        self.pad_by_drone[drone], destination_ned_m
                    ),
                    self.pad_by_drone[drone],
                )
            ]
        occupied = set(self.pad_by_drone.values())
        free = [position for position in self.positions if position not in occupied]
        inner_pads = free[: max(FIRST_RING_PADS - len(occupied), 0)] or free
        return sorted(
            (self._route_angle_off_pad_bearing_rad(position, destination_ned_m), position)
            for position in inner_pads
        )

    def _route_angle_off_pad_bearing_rad(self, pad: Ned, destination_ned_m: Ned) -> float:
        """Return the angle by which the route from the pad turns back over stop and pads."""
        pad_bearing_rad = math.atan2(pad[1] - self.stop_ned_m[1], pad[0] - self.stop_ned_m[0])
        route_bearing_rad = math.atan2(destination_ned_m[1] - pad[1], destination_ned_m[0] - pad[0])
        return abs((route_bearing_rad - pad_bearing_rad + math.pi) % (2.0 * math.pi) - math.pi)
