"""Data for export: a planned mission with its site, and the track of a flight."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from companion.core.base.geo import LocalFrame, Ned, ObstacleMap
from companion.core.mission.flight_plan import FlightPlan
from companion.core.mission.mission_commands import MAV_COMMANDS, mavlink_params_1_to_4
from companion.core.mission.mission_items import MissionItem, MissionPosition


class GeoPoint(NamedTuple):
    """A point: degrees, metres above mean sea level."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class NamedPoint:
    """A ground point with a name; `kind` is its role in the flight."""

    name: str
    kind: str
    point: GeoPoint


@dataclass(frozen=True, slots=True)
class Area:
    """An obstacle's outline: (latitude, longitude) in degrees, not closed.

    `height_m` is its top above the depot; None: a no-fly area of unlimited height. `in_fence`: as
    high as the mission, so that a geofence may exclude it at all heights. `bottom_m`: lower limit
    of a geo-zone above the depot; None: on the ground.
    """

    name: str
    ring_deg: tuple[tuple[float, float], ...]
    height_m: float | None
    in_fence: bool
    bottom_m: float | None = None


@dataclass(frozen=True, slots=True)
class CommandItem:
    """A MAVLink mission item; `spot` is None without a position, heights are above home."""

    command: int
    params: tuple[float, float, float, float]
    spot: MissionPosition | None


@dataclass(frozen=True, slots=True)
class RallyPoint:
    """An alternative return point of the autopilot, with its arrival height above home."""

    name: str
    spot: MissionPosition


@dataclass(frozen=True, slots=True)
class MissionExport:
    """One mission: its locations, its routes out and home, and the items to upload.

    Jumps in `items` lead to items numbered from 1, as `.plan` and QGC WPL files number them.
    """

    name: str
    home: GeoPoint
    speed_mps: float
    items: tuple[CommandItem, ...]
    outbound: tuple[GeoPoint, ...]
    homeward: tuple[GeoPoint, ...]
    locations: tuple[NamedPoint, ...]
    rally: tuple[RallyPoint, ...]
    areas: tuple[Area, ...]


class TrackPoint(NamedTuple):
    """A recorded position; `utc_s`: seconds since 1970, None if not in the log."""

    point: GeoPoint
    utc_s: float | None


@dataclass(frozen=True, slots=True)
class TrackExport:
    """The track of a flight, in order of time."""

    name: str
    points: tuple[TrackPoint, ...]


def build_mission_export(
    flight_plan: FlightPlan, name: str, *, free_yaw_value: float = math.nan
) -> MissionExport:
    """Return the mission of a planned flight. `free_yaw_value`: value that lets the autopilot
    choose its heading (NaN; ArduPilot stores 0 instead)."""
    mission, site = flight_plan.mission, flight_plan.site
    home = _to_rounded_geo_point(site.frame, (0.0, 0.0, 0.0))

    def to_amsl_point(spot: MissionPosition | None) -> GeoPoint:
        assert spot is not None, "expected an item with a position"
        return GeoPoint(spot.lat_deg, spot.lon_deg, home.alt_amsl_m + spot.height_rel_m)

    def points_of_items(item_indices: Sequence[int]) -> tuple[GeoPoint, ...]:
        return tuple(to_amsl_point(mission.items[index].spot) for index in item_indices)

    positions = [item.spot for item in mission.items if item.spot is not None]
    highest_m = max(spot.height_rel_m for spot in positions)
    return MissionExport(
        name=name,
        home=home,
        speed_mps=flight_plan.plan.home_ground_speed_mps,
        items=tuple(_to_command_item(item, free_yaw_value) for item in mission.items),
        outbound=points_of_items((mission.takeoff, *mission.outbound, mission.deliver)),
        homeward=points_of_items((mission.deliver, *mission.returning, mission.land)),
        locations=_named_locations(flight_plan),
        rally=tuple(
            RallyPoint(landing.name, spot)
            for landing, (over, _) in zip(
                flight_plan.plan.uploaded_sites_except_return_end, mission.rally, strict=True
            )
            if (spot := mission.items[over].spot) is not None
        ),
        areas=_areas_of_obstacles(site.frame, site.obstacles, highest_m),
    )


def _to_command_item(item: MissionItem, free_yaw_value: float) -> CommandItem:
    return CommandItem(
        MAV_COMMANDS[item.kind], mavlink_params_1_to_4(item, 1, free_yaw_value), item.spot
    )


def _named_locations(flight_plan: FlightPlan) -> tuple[NamedPoint, ...]:
    plan, frame = flight_plan.plan, flight_plan.site.frame
    away = flight_plan.site.home_differs_from_launch_pad
    found = [
        NamedPoint(
            "launch",
            "launch" if away else "launch and home",
            _to_rounded_geo_point(frame, (0, 0, 0)),
        )
    ]
    if away:
        found.append(
            NamedPoint(
                flight_plan.site.home or "home",
                "home",
                _to_rounded_geo_point(frame, plan.return_route_end_ground_ned_m),
            )
        )
    found.append(
        NamedPoint("customer", "customer", _to_rounded_geo_point(frame, plan.customer_ned_m))
    )
    found += [
        NamedPoint(s.name, "rally point", _to_rounded_geo_point(frame, s.ground_ned_m))
        for s in plan.uploaded_sites_except_return_end
    ]
    return tuple(found)


def _areas_of_obstacles(
    frame: LocalFrame, obstacle_map: ObstacleMap, highest_waypoint_m: float
) -> tuple[Area, ...]:
    found: list[Area] = []
    for obstacle in obstacle_map.obstacles:
        ring = [
            _to_rounded_geo_point(frame, (north, east, 0.0)) for north, east in obstacle.ring_ne_m
        ]
        if ring[0] == ring[-1]:
            ring.pop()
        found.append(
            Area(
                obstacle.name,
                tuple((point.lat_deg, point.lon_deg) for point in ring),
                None if math.isinf(obstacle.height_m) else obstacle.height_m,
                obstacle.height_m + obstacle_map.clearance_up_m > highest_waypoint_m
                and not obstacle_map.is_flown_under(obstacle),
                None if math.isinf(obstacle.bottom_m) else obstacle.bottom_m,
            )
        )
    return tuple(found)


def _to_rounded_geo_point(frame: LocalFrame, ned_m: Ned) -> GeoPoint:
    lat_rad, lon_rad, alt_amsl_m = frame.to_geodetic(ned_m)
    # Resolution of mission items: 1e-7 degrees.
    return GeoPoint(
        round(math.degrees(lat_rad), 7), round(math.degrees(lon_rad), 7), round(alt_amsl_m, 2)
    )
