"""Paths lengthened to a given time and length, for climbs at the steepest angle.

The goal's position in the air frame is then known, so this is plain geometry. First LSL and RSR
with full circles, the radius increased until the length fits. Both are closed form, since turning
does not depend on the radius and `|c|^2` is quadratic in it. Where that does not fit (medium
altitude), an arc opposite to the first turn: Owen, Beard & McLain 2015, figure 7.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from sim_bridge.research.dubins.air_path import PARTS
from sim_bridge.research.dubins.rendezvous import Meeting
from sim_bridge.research.dubins.words import (
    FIRST,
    LAST,
    MIDDLE,
    TWO_PI,
    centre_shift,
    length_of,
    round_off,
    turns_of,
)

_WIDEST = 3.0  # largest radius, as a multiple of the minimum
_ARCS = np.linspace(0.0, TWO_PI, 33)
_BISECTIONS = 40


@dataclass(slots=True)
class Stretched:
    """Lengthened paths by row; `found` (n,) marks the rows that have one."""

    found: NDArray[np.bool_]
    time_s: Floats
    word: Ints
    turn: NDArray[np.int8]
    length_m: Floats
    radius_m: Floats

    @classmethod
    def none(cls, count: int) -> "Stretched":
        """Empty result of `count` rows."""
        return cls(
            np.zeros(count, np.bool_),
            np.zeros(count),
            np.zeros(count, np.int64),
            np.zeros((count, PARTS), np.int8),
            np.zeros((count, PARTS)),
            np.zeros(count),
        )

    def put(self, rows: Ints, other: "Stretched") -> None:
        """Copy another result's rows to these indices."""
        for name in ("found", "time_s", "word", "turn", "length_m", "radius_m"):
            getattr(self, name)[rows] = getattr(other, name)


def stretched(meeting: Meeting, time_s: Floats, level_mps: Floats) -> Stretched:
    """A path for each pair that takes exactly `time_s` at horizontal airspeed `level_mps`."""
    found = Stretched.none(len(time_s))
    found.time_s = time_s
    length = level_mps * time_s
    away_n = meeting.away_n - meeting.wind_n * time_s
    away_e = meeting.away_e - meeting.wind_e * time_s
    _by_radius(meeting, away_n, away_e, length, found)
    rows = np.flatnonzero(~found.found)
    for word in range(4):
        if not len(rows):
            break
        _by_arc(meeting.take(rows), word, away_n[rows], away_e[rows], length[rows], rows, found)
        rows = rows[~found.found[rows]]
    return found


def _by_radius(
    meeting: Meeting, away_n: Floats, away_e: Floats, length_m: Floats, found: Stretched
) -> None:
    """LSL or RSR, whichever needs the smaller radius."""
    best = np.full(len(length_m), np.inf)
    for word in (0, 1):
        turn = int(FIRST[word])
        least = round_off(turn * (meeting.goal_rad - meeting.start_rad))
        # c(R) = away + R m; its length at the minimum radius sets how many circles fit.
        m_n = turn * (np.sin(meeting.start_rad) - np.sin(meeting.goal_rad))
        m_e = turn * (np.cos(meeting.goal_rad) - np.cos(meeting.start_rad))
        direct = np.hypot(away_n + meeting.radius_m * m_n, away_e + meeting.radius_m * m_e)
        turning = (length_m - direct) / meeting.radius_m
        circles = np.floor((turning - least) / TWO_PI + 1e-12)
        total = least + TWO_PI * np.maximum(circles, 0.0)
        radius = _radius_of_length(away_n, away_e, m_n, m_e, total, length_m)
        c_n, c_e = away_n + radius * m_n, away_e + radius * m_e
        turns = turns_of(word, c_n, c_e, meeting.start_rad, meeting.goal_rad, radius)
        fits = (circles >= 0.0) & (radius >= meeting.radius_m * (1.0 - 1e-9))
        fits &= (radius <= _WIDEST * meeting.radius_m) & (radius < best)
        fits &= turns.first_rad + turns.last_rad <= total + 1e-7
        best = np.where(fits, radius, best)
        rows = np.flatnonzero(fits)
        found.found[rows] = True
        found.word[rows] = word
        found.radius_m[rows] = radius[rows]
        found.turn[rows] = (0, turn, 0, turn)
        arcs = radius * np.stack([total - turns.last_rad, turns.last_rad])
        zero = np.zeros(len(radius))
        found.length_m[rows] = np.stack([zero, arcs[0], turns.middle, arcs[1]], axis=1)[rows]


