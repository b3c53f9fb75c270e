"""Fronts: a wind that changes for good where one member is, and comes to the others.

A member's newest 10 s mean is held against the mean of the minute before. The process says how much
the two differ by chance, and the last ten minutes how much gustier it is than that. Where they
differ by more, all that the members near by told is weighed (`front_odds`): the odds of a front
decide, and say where it goes and when. Whoever feels it next corrects that: times of arrival are
linear in the slowness vector s, t = t0 + s . x. Where hardly anybody does and what is told
speaks against a front, it is withdrawn.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from heapq import nsmallest

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.front_odds import KEPT_S, FrontOdds, front_odds
from companion.core.wind_field.tellings import TELLING_S, WindTelling

BEFORE_S, GAP_S = 60.0, 15.0
"""The minute before, and the seconds between it and now in which a front may be passing."""
LEAST_BEFORE_S = 30.0

SUSPECT_SQUARE = 5.0
"""Change over chance, squared, at which the odds are worked out: chance makes it
once in a dozen."""
LOOK_S = 2.0
"""And no sooner after the last time."""
MOST_STANDING_SHARE = 0.1
"""More of the ground is not taken into account: it would hide fronts from drones that move."""
LOG_ODDS = 6.5
"""A front is believed from these odds on (natural logarithm).

Chosen on fields about recorded wind (seeds 200 to 202: 82 fronts, 74 h) for less than one false
alert in ten hours of eight drones.
"""
ALONE_LOG_ODDS = 2.5
"""And where a change that only one member tells of explains what was told no better than so much:
who stands near it would have felt a front."""
MOST_ASKED = 10
"""So many members are asked: who suspects a front, and the nearest. More says little more."""
HEARD_S = 15.0
"""Who has told nothing for so long is not asked."""

DOUBTED_S, WITHDRAWN_LOG_ODDS = 60.0, 2.0
"""So long after a front is noticed its odds are worked out again; at fewer it is withdrawn.

On fields about recorded wind (seeds 200 to 202) those of a gust fall so far within this time, those
of a front rise first. Later they fall, too: the wind behind it becomes the wind of before.
"""

SURE_OTHERS = 2
"""So many others have felt it: it is not withdrawn any more."""

FELT_SQUARE, FELT_MPS, FELT_COS = 8.0, 3.5, 0.7
"""Of a member's own change once a front is known: it has come there. Within 45 degrees of it."""
FELT_STD_S = 10.0

GUSTS_S, MOST_SQUARE, USUAL_SQUARE = 600.0, 14.0, 2.0
"""How gusty it is, learned over ten minutes: the mean square, over 2 by the process. Fronts count
as no more than a gust."""

GONE_S = 300.0
"""After so long a front has left the site, and another one may come."""


@dataclass(frozen=True, slots=True)
class FeltChange:
    """One member's change of wind: where and when it was noticed, the change, the wind behind.

    Of who feels a front first they are what is believed of it: the change has only begun there.
    """

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
        due_s, std_s = self.arrivals(np.array([place_ne_m]))
        return float(due_s[0]), float(std_s[0])

    def arrivals(self, place_ne_m: Floats) -> tuple[Floats, Floats]:
        """The same at places (n, 2): times and standard deviations (n,)."""
        off_m = place_ne_m - self.origin_ne_m
        rows = np.column_stack([np.ones(len(off_m)), off_m])
        variance = np.einsum("ij,jk,ik->i", rows, self.cov, rows)
        return self.t0_s + off_m @ self.slowness_spm, np.sqrt(variance + FELT_STD_S**2)

    def catches(self, place_ne_m: tuple[float, float], first_s: float, last_s: float) -> bool:
        """Whether it may pass a place within a stretch of time (two standard deviations)."""
        t_s, std_s = self.arrives(place_ne_m)
        return first_s - 2.0 * std_s <= t_s <= last_s + 2.0 * std_s

    def better_known(self, felt: FeltChange) -> "FrontAhead":
        """The same front once one more member has felt it: a linear update of its times."""
        row = np.array([1.0, *(np.array(felt.place_ne_m) - self.origin_ne_m)])
        late_s = felt.t_s - self.t0_s - float(row[1:] @ self.slowness_spm)
        with_late = self.cov @ row
        variance = float(row @ with_late) + FELT_STD_S**2
        gain = with_late / variance
        cov = self.cov - np.outer(gain, with_late)
        return replace(
            self,
            felt=(*self.felt, felt),
            t0_s=self.t0_s + float(gain[0]) * late_s,
            slowness_spm=self.slowness_spm + gain[1:] * late_s,
            cov=0.5 * (cov + cov.T),
        )


