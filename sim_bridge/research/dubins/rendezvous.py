"""Dubins words in wind, solved as a rendezvous: in the air frame the goal drifts upwind.

There the goal moves at minus the wind. A word's length must equal the distance flown in its time
(McGee, Spry & Hedrick 2005; Techy & Woolsey, "Minimum-time path planning for unmanned aerial
vehicles in steady uniform winds", 2009): `L(c(T)) = V T`, `c(T) = c - w T`.

Equal turns (LSL, RSR): the turning does not depend on T and the rest is monotone in T. There is
one root per number of full circles, in closed form.
Other words: the turning is unwrapped along T, without jumps at full circles. Each root is a
crossing of a smooth function with a multiple of 2 pi R. Crossings are bracketed on a grid over the
times at which the word exists, and refined by bisection.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats
from sim_bridge.research.dubins.words import (
    FIRST_TURN,
    LAST_TURN,
    MIDDLE_ARC_SIGN,
    MIDDLE_PART,
    TWO_PI,
    WordParts,
    dubins_word_parts,
    turn_centre_shift_m,
    word_length_m,
    wrap_angle_rad,
)

_GRID = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 10))  # denser at both ends of an interval
_BISECTIONS = 48
_MAX_CROSSINGS = 4  # crossings tried in each interval


@dataclass(frozen=True, slots=True)
class PosePairs:
    """Pose pairs to join; arrays (n,). `away` is goal minus start; wind is towards north and
    east.
    """

    away_n: Floats
    away_e: Floats
    start_rad: Floats
    goal_rad: Floats
    wind_n: Floats
    wind_e: Floats
    radius_m: Floats
    airspeed_mps: float

    def select(self, indices: NDArray[np.int64]) -> "PosePairs":
        """Return the pairs at these indices."""
        fields = (
            self.away_n,
            self.away_e,
            self.start_rad,
            self.goal_rad,
            self.wind_n,
            self.wind_e,
            self.radius_m,
        )
        return PosePairs(*(field[indices] for field in fields), airspeed_mps=self.airspeed_mps)

    def turn_centre_shift_m(self, word_index: int) -> tuple[Floats, Floats]:
        """Return `c` of a word at T = 0: (north, east) m between the centres of its last and
        first turn.
        """
        return turn_centre_shift_m(
            self.away_n,
            self.away_e,
            self.start_rad,
            self.goal_rad,
            int(FIRST_TURN[word_index]),
            int(LAST_TURN[word_index]),
            self.radius_m,
        )

    def word_parts_at_time(self, word_index: int, time_s: Floats) -> WordParts:
        """Return the three parts of a word for a flight of this duration."""
        c_n, c_e = self.turn_centre_shift_m(word_index)
        c_n, c_e = c_n - self.wind_n * time_s, c_e - self.wind_e * time_s
        return dubins_word_parts(word_index, c_n, c_e, self.start_rad, self.goal_rad, self.radius_m)


def intercept_time_s(
    pairs: PosePairs, centre_shift_n_m: Floats, centre_shift_e_m: Floats, extra_path_m: Floats
) -> Floats:
    """Return the T with `V T = extra + |c - w T|`: the only root of an increasing function."""
    speed = pairs.airspeed_mps
    speed_margin = speed**2 - pairs.wind_n**2 - pairs.wind_e**2
    b = speed * extra_path_m - centre_shift_n_m * pairs.wind_n - centre_shift_e_m * pairs.wind_e
    gap = np.maximum(
        b**2 - speed_margin * (extra_path_m**2 - centre_shift_n_m**2 - centre_shift_e_m**2), 0.0
    )
    return np.maximum((b + np.sqrt(gap)) / speed_margin, 0.0)


def same_turn_time_s(pairs: PosePairs, word: int, extra_circles: int) -> Floats:
    """Return the time of LSL or RSR with `extra_circles` extra full circles; infinite if too few.

    With `extra_circles` = 1 it is always finite: a path always exists.
    """
    turn = int(FIRST_TURN[word])
    total = wrap_angle_rad(turn * (pairs.goal_rad - pairs.start_rad)) + TWO_PI * extra_circles
    time = intercept_time_s(pairs, *pairs.turn_centre_shift_m(word), pairs.radius_m * total)
    parts = pairs.word_parts_at_time(word, time)
    return np.where(parts.first_rad + parts.last_rad <= total + 1e-7, time, np.inf)


def first_solution_time_s(
    pairs: PosePairs, word: int, earliest_s: Floats, latest_s: Floats
) -> Floats:
    """Return the first T in the interval at which a word other than LSL and RSR fits; or inf."""
    found = np.full(len(pairs.away_n), np.inf)
    for begin, end in _feasible_intervals_s(pairs, word, earliest_s, latest_s):
        rows = np.flatnonzero(begin < np.minimum(end, found))
        if len(rows):
            sub = pairs.select(rows)
            first = _first_solution_in_interval_s(sub, word, begin[rows], end[rows])
            found[rows] = np.minimum(found[rows], first)
    return found


def _feasible_intervals_s(
    pairs: PosePairs, word: int, earliest_s: Floats, latest_s: Floats
) -> list[tuple[Floats, Floats]]:
    """Return the intervals in which the distance of the end circles permits the word: large
    enough (two turns) or small enough (three).
    """
    c_n, c_e = pairs.turn_centre_shift_m(word)
    limit = (4.0 if MIDDLE_PART[word] != 0 else 2.0) * pairs.radius_m
    wind2 = np.maximum(pairs.wind_n**2 + pairs.wind_e**2, 1e-18)
    closest = (c_n * pairs.wind_n + c_e * pairs.wind_e) / wind2
    off2 = c_n**2 + c_e**2 - closest**2 * wind2
    inside = limit**2 - off2
    half = np.sqrt(np.maximum(inside, 0.0) / wind2)
    into, out = closest - half, closest + half
    if MIDDLE_PART[word] != 0:
        nowhere = inside <= 0.0
        end = np.where(nowhere, earliest_s, np.minimum(latest_s, out))
        return [(np.maximum(earliest_s, into), end)]
    is_empty = inside <= 0.0
    before = np.where(is_empty, latest_s, np.minimum(latest_s, into))
    after = np.where(is_empty, latest_s, np.maximum(earliest_s, out))
    return [(earliest_s, before), (after, latest_s)]


def _excess_length_in_circles(
    pairs: PosePairs, word: int, time_s: Floats, base_s: Floats
) -> Floats:
    """Distance flown minus the word's length with its turning unwrapped, in full circles.

    `time_s` (n, k); the turning is unwrapped from `base_s` (n,). Roots are at whole numbers.
    """
    turn = float(FIRST_TURN[word])
    c_n, c_e = (c[:, None] for c in pairs.turn_centre_shift_m(word))
    n = c_n - pairs.wind_n[:, None] * time_s
    e = c_e - pairs.wind_e[:, None] * time_s
    radius = pairs.radius_m[:, None]
    far2 = n * n + e * e
    flown = pairs.airspeed_mps * time_s
    if MIDDLE_PART[word] != 0:
        half = np.arccos(np.minimum(np.sqrt(far2) / (4.0 * radius), 1.0))
        angle = turn * (pairs.goal_rad - pairs.start_rad)
        needed = radius * (angle[:, None] + 4.0 * MIDDLE_ARC_SIGN[word] * half)
        return (flown - needed) / (TWO_PI * radius)
    straight = np.sqrt(np.maximum(far2 - 4.0 * radius * radius, 0.0))
    # c moves on a straight line, so its bearing changes by less than pi from the first.
    n0 = c_n - (pairs.wind_n * base_s)[:, None]
    e0 = c_e - (pairs.wind_e * base_s)[:, None]
    swept = np.arctan2(n0 * e - e0 * n, n0 * n + e0 * e) + np.arctan2(e0, n0)
    course = swept + turn * np.arctan2(2.0 * radius, straight)
    angle = turn * (2.0 * course - (pairs.start_rad + pairs.goal_rad)[:, None])
    return (flown - radius * angle - straight) / (TWO_PI * radius)


def _first_solution_in_interval_s(
    pairs: PosePairs, word: int, begin_s: Floats, end_s: Floats
) -> Floats:
    time = begin_s[:, None] + (end_s - begin_s)[:, None] * _GRID
    spare = _excess_length_in_circles(pairs, word, time, begin_s)
    level = np.floor(spare)
    crossing = level[:, 1:] != level[:, :-1]
    found = np.full(len(begin_s), np.inf)
    waiting = np.flatnonzero(crossing.any(axis=1))
    for _ in range(_MAX_CROSSINGS):
        if not len(waiting):
            break
        cell = np.argmax(crossing[waiting], axis=1)
        whole = np.maximum(level[waiting, cell], level[waiting, cell + 1])
        low, high = time[waiting, cell], time[waiting, cell + 1]
        sub = pairs.select(waiting)
        at_low = spare[waiting, cell] - whole
        root = _bisect_crossing_time_s(sub, word, begin_s[waiting], whole, low, high, at_low)
        fits = _is_solution(sub, word, root)
        found[waiting[fits]] = root[fits]
        crossing[waiting, cell] = False
        waiting = waiting[~fits]
        waiting = waiting[crossing[waiting].any(axis=1)]
    return found


def _is_solution(pairs: PosePairs, word: int, time_s: Floats) -> NDArray[np.bool_]:
    """Return True where the distance flown equals the word's length plus whole circles."""
    length = word_length_m(word, pairs.word_parts_at_time(word, time_s), pairs.radius_m)
    loops = (pairs.airspeed_mps * time_s - length) / (TWO_PI * pairs.radius_m)
    whole = np.round(loops)
    return (whole >= 0.0) & (np.abs(loops - whole) < 1e-6)


def _bisect_crossing_time_s(
    pairs: PosePairs,
    word: int,
    base_s: Floats,
    full_circles: Floats,
    low_s: Floats,
    high_s: Floats,
    excess_at_low: Floats,
) -> Floats:
    """Find the crossing in each bracket by bisection."""
    low, high, sign = low_s, high_s, np.sign(excess_at_low)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        excess = (
            _excess_length_in_circles(pairs, word, middle[:, None], base_s)[:, 0] - full_circles
        )
        left = np.sign(excess) == sign
        low, high = np.where(left, middle, low), np.where(left, high, middle)
    return 0.5 * (low + high)
