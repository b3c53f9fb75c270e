"""Time-optimal level Dubins paths between poses in steady wind, for many pairs at a time.

Kinematics (arXiv 2604.13441, III-A, in the air frame): constant airspeed and turn radius; the wind
displaces the path. Frame: north, east; headings clockwise from north; a turn is +1 right, -1 left,
0 straight. The right normal of heading h is `n(h) = (-sin h, cos h)`; the circle of a turn s at
(p, h) has its centre at `p + R s n(h)`. With `c` from the first turn's centre to the last one's:

  same turns, s S s        straight along `c`, |c| long
  opposite turns, s S -s   `c = S u(phi) - 2 R s n(phi)`, S = sqrt(|c|^2 - 4 R^2)
  three turns, s -s s      centres 2 R from each other; the middle turn is pi +- 2 acos(|c| / 4 R)

In the air frame the goal moves at minus the wind: a rendezvous. A word's length must equal the
distance flown in its time (McGee, Spry & Hedrick 2005; Techy & Woolsey, "Minimum-time path planning
for unmanned aerial vehicles in steady uniform winds", 2009): `L(c(T)) = V T`, `c(T) = c - w T`. The
turning is unwrapped along T, without jumps at full circles. Each root is a crossing of a smooth
function with a multiple of 2 pi R. Crossings are bracketed on a grid over the times at which the
word exists, and refined by bisection. Equal turns with an extra full circle (LSL, RSR) always fit,
at a time in closed form that bounds the others.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.vehicle.power import GRAVITY_MPS2

TWO_PI = 2.0 * np.pi
FULL_CIRCLE_TOLERANCE_RAD = 1e-9  # rad; a turn this close to a full circle counts as 0

DUBINS_WORDS = ("LSL", "RSR", "LSR", "RSL", "LRL", "RLR", "LRL", "RLR")
FIRST_TURN = np.array([-1, 1, -1, 1, -1, 1, -1, 1])
LAST_TURN = np.array([-1, 1, 1, -1, -1, 1, -1, 1])
MIDDLE_PART = np.array([0, 0, 0, 0, 1, -1, 1, -1])
MIDDLE_ARC_SIGN = np.array([0, 0, 0, 0, 1, 1, -1, -1])
"""Middle of three turns: +1 more than half a circle, -1 less; 0 for a straight."""

_PARTS = 3
_GRID = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 10))  # denser at both ends of an interval
_BISECTIONS = 48
_MAX_CROSSINGS = 4  # crossings tried in each interval

Vectors = NDArray[np.complex128]
"""Horizontal vectors (n,): north + 1j east."""


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """Airspeed of the path, which exceeds the wind speed, and its turn radius IN THE AIR."""

    airspeed_mps: float
    turn_radius_m: float

    @classmethod
    def from_bank(cls, airspeed_mps: float, bank_rad: float) -> "FlightLimits":
        """Limits from a bank limit, `R = V^2 / (g tan bank)`."""
        return cls(airspeed_mps, airspeed_mps**2 / (GRAVITY_MPS2 * math.tan(bank_rad)))

    @property
    def turn_rate_rps(self) -> float:
        """Rate of change of the air heading in a level turn (rad/s)."""
        return self.airspeed_mps / self.turn_radius_m


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
    away = (goal - start)[:, :2] @ np.array([1.0, 1j])
    pairs = _PosePairs(away, start[:, 2], goal[:, 2], wind @ np.array([1.0, 1j]), limits)
    time, word = _fastest_time_and_word_index(pairs)
    turn, length = np.zeros((len(start), _PARTS), np.int8), np.zeros((len(start), _PARTS))
    for number in np.unique(word):
        rows = np.flatnonzero(word == number)
        turn[rows] = (FIRST_TURN[number], MIDDLE_PART[number], LAST_TURN[number])
        parts = pairs.select(rows).part_lengths_m(int(number), time[rows])
        circle_m = TWO_PI * limits.turn_radius_m
        spare = np.round((limits.airspeed_mps * time[rows] - parts.sum(axis=1)) / circle_m)
        parts[:, 0] += circle_m * spare  # extra full circles, in the first turn
        length[rows] = parts
    return LevelPaths(start, turn, length, limits, wind)


@dataclass(frozen=True, slots=True)
class _PosePairs:
    """Pose pairs to join; arrays (n,). `away` (m) is goal minus start; `wind` (m/s) is towards."""

    away: Vectors
    start_rad: Floats
    goal_rad: Floats
    wind: Vectors
    limits: FlightLimits

    def select(self, indices: Ints) -> "_PosePairs":
        """Return the pairs at these indices."""
        names = ("away", "start_rad", "goal_rad", "wind")
        return replace(self, **{name: getattr(self, name)[indices] for name in names})

    def turn_centre_shift_m(self, word: int) -> Vectors:
        """Return `c` of a word at T = 0: from the centre of its first turn to its last one's."""
        last, first = np.exp(1j * self.goal_rad), np.exp(1j * self.start_rad)
        normals = LAST_TURN[word] * last - FIRST_TURN[word] * first
        return self.away + 1j * self.limits.turn_radius_m * normals

    def part_lengths_m(self, word: int, time_s: Floats) -> Floats:
        """Return the lengths of a word's three parts for a flight of this duration; (n, 3).

        NaN if the word has no path.
        """
        radius, first, last = self.limits.turn_radius_m, FIRST_TURN[word], LAST_TURN[word]
        shift = self.turn_centre_shift_m(word) - self.wind * time_s
        course, middle_m = np.angle(shift), np.abs(shift)
        lead: Floats | float = 0.0
        with np.errstate(invalid="ignore"):  # no such path: NaN
            if MIDDLE_PART[word] != 0:
                half = MIDDLE_ARC_SIGN[word] * np.arccos(middle_m / (4.0 * radius))
                lead, middle_m = half + np.pi / 2, radius * (np.pi + 2.0 * half)
            elif first != last:
                middle_m = np.sqrt(middle_m**2 - 4.0 * radius**2)
                course = course + first * np.arctan2(2.0 * radius, middle_m)
        first_rad = _wrap_angle_rad(first * (course - self.start_rad) + lead)
        last_rad = _wrap_angle_rad(last * (self.goal_rad - course) + lead)
        return np.stack([radius * first_rad, middle_m, radius * last_rad], axis=1)

    def intercept_time_s(self, shift_m: Vectors, extra_path_m: Floats) -> Floats:
        """Return the T with `V T = extra + |c - w T|`: the only root of an increasing function."""
        speed = self.limits.airspeed_mps
        margin = speed**2 - np.abs(self.wind) ** 2
        b = speed * extra_path_m - (shift_m * self.wind.conj()).real
        gap = np.maximum(b**2 - margin * (extra_path_m**2 - np.abs(shift_m) ** 2), 0.0)
        return np.maximum((b + np.sqrt(gap)) / margin, 0.0)