def _radius_of_length(
    away_n: Floats, away_e: Floats, m_n: Floats, m_e: Floats, total: Floats, length_m: Floats
) -> Floats:
    """R with `R total + |away + R m| = length`, at most length / total; NaN if there is none."""
    a = total**2 - m_n**2 - m_e**2
    b = length_m * total + away_n * m_n + away_e * m_e
    c = length_m**2 - away_n**2 - away_e**2
    with np.errstate(invalid="ignore", divide="ignore"):
        # The smaller root, in the form without cancellation.
        radius = c / (b + np.sqrt(b**2 - a * c))
    return np.where(np.isfinite(radius), radius, np.nan)


def _by_arc(
    meeting: Meeting,
    word: int,
    away_n: Floats,
    away_e: Floats,
    length_m: Floats,
    rows: Ints,
    found: Stretched,
) -> None:
    """An arc opposite to the first turn, then the word; solves for the arc that fits the length."""

    def beyond(arc: Floats, sub: Meeting, n: Floats, e: Floats, wanted: Floats) -> Floats:
        return _length_with(sub, word, arc, n, e) - wanted

    table = np.stack(
        [beyond(np.full(len(rows), arc), meeting, away_n, away_e, length_m) for arc in _ARCS],
        axis=1,
    )
    rising = (table[:, :-1] <= 0.0) & (table[:, 1:] >= 0.0)
    # A jump by a full circle is not a crossing.
    smooth = np.abs(np.diff(table, axis=1)) < np.pi * meeting.radius_m[:, None]
    crossing = rising & smooth
    some = np.flatnonzero(crossing.any(axis=1))
    if not len(some):
        return
    cell = np.argmax(crossing[some], axis=1)
    low, high = _ARCS[cell], _ARCS[cell + 1]
    sub = meeting.take(some)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        short = beyond(middle, sub, away_n[some], away_e[some], length_m[some]) <= 0.0
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    met = np.abs(beyond(low, sub, away_n[some], away_e[some], length_m[some])) < 1e-5
    turns = _turns_after(sub, word, low, away_n[some], away_e[some])
    parts = sub.radius_m * np.stack(
        [low, turns.first_rad, turns.middle / sub.radius_m, turns.last_rad]
    )
    at = rows[some[met]]
    found.found[at] = True
    found.word[at] = word
    found.radius_m[at] = sub.radius_m[met]
    found.turn[at] = (-FIRST[word], FIRST[word], MIDDLE[word], LAST[word])
    found.length_m[at] = parts.T[met]


def _turns_after(meeting: Meeting, word: int, arc: Floats, away_n: Floats, away_e: Floats):
    first = int(FIRST[word])
    heading = meeting.start_rad - first * arc
    # The arc turns by -first; subtract its chord, north and east.
    n = away_n - meeting.radius_m * first * (np.sin(meeting.start_rad) - np.sin(heading))
    e = away_e - meeting.radius_m * first * (np.cos(heading) - np.cos(meeting.start_rad))
    c = centre_shift(n, e, heading, meeting.goal_rad, first, int(LAST[word]), meeting.radius_m)
    return turns_of(word, *c, heading, meeting.goal_rad, meeting.radius_m)


def _length_with(
    meeting: Meeting, word: int, arc: Floats, away_n: Floats, away_e: Floats
) -> Floats:
    """Length (m) of the arc and the word; NaN where the word has no path."""
    turns = _turns_after(meeting, word, arc, away_n, away_e)
    return meeting.radius_m * arc + length_of(word, turns, meeting.radius_m)
