"""Dubins words in wind, solved as a rendezvous: in the air frame the goal drifts upwind.

There the goal moves at minus the wind. So a word's length must equal the distance flown in the time
it takes (McGee, Spry & Hedrick 2005; Techy & Woolsey, "Minimum-time path planning for unmanned
aerial vehicles in steady uniform winds", 2009): `L(c(T)) = D(T)`, `c(T) = c - w T`, and with a
climb dz `D(T) = sqrt(V^2 T^2 - dz^2)`.

Equal turns (LSL, RSR): the turning does not depend on T and the rest is monotone in T. So there is
one root per number of full circles: closed form if level, else Newton from below.
Other words: the turning is unwrapped along T, without jumps at full circles. So each root is where
a smooth function crosses a multiple of 2 pi R. Crossings are bracketed on a grid over the times at
which the word exists, and refined by regula falsi.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats
from sim_bridge.research.dubins.words import (
    FIRST,
    LAST,
    MIDDLE,
    TWO_PI,
    WIDE,
    Turns,
    centre_shift,
    length_of,
    round_off,
    turns_of,
)

_NEWTON_STEPS = 5
_GRID = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 10))  # denser at both ends of an interval
_FALSI_STEPS = 9
_BISECTIONS = 36
_MET_M = 1e-7
_ROUNDS = 4  # crossings tried in each interval before giving up


@dataclass(frozen=True, slots=True)
class Meeting:
    """Pose pairs to join; arrays (n,). `away` is goal minus start; wind is towards north and
    east.
    """

    away_n: Floats
    away_e: Floats
    climb_m: Floats
    start_rad: Floats
    goal_rad: Floats
    wind_n: Floats
    wind_e: Floats
    radius_m: Floats
    airspeed_mps: float

    def take(self, at: NDArray[np.int64]) -> "Meeting":
        """The pairs at these indices."""
        fields = (
            self.away_n,
            self.away_e,
            self.climb_m,
            self.start_rad,
            self.goal_rad,
            self.wind_n,
            self.wind_e,
            self.radius_m,
        )
        return Meeting(*(field[at] for field in fields), airspeed_mps=self.airspeed_mps)

    def flown_m(self, time_s: Floats) -> Floats:
        """D(T): horizontal metres flown through the air by then; (n,)."""
        return np.sqrt(np.maximum((self.airspeed_mps * time_s) ** 2 - self.climb_m**2, 0.0))

    def shift(self, word: int) -> tuple[Floats, Floats]:
        """`c` of a word at T = 0: (north, east) m between the centres of its last and
        first turn.
        """
        return centre_shift(
            self.away_n,
            self.away_e,
            self.start_rad,
            self.goal_rad,
            int(FIRST[word]),
            int(LAST[word]),
            self.radius_m,
        )

    def turns_at(self, word: int, time_s: Floats) -> Turns:
        """The three parts of a word if the flight takes that long."""
        c_n, c_e = self.shift(word)
        c_n, c_e = c_n - self.wind_n * time_s, c_e - self.wind_e * time_s
        return turns_of(word, c_n, c_e, self.start_rad, self.goal_rad, self.radius_m)


def chase_time_s(meeting: Meeting, c_n: Floats, c_e: Floats, extra_m: Floats) -> Floats:
    """The T with `D(T) = extra + |c - w T|`: the only root of a rising function."""
    speed = meeting.airspeed_mps
    room = speed**2 - meeting.wind_n**2 - meeting.wind_e**2
    b = speed * extra_m - c_n * meeting.wind_n - c_e * meeting.wind_e
    gap = np.maximum(b**2 - room * (extra_m**2 - c_n**2 - c_e**2), 0.0)
    time = np.maximum((b + np.sqrt(gap)) / room, 0.0)
    if not meeting.climb_m.any():
        return time
    # D is concave and |c - w T| convex: Newton from the level root rises to the root, never past.
    time = np.maximum(time, (1.0 + 1e-9) * np.abs(meeting.climb_m) / speed)
    wind2 = meeting.wind_n**2 + meeting.wind_e**2
    along = c_n * meeting.wind_n + c_e * meeting.wind_e
    for _ in range(_NEWTON_STEPS):
        n, e = c_n - meeting.wind_n * time, c_e - meeting.wind_e * time
        far = np.hypot(n, e)
        flown = np.maximum(meeting.flown_m(time), 1e-9)
        drift = (wind2 * time - along) / np.maximum(far, 1e-9)
        slope = speed**2 * time / flown - drift
        time = np.maximum(time - (flown - far - extra_m) / slope, 0.0)
    return time


def equal_turns_time_s(meeting: Meeting, word: int, circles: int) -> Floats:
    """Time of LSL or RSR with `circles` extra full circles; infinite if it needs one more.

    With `circles` = 1 it is always finite: a path always exists.
    """
    turn = int(FIRST[word])
    total = round_off(turn * (meeting.goal_rad - meeting.start_rad)) + TWO_PI * circles
    time = chase_time_s(meeting, *meeting.shift(word), meeting.radius_m * total)
    turns = meeting.turns_at(word, time)
    return np.where(turns.first_rad + turns.last_rad <= total + 1e-7, time, np.inf)


def first_meeting_s(meeting: Meeting, word: int, earliest_s: Floats, latest_s: Floats) -> Floats:
    """First T in the interval at which a word other than LSL and RSR fits; infinite if none."""
    found = np.full(len(meeting.away_n), np.inf)
    for begin, end in _where_it_exists(meeting, word, earliest_s, latest_s):
        rows = np.flatnonzero(begin < np.minimum(end, found))
        if len(rows):
            sub = meeting.take(rows)
            first = _first_crossing_s(sub, word, begin[rows], end[rows])
            found[rows] = np.minimum(found[rows], first)
    return found


def _where_it_exists(
    meeting: Meeting, word: int, earliest_s: Floats, latest_s: Floats
) -> list[tuple[Floats, Floats]]:
    """Intervals in which the end circles are far enough apart (two turns) or close enough
    (three).
    """
    c_n, c_e = meeting.shift(word)
    limit = (4.0 if MIDDLE[word] != 0 else 2.0) * meeting.radius_m
    wind2 = np.maximum(meeting.wind_n**2 + meeting.wind_e**2, 1e-18)
    closest = (c_n * meeting.wind_n + c_e * meeting.wind_e) / wind2
    off2 = c_n**2 + c_e**2 - closest**2 * wind2
    inside = limit**2 - off2
    half = np.sqrt(np.maximum(inside, 0.0) / wind2)
    into, out = closest - half, closest + half
    if MIDDLE[word] != 0:
        nowhere = inside <= 0.0
        end = np.where(nowhere, earliest_s, np.minimum(latest_s, out))
        return [(np.maximum(earliest_s, into), end)]
    never = inside <= 0.0
    before = np.where(never, latest_s, np.minimum(latest_s, into))
    after = np.where(never, latest_s, np.maximum(earliest_s, out))
    return [(earliest_s, before), (after, latest_s)]


def _spare_loops(meeting: Meeting, word: int, time_s: Floats, base_s: Floats) -> Floats:
    """Distance flown beyond the word's length with its turning unwrapped, in full circles.

    `time_s` (n, k); the turning is unwrapped from `base_s` (n,). Roots are at whole numbers.
    """
    turn = float(FIRST[word])
    c_n, c_e = (c[:, None] for c in meeting.shift(word))
    n = c_n - meeting.wind_n[:, None] * time_s
    e = c_e - meeting.wind_e[:, None] * time_s
    radius = meeting.radius_m[:, None]
    far2 = n * n + e * e
    flown = np.sqrt(
        np.maximum((meeting.airspeed_mps * time_s) ** 2 - meeting.climb_m[:, None] ** 2, 0.0)
    )
    if MIDDLE[word] != 0:
        half = np.arccos(np.minimum(np.sqrt(far2) / (4.0 * radius), 1.0))
        angle = turn * (meeting.goal_rad - meeting.start_rad)
        needed = radius * (angle[:, None] + 4.0 * WIDE[word] * half)
        return (flown - needed) / (TWO_PI * radius)
    straight = np.sqrt(np.maximum(far2 - 4.0 * radius * radius, 0.0))
    # c moves on a straight line, so its bearing changes by less than pi from the first.
    n0 = c_n - (meeting.wind_n * base_s)[:, None]
    e0 = c_e - (meeting.wind_e * base_s)[:, None]
    swept = np.arctan2(n0 * e - e0 * n, n0 * n + e0 * e) + np.arctan2(e0, n0)
    course = swept + turn * np.arctan2(2.0 * radius, straight)
    angle = turn * (2.0 * course - (meeting.start_rad + meeting.goal_rad)[:, None])
    return (flown - radius * angle - straight) / (TWO_PI * radius)


def _first_crossing_s(meeting: Meeting, word: int, begin_s: Floats, end_s: Floats) -> Floats:
    time = begin_s[:, None] + (end_s - begin_s)[:, None] * _GRID
    spare = _spare_loops(meeting, word, time, begin_s)
    level = np.floor(spare)
    crossing = level[:, 1:] != level[:, :-1]
    found = np.full(len(begin_s), np.inf)
    waiting = np.flatnonzero(crossing.any(axis=1))
    for _ in range(_ROUNDS):
        if not len(waiting):
            break
        cell = np.argmax(crossing[waiting], axis=1)
        whole = np.maximum(level[waiting, cell], level[waiting, cell + 1])
        low, high = time[waiting, cell], time[waiting, cell + 1]
        ends = (spare[waiting, cell] - whole, spare[waiting, cell + 1] - whole)
        sub = meeting.take(waiting)
        root = _closed_in(sub, word, begin_s[waiting], whole, low, high, *ends)
        fits = _fits(sub, word, root)
        found[waiting[fits]] = root[fits]
        crossing[waiting, cell] = False
        waiting = waiting[~fits]
        waiting = waiting[crossing[waiting].any(axis=1)]
    return found


def _fits(meeting: Meeting, word: int, time_s: Floats) -> NDArray[np.bool_]:
    """Whether the word's length equals the distance flown, or is less by whole circles."""
    length = length_of(word, meeting.turns_at(word, time_s), meeting.radius_m)
    loops = (meeting.flown_m(time_s) - length) / (TWO_PI * meeting.radius_m)
    whole = np.round(loops)
    return (whole >= 0.0) & (np.abs(loops - whole) < 1e-6)


