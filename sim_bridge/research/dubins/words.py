"""Dubins' words as geometry of circles, for many paths at a time.

Frame: north, east; headings clockwise from north; a turn is +1 right, -1 left, 0 straight. The
right normal of heading h is `n(h) = (-sin h, cos h)`; the circle of a turn s at (p, h) has its
centre at `p + R s n(h)`. With `c` from the first turn's centre to the last one's:

  same turns, s S s        straight along `c`, |c| long
  opposite turns, s S -s   `c = S u(phi) - 2 R s n(phi)`, S = sqrt(|c|^2 - 4 R^2)
  three turns, s -s s      centres 2 R from each other; the middle turn is pi +- 2 acos(|c| / 4 R):
                           the greater in calm air; also the lesser for a moving goal
"""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats

TWO_PI = 2.0 * np.pi
FULL_CIRCLE_TOLERANCE_RAD = 1e-9  # rad; a turn this close to a full circle counts as 0

DUBINS_WORDS = ("LSL", "RSR", "LSR", "RSL", "LRL", "RLR", "LRL", "RLR")
FIRST_TURN = np.array([-1, 1, -1, 1, -1, 1, -1, 1])
LAST_TURN = np.array([-1, 1, 1, -1, -1, 1, -1, 1])
MIDDLE_PART = np.array([0, 0, 0, 0, 1, -1, 1, -1])
MIDDLE_ARC_SIGN = np.array([0, 0, 0, 0, 1, 1, -1, -1])
"""Middle of three turns: +1 more than half a circle, -1 less; 0 for a straight."""
CALM_WORD_COUNT = 6
"""Number of words needed in calm air: Dubins' six, listed first."""


@dataclass(frozen=True, slots=True)
class WordParts:
    """First turn (rad), middle (straight in m, or a turn in rad), last turn (rad); NaN: no path."""

    first_rad: Floats
    middle: Floats
    last_rad: Floats


def wrap_angle_rad(angle_rad: Floats) -> Floats:
    """Wrap the angle to [0, 2 pi). Values just below a full circle become 0."""
    angle = np.mod(angle_rad, TWO_PI)
    return np.where(angle > TWO_PI - FULL_CIRCLE_TOLERANCE_RAD, 0.0, angle)


def turn_centre_shift_m(
    goal_offset_n_m: Floats,
    goal_offset_e_m: Floats,
    start_rad: Floats,
    goal_rad: Floats,
    first_turn_sign: int,
    last_turn_sign: int,
    radius: Floats,
) -> tuple[Floats, Floats]:
    """Return `c` (north, east) m for a word's first and last turn."""
    north = goal_offset_n_m + radius * (
        first_turn_sign * np.sin(start_rad) - last_turn_sign * np.sin(goal_rad)
    )
    east = goal_offset_e_m + radius * (
        last_turn_sign * np.cos(goal_rad) - first_turn_sign * np.cos(start_rad)
    )
    return north, east


def dubins_word_parts(
    word_index: int,
    centre_shift_n_m: Floats,
    centre_shift_e_m: Floats,
    start_rad: Floats,
    goal_rad: Floats,
    radius: Floats,
) -> WordParts:
    """Return the three parts of a word for a given `c`."""
    first, last = int(FIRST_TURN[word_index]), int(LAST_TURN[word_index])
    course = np.arctan2(centre_shift_e_m, centre_shift_n_m)
    distance = np.hypot(centre_shift_n_m, centre_shift_e_m)
    lead: Floats | float = 0.0
    with np.errstate(invalid="ignore"):  # no such path: NaN
        if MIDDLE_PART[word_index] != 0:
            half = MIDDLE_ARC_SIGN[word_index] * np.arccos(distance / (4.0 * radius))
            lead, middle = half + np.pi / 2, np.pi + 2.0 * half
        elif first != last:
            middle = np.sqrt(centre_shift_n_m**2 + centre_shift_e_m**2 - 4.0 * radius**2)
            course = course + first * np.arctan2(2.0 * radius, middle)
        else:
            middle = distance
    return WordParts(
        wrap_angle_rad(first * (course - start_rad) + lead),
        middle,
        wrap_angle_rad(last * (goal_rad - course) + lead),
    )


def word_length_m(word_index: int, parts: WordParts, radius: Floats) -> Floats:
    """Return the horizontal length (m) through the air; NaN if the word has no path."""
    middle = parts.middle * radius if MIDDLE_PART[word_index] != 0 else parts.middle
    return radius * (parts.first_rad + parts.last_rad) + middle
