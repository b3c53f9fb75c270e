"""Geofences: cylinder, polygons and circles, and which of them a position breaches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from sim_bridge.autopilot.base.geodesy import LocalFrame
from sim_bridge.autopilot.mavlink.enums import Cmd
from sim_bridge.autopilot.mission.items import MissionItem
from sim_bridge.autopilot.state import VehicleState

PointNE = tuple[float, float]


_VERTICES = (
    Cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    Cmd.NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)


class Breach(Enum):
    """Type of a breach, by its MAVLink FENCE_BREACH number."""

    MAX_HEIGHT = 2
    BOUNDARY = 3


@dataclass(frozen=True, slots=True)
class Area:
    """A polygon (or a circle, by its radius about one vertex) to stay in, or out of."""

    vertices_ne_m: tuple[PointNE, ...]
    radius_m: float | None
    is_inclusion: bool

    def contains(self, point_ne_m: PointNE) -> bool:
        """Return True if a point is inside."""
        if self.radius_m is not None:
            return math.dist(point_ne_m, self.vertices_ne_m[0]) <= self.radius_m
        return _is_in_polygon(point_ne_m, self.vertices_ne_m)


def _is_in_polygon(point: PointNE, vertices: Sequence[PointNE]) -> bool:
    """Crossing-number test; the boundary belongs to either side."""
    north, east = point
    inside = False
    previous = vertices[-1]
    for vertex in vertices:
        (n0, e0), (n1, e1) = previous, vertex
        if (e0 > east) != (e1 > east) and north < (n1 - n0) * (east - e0) / (e1 - e0) + n0:
            inside = not inside
        previous = vertex
    return inside


def fence_areas_from_items(
    items: Sequence[MissionItem], local_frame: LocalFrame
) -> tuple[Area, ...]:
    """The areas of a stored fence; an incomplete polygon is left out."""
    areas: list[Area] = []
    vertices: list[PointNE] = []
    for item in items:
        point = local_frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
        is_inclusion = item.command in (
            Cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION,
            Cmd.NAV_FENCE_CIRCLE_INCLUSION,
        )
        if item.command in (Cmd.NAV_FENCE_CIRCLE_INCLUSION, Cmd.NAV_FENCE_CIRCLE_EXCLUSION):
            areas.append(Area((point,), item.param1, is_inclusion))
        elif item.command in _VERTICES:
            vertices.append(point)
            if len(vertices) >= max(int(item.param1), 3):
                areas.append(Area(tuple(vertices), None, is_inclusion))
                vertices = []
    return tuple(areas)


@dataclass(frozen=True, slots=True)
class Fence:
    """All limits of the flight; None for no limit."""

    areas: tuple[Area, ...] = ()
    radius_m: float | None = None
    height_m: float | None = None

    @property
    def is_empty(self) -> bool:
        """Return True without any limit."""
        return not self.areas and self.radius_m is None and self.height_m is None

    def breach_at(
        self, point_ne_m: PointNE, home_ne_m: PointNE, height_above_home_m: float
    ) -> Breach | None:
        """Return the breach at a position; `height_above_home_m` is above home.

        With several inclusion areas, one is sufficient (PX4); ArduPilot requires all unless
        FENCE_OPTIONS differs, and usually there is one.
        """
        if self.height_m is not None and height_above_home_m > self.height_m:
            return Breach.MAX_HEIGHT
        if self.radius_m is not None and math.dist(point_ne_m, home_ne_m) > self.radius_m:
            return Breach.BOUNDARY
        inclusions = [area for area in self.areas if area.is_inclusion]
        if inclusions and not any(area.contains(point_ne_m) for area in inclusions):
            return Breach.BOUNDARY
        if any(area.contains(point_ne_m) for area in self.areas if not area.is_inclusion):
            return Breach.BOUNDARY
        return None


class Geofence:
    """The fence in force, and whether the vehicle breaches it."""

    def __init__(self, state: VehicleState) -> None:
        self._state = state
        self.fence = Fence()

    def current_vehicle_breach(self) -> Breach | None:
        """Return the vehicle's current breach; None on the ground or without a position."""
        state = self._state
        if self.fence.is_empty or state.is_landed or not state.has_position:
            return None
        north, east, _ = state.pos_ned_m
        home = state.home_ned_m
        return self.fence.breach_at((north, east), (home[0], home[1]), state.height_above_home_m)
