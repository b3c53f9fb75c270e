"""What is exported: a planned mission with its site, and the track of a flight."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from companion.core.base.geo import LocalFrame, Ned, ObstacleMap
from companion.core.mission.flight_plan import FlightPlan
from companion.core.mission.mission_commands import COMMAND, params_of
from companion.core.mission.mission_items import MissionItem, Spot


class GeoPoint(NamedTuple):
    """A point: degrees, metres above mean sea level."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class NamedPoint:
    """A ground point with a name; `kind` says what it is to the flight."""

    name: str
    kind: str
    point: GeoPoint


@dataclass(frozen=True, slots=True)
class Area:
    """An obstacle's outline: (latitude, longitude) in degrees, not closed.

    `height_m` is its top above the depot; None: a no-fly area, which no height clears. `in_fence`:
    it stands as high as the mission flies, so that a geofence may exclude it at all heights.
    `floor_m`: where a geo-zone begins above the depot; None: on the ground.
    """

    name: str
    ring_deg: tuple[tuple[float, float], ...]
    height_m: float | None
    in_fence: bool
    floor_m: float | None = None


@dataclass(frozen=True, slots=True)
class CommandItem:
    """A MAVLink mission item; `spot` is None without a place, heights are above home."""

    command: int
    params: tuple[float, float, float, float]
    spot: Spot | None


@dataclass(frozen=True, slots=True)
class RallyPoint:
    """Where an autopilot may return to instead of home, and how high above home it arrives."""

    name: str
    spot: Spot


@dataclass(frozen=True, slots=True)
class MissionExport:
    """One mission: its places, its way out and home, and the items that go aboard.

    Jumps in `items` lead to items numbered from 1, as `.plan` and QGC WPL files number them.
    """

    name: str
    home: GeoPoint
    speed_mps: float
    items: tuple[CommandItem, ...]
    outbound: tuple[GeoPoint, ...]
    homeward: tuple[GeoPoint, ...]
    places: tuple[NamedPoint, ...]
    rally: tuple[RallyPoint, ...]
    areas: tuple[Area, ...]


class TrackPoint(NamedTuple):
    """Where a vehicle was; `utc_s`: seconds since 1970, None where the log does not tell."""

    point: GeoPoint
    utc_s: float | None


@dataclass(frozen=True, slots=True)
class TrackExport:
    """The track of a flight, in the order of its times."""

    name: str
    points: tuple[TrackPoint, ...]


def mission_export(flown: FlightPlan, name: str, *, free_yaw: float = math.nan) -> MissionExport:
    """The mission of a planned flight. `free_yaw`: how the autopilot is told to choose its heading
    (NaN; ArduPilot keeps 0 in its place).
    """
    mission, site = flown.mission, flown.site
    home = _geo(site.frame, (0.0, 0.0, 0.0))

    def above(spot: Spot | None) -> GeoPoint:
        assert spot is not None, "only items with a place are asked for theirs"
        return GeoPoint(spot.lat_deg, spot.lon_deg, home.alt_amsl_m + spot.height_rel_m)

    def way(items: Sequence[int]) -> tuple[GeoPoint, ...]:
        return tuple(above(mission.items[index].spot) for index in items)

    placed = [item.spot for item in mission.items if item.spot is not None]
    highest_m = max(spot.height_rel_m for spot in placed)
    return MissionExport(
        name=name,
        home=home,
        speed_mps=flown.plan.home_ground_speed_mps,
        items=tuple(_command(item, free_yaw) for item in mission.items),
        outbound=way((mission.takeoff, *mission.outbound, mission.deliver)),
        homeward=way((mission.deliver, *mission.returning, mission.land)),
        places=_places(flown),
        rally=tuple(
            RallyPoint(landing.name, spot)
            for landing, (over, _) in zip(flown.plan.sites, mission.rally, strict=True)
            if (spot := mission.items[over].spot) is not None
        ),
        areas=_areas(site.frame, site.obstacles, highest_m),
    )


def _command(item: MissionItem, free_yaw: float) -> CommandItem:
    return CommandItem(COMMAND[item.kind], params_of(item, 1, free_yaw), item.spot)


def _places(flown: FlightPlan) -> tuple[NamedPoint, ...]:
    plan, frame = flown.plan, flown.site.frame
    away = flown.site.home_is_away
    found = [NamedPoint("launch", "launch" if away else "launch and home", _geo(frame, (0, 0, 0)))]
    if away:
        found.append(NamedPoint(flown.site.home or "home", "home", _geo(frame, plan.landing_ned_m)))
    found.append(NamedPoint("customer", "customer", _geo(frame, plan.customer_ned_m)))
    found += [NamedPoint(s.name, "rally point", _geo(frame, s.ground_ned_m)) for s in plan.sites]
    return tuple(found)


def _areas(frame: LocalFrame, obstacles: ObstacleMap, highest_m: float) -> tuple[Area, ...]:
    found: list[Area] = []
    for obstacle in obstacles.obstacles:
        ring = [_geo(frame, (north, east, 0.0)) for north, east in obstacle.ring_ne_m]
        if ring[0] == ring[-1]:
            ring.pop()
        found.append(
            Area(
                obstacle.name,
                tuple((point.lat_deg, point.lon_deg) for point in ring),
                None if math.isinf(obstacle.height_m) else obstacle.height_m,
                obstacle.height_m + obstacles.clearance_up_m > highest_m
                and not obstacles.flown_under(obstacle),
                None if math.isinf(obstacle.floor_m) else obstacle.floor_m,
            )
        )
    return tuple(found)


def _geo(frame: LocalFrame, ned_m: Ned) -> GeoPoint:
    lat_rad, lon_rad, alt_amsl_m = frame.to_geodetic(ned_m)
    # As mission items keep them: 1e-7 degrees.
    return GeoPoint(
        round(math.degrees(lat_rad), 7), round(math.degrees(lon_rad), 7), round(alt_amsl_m, 2)
    )
