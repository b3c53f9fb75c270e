"""Duration of a planned route: climb, legs and descent, fitted to flights of one vehicle.

A leg's time is its length over the commanded ground speed plus `a + b v` for acceleration, braking
and turns. The time of a climb or descent is height over rate plus a constant (spool-up; slow final
metres).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import theilslopes

from companion.analysis.measured_energy.flown_track import (
    STEP_S,
    FlownTrack,
    detect_leg_sequence,
    slowest_indices_between_legs,
)
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError

_MIN_FLIGHTS = 4


@dataclass(frozen=True, slots=True)
class RoutePlan:
    """A commanded route: cruise height above take-off, ground speed, and leg lengths."""

    height_m: float
    speed_mps: float
    leg_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class FlownRoute:
    """A flown route: grid indices of the ends of climb and legs, and durations.

    `marks` are the start, each leg's start (a corner from the second on) and the last leg's end.
    """

    plan: RoutePlan
    marks: tuple[int, ...]
    climb_s: float
    leg_s: tuple[float, ...]
    descent_s: float


@dataclass(frozen=True, slots=True)
class RouteTimes:
    """Each is a constant (s) and a slope: over height (s/m) or over speed (s per m/s)."""

    climb: tuple[float, float]
    leg: tuple[float, float]
    descent: tuple[float, float]

    def climb_s(self, height_m: float) -> float:
        """Return the time from power on to the start of the first leg."""
        return self.climb[0] + self.climb[1] * height_m

    def leg_time_beyond_constant_speed_s(self, speed_mps: float) -> float:
        """Return the extra time of a leg over its length at the commanded speed."""
        return self.leg[0] + self.leg[1] * speed_mps

    def leg_s(self, length_m: float, speed_mps: float) -> float:
        """Return the time from one corner to the next."""
        return length_m / speed_mps + self.leg_time_beyond_constant_speed_s(speed_mps)

    def descent_s(self, height_m: float) -> float:
        """Return the time from the end of the last leg to power off."""
        return self.descent[0] + self.descent[1] * height_m


def build_flown_route(track: FlownTrack, height_m: float, speed_mps: float) -> FlownRoute:
    """Return the route of a flight; its corners are the stops.

    Raises LeewayError for fewer than two legs, or a log that ends in flight.
    """
    leg_sequence = detect_leg_sequence(track, speed_mps)
    if len(leg_sequence) < 2:
        raise LeewayError(
            f"{track.name}: {len(leg_sequence)} legs at {speed_mps:g} m/s, 2 or more expected"
        )
    if track.ends_in_flight:
        raise LeewayError(f"{track.name}: the log ends in flight; expected a landing")
    marks = (
        0,
        leg_sequence[0].first,
        *slowest_indices_between_legs(track, leg_sequence),
        leg_sequence[-1].last,
    )
    positions_ne_m = [track.position_ne_m(0), *(track.position_ne_m(i) for i in marks[2:])]
    lengths = tuple(float(np.hypot(b[0] - a[0], b[1] - a[1])) for a, b in pairwise(positions_ne_m))
    durations_s = [STEP_S * (b - a) for a, b in pairwise(marks)]
    return FlownRoute(
        RoutePlan(height_m, speed_mps, lengths),
        marks,
        durations_s[0],
        tuple(durations_s[1:]),
        STEP_S * (len(track.t_s) - marks[-1]),
    )


def fit_route_times(routes: Sequence[FlownRoute]) -> RouteTimes:
    """Fit times by Theil-Sen, which ignores a pause. Raises LeewayError for too few flights."""
    if len(routes) < _MIN_FLIGHTS:
        raise LeewayError(f"times of a route: {len(routes)} flights, {_MIN_FLIGHTS} expected")
    heights = np.array([r.plan.height_m for r in routes])
    speeds = np.array([r.plan.speed_mps for r in routes])
    extra = [(sum(r.leg_s) - sum(r.plan.leg_m) / r.plan.speed_mps) / len(r.leg_s) for r in routes]
    return RouteTimes(
        climb=_fit_constant_and_slope(heights, [r.climb_s for r in routes]),
        leg=_fit_constant_and_slope(speeds, extra),
        descent=_fit_constant_and_slope(heights, [r.descent_s for r in routes]),
    )


def _fit_constant_and_slope(
    regressor_values: Floats, durations_s: Sequence[float]
) -> tuple[float, float]:
    """Return constant and slope; slope 0 if `regressor_values` is constant."""
    if np.ptp(regressor_values) < 1e-6:
        return float(np.median(durations_s)), 0.0
    line = theilslopes(durations_s, regressor_values, method="joint")
    slope, constant = np.asarray(line, np.float64)[:2]
    return float(constant), float(slope)
