"""Fronts: a wind that changes for good where one member is, and comes to the others.

A member's newest 10 s mean is held against the mean of the minute before. The process says how much
the two differ by chance, and the last ten minutes how much gustier it is than that; what differs by
far more is a front. Two members that feel the like, one after the other, need less than one alone.

Where it goes is guessed from the change itself: the normal of a gust front lies along the change
of the wind, and it moves as a density current, at about three quarters of the wind behind it (0.6
to 0.9: Goff, Mon. Weather Rev. 104, 1976). Whoever feels it next corrects that: times of arrival
are linear in the slowness vector s, t = t0 + s . x, which is estimated by least squares with the
guess as prior.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.tellings import TELLING_S, WindTelling

BEFORE_S, GAP_S = 60.0, 15.0
"""The minute before, and the seconds between it and now in which a front may be passing."""
LEAST_BEFORE_S = 30.0

ALONE_SQUARE, ALONE_MPS = 25.0, 6.0
"""Change over chance, squared, and the change itself, of one member that is believed alone.

These limits and the next were chosen on fields about recorded wind (seed 99) for about one false
alert in ten hours of eight drones. With a sum of 34 there were five in seven hours, and alerts came
4 s sooner.
"""
EACH_SQUARE, EACH_MPS, SUM_SQUARE = 8.0, 3.5, 40.0
"""Of each of two members that are believed together, and the sum of their squares."""
TOGETHER_S, TOGETHER_COS, TOGETHER_STDS = 45.0, 0.7, 1.5
"""Felt within so long, within 45 degrees, and when the first one's front was due at the second."""

SPEED_OVER_BEHIND = 0.75
SPEED_STD_FRAC, NORMAL_STD_RAD = 0.35, math.radians(35.0)
FELT_STD_S = 10.0
LEAST_SPEED_MPS = 2.0

APART_M = 200.0
"""Two members nearer than this may feel the same gust."""

GUSTS_S, MOST_SQUARE, USUAL_SQUARE = 600.0, 14.0, 2.0
"""How gusty it is, learned over ten minutes: the mean square, over 2 by the process. Fronts count
as no more than a gust."""

GONE_S = 300.0
"""After so long a front has left the site, and another one may come."""
DULL_S = 120.0
"""A member that felt a front feels its other side no sooner than that."""


@dataclass(frozen=True, slots=True)
class FeltChange:
    """One member's change of wind: where and when it was noticed, the change, the wind behind."""

    member: str
    t_s: float
    place_ne_m: tuple[float, float]
    change_ne_mps: tuple[float, float]
    wind_ne_mps: tuple[float, float]
    square: float
    """The change over what the process expects, squared: chi-square of two degrees by chance."""

    @property
    def size_mps(self) -> float:
        """How much the wind changed."""
        return math.hypot(*self.change_ne_mps)


@dataclass(frozen=True, slots=True)
class FrontAhead:
    """A front that is believed: when it passes a place, and how well that is known.

    `slowness_spm` (2,) seconds per metre towards north and east, `cov` (3, 3) of (t0, slowness)
    about `origin_ne_m`.
    """

    noticed_s: float
    felt: tuple[FeltChange, ...]
    origin_ne_m: Floats
    t0_s: float
    slowness_spm: Floats
    cov: Floats

    @property
    def change_ne_mps(self) -> tuple[float, float]:
        """The strongest change that anybody felt."""
        return max(self.felt, key=lambda one: one.size_mps).change_ne_mps

    @property
    def speed_mps(self) -> float:
        """How fast it moves."""
        return 1.0 / max(float(np.hypot(*self.slowness_spm)), 1e-3)

    @property
    def towards_rad(self) -> float:
        """Where it moves to, clockwise from north."""
        return math.atan2(float(self.slowness_spm[1]), float(self.slowness_spm[0]))

    def arrives(self, place_ne_m: tuple[float, float]) -> tuple[float, float]:
        """When it is noticed at a place, and the standard deviation of that, s."""
        row = np.array([1.0, *(np.array(place_ne_m) - self.origin_ne_m)])
        t_s = self.t0_s + float(row[1:] @ self.slowness_spm)
        return t_s, math.sqrt(float(row @ self.cov @ row) + FELT_STD_S**2)

    def catches(self, place_ne_m: tuple[float, float], first_s: float, last_s: float) -> bool:
        """Whether it may pass a place within a stretch of time (two standard deviations)."""
        t_s, std_s = self.arrives(place_ne_m)
        return first_s - 2.0 * std_s <= t_s <= last_s + 2.0 * std_s