@dataclass(frozen=True, slots=True)
class FrontWithdrawn:
    """A front that was believed is none, as is known from `t_s` on."""

    front: FrontAhead
    t_s: float


FrontNews = FrontAhead | FrontWithdrawn


@dataclass(slots=True)
class _Member:
    """What one member told in the last minutes, oldest first, and how gusty it is there."""

    told: deque[WindTelling] = field(default_factory=deque)
    square: float = USUAL_SQUARE
    newest: FeltChange | None = None
    """How much the wind has changed, by the newest of them."""

    def learn(self, square: float, dt_s: float) -> None:
        """Follow how gusty it is here."""
        share = -math.expm1(-dt_s / GUSTS_S)
        self.square += share * (min(square, MOST_SQUARE) - self.square)

    def change(self, telling: WindTelling) -> tuple[float, float] | None:
        """Newest wind less the mean of the minute before; None while that is not known."""
        now_s = telling.t_s
        while self.told and now_s - self.told[0].t_s > KEPT_S:
            self.told.popleft()
        before = [one for one in self.told if GAP_S <= now_s - one.t_s <= BEFORE_S + GAP_S]
        self.told.append(telling)
        if len(before) < 2 or before[-1].t_s - before[0].t_s < LEAST_BEFORE_S:
            return None
        north, east = (sum(one.mean_to_ne_mps[k] for one in before) / len(before) for k in (0, 1))
        wind = telling.mean_to_ne_mps
        return wind[0] - north, wind[1] - east


