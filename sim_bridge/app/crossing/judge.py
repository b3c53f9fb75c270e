"""Minimum separation in a crossing from ground truth, in units of the required one."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_bridge.app.day.judge import VehicleTrack, relative_motion_while_both_airborne

SPAN_M = 1.0
"""DJI Matrice 100: 0.65 m diagonal between motors, 13 inch propellers (manufacturer's data)."""

MIN_HORIZONTAL_M, MIN_VERTICAL_M = 5.0 + SPAN_M, 4.0 + SPAN_M
"""Required centre distances with the span; one of both is kept: docs/explanation/avoidance.md."""

INTERPOLATION_STEPS = 20
"""Instants evaluated by linear interpolation between two samples, 0.2 s from each other."""


@dataclass(frozen=True, slots=True)
class Nearest:
    """Minimum separation, in units of the required one, with its distances, time and vehicles."""

    separations: float
    horizontal_m: float
    vertical_m: float
    t_s: float
    who: tuple[str, str]


def find_minimum_separation(tracks: Sequence[VehicleTrack]) -> Nearest | None:
    """Return the minimum of all pairs while both fly."""
    found = [_pair_minimum_separation(*pair) for pair in itertools.combinations(tracks, 2)]
    return min((near for near in found if near), key=lambda near: near.separations, default=None)


def _pair_minimum_separation(first: VehicleTrack, second: VehicleTrack) -> Nearest | None:
    motion = relative_motion_while_both_airborne(first, second)
    if motion is None:
        return None
    times_s, start_ned_m, change_ned_m = motion
    share = np.linspace(0.0, 1.0, INTERPOLATION_STEPS + 1)[:, None, None]
    between = start_ned_m + share * change_ned_m
    horizontal = np.hypot(between[..., 0], between[..., 1])
    vertical = np.abs(between[..., 2])
    separation = np.maximum(horizontal / MIN_HORIZONTAL_M, vertical / MIN_VERTICAL_M)
    at = np.unravel_index(separation.argmin(), separation.shape)
    return Nearest(
        float(separation[at]),
        float(horizontal[at]),
        float(vertical[at]),
        float(times_s[at[1]]),
        (first.vehicle, second.vehicle),
    )
