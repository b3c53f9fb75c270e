"""Separation by plan (safety rule 7): which sorties may be in the air at once, for any companion.

Each sortie gets an operational volume: its layer over all the ground that it may cross (outbound
route, return route, and every shortcut between them after an early turn-back), and a column from
the ground to that layer at each position where it climbs or descends. Two sorties whose times in
the air may overlap must have separated volumes. No rule depends on a drone's position along its
route, so a drone that turns back, waits, or is late stays separated. Only the set of drones in the
air counts, and the desk knows it at each launch.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import shapely

HORIZONTAL_SEPARATION_M = 16.0
"""Horizontal: 10 m between centres, and 3 m for each drone's position error and gusts."""
LAYER_GAP_M = 12.0
"""Vertical: 10 m between centres, and 1 m for each drone's barometer error and overshoot."""
LATE_MARGIN_S = 30.0
"""Time after the planned landing when a sortie may still be in the air."""


@dataclass(frozen=True)
class OperationalVolume:
    """The airspace that one sortie may use.

    `ground_ne_m`: the points between which it flies level. `columns_ne_m`: positions where it
    climbs and descends. Heights are above the depot, times as planned.
    """

    vehicle: str
    order: str
    ground_ne_m: tuple[tuple[float, float], ...]
    columns_ne_m: tuple[tuple[float, float], ...]
    low_m: float
    high_m: float
    from_s: float
    to_s: float

    @cached_property
    def level_flight_hull(self) -> shapely.Geometry:
        """The hull of all level flight, seen from above."""
        return shapely.convex_hull(shapely.MultiPoint(self.ground_ne_m))

    @cached_property
    def climb_descent_columns(self) -> shapely.Geometry:
        """The columns, seen from above."""
        return shapely.MultiPoint(self.columns_ne_m)


@dataclass(frozen=True, slots=True)
class Proximity:
    """Parts of two sorties that come close, seen from above."""

    layers: bool
    columns: bool
    under_first: bool
    """A column of the second is below level flight of the first: the first must be the higher one.
    """
    under_second: bool

    def conflict_reason(
        self, first_height_range_m: tuple[float, float], second_height_range_m: tuple[float, float]
    ) -> str | None:
        """Return the conflict of the two with these layers (lowest, highest); None: no conflict."""
        if self.columns:
            return "they climb and descend too close to each other"
        if self.layers and not (
            _is_above_by_layer_gap(first_height_range_m, second_height_range_m)
            or _is_above_by_layer_gap(second_height_range_m, first_height_range_m)
        ):
            return "their ways come close in layers that are too close"
        if self.under_first and not _is_above_by_layer_gap(
            first_height_range_m, second_height_range_m
        ):
            return "one flies where the other climbs or descends"
        if self.under_second and not _is_above_by_layer_gap(
            second_height_range_m, first_height_range_m
        ):
            return "one flies where the other climbs or descends"
        return None


def _is_above_by_layer_gap(
    upper_height_range_m: tuple[float, float], lower_height_range_m: tuple[float, float]
) -> bool:
    return upper_height_range_m[0] >= lower_height_range_m[1] + LAYER_GAP_M - 1e-6


def proximity(first: OperationalVolume, second: OperationalVolume) -> Proximity:
    """Return the parts of these two volumes that come close."""
    return Proximity(
        layers=_are_closer_than_separation(first.level_flight_hull, second.level_flight_hull),
        columns=_are_closer_than_separation(
            first.climb_descent_columns, second.climb_descent_columns
        ),
        under_first=_are_closer_than_separation(
            first.level_flight_hull, second.climb_descent_columns
        ),
        under_second=_are_closer_than_separation(
            second.level_flight_hull, first.climb_descent_columns
        ),
    )


def _are_closer_than_separation(one: shapely.Geometry, other: shapely.Geometry) -> bool:
    return bool(shapely.dwithin(one, other, HORIZONTAL_SEPARATION_M))


def conflict_reason(first: OperationalVolume, second: OperationalVolume) -> str | None:
    """Return the conflict of these two when in the air at once; None: no conflict."""
    layers = (first.low_m, first.high_m), (second.low_m, second.high_m)
    return proximity(first, second).conflict_reason(*layers)


def launch_conflict_reason(
    launch_volume: OperationalVolume, airborne_volumes: Iterable[OperationalVolume]
) -> str | None:
    """Check a launch against the sorties in the air: return the conflict; None: it may launch.

    The same check precedes a change of the home of a sortie in the air, with the changed sortie.
    """
    for other in airborne_volumes:
        if other.vehicle == launch_volume.vehicle:
            return f"{launch_volume.vehicle} is in the air already, with {other.order}"
        reason = conflict_reason(launch_volume, other)
        if reason is not None:
            return f"{other.vehicle} with {other.order} is in the air: {reason}"
    return None
