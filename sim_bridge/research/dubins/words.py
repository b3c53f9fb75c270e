"""Dubins' words as geometry of circles, for many paths at a time.

Frame: north, east; headings clockwise from north; a turn is +1 right, -1 left, 0 straight. The
right normal of heading h is `n(h) = (-sin h, cos h)`; the circle of a turn s at (p, h) has its
centre at `p + R s n(h)`. With `c` from the first turn's centre to the last one's:

  same turns, s S s        straight along `c`, |c| long
  opposite turns, s S -s   `c = S u(phi) - 2 R s n(phi)`, S = sqrt(|c|^2 - 4 R^2)
  three turns, s -s s      centres 2 R apart; the middle turn is pi +- 2 acos(|c| / 4 R): the
                           greater in calm air; the lesser too where a moving goal must be met
"""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats

TWO_PI = 2.0 * np.pi
NEARLY_ROUND = 1e-9  # rad; a turn this close to a full circle counts as 0

WORDS = ("LSL", "RSR", "LSR", "RSL", "LRL", "RLR", "LRL", "RLR")
FIRST = np.array([-1, 1, -1, 1, -1, 1, -1, 1])
LAST = np.array([-1, 1, 1, -1, -1, 1, -1, 1])
MIDDLE = np.array([0, 0, 0, 0, 1, -1, 1, -1])
WIDE = np.array([0, 0, 0, 0, 1, 1, -1, -1])
"""Middle of three turns: +1 more than half a circle, -1 less; 0 for a straight."""
IN_CALM = 6
"""Number of words needed in calm air: Dubins' six, the first six of WORDS."""


@dataclass(frozen=True, slots=True)
class Turns:
    """First turn (rad), middle (straight in m, or a turn in rad), last turn (rad); NaN: no path."""

    first_rad: Floats
    middle: Floats
    last_rad: Floats


def round_off(angle_rad: Floats) -> Floats:
    """The angle in [0, 2 pi); values just below a full circle become 0."""
    angle = np.mod(angle_rad, TWO_PI)
    return np.where(angle > TWO_PI - NEARLY_ROUND, 0.0, angle)


def centre_shift(
    away_n: Floats,
    away_e: Floats,
    start_rad: Floats,
    goal_rad: Floats,
    first: int,
    last: int,
    radius: Floats,
) -> tuple[Floats, Floats]:
    """`c` (north, east) m for a word's first and last turn."""
    north = away_n + radius * (first * np.sin(start_rad) - last * np.sin(goal_rad))
    east = away_e + radius * (last * np.cos(goal_rad) - first * np.cos(start_rad))
    return north, east


def turns_of(
    word: int, c_n: Floats, c_e: Floats, start_rad: Floats, goal_rad: Floats, radius: Floats
) -> Turns:
    """The three parts of a word for a given `c`."""
    first, last = int(FIRST[word]), int(LAST[word])
    if MIDDLE[word] != 0:
        return _three_turns(word, c_n, c_e, start_rad, goal_rad, radius)
    course = np.arctan2(c_e, c_n)
    straight = np.hypot(c_n, c_e)
    if first != last:
        with np.errstate(invalid="ignore"):
            straight = np.sqrt(c_n**2 + c_e**2 - 4.0 * radius**2)
        course = course + first * np.arctan2(2.0 * radius, straight)
    return Turns(
        round_off(first * (course - start_rad)), straight, round_off(last * (goal_rad - course))
    )


def _three_turns(
    word: int, c_n: Floats, c_e: Floats, start_rad: Floats, goal_rad: Floats, radius: Floats
) -> Turns:
    turn = int(FIRST[word])
    with np.errstate(invalid="ignore"):
        half = WIDE[word] * np.arccos(np.hypot(c_n, c_e) / (4.0 * radius))
    course = np.arctan2(c_e, c_n)
    lead = half + np.pi / 2
    return Turns(
        round_off(turn * (course - start_rad) + lead),
        np.pi + 2.0 * half,
        round_off(turn * (goal_rad - course) + lead),
    )


def length_of(word: int, turns: Turns, radius: Floats) -> Floats:
    """Horizontal length (m) through the air; NaN where the word has no path."""
    middle = turns.middle * radius if MIDDLE[word] != 0 else turns.middle
    return radius * (turns.first_rad + turns.last_rad) + middle


def shortest_lengths_m(
    away_ne_m: Floats, start_rad: Floats, goal_rad: Floats, radius_m: Floats
) -> Floats:
    """Dubins length of each word without wind; (n, 6), infinite where no such path exists.

    Shkel & Lumelsky, "Classification of the Dubins set", 2001, by the circles above.
    """
    lengths = np.empty((len(start_rad), IN_CALM))
    for word in range(IN_CALM):
        c = centre_shift(
            away_ne_m[:, 0],
            away_ne_m[:, 1],
            start_rad,
            goal_rad,
            int(FIRST[word]),
            int(LAST[word]),
            radius_m,
        )
        turns = turns_of(word, *c, start_rad, goal_rad, radius_m)
        lengths[:, word] = length_of(word, turns, radius_m)
    return np.where(np.isnan(lengths), np.inf, lengths)
