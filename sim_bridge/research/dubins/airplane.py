"""Time-optimal Dubins-airplane paths between poses in steady wind, within climb limits.

Kinematics (arXiv 2604.13441, III-A, in the air frame as its last lines ask): constant airspeed,
turn radius and flight-path angle; the wind displaces the path. The three cases are those of Chitsaz
& LaValle 2007 and Owen, Beard & McLain 2015. Low altitude: the Dubins path at a smaller angle.
High: full circles of a slightly larger radius at the steepest angle. Medium: first an arc the other
way, or, if none fits exactly, a full circle at a smaller angle.

At the steepest angle the flight time is known, `T = dz / (V sin gamma)`. So the drifted goal's
position is known, and lengthening the path needs no rendezvous.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from sim_bridge.research.dubins.air_path import PARTS, AirPaths
from sim_bridge.research.dubins.limits import FlightLimits, require_air_faster
from sim_bridge.research.dubins.rendezvous import (
    Meeting,
    chase_time_s,
    equal_turns_time_s,
    first_meeting_s,
)
from sim_bridge.research.dubins.stretch import Stretched, stretched
from sim_bridge.research.dubins.words import (
    FIRST,
    IN_CALM,
    LAST,
    MIDDLE,
    TWO_PI,
    WORDS,
    Turns,
    length_of,
)

_CHUNK = 4096  # paths per batch: amortises numpy's overhead, fits the cache
_CALM_MPS = 1e-6
_MOST_CIRCLES = 1000
_LATER = 2.0  # a requested word may take at most this many times the quickest


def join_poses(
    start: ArrayLike,
    goal: ArrayLike,
    limits: FlightLimits,
    wind_to_ne_mps: ArrayLike = (0.0, 0.0),
    radius_m: ArrayLike | None = None,
    words: ArrayLike | None = None,
) -> AirPaths:
    """The quickest path from each start to each goal.

    Poses (n, 4): north, east, down m, AIR heading rad. Winds (2,) or (n, 2), towards north and
    east. `radius_m` (n,) widens turns. `words` (n,) requests a word per path, -1 for any; if that
    word does not connect the poses, any may.

    A path always exists. Raises LeewayError for poses that are not finite, for wind as fast as the
    airspeed, for a radius below the limit, and for a climb of more than 1000 circles.
    """
    start = np.atleast_2d(np.asarray(start, float))
    goal = np.atleast_2d(np.asarray(goal, float))
    if start.shape != goal.shape or start.shape[1:] != (4,):
        raise LeewayError(
            f"poses {start.shape} and {goal.shape}: expected (n, 4) twice, north, east, down, rad"
        )
    if not (np.isfinite(start).all() and np.isfinite(goal).all()):
        row = int(np.argmin(np.isfinite(np.hstack([start, goal])).all(axis=1)))
        raise LeewayError(f"pose {row}: expected finite numbers")
    wind = np.broadcast_to(np.asarray(wind_to_ne_mps, float), (len(start), 2))
    radius = _radii(radius_m, limits, len(start))
    word = np.broadcast_to(np.asarray(-1 if words is None else words, np.int64), (len(start),))
    require_air_faster(limits.airspeed_mps, wind)
    steepest = np.where(start[:, 2] >= goal[:, 2], limits.climb_rad, limits.descent_rad)
    # In the steepest climb the horizontal airspeed must exceed the wind.
    climbs = start[:, 2] != goal[:, 2]
    if climbs.any():
        slowest = limits.airspeed_mps * math.cos(max(limits.climb_rad, limits.descent_rad))
        require_air_faster(slowest, wind[climbs])
    chunks = [
        _joined(
            start[at], goal[at], wind[at], radius[at], steepest[at], limits.airspeed_mps, word[at]
        )
        for at in (slice(i, i + _CHUNK) for i in range(0, len(start), _CHUNK))
    ]
    return chunks[0] if len(chunks) == 1 else concatenated(chunks)


def concatenated(paths: list[AirPaths]) -> AirPaths:
    """All paths as one batch."""
    if not paths:
        none = np.empty(0)
        return AirPaths(
            np.empty((0, 4)), np.empty((0, PARTS), np.int8), np.empty((0, PARTS)),
            none, none, none, np.empty((0, 2)), (),
        )  # fmt: skip
    return AirPaths(
        np.concatenate([p.start for p in paths]),
        np.concatenate([p.turn for p in paths]),
        np.concatenate([p.length_m for p in paths]),
        np.concatenate([p.radius_m for p in paths]),
        np.concatenate([p.level_mps for p in paths]),
        np.concatenate([p.climb_mps for p in paths]),
        np.concatenate([p.wind_to_ne_mps for p in paths]),
        tuple(word for p in paths for word in p.word),
    )


def _radii(radius_m: ArrayLike | None, limits: FlightLimits, count: int) -> Floats:
    if radius_m is None:
        return np.full(count, limits.turn_radius_m)
    radius = np.broadcast_to(np.asarray(radius_m, float), (count,))
    if not (radius >= limits.turn_radius_m * (1.0 - 1e-12)).all():
        raise LeewayError(
            f"radius_m: expected at least the limit, {limits.turn_radius_m:.1f} m, everywhere"
        )
    return radius.copy()


def _joined(
    start: Floats,
    goal: Floats,
    wind: Floats,
    radius: Floats,
    steepest: Floats,
    airspeed: float,
    wanted: Ints,
) -> AirPaths:
    away = goal - start
    meeting = Meeting(
        away[:, 0], away[:, 1], -away[:, 2], start[:, 3], goal[:, 3],
        wind[:, 0], wind[:, 1], radius, airspeed,
    )  # fmt: skip
    # The steepest angle gives the shortest climb time.
    needed_s = np.abs(meeting.climb_m) / (airspeed * np.sin(steepest))
    time, word = quickest(meeting, np.zeros(len(start)), wanted)
    longer = Stretched.none(len(start))
    steep = np.flatnonzero(time < needed_s)
    if len(steep):
        sub, least_s = meeting.take(steep), needed_s[steep]
        longer.put(steep, stretched(sub, least_s, airspeed * np.cos(steepest[steep])))
        left = np.flatnonzero(~longer.found[steep])
        if len(left):
            time[steep[left]], word[steep[left]] = quickest(
                sub.take(left), least_s[left], wanted[steep[left]]
            )
    return _laid_out(start, meeting, time, word, longer)


def quickest(meeting: Meeting, not_before_s: Floats, wanted: Ints) -> tuple[Floats, Ints]:
    """Least time not before `not_before_s` and its word, per path; the wanted word where it
    fits.
    """
    nothing = np.zeros(len(not_before_s))
    straight = chase_time_s(meeting, meeting.away_n, meeting.away_e, nothing)
    earliest = np.maximum(straight * (1.0 - 1e-9) - 1e-9, not_before_s)
    earliest = np.maximum(earliest, np.abs(meeting.climb_m) / meeting.airspeed_mps)
    times = np.full((len(WORDS), len(not_before_s)), np.inf)
    for word in (0, 1):
        times[word] = _equal_turns(meeting, word, not_before_s, np.arange(len(not_before_s)), 0)
        late = np.flatnonzero(np.isinf(times[word]))
        times[word, late] = _equal_turns(meeting, word, not_before_s, late, 1)
    _more_circles(meeting, not_before_s, times)
    asked = wanted >= 0
    latest = times[:2].min(axis=0)
    latest = np.where(asked, _LATER * latest, latest)
    for word in range(2, len(WORDS)):
        times[word] = _other_word(meeting, word, earliest, latest)
    best = np.argmin(times, axis=0)
    if asked.any():
        fits = asked & np.isfinite(times[wanted, np.arange(times.shape[1])])
        best = np.where(fits, wanted, best)
    return times[best, np.arange(times.shape[1])], best


def _equal_turns(
    meeting: Meeting, word: int, not_before_s: Floats, rows: Ints, circles: int
) -> Floats:
    time = equal_turns_time_s(meeting.take(rows), word, circles)
    return np.where(time >= not_before_s[rows] * (1.0 - 1e-12), time, np.inf)


def _more_circles(meeting: Meeting, not_before_s: Floats, times: Floats) -> None:
    """Add full circles until the climb is completed, where one is not enough."""
    for circles in range(2, _MOST_CIRCLES):
        rows = np.flatnonzero(np.isinf(times[:2].min(axis=0)))
        if not len(rows):
            return
        for word in (0, 1):
            times[word, rows] = _equal_turns(meeting, word, not_before_s, rows, circles)
    raise LeewayError(
        f"climb: more than {_MOST_CIRCLES} circles; expected a smaller difference of height"
    )


def _other_word(meeting: Meeting, word: int, earliest: Floats, latest: Floats) -> Floats:
    """Least time with two opposite turns or three turns; closed-form lengths in calm air."""
    calm = np.hypot(meeting.wind_n, meeting.wind_e) < _CALM_MPS
    time = np.full(len(earliest), np.inf)
    still = np.flatnonzero(calm)
    if len(still) and word < IN_CALM:
        sub = meeting.take(still)
        length = length_of(word, sub.turns_at(word, np.zeros(len(still))), sub.radius_m)
        took = np.hypot(length, sub.climb_m) / sub.airspeed_mps
        time[still] = np.where(took >= earliest[still] * (1.0 - 1e-9), took, np.inf)
    moving = np.flatnonzero(~calm)
    if len(moving):
        time[moving] = first_meeting_s(meeting.take(moving), word, earliest[moving], latest[moving])
    return np.where(np.isnan(time), np.inf, time)


def _laid_out(
    start: Floats, meeting: Meeting, time: Floats, word: Ints, longer: Stretched
) -> AirPaths:
    count = len(time)
    time = np.where(longer.found, longer.time_s, time)
    word = np.where(longer.found, longer.word, word)
    flown = meeting.flown_m(time)
    turn = np.zeros((count, PARTS), np.int8)
    length = np.zeros((count, PARTS))
    radius = np.where(longer.found, longer.radius_m, meeting.radius_m)
    for number in range(len(WORDS)):
        rows = np.flatnonzero((word == number) & ~longer.found)
        if not len(rows):
            continue
        sub = meeting.take(rows)
        turn[rows, 1:] = (FIRST[number], MIDDLE[number], LAST[number])
        length[rows, 1:] = _parts_m(
            number, sub.turns_at(number, time[rows]), sub.radius_m, flown[rows]
        )
    turn[longer.found] = longer.turn[longer.found]
    length[longer.found] = longer.length_m[longer.found]
    took = np.where(time > 0.0, time, 1.0)
    names = tuple(
        ("" if lead == 0 else "R" if lead > 0 else "L") + WORDS[w]
        for lead, w in zip(turn[:, 0], word, strict=True)
    )
    return AirPaths(
        start=start,
        turn=turn,
        length_m=length,
        radius_m=radius,
        level_mps=np.where(time > 0.0, length.sum(axis=1) / took, meeting.airspeed_mps),
        climb_mps=np.where(time > 0.0, meeting.climb_m / took, 0.0),
        wind_to_ne_mps=np.stack([meeting.wind_n, meeting.wind_e], axis=1),
        word=names,
    )


def _parts_m(word: int, turns: Turns, radius: Floats, flown_m: Floats) -> Floats:
    """The word's three lengths; extra full circles are added to its first turn."""
    straight = MIDDLE[word] == 0
    middle = turns.middle if straight else turns.middle * radius
    first, last = radius * turns.first_rad, radius * turns.last_rad
    spare = np.round((flown_m - first - middle - last) / (TWO_PI * radius))
    return np.stack([first + TWO_PI * radius * spare, middle, last], axis=1)