def _closed_in(
    meeting: Meeting,
    word: int,
    base_s: Floats,
    whole: Floats,
    low_s: Floats,
    high_s: Floats,
    at_low: Floats,
    at_high: Floats,
) -> Floats:
    """The crossing in each bracket: regula falsi (Illinois), then bisection where not converged."""

    def beyond(time: Floats, rows: NDArray[np.int64] | slice = slice(None)) -> Floats:
        sub = meeting if isinstance(rows, slice) else meeting.take(rows)
        return _spare_loops(sub, word, time[:, None], base_s[rows])[:, 0] - whole[rows]

    low, high, f_low, f_high = low_s.copy(), high_s.copy(), at_low.copy(), at_high.copy()
    middle = low
    for _ in range(_FALSI_STEPS):
        width = f_high - f_low
        share = np.where(width != 0.0, -f_low / np.where(width != 0.0, width, 1.0), 0.5)
        middle = low + np.clip(share, 0.0, 1.0) * (high - low)
        f = beyond(middle)
        left = np.sign(f) == np.sign(f_low)
        f_high = np.where(left, 0.5 * f_high, f)
        high = np.where(left, high, middle)
        f_low = np.where(left, f, 0.5 * f_low)
        low = np.where(left, middle, low)
    met = np.abs(beyond(middle)) * TWO_PI * meeting.radius_m < _MET_M
    rows = np.flatnonzero(~met)
    if len(rows):
        middle = middle.copy()
        middle[rows] = _bisected(beyond, rows, low_s[rows], high_s[rows], at_low[rows])
    return middle


def _bisected(
    beyond: Callable[[Floats, NDArray[np.int64]], Floats],
    rows: NDArray[np.int64],
    low: Floats,
    high: Floats,
    f_low: Floats,
) -> Floats:
    sign = np.sign(f_low)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        left = np.sign(beyond(middle, rows)) == sign
        low, high = np.where(left, middle, low), np.where(left, high, middle)
    return 0.5 * (low + high)