class FrontWatch:
    """Follows what members tell, about once a second; one per desk."""

    def __init__(self, process: WindProcessParams) -> None:
        self._process = process
        self._field = FieldProcess(process)
        self._chance_m2ps2 = chance_m2ps2(process)
        self._members: dict[str, _Member] = {}
        self._looked_s = -math.inf
        self._standing_share = 0.0
        self.front: FrontAhead | None = None
        """The front that is passing, while it may be on the site."""

    def expect_ground(self, standing_share: float) -> None:
        """What the ground does to the wind, over the mean wind, as is known from now on."""
        self._standing_share = min(standing_share, MOST_STANDING_SHARE)

    def hear(self, telling: WindTelling) -> FrontNews | None:
        """Take a telling; returns the front where it is new, better known or withdrawn by it."""
        if telling.trouble():
            return None
        felt = self._felt(telling)
        if self.front is not None and telling.t_s - self.front.noticed_s > GONE_S:
            self.front = None
        if self.front is not None and self._is_none(self.front, telling.t_s):
            withdrawn, self.front = FrontWithdrawn(self.front, telling.t_s), None
            return withdrawn
        if felt is None or felt.square < SUSPECT_SQUARE:
            return None
        if self.front is not None:
            return self._better_known(self.front, felt)
        if felt.t_s - self._looked_s < LOOK_S - 0.05:
            return None
        self._looked_s = felt.t_s
        return self._noticed(felt)

    def _felt(self, telling: WindTelling) -> FeltChange | None:
        """How much the wind has changed where it is; None: not known."""
        known = self._members.setdefault(telling.member, _Member())
        before_s = known.told[-1].t_s if known.told else telling.t_s
        if known.told and telling.t_s <= before_s:
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
        known.newest = FeltChange(
            telling.member,
            telling.t_s,
            telling.place_ne_m,
            change,
            telling.mean_to_ne_mps,
            square / self._gustier,
        )
        return known.newest

    @property
    def _gustier(self) -> float:
        """How much gustier it is than the process says: the ratio of squares, at least 1."""
        squares = [one.square for one in self._members.values()]
        return max(sum(squares) / len(squares) / USUAL_SQUARE, 1.0)

    def _noticed(self, felt: FeltChange) -> FrontAhead | None:
        """Whether there is a front now, by all who are near."""
        asked = self._near(felt.place_ne_m, felt.t_s)
        odds = self._odds(asked, felt.place_ne_m, felt.t_s)
        if odds is None or odds.log_odds < LOG_ODDS:
            return None
        if odds.log_odds < odds.alone_log_odds - ALONE_LOG_ODDS:
            return None
        changes = [one.newest for one in asked if one.newest is not None]
        towards = odds.change_ne_mps
        first = max(changes, key=lambda one: np.dot(one.change_ne_mps, towards))
        self.front = _front_of(odds, replace(first, t_s=felt.t_s))
        return self.front

    def _is_none(self, front: FrontAhead, now_s: float) -> bool:
        """Whether what was told since a front was noticed speaks against it."""
        first, *others = front.felt
        if len(others) >= SURE_OTHERS or now_s - front.noticed_s > DOUBTED_S:
            return False
        if now_s - self._looked_s < LOOK_S - 0.05:
            return False
        self._looked_s = now_s
        place = first.place_ne_m
        odds = self._odds(self._near(place, now_s), place, now_s)
        return odds is not None and odds.log_odds < WITHDRAWN_LOG_ODDS

    def _odds(
        self, asked: Sequence[_Member], place_ne_m: tuple[float, float], now_s: float
    ) -> FrontOdds | None:
        told = [tuple(one.told) for one in asked]
        return front_odds(told, place_ne_m, now_s, self._field, self._gustier, self._standing_share)

    def _near(self, place_ne_m: tuple[float, float], now_s: float) -> list[_Member]:
        """Who is asked: the nearest of those that have told of late."""
        heard = (
            one
            for one in self._members.values()
            if one.told and now_s - one.told[-1].t_s <= HEARD_S
        )
        return nsmallest(
            MOST_ASKED, heard, key=lambda one: math.dist(one.told[-1].place_ne_m, place_ne_m)
        )

    def _better_known(self, known: FrontAhead, felt: FeltChange) -> FrontAhead | None:
        if felt.square < FELT_SQUARE or felt.size_mps < FELT_MPS or not _alike(known.felt[0], felt):
            return None
        if any(one.member == felt.member for one in known.felt):
            return None
        self.front = known.better_known(felt)
        return self.front


def _front_of(odds: FrontOdds, felt: FeltChange) -> FrontAhead:
    """The front that is believed, and who feels most of it."""
    before = np.subtract(felt.wind_ne_mps, felt.change_ne_mps)
    north, east = before + odds.change_ne_mps
    first = replace(felt, change_ne_mps=odds.change_ne_mps, wind_ne_mps=(float(north), float(east)))
    return FrontAhead(felt.t_s, (first,), odds.origin_ne_m, odds.t0_s, odds.slowness_spm, odds.cov)


def _alike(one: FeltChange, other: FeltChange) -> bool:
    """Whether the winds changed in much the same direction."""
    (n0, e0), (n1, e1) = one.change_ne_mps, other.change_ne_mps
    return n0 * n1 + e0 * e1 >= FELT_COS * one.size_mps * other.size_mps


def chance_m2ps2(process: WindProcessParams) -> float:
    """Variance of a 10 s mean less the mean of the minute before, by the process at its reference
    wind, per axis.
    """
    ages = np.concatenate([[0.0], np.arange(GAP_S, GAP_S + BEFORE_S, TELLING_S)])
    weight = np.array([1.0, *np.full(ages.size - 1, -1.0 / (ages.size - 1))])
    # E[(sum w x)^2] = -1/2 sum w_i w_j E[(x_i - x_j)^2] for weights that sum to nothing
    moved = process.mean_squared_change_m2ps2(np.abs(np.subtract.outer(ages, ages)), TELLING_S)
    return float(-0.5 * weight @ moved @ weight)
