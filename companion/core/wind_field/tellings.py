"""What members tell of the wind where they are, and what is kept of it.

A belief is a mean over about 10 s. What is older than half a minute is joined to means of a minute:
the past is then known as well, and costs less.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.core.base.arrays import Floats, Ints

TELLING_S = 10.0
"""Beliefs are means over about so long: those told in between repeat one another."""
FRESH_S = 30.0
JOINED_S = 60.0
KEPT_S = 900.0
"""Older than that, even slow changes have been seen again since."""

FROZEN_S = 50.0
FROZEN_COUNT = 5
"""A belief of wind that stays to the centimetre a second for so long, so often, is none."""

MOST_WIND_MPS = 60.0
MOST_STD_MPS = 20.0
MOST_AGE_S = 20.0
MOST_SPEED_MPS = 60.0
MOST_DISTANCE_M = 50_000.0
MOST_HEIGHT_M = 3_000.0
LEAST_STD_MPS = 0.3
"""No wind estimate aboard a multirotor is better, whatever is told."""


@dataclass(frozen=True, slots=True)
class WindTelling:
    """One member's belief of the wind where it is.

    `place_ne_m` about the desk's or vehicle's own origin, `height_m` above the ground, the belief's
    mean and covariance (2, 2), where the air moves to. `t_s` on the receiver's clock.
    """

    member: str
    t_s: float
    place_ne_m: tuple[float, float]
    height_m: float
    mean_to_ne_mps: tuple[float, float]
    cov_ne_m2ps2: tuple[float, float, float]
    """nn, ne, ee"""

    def trouble(self) -> str:
        """Why this can be no belief of wind; empty: it can."""
        nn, ne, ee = self.cov_ne_m2ps2
        numbers = (*self.place_ne_m, self.height_m, *self.mean_to_ne_mps, nn, ne, ee, self.t_s)
        if not all(map(math.isfinite, numbers)):
            return "a number that is not finite"
        if math.hypot(*self.mean_to_ne_mps) > MOST_WIND_MPS:
            return f"more wind than {MOST_WIND_MPS:g} m/s"
        if min(nn, ee) <= 0.0 or ne * ne > nn * ee or max(nn, ee) > MOST_STD_MPS**2:
            return "a covariance that is none"
        if math.hypot(*self.place_ne_m) > MOST_DISTANCE_M:
            return f"further away than {MOST_DISTANCE_M / 1000.0:g} km"
        if abs(self.height_m) > MOST_HEIGHT_M:
            return f"further than {MOST_HEIGHT_M:g} m from the ground"
        return ""

    @property
    def variance_m2ps2(self) -> tuple[float, float]:
        """Variances north and east that, uncorrelated, are no less in any direction than told.

        [[a, b], [b, c]] <= diag(a + |b|, c + |b|).
        """
        nn, ne, ee = self.cov_ne_m2ps2
        least = LEAST_STD_MPS**2
        return max(nn + abs(ne), least), max(ee + abs(ne), least)


@dataclass(slots=True)
class Stretch:
    """The mean of a member's tellings over a stretch of its way.

    `first` and `last`: time, north, east, height at its ends.
    """

    count: int
    first: tuple[float, float, float, float]
    last: tuple[float, float, float, float]
    wind_ne_mps: tuple[float, float]
    variance_ne_m2ps2: tuple[float, float]

    @classmethod
    def of(cls, telling: WindTelling) -> "Stretch":
        """A single telling: it is a mean over the seconds before it."""
        north, east = telling.place_ne_m
        here = (telling.t_s, north, east, telling.height_m)
        return cls(1, here, here, telling.mean_to_ne_mps, telling.variance_m2ps2)

    def joined(self, later: "Stretch") -> "Stretch":
        """Both as one mean."""
        count = self.count + later.count
        old, new = self.count / count, later.count / count
        wind, variance = (
            (old * a[0] + new * b[0], old * a[1] + new * b[1])
            for a, b in (
                (self.wind_ne_mps, later.wind_ne_mps),
                (self.variance_ne_m2ps2, later.variance_ne_m2ps2),
            )
        )
        return Stretch(count, self.first, later.last, wind, variance)

    @property
    def numbers(self) -> tuple[float, ...]:
        """Its two ends (8), wind (2), variances (2) and count."""
        return (*self.first, *self.last, *self.wind_ne_mps, *self.variance_ne_m2ps2, self.count)


@dataclass(slots=True)
class MemberTellings:
    """What is kept of one member's tellings, oldest first."""

    stretches: list[Stretch] = field(default_factory=list)
    newest: WindTelling | None = None
    _same_since_s: float = 0.0
    _same_count: int = 0

    def take(self, telling: WindTelling, joined_s: float = TELLING_S) -> str:
        """Keep a telling; returns why not, empty: it is kept, or repeats what was.

        `joined_s`: fresh tellings within so long are joined.
        """
        if trouble := telling.trouble():
            return trouble
        before = self.newest
        if before is not None:
            if telling.t_s <= before.t_s:
                return ""
            if telling.t_s - before.t_s < TELLING_S - 0.5 and not self._is_forgotten(telling.t_s):
                return ""
            if _speed_mps(before, telling) > MOST_SPEED_MPS:
                self.stretches.clear()
                self.newest = telling
                return f"it moved faster than {MOST_SPEED_MPS:g} m/s"
        if trouble := self._frozen(telling):
            return trouble
        self.newest = telling
        fresh = Stretch.of(telling)
        last = self.stretches[-1] if self.stretches else None
        if last is not None and telling.t_s - last.first[0] < joined_s - 0.5:
            self.stretches[-1] = last.joined(fresh)
        else:
            self.stretches.append(fresh)
        return ""

    @property
    def is_frozen(self) -> bool:
        """It has told the same so often that nothing of it is believed: that is not forgotten."""
        return self._same_count >= FROZEN_COUNT

    def forget(self, now_s: float, most: int) -> None:
        """Join what is no longer fresh, drop what is old; the newest `most` stay."""
        kept: list[Stretch] = []
        for one in self.stretches:
            if now_s - one.last[0] > KEPT_S:
                continue
            before = kept[-1] if kept else None
            fits = before is not None and one.last[0] - before.first[0] < JOINED_S - 0.5
            if before is not None and fits and now_s - one.last[0] > FRESH_S:
                kept[-1] = before.joined(one)
            else:
                kept.append(one)
        self.stretches = kept[-most:]

    def _is_forgotten(self, t_s: float) -> bool:
        return not self.stretches or t_s - self.stretches[-1].last[0] > KEPT_S

    def _frozen(self, telling: WindTelling) -> str:
        """Whether it has told the same for long; what it told meanwhile is then dropped."""
        before = self.newest
        if before is None or before.mean_to_ne_mps != telling.mean_to_ne_mps:
            self._same_since_s, self._same_count = telling.t_s, 1
            return ""
        self._same_count += 1
        if self._same_count < FROZEN_COUNT or telling.t_s - self._same_since_s < FROZEN_S - 0.5:
            return ""
        began_s = self._same_since_s
        self.stretches = [one for one in self.stretches if one.last[0] < began_s]
        self.newest = telling
        return f"it has told the same wind for {telling.t_s - began_s:.0f} s"


