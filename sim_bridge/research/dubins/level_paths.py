"""Time-optimal level Dubins paths between poses in steady wind, for many pairs at a time.

Kinematics (arXiv 2604.13441, III-A, in the air frame): constant airspeed and turn radius; the wind
displaces the path.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.core.base.arrays import Floats, Ints
from sim_bridge.research.dubins.limits import FlightLimits
from sim_bridge.research.dubins.rendezvous import (
    PosePairs,
    first_solution_time_s,
    intercept_time_s,
    same_turn_time_s,
)
from sim_bridge.research.dubins.words import (
    CALM_WORD_COUNT,
    DUBINS_WORDS,
    FIRST_TURN,
    LAST_TURN,
    MIDDLE_PART,
    TWO_PI,
    WordParts,
    word_length_m,
)

_CALM_MPS = 1e-6
_PARTS = 3


@dataclass(frozen=True, slots=True)
class LevelPaths:
    """n paths, each of three parts of constant turn: +1 right, -1 left, 0 straight.

    `start` (n, 3): north, east m, AIR heading rad. `turn` (n, 3); `length_m` (n, 3): metres through
    the air; `wind_to_ne_mps` (n, 2).
    """

    start: Floats
    turn: NDArray[np.int8]
    length_m: Floats
    limits: FlightLimits
    wind_to_ne_mps: Floats

    @property
    def air_length_m(self) -> Floats:
        """Metres through the air; (n,)."""
        return self.length_m.sum(axis=1)

    @property
    def time_s(self) -> Floats:
        """Duration of each path; (n,)."""
        return self.air_length_m / self.limits.airspeed_mps

    def poses_at(self, time_s: Floats) -> Floats:
        """Return the pose at each time: (n, k) gives (n, k, 3), north, east m, air heading."""
        flown_m = np.clip(time_s, 0.0, self.time_s[:, None]) * self.limits.airspeed_mps
        north, east, heading = (np.repeat(self.start[:, [k]], time_s.shape[1], 1) for k in range(3))
        start_m = np.zeros((len(self.start), 1))
        for part in range(_PARTS):
            length = self.length_m[:, part : part + 1]
            done_m = np.clip(flown_m - start_m, 0.0, length)
            angle = self.turn[:, part : part + 1] * done_m / self.limits.turn_radius_m
            # Chord of the arc: length 2 R sin(angle / 2), at half the angle from the heading.
            chord = done_m * np.sinc(angle / TWO_PI)
            north += chord * np.cos(heading + 0.5 * angle)
            east += chord * np.sin(heading + 0.5 * angle)
            heading += angle
            start_m = start_m + length
        seconds = flown_m / self.limits.airspeed_mps
        north += self.wind_to_ne_mps[:, 0:1] * seconds
        east += self.wind_to_ne_mps[:, 1:2] * seconds
        return np.stack([north, east, heading], axis=2)


def fastest_dubins_paths(
    start: ArrayLike, goal: ArrayLike, limits: FlightLimits, wind_to_ne_mps: ArrayLike = (0.0, 0.0)
) -> LevelPaths:
    """Return the fastest path from each start to each goal. A path always exists.

    Poses (n, 3): north, east m, AIR heading rad. Winds (2,) or (n, 2), towards north and east.
    """
    start = np.atleast_2d(np.asarray(start, float))
    goal = np.atleast_2d(np.asarray(goal, float))
    wind = np.broadcast_to(np.asarray(wind_to_ne_mps, float), (len(start), 2))
    radius = np.full(len(start), limits.turn_radius_m)
    away = goal - start
    pairs = PosePairs(
        away[:, 0], away[:, 1], start[:, 2], goal[:, 2], wind[:, 0], wind[:, 1], radius,
        limits.airspeed_mps,
    )  # fmt: skip
    time, word = _fastest_time_and_word_index(pairs)
    turn, length = np.zeros((len(start), _PARTS), np.int8), np.zeros((len(start), _PARTS))
    for number in np.unique(word):
        rows = np.flatnonzero(word == number)
        turn[rows] = (FIRST_TURN[number], MIDDLE_PART[number], LAST_TURN[number])
        length[rows] = _part_lengths_m(int(number), pairs.select(rows), time[rows])
    return LevelPaths(start, turn, length, limits, wind)


def _fastest_time_and_word_index(pairs: PosePairs) -> tuple[Floats, Ints]:
    """Return the minimum time and its word, per path."""
    count = len(pairs.away_n)
    straight = intercept_time_s(pairs, pairs.away_n, pairs.away_e, np.zeros(count))
    earliest = np.maximum(straight * (1.0 - 1e-9) - 1e-9, 0.0)
    times = np.full((len(DUBINS_WORDS), count), np.inf)
    for word in (0, 1):
        times[word] = same_turn_time_s(pairs, word, 0)
        late = np.flatnonzero(np.isinf(times[word]))
        times[word, late] = same_turn_time_s(pairs.select(late), word, 1)
    latest = times[:2].min(axis=0)
    for word in range(2, len(DUBINS_WORDS)):
        times[word] = _min_time_of_unequal_turn_word_s(pairs, word, earliest, latest)
    best = np.argmin(times, axis=0)
    return times[best, np.arange(count)], best


def _min_time_of_unequal_turn_word_s(
    pairs: PosePairs, word: int, earliest_s: Floats, latest_s: Floats
) -> Floats:
    """Minimum time with two opposite turns or three turns; closed-form lengths in calm air."""
    calm = np.hypot(pairs.wind_n, pairs.wind_e) < _CALM_MPS
    time = np.full(len(earliest_s), np.inf)
    still = np.flatnonzero(calm)
    if len(still) and word < CALM_WORD_COUNT:
        sub = pairs.select(still)
        length = word_length_m(
            word, sub.word_parts_at_time(word, np.zeros(len(still))), sub.radius_m
        )
        time[still] = length / sub.airspeed_mps
    moving = np.flatnonzero(~calm)
    if len(moving):
        time[moving] = first_solution_time_s(
            pairs.select(moving), word, earliest_s[moving], latest_s[moving]
        )
    return np.where(np.isnan(time), np.inf, time)


def _part_lengths_m(word: int, pairs: PosePairs, time_s: Floats) -> Floats:
    """Return the word's three lengths. Extra full circles are added to its first turn."""
    parts: WordParts = pairs.word_parts_at_time(word, time_s)
    radius = pairs.radius_m
    middle = parts.middle if MIDDLE_PART[word] == 0 else parts.middle * radius
    first, last = radius * parts.first_rad, radius * parts.last_rad
    spare = np.round((pairs.airspeed_mps * time_s - first - middle - last) / (TWO_PI * radius))
    return np.stack([first + TWO_PI * radius * spare, middle, last], axis=1)
