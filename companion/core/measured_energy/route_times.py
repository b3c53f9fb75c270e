"""How long a planned route takes: climb, legs and descent, fitted to flights of one vehicle.

A leg's time is its length over the commanded ground speed plus what starting, stopping and turning
take, `a + b v`. A climb or a descent is a height over a rate plus a constant (spooling up; the slow
last metres).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.measured_energy.flown_track import STEP_S, FlownTrack, corners, flown_legs

_LEAST_FLIGHTS = 4


@dataclass(frozen=True, slots=True)
class RoutePlan:
    """A route as ordered: cruise height above take-off, ground speed, and legs' lengths."""

    height_m: float
    speed_mps: float
    leg_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class FlownRoute:
    """The same route as flown: grid indices where climb and legs end, and each part's duration.

    `marks` are the start, each leg's beginning (a corner from the second on) and the last leg's
    end.
    """

    plan: RoutePlan
    marks: tuple[int, ...]
    climb_s: float
    leg_s: tuple[float, ...]
    descent_s: float

    @property
    def corners(self) -> tuple[int, ...]:
        """Grid indices of the corners."""
        return self.marks[2:-1]


@dataclass(frozen=True, slots=True)
class RouteTimes:
    """Each a constant (s) and a slope: over height (s/m) or over speed (s per m/s)."""

    climb: tuple[float, float]
    leg: tuple[float, float]
    descent: tuple[float, float]

    def climb_s(self, height_m: float) -> float:
        """From power on to the begin of the first leg."""
        return self.climb[0] + self.climb[1] * height_m

    def extra_s(self, speed_mps: float) -> float:
        """Of one leg, over its length at the commanded speed."""
        return self.leg[0] + self.leg[1] * speed_mps

    def leg_s(self, length_m: float, speed_mps: float) -> float:
        """From one corner to the next."""
        return length_m / speed_mps + self.extra_s(speed_mps)

    def descent_s(self, height_m: float) -> float:
        """From the end of the last leg to power off."""
        return self.descent[0] + self.descent[1] * height_m


def flown_route(track: FlownTrack, height_m: float, speed_mps: float) -> FlownRoute:
    """The route of a flight; its corners are where it stopped.

    LeewayError where there are no legs, or the log ends in the air.
    """
    legs = flown_legs(track, speed_mps)
    if len(legs) < 2:
        raise LeewayError(
            f"{track.name}: {len(legs)} legs at {speed_mps:g} m/s, 2 or more expected"
        )
    if track.cut_short:
        raise LeewayError(f"{track.name}: cut off in the air; nothing to go is known")
    marks = (0, legs[0].first, *corners(track, legs), legs[-1].last)
    places = [track.place(0), *(track.place(i) for i in marks[2:])]
    lengths = tuple(float(np.hypot(b[0] - a[0], b[1] - a[1])) for a, b in pairwise(places))
    spans = [STEP_S * (b - a) for a, b in pairwise(marks)]
    return FlownRoute(
        RoutePlan(height_m, speed_mps, lengths),
        marks,
        spans[0],
        tuple(spans[1:]),
        STEP_S * (len(track.t_s) - marks[-1]),
    )


def fit_times(routes: Sequence[FlownRoute]) -> RouteTimes:
    """Least squares over flights; LeewayError for too few."""
    if len(routes) < _LEAST_FLIGHTS:
        raise LeewayError(f"times of a route: {len(routes)} flights, {_LEAST_FLIGHTS} expected")
    heights = np.array([r.plan.height_m for r in routes])
    speeds = np.array([r.plan.speed_mps for r in routes for _ in r.leg_s])
    extra = [
        flown_s - length_m / r.plan.speed_mps
        for r in routes
        for flown_s, length_m in zip(r.leg_s, r.plan.leg_m, strict=True)
    ]
    return RouteTimes(
        climb=_line(heights, [r.climb_s for r in routes]),
        leg=_line(speeds, extra),
        descent=_line(heights, [r.descent_s for r in routes]),
    )


def _line(over: Floats, seconds: Sequence[float]) -> tuple[float, float]:
    """Constant and slope; where all are alike, a constant."""
    if np.ptp(over) < 1e-6:
        return float(np.mean(seconds)), 0.0
    slope, constant = np.polyfit(over, np.asarray(seconds, float), 1)
    return float(constant), float(slope)
