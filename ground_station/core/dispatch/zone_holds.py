"""Launches that geo-zones forbid now: a flight, drawn out, that would be in one while it is in
force.

A vehicle leads its way round every zone that is in force in the hours that its flight states. What
is left are zones that it passes because they are not: a launch so late that it would still be out
when such a zone begins is held.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import shapely

from companion.core.base.geo import Obstacle
from companion.core.base.geo_zones import FREE, GeoZone, ZoneTerms, is_zone, zone_of
from companion.core.base.obstacle_document import features_of
from companion.core.base.zone_times import UtcSpan
from companion.core.mission.flight_plan import (
    CLEARANCE_M,
    CLEARANCE_UP_M,
    DODGE_M,
    DODGES,
    frame_at,
)
from ground_station.core.schema.day_data import DayData
from ground_station.core.weather.forecast_field import utc_words

STEP_S, MOST_S = 300.0, 86_400.0
"""The end of a zone's hours is looked for in such steps, for a day."""

Way = Sequence[tuple[float, float]]
"""Places (north, east) in metres about the depot."""


@dataclass(frozen=True, slots=True)
class ZoneHeld:
    """Why a launch is held by a zone: its name, and until when (Unix seconds; None: for a day or
    longer).
    """

    zone: str
    until_s: float | None

    @property
    def words(self) -> str:
        """For people."""
        until = (
            "for a day or longer" if self.until_s is None else f"until {utc_words(self.until_s)}"
        )
        return f"zone {self.zone} is or comes in force while it would be out; {until}"


class ZoneHolds:
    """The zones of a day that its flights pass for their hours only."""

    def __init__(self, data: DayData) -> None:
        terms = data.day.mission.zone_terms
        frame = frame_at(data.day.depot.place)
        features = features_of(data.no_fly or {}) or []
        zones = [zone_of(i, one) for i, one in enumerate(features) if is_zone(one)]
        self._zones: list[tuple[GeoZone, list[Obstacle]]] = [
            (zone, zone.prisms(frame, None)) for zone in zones if _is_passed_now_only(zone, terms)
        ]
        self._authorised = terms.authorised

    def __bool__(self) -> bool:
        return bool(self._zones)

    def held(self, way: Way, highest_m: float, out_s: float, now_s: float) -> ZoneHeld | None:
        """Why a launch now is held. `highest_m`: of its flight above the depot, `out_s`: how long
        it may be out at most, `now_s` Unix seconds. None: no zone forbids it.
        """
        found: ZoneHeld | None = None
        for zone, prisms in self._zones:
            if not self._in_force(zone, now_s, out_s) or not _meets(way, highest_m, prisms):
                continue
            held = ZoneHeld(prisms[0].name, self._ends_s(zone, now_s, out_s))
            if found is None or _later(held, found):
                found = held
        return found

    def _in_force(self, zone: GeoZone, from_s: float, for_s: float) -> bool:
        terms = ZoneTerms(self._authorised, UtcSpan(from_s, from_s + for_s))
        return not zone.passed(terms)

    def _ends_s(self, zone: GeoZone, now_s: float, out_s: float) -> float | None:
        """The first launch, by whole steps, that it lets go."""
        first = math.floor(now_s / STEP_S) + 1
        for step in range(int(MOST_S / STEP_S)):
            at_s = (first + step) * STEP_S
            if not self._in_force(zone, at_s, out_s):
                return at_s
        return None


def _is_passed_now_only(zone: GeoZone, terms: ZoneTerms) -> bool:
    """Whether flights pass it because it is not in force in the hours that they state."""
    always = ZoneTerms(terms.authorised, None)
    return zone.restriction != FREE and bool(zone.passed(terms)) and not zone.passed(always)


def _meets(way: Way, highest_m: float, prisms: Sequence[Obstacle]) -> bool:
    """Whether a way comes too near a prism that it does not stay under."""
    line = shapely.LineString(way) if len(set(way)) > 1 else shapely.Point(way[0])
    reach_m = highest_m + max(DODGES) * DODGE_M + CLEARANCE_UP_M
    return any(
        prism.floor_m < reach_m and line.distance(shapely.Polygon(prism.ring_ne_m)) < CLEARANCE_M
        for prism in prisms
    )


def _later(one: ZoneHeld, other: ZoneHeld) -> bool:
    if one.until_s is None or other.until_s is None:
        return one.until_s is None and other.until_s is not None
    return one.until_s > other.until_s