def _wrap_angle_rad(angle_rad: Floats) -> Floats:
    """Wrap the angle to [0, 2 pi). Values just below a full circle become 0."""
    angle = np.mod(angle_rad, TWO_PI)
    return np.where(angle > TWO_PI - FULL_CIRCLE_TOLERANCE_RAD, 0.0, angle)


def _fastest_time_and_word_index(pairs: _PosePairs) -> tuple[Floats, Ints]:
    """Return the minimum time and its word, per path."""
    count = len(pairs.away)
    straight = pairs.intercept_time_s(pairs.away, np.zeros(count))
    earliest = np.maximum(straight * (1.0 - 1e-9) - 1e-9, 0.0)
    times = np.full((len(DUBINS_WORDS), count), np.inf)
    for word in (0, 1):
        total = _wrap_angle_rad(FIRST_TURN[word] * (pairs.goal_rad - pairs.start_rad)) + TWO_PI
        extra_m = pairs.limits.turn_radius_m * total
        times[word] = pairs.intercept_time_s(pairs.turn_centre_shift_m(word), extra_m)
    latest = times[:2].min(axis=0)
    for word in range(len(DUBINS_WORDS)):
        for begin, end in _feasible_intervals_s(pairs, word, earliest, latest):
            rows = np.flatnonzero(begin < np.minimum(end, times[word]))
            if len(rows):
                found = _first_solution_time_s(pairs.select(rows), word, begin[rows], end[rows])
                times[word, rows] = np.minimum(times[word, rows], found)
    best = np.argmin(times, axis=0)
    return times[best, np.arange(count)], best


