"""The verdict on a crossing, from truth alone: least separations and each vehicle's outcome."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats

SPAN_M = 1.0
"""DJI Matrice 100: 0.65 m between motors across, 13 inch propellers; told by its maker."""

HORIZONTAL_M, VERTICAL_M = 5.0 + SPAN_M, 4.0 + SPAN_M
"""Between centres, the span added: one or the other is kept (docs/explanation/avoidance.md)."""

BETWEEN = 10
"""Instants looked at between two rows, a tenth of a second apart, on the straight between them."""

HOME_M, DELIVERED_M = 10.0, 10.0


@dataclass(frozen=True, slots=True)
class Nearest:
    """The least separation: 1 is what must be kept; where and when that was."""

    separations: float
    horizontal_m: float
    vertical_m: float
    t_s: float
    who: tuple[str, str]


def nearest_of(flown: dict[str, Floats]) -> Nearest | None:
    """Of all pairs while both fly; rows are (t, north, east, down, airborne), of the same times."""
    names = list(flown)
    found: list[Nearest] = []
    for k, one in enumerate(names):
        for other in names[:k]:
            near = _pair(flown[one], flown[other], (other, one))
            if near is not None:
                found.append(near)
    return min(found, key=lambda near: near.separations, default=None)


def _pair(a: Floats, b: Floats, who: tuple[str, str]) -> Nearest | None:
    times, of_a, of_b = np.intersect1d(
        np.round(a[:, 0], 3), np.round(b[:, 0], 3), return_indices=True
    )
    a, b = a[of_a], b[of_b]
    both = (a[:, 4] > 0.0) & (b[:, 4] > 0.0)
    fly = both[:-1] & both[1:]
    if not fly.any():
        return None
    away = a[:, 1:4] - b[:, 1:4]
    share = np.linspace(0.0, 1.0, BETWEEN + 1)[:, None, None]
    between = away[:-1] + share * (away[1:] - away[:-1])
    horizontal = np.hypot(between[..., 0], between[..., 1])
    vertical = np.abs(between[..., 2])
    apart = np.maximum(horizontal / HORIZONTAL_M, vertical / VERTICAL_M)
    apart = np.where(fly, apart, np.inf)
    at = np.unravel_index(apart.argmin(), apart.shape)
    return Nearest(
        float(apart[at]),
        float(horizontal[at]),
        float(vertical[at]),
        float(times[at[1]]),
        who,
    )


def outcome_of(
    rows: Floats,
    pad_ne_m: tuple[float, float],
    customer_ne_m: tuple[float, float],
    released_ned_m: tuple[float, float, float] | None,
    *,
    crashed: bool,
) -> str:
    """SUC, DEL, ABRT or FAIL (docs/reference/outcomes.md); NONE: it never took off."""
    if not (rows[:, 4] > 0.0).any():
        return "NONE"
    down = rows[-1, 4] == 0.0 and not crashed
    home = down and math.dist(rows[-1, 1:3], pad_ne_m) <= HOME_M
    brought = (
        released_ned_m is not None and math.dist(released_ned_m[:2], customer_ne_m) <= DELIVERED_M
    )
    if home:
        return "SUC" if brought else "ABRT"
    return "DEL" if brought else "FAIL"