@dataclass(slots=True)
class _Member:
    """One member's winds of the last minutes: time, north, east."""

    winds: deque[tuple[float, float, float]] = field(default_factory=deque)
    square: float = USUAL_SQUARE

    def learn(self, square: float, dt_s: float) -> None:
        """Follow how gusty it is here."""
        share = -math.expm1(-dt_s / GUSTS_S)
        self.square += share * (min(square, MOST_SQUARE) - self.square)

    def change(self, telling: WindTelling) -> tuple[float, float] | None:
        """Newest wind less the mean of the minute before; None while that is not known."""
        now_s = telling.t_s
        while self.winds and now_s - self.winds[0][0] > BEFORE_S + GAP_S:
            self.winds.popleft()
        before = [one for one in self.winds if now_s - one[0] >= GAP_S]
        self.winds.append((now_s, *telling.mean_to_ne_mps))
        if len(before) < 2 or before[-1][0] - before[0][0] < LEAST_BEFORE_S:
            return None
        north, east = (sum(one[k] for one in before) / len(before) for k in (1, 2))
        wind = telling.mean_to_ne_mps
        return wind[0] - north, wind[1] - east


class FrontWatch:
    """Follows what members tell, about once a second; one per desk."""

    def __init__(self, process: WindProcessParams) -> None:
        self._process = process
        self._chance_m2ps2 = chance_m2ps2(process)
        self._members: dict[str, _Member] = {}
        self._suspects: deque[FeltChange] = deque()
        self._dull_until_s: dict[str, float] = {}
        self.front: FrontAhead | None = None
        """The front that is passing, while it may be on the site."""

    def hear(self, telling: WindTelling) -> FrontAhead | None:
        """Take a telling; returns the front where it is new or better known by this telling."""
        if telling.trouble():
            return None
        felt = self._felt(telling)
        if self.front is not None and telling.t_s - self.front.noticed_s > GONE_S:
            self.front = None
        if felt is None:
            return None
        if self.front is not None:
            return self._better_known(felt)
        return self._noticed(felt)

    def _felt(self, telling: WindTelling) -> FeltChange | None:
        """The change where it is one that a front might make."""
        known = self._members.setdefault(telling.member, _Member())
        before_s = known.winds[-1][0] if known.winds else telling.t_s
        if known.winds and telling.t_s <= before_s:
            return None
        change = known.change(telling)
        if change is None:
            return None
        north, east = change
        scale = self._process.variance_scale(
            math.hypot(telling.mean_to_ne_mps[0] - north, telling.mean_to_ne_mps[1] - east)
        )
        told = 0.5 * sum(telling.variance_m2ps2)
        square = (north**2 + east**2) / (scale * self._chance_m2ps2 + told)
        known.learn(square, min(telling.t_s - before_s, BEFORE_S))
        square /= max(self._gusts, 1.0)
        dull_s = self._dull_until_s.get(telling.member)
        if dull_s is not None and telling.t_s < dull_s:
            return None
        if square < EACH_SQUARE or math.hypot(north, east) < EACH_MPS:
            return None
        wind = telling.mean_to_ne_mps
        here = telling.place_ne_m
        return FeltChange(telling.member, telling.t_s, here, (north, east), wind, square)

    @property
    def _gusts(self) -> float:
        """How much gustier it is than the process says: the ratio of squares."""
        squares = [one.square for one in self._members.values()]
        return sum(squares) / len(squares) / USUAL_SQUARE

    def _noticed(self, felt: FeltChange) -> FrontAhead | None:
        """Whether there is a front now: one member felt much, or two felt the like."""
        while self._suspects and felt.t_s - self._suspects[0].t_s > TOGETHER_S:
            self._suspects.popleft()
        others: dict[str, FeltChange] = {}
        for one in self._suspects:
            if _fits(one, felt):
                others.setdefault(one.member, one)
        self._suspects.append(felt)
        alone = felt.square >= ALONE_SQUARE and felt.size_mps >= ALONE_MPS
        if not alone and not others:
            return None
        self._suspects.clear()
        everybody = (*sorted(others.values(), key=lambda one: one.t_s), felt)
        for one in everybody:
            self._dull_until_s[one.member] = felt.t_s + DULL_S
        self.front = estimated(felt.t_s, everybody)
        return self.front

    def _better_known(self, felt: FeltChange) -> FrontAhead | None:
        assert self.front is not None
        known = self.front
        if any(one.member == felt.member for one in known.felt) or not _alike(known.felt[0], felt):
            return None
        self._dull_until_s[felt.member] = felt.t_s + DULL_S
        self.front = estimated(known.noticed_s, (*known.felt, felt))
        return self.front


