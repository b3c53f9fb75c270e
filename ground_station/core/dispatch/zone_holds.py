"""Launches that geo-zones forbid now: the flight would be inside a zone while it is in force.

A vehicle plans its route around every zone that is in force in the hours that its flight states.
Other zones it may cross. A launch so late that the flight would still be out when such a zone comes
into force is held.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import shapely

from companion.core.base.geo import Obstacle
from companion.core.base.geo_zones import (
    NO_RESTRICTION,
    GeoZone,
    ZoneAuthorisation,
    is_geo_zone_feature,
    parse_geo_zone,
)
from companion.core.base.obstacle_document import document_features
from companion.core.base.zone_times import UtcSpan
from companion.core.mission.flight_plan import (
    AVOIDANCE_LEVELS,
    AVOIDANCE_STEP_M,
    CLEARANCE_M,
    VERTICAL_CLEARANCE_M,
    depot_frame,
)
from ground_station.core.schema.day_data import DayData
from ground_station.core.weather.forecast_field import format_utc

STEP_S, HORIZON_S = 300.0, 86_400.0
"""Step and horizon of the search for the end of a zone's hours."""

RoutePoints = Sequence[tuple[float, float]]
"""Positions (north, east) in metres about the depot."""


@dataclass(frozen=True, slots=True)
class ZoneHold:
    """Reason of a hold by a zone: its name, and its end (Unix seconds; None: a day or longer)."""

    zone: str
    until_s: float | None

    @property
    def reason_text(self) -> str:
        """Reason as text."""
        until = (
            "for a day or longer" if self.until_s is None else f"until {format_utc(self.until_s)}"
        )
        return f"zone {self.zone} is or will be in force during its flight; {until}"


class ZoneHoldRules:
    """The zones of a day that its flights may cross only because of their hours."""

    def __init__(self, data: DayData) -> None:
        zone_conditions = data.day.mission.zone_authorisation
        frame = depot_frame(data.day.depot.location)
        features = document_features(data.no_fly or {}) or []
        zones = [
            parse_geo_zone(i, one) for i, one in enumerate(features) if is_geo_zone_feature(one)
        ]
        self._zones: list[tuple[GeoZone, list[Obstacle]]] = [
            (zone, zone.obstacle_prisms(frame, None))
            for zone in zones
            if _is_crossable_by_time_only(zone, zone_conditions)
        ]
        self._authorised = zone_conditions.authorised

    def __bool__(self) -> bool:
        return bool(self._zones)

    def find_zone_hold(
        self, route: RoutePoints, max_height_m: float, flight_duration_s: float, now_s: float
    ) -> ZoneHold | None:
        """Return the hold of a launch now; None: no zone forbids it. `max_height_m`: greatest
        height of the flight above the depot, `flight_duration_s`: maximum time in the air, `now_s`:
        Unix seconds.
        """
        found: ZoneHold | None = None
        for zone, prisms in self._zones:
            if not self._is_in_force_during_flight(
                zone, now_s, flight_duration_s
            ) or not _is_route_too_close_to_prism(route, max_height_m, prisms):
                continue
            hold = ZoneHold(
                prisms[0].name, self._first_permitted_launch_s(zone, now_s, flight_duration_s)
            )
            if found is None or _ends_later(hold, found):
                found = hold
        return found

    def _is_in_force_during_flight(
        self, zone: GeoZone, launch_s: float, flight_duration_s: float
    ) -> bool:
        zone_conditions = ZoneAuthorisation(
            self._authorised, UtcSpan(launch_s, launch_s + flight_duration_s)
        )
        return not zone.exemption_reason(zone_conditions)

    def _first_permitted_launch_s(
        self, zone: GeoZone, now_s: float, flight_duration_s: float
    ) -> float | None:
        """Return the time of the first launch, in whole steps, that the zone permits."""
        first = math.floor(now_s / STEP_S) + 1
        for step in range(int(HORIZON_S / STEP_S)):
            at_s = (first + step) * STEP_S
            if not self._is_in_force_during_flight(zone, at_s, flight_duration_s):
                return at_s
        return None


def _is_crossable_by_time_only(zone: GeoZone, zone_conditions: ZoneAuthorisation) -> bool:
    """Return True if flights may cross the zone only because of their stated hours."""
    untimed_conditions = ZoneAuthorisation(zone_conditions.authorised, None)
    return (
        zone.restriction != NO_RESTRICTION
        and bool(zone.exemption_reason(zone_conditions))
        and not zone.exemption_reason(untimed_conditions)
    )


def _is_route_too_close_to_prism(
    route: RoutePoints, max_height_m: float, prisms: Sequence[Obstacle]
) -> bool:
    """Return True if a route comes too close to a prism and is not below it."""
    line = shapely.LineString(route) if len(set(route)) > 1 else shapely.Point(route[0])
    top_clearance_m = max_height_m + max(AVOIDANCE_LEVELS) * AVOIDANCE_STEP_M + VERTICAL_CLEARANCE_M
    return any(
        prism.bottom_m < top_clearance_m
        and line.distance(shapely.Polygon(prism.ring_ne_m)) < CLEARANCE_M
        for prism in prisms
    )


def _ends_later(hold: ZoneHold, reference_hold: ZoneHold) -> bool:
    if hold.until_s is None or reference_hold.until_s is None:
        return hold.until_s is None and reference_hold.until_s is not None
    return hold.until_s > reference_hold.until_s