def _feasible_intervals_s(
    pairs: _PosePairs, word: int, earliest_s: Floats, latest_s: Floats
) -> list[tuple[Floats, Floats]]:
    """Return the intervals in which the distance of the end circles permits the word: large
    enough (two unequal turns) or small enough (three).
    """
    if FIRST_TURN[word] == LAST_TURN[word] and MIDDLE_PART[word] == 0:
        return [(earliest_s, latest_s)]
    shift = pairs.turn_centre_shift_m(word)
    limit = (4.0 if MIDDLE_PART[word] != 0 else 2.0) * pairs.limits.turn_radius_m
    wind2 = np.maximum(np.abs(pairs.wind) ** 2, 1e-18)
    closest = (shift * pairs.wind.conj()).real / wind2
    inside = limit**2 - np.abs(shift) ** 2 + closest**2 * wind2
    half = np.sqrt(np.maximum(inside, 0.0) / wind2)
    into, out, never = closest - half, closest + half, inside <= 0.0
    if MIDDLE_PART[word] != 0:
        end = np.where(never, earliest_s, np.minimum(latest_s, out))
        return [(np.maximum(earliest_s, into), end)]
    before = np.where(never, latest_s, np.minimum(latest_s, into))
    after = np.where(never, latest_s, np.maximum(earliest_s, out))
    return [(earliest_s, before), (after, latest_s)]


def _excess_length_in_circles(
    pairs: _PosePairs, word: int, time_s: Floats, base_s: Floats
) -> Floats:
    """Distance flown minus the word's length with its turning unwrapped, in full circles.

    `time_s` (n, k); the turning is unwrapped from `base_s` (n,). Roots are at whole numbers.
    """
    turn, radius = FIRST_TURN[word], pairs.limits.turn_radius_m
    base = pairs.turn_centre_shift_m(word)
    shift = base[:, None] - pairs.wind[:, None] * time_s
    flown_m = pairs.limits.airspeed_mps * time_s
    change, straight = (turn * (pairs.goal_rad - pairs.start_rad))[:, None], 0.0
    if MIDDLE_PART[word] != 0:
        half = np.arccos(np.minimum(np.abs(shift) / (4.0 * radius), 1.0))
        change = change + 4.0 * MIDDLE_ARC_SIGN[word] * half
    elif turn == LAST_TURN[word]:
        straight = np.abs(shift)
    else:
        straight = np.sqrt(np.maximum(np.abs(shift) ** 2 - 4.0 * radius**2, 0.0))
        # c moves on a straight line, so its bearing changes by less than pi from the first.
        first = (base - pairs.wind * base_s)[:, None]
        course = np.angle(shift * first.conj()) + np.angle(first)
        course = course + turn * np.arctan2(2.0 * radius, straight)
        change = turn * (2.0 * course - (pairs.start_rad + pairs.goal_rad)[:, None])
    return (flown_m - radius * change - straight) / (TWO_PI * radius)


def _first_solution_time_s(pairs: _PosePairs, word: int, begin_s: Floats, end_s: Floats) -> Floats:
    """Return the first T in the interval at which a word fits; or inf."""
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
        sub, sign = pairs.select(waiting), np.sign(spare[waiting, cell] - whole)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            excess = _excess_length_in_circles(sub, word, middle[:, None], begin_s[waiting])[:, 0]
            left = np.sign(excess - whole) == sign
            low, high = np.where(left, middle, low), np.where(left, high, middle)
        root = 0.5 * (low + high)
        fits = _is_solution(sub, word, root)
        found[waiting[fits]] = root[fits]
        crossing[waiting, cell] = False
        waiting = waiting[~fits]
        waiting = waiting[crossing[waiting].any(axis=1)]
    return found


def _is_solution(pairs: _PosePairs, word: int, time_s: Floats) -> Bools:
    """Return True where the distance flown equals the word's length plus whole circles."""
    length_m = pairs.part_lengths_m(word, time_s).sum(axis=1)
    flown_m = pairs.limits.airspeed_mps * time_s
    loops = (flown_m - length_m) / (TWO_PI * pairs.limits.turn_radius_m)
    whole = np.round(loops)
    return (whole >= 0.0) & (np.abs(loops - whole) < 1e-6)