def _speed_mps(one: WindTelling, other: WindTelling) -> float:
    (n0, e0), (n1, e1) = one.place_ne_m, other.place_ne_m
    return math.hypot(n1 - n0, e1 - e0) / max(other.t_s - one.t_s, 1e-3)


@dataclass(frozen=True, slots=True)
class KeptStretches:
    """All stretches of all members as arrays, in order of time: members by number, ends (n, 4),
    winds and variances (n, 2), counts (n,)."""

    members: tuple[str, ...]
    member: Ints
    middle: Floats
    first: Floats
    last: Floats
    wind_ne_mps: Floats
    variance_ne_m2ps2: Floats
    count: Floats

    @classmethod
    def of(cls, members: dict[str, MemberTellings], most: int) -> "KeptStretches":
        """At most so many stretches: the oldest are left out."""
        rows = sorted(_rows(members), key=lambda row: row[1].first[0] + row[1].last[0])
        rows = rows[-most:]
        numbers = np.array([row[1].numbers for row in rows]).reshape(-1, 13)
        first, last = numbers[:, 0:4], numbers[:, 4:8]
        middle = 0.5 * (first + last)
        middle[:, 0] -= 0.5 * TELLING_S  # a telling is a mean over the seconds before it
        return cls(
            tuple(members),
            np.array([row[0] for row in rows], np.int64),
            middle,
            first,
            last,
            numbers[:, 8:10],
            numbers[:, 10:12],
            numbers[:, 12],
        )

    def without(self, names: frozenset[str]) -> "KeptStretches":
        """The same less what these members told."""
        stays = np.array([self.members[int(k)] not in names for k in self.member], np.bool_)
        return KeptStretches(
            self.members,
            self.member[stays],
            self.middle[stays],
            self.first[stays],
            self.last[stays],
            self.wind_ne_mps[stays],
            self.variance_ne_m2ps2[stays],
            self.count[stays],
        )


def _rows(members: dict[str, MemberTellings]) -> Iterator[tuple[int, Stretch]]:
    for number, name in enumerate(members):
        for stretch in members[name].stretches:
            yield number, stretch