def estimated(noticed_s: float, felt: tuple[FeltChange, ...]) -> FrontAhead:
    """Where a front goes, from who felt it where and when (at least one, in order of time)."""
    change = np.mean([one.change_ne_mps for one in felt], axis=0)
    behind = np.mean([one.wind_ne_mps for one in felt], axis=0)
    normal = change / max(float(np.hypot(*change)), 1e-6)
    speed = max(SPEED_OVER_BEHIND * float(behind @ normal), LEAST_SPEED_MPS)
    aside = np.array([-normal[1], normal[0]])
    turned = np.stack([normal, aside], axis=1)
    guess = normal / speed
    spread = np.diag([SPEED_STD_FRAC / speed, NORMAL_STD_RAD / speed]) ** 2
    origin = np.array(felt[0].place_ne_m)
    prior = np.zeros((3, 3))
    prior[0, 0] = 1e6  # nothing is known of the time but what was felt
    prior[1:, 1:] = turned @ spread @ turned.T
    rows = np.array([[1.0, *(np.array(one.place_ne_m) - origin)] for one in felt])
    late = np.array([one.t_s for one in felt]) - felt[0].t_s - rows[:, 1:] @ guess
    gain = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + FELT_STD_S**2 * np.eye(len(felt)))
    step = gain @ late
    cov = prior - gain @ rows @ prior
    t0_s = felt[0].t_s + float(step[0])
    return FrontAhead(noticed_s, felt, origin, t0_s, guess + step[1:], 0.5 * (cov + cov.T))


def _fits(one: FeltChange, later: FeltChange) -> bool:
    """Whether two members may have felt one front: enough, apart, alike, and when it was due."""
    if one.member == later.member or one.square + later.square < SUM_SQUARE:
        return False
    if math.dist(one.place_ne_m, later.place_ne_m) < APART_M or not _alike(one, later):
        return False
    due_s, std_s = estimated(one.t_s, (one,)).arrives(later.place_ne_m)
    return one.t_s < later.t_s and abs(later.t_s - due_s) <= TOGETHER_STDS * std_s


def _alike(one: FeltChange, other: FeltChange) -> bool:
    """Whether the winds changed in much the same direction."""
    (n0, e0), (n1, e1) = one.change_ne_mps, other.change_ne_mps
    return n0 * n1 + e0 * e1 >= TOGETHER_COS * one.size_mps * other.size_mps


def chance_m2ps2(process: WindProcessParams) -> float:
    """Variance of a 10 s mean less the mean of the minute before, by the process at its reference
    wind, per axis.
    """
    ages = np.concatenate([[0.0], np.arange(GAP_S, GAP_S + BEFORE_S, TELLING_S)])
    weight = np.array([1.0, *np.full(ages.size - 1, -1.0 / (ages.size - 1))])
    # E[(sum w x)^2] = -1/2 sum w_i w_j E[(x_i - x_j)^2] for weights that sum to nothing
    moved = process.mean_squared_change_m2ps2(np.abs(np.subtract.outer(ages, ages)), TELLING_S)
    return float(-0.5 * weight @ moved @ weight)
