"""One belief of the wind over a site: what members told, and the forecast before that.

Kriging with the covariance of `field_process` (Rasmussen and Williams 2006, ch. 2): with at most
`MOST_STRETCHES` means of what was told, all is worked out anew each time, in a few milliseconds.
Both axes share the covariance of the wind. What is told of them has an error of its own: a part
that is new each time, and a lasting one, the same in all that a member tells.

A member alone gives itself the forecast that the wind process gives. Members that contradict the
others are left out (`agreement`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from companion.core.base.arrays import Floats
from companion.core.wind_field.agreement import LEAST_TELLINGS, NEW_S, contradicting
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.front_term import FrontTerm
from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.tellings import (
    JOINED_S,
    KEPT_S,
    MOST_AGE_S,
    TELLING_S,
    KeptStretches,
    MemberTellings,
    Stretch,
    WindTelling,
)

MOST_STRETCHES = 150
"""With a hundred drones the newest two minutes; with eight all that is kept."""
_CROWD = 12
"""More members than that join their fresh tellings over longer: there is enough of them."""

_NEWER_S = 2.0
"""A belief of this moment says something new so long after the last one that is kept."""

_SPARE_STRETCHES = 3
"""Kept of each member beyond its share: some tell less often, or leave."""

LEAST_MISFIT, MOST_MISFIT = 1.1, 6.0
"""What was told differs by more than the process says, squared: gustier air, or a front. The
process's variances are then taken so many times as large."""
_MISFIT_PRIOR = 20.0
"""Weight of the process itself in that, as so many values: few say little."""

FRONT_COUNTS_S = KEPT_S + 300.0
"""After it was noticed: it has left the site, and nothing told before it is kept."""

_JITTER_M2PS2 = 1e-6


@dataclass(frozen=True, slots=True)
class WindPrior:
    """The wind expected before anybody told any: a forecast's mean at a height, and its error on
    each axis."""

    mean_to_ne_mps: tuple[float, float]
    std_mps: float
    height_m: float = 10.0


@dataclass(frozen=True, slots=True)
class FieldForecast:
    """Joint law of the wind at points: means (n, 2), covariances of the north and the east winds
    (n, n) each; the two are independent."""

    mean_to_ne_mps: Floats
    north_cov_m2ps2: Floats
    east_cov_m2ps2: Floats


class FieldBelief:
    """Follows what members tell; one per desk or vehicle. `prior` None: any wind."""

    def __init__(self, process: FieldProcess, prior: WindPrior | None = None) -> None:
        self._process = process
        self._prior = prior or WindPrior((0.0, 0.0), process.process.level_std_mps)
        self._members: dict[str, MemberTellings] = {}
        self._front: FrontAhead | None = None

    def expect_front(self, front: FrontAhead | None) -> None:
        """A front that is believed from now on, or better known; None: there is none any more.

        It counts while somebody is believed who has felt it, until what was told before it is gone.
        """
        self._front = front

    def expect(self, prior: WindPrior) -> None:
        """What is expected where nobody tells, from now on: a forecast moves on with the time."""
        self._prior = prior

    def tell(self, telling: WindTelling, now_s: float) -> str:
        """Take a telling (any rate; thinned inside); returns why it is left out, or empty.

        Times are the receiver's own: one from long ago, or from the future, is left out.
        """
        if not -1.0 <= now_s - telling.t_s <= MOST_AGE_S:
            return f"{now_s - telling.t_s:.0f} s old"
        crowd = min(TELLING_S * -(-len(self._members) // _CROWD), JOINED_S)
        return self._members.setdefault(telling.member, MemberTellings()).take(telling, crowd)

    def drop(self, member: str) -> None:
        """Forget all that a member told."""
        self._members.pop(member, None)

    def settle(
        self,
        now_s: float,
        always: str = "",
        firm: frozenset[str] = frozenset(),
        newest: WindTelling | None = None,
    ) -> "SettledField":
        """The field as believed now. `always` is the vehicle itself: never left out. Nor is who is
        `firm`: that is judged elsewhere. `newest`: what it feels at this moment, not kept.
        """
        each = MOST_STRETCHES // max(len(self._members), 1) + _SPARE_STRETCHES
        for name in list(self._members):
            self._members[name].forget(now_s, each)
            if not self._members[name].stretches and not self._members[name].is_frozen:
                del self._members[name]
        kept = KeptStretches.of(self._with(newest), MOST_STRETCHES)
        out: dict[str, str] = {}
        while True:
            settled = self._settled(kept, now_s)
            bad = contradicting(settled.mean_shift_squares, kept, now_s, always, firm)
            if not bad:
                break
            out |= bad
            kept = kept.without(frozenset(bad))
        # Not before: a front would excuse the one who made it up.
        front = self._front_of(kept, now_s)
        if front is not None:
            settled = self._settled(kept, now_s, front, settled)
        return settled.leaving_out(out)

    def _settled(
        self,
        kept: KeptStretches,
        now_s: float,
        front: FrontTerm | None = None,
        same: "SettledField | None" = None,
    ) -> "SettledField":
        """By what is kept; as gusty as it makes the air. `same`: of this kept already."""
        settled = SettledField(self._process, self._prior, kept, now_s, 1.0, front, same)
        if (misfit := settled.misfit()) <= LEAST_MISFIT:
            return settled
        more = min(misfit, MOST_MISFIT)
        return SettledField(self._process, self._prior, kept, now_s, more, front, settled)

    def _front_of(self, kept: KeptStretches, now_s: float) -> FrontTerm | None:
        """The front as far as it counts."""
        front = self._front
        if front is None or now_s - front.noticed_s > FRONT_COUNTS_S:
            return None
        believed = {kept.members[int(k)] for k in np.unique(kept.member)}
        return FrontTerm(front) if any(one.member in believed for one in front.felt) else None

    def _with(self, newest: WindTelling | None) -> dict[str, MemberTellings]:
        """All members, one of them with what it feels at this moment."""
        if newest is None or newest.trouble():
            return self._members
        before = self._members.get(newest.member, MemberTellings()).stretches
        if before and newest.t_s - before[-1].last[0] < _NEWER_S:
            return self._members
        return self._members | {newest.member: MemberTellings([*before, Stretch.of(newest)])}


class SettledField:
    """The belief as it stands after what was kept; `left_out` says who, and why."""

    def __init__(
        self,
        process: FieldProcess,
        prior: WindPrior,
        kept: KeptStretches,
        now_s: float,
        gustier: float = 1.0,
        front: FrontTerm | None = None,
        same: "SettledField | None" = None,
    ) -> None:
        """`gustier`: the process's variances are so many times as large. `same`: another of what is
        kept, whose covariance by the process alone need not be worked out again.
        """
        self.left_out: dict[str, str] = {}
        self.now_s = now_s
        self._gustier, self._front = gustier, front
        self._process, self._kept = process, kept
        self._height_m = float(kept.middle[:, 3].mean()) if kept.count.size else prior.height_m
        grown, doubt = process.shear(np.array([self._height_m]), prior.height_m)
        self._prior_ne = float(grown[0]) * np.array(prior.mean_to_ne_mps)
        doubt_mps = float(doubt[0] * np.hypot(*self._prior_ne))
        self._level_m2ps2 = prior.std_mps**2 + doubt_mps**2
        self.mean_to_ne_mps = self._mean_wind()
        speed = float(np.hypot(*self.mean_to_ne_mps))
        self._scale = gustier * process.process.variance_scale(speed)
        if same is None:
            self._told_s, self._told_left = self._coordinates(kept)
            self._within = process.within(self._told_s, self._told_left)
        else:
            self._told_s, self._told_left = same._told_s, same._told_left
            self._within = same._within
        ends = kept.middle
        span_s = kept.last[:, 0] - kept.first[:, 0] + TELLING_S
        self._told_behind = self._behind(ends[:, 1:3], ends[:, 0], span_s)
        self._factors = self._factored()

    @property
    def members(self) -> tuple[str, ...]:
        """Who is believed."""
        return tuple(self._kept.members[k] for k in np.unique(self._kept.member))

    def leaving_out(self, why: dict[str, str]) -> "SettledField":
        """The same, saying who was left out."""
        self.left_out = dict(why)
        return self

    def forecast(self, points: FieldPoints, averaged_s: float = TELLING_S) -> FieldForecast:
        """The wind at points, as means over `averaged_s` about each time."""
        moved = FieldPoints(points.place_ne_m, points.height_m, points.t_s - self.now_s)
        asked_s = self._process.coordinates_s(moved, self.mean_to_ne_mps)
        left = self._process.left_by_averaging(np.full(points.count, averaged_s))
        level = self._level_m2ps2
        grown, doubt = self._process.shear(points.height_m, self._height_m)
        cov = self._scale * self._process.within(asked_s, left) + level
        with_told = self._scale * self._process.between(
            asked_s, left, self._told_s, self._told_left
        )
        with_told += level
        span_s = np.full(points.count, averaged_s)
        behind = self._behind(points.place_ne_m, points.t_s, span_s)
        means: list[Floats] = []
        covs: list[Floats] = []
        for axis, (lower, weighed) in enumerate(self._factors):
            mean, to_told, own = self._prior_ne[axis], with_told, cov
            if self._front is not None:
                mean = mean + self._front.mean_ne_mps(behind)[:, axis]
                to_told = to_told + self._front.cov_m2ps2(behind, self._told_behind, axis)
                own = own + self._front.cov_m2ps2(behind, behind, axis)
            mean = mean + to_told @ weighed
            known = solve_triangular(lower, to_told.T, lower=True, check_finite=False)
            left_over = np.outer(grown, grown) * (own - known.T @ known)
            means.append(grown * mean)
            covs.append(left_over + np.diag((doubt * grown * mean) ** 2))
        return FieldForecast(np.stack(means, axis=1), covs[0], covs[1])

    def misfit(self) -> float:
        """Mean square of what was told over what is expected of it: 1 where the process holds.

        r' K^-1 r over the number of values (Rasmussen and Williams 2006, eq. 5.8: its share in the
        likelihood).
        """
        count = self._kept.count.size
        if not count:
            return 1.0
        grown, _ = self._process.shear(self._kept.middle[:, 3], self._height_m)
        told = self._kept.wind_ne_mps / grown[:, None] - self._prior_ne - self._front_ne_mps
        squares = (told[:, k] @ weighed for k, (_, weighed) in enumerate(self._factors))
        return (0.5 * float(sum(squares)) + _MISFIT_PRIOR) / (count + _MISFIT_PRIOR)

    def mean_shift_squares(self, groups: Floats) -> Floats:
        """How unlikely it is that the values of each group (n, groups) are as they should be.

        Chi-square of two degrees each: see `agreement`.
        """
        total = np.zeros(groups.shape[1])
        for lower, weighed in self._factors:
            known = solve_triangular(lower, groups, lower=True, check_finite=False)
            error = np.square(known).sum(axis=0)
            shift = groups.T @ weighed
            total += np.divide(shift**2, error, out=np.zeros_like(error), where=error > 0.0)
        return total

    def disagreement(self, member: str) -> float | None:
        """Chi-square of two degrees that what a member tells fits what all the others tell: all
        that it told, or its newest minute, whichever fits worse. None: one side has told too
        little to compare.

        As the process itself says it: a lie makes the air look gustier, and then it would fit.
        """
        kept = self._kept
        if member not in kept.members:
            return None
        own = kept.member == kept.members.index(member)
        if min(kept.count[own].sum(), kept.count[~own].sum()) < LEAST_TELLINGS:
            return None
        fresh = own & (self.now_s - kept.last[:, 0] <= NEW_S)
        groups = np.stack([own, fresh] if fresh.any() else [own], axis=1).astype(np.float64)
        return self._gustier * float(self.mean_shift_squares(groups).max())

    def _mean_wind(self) -> Floats:
        """What carries the eddies: the mean of what was told, or the prior."""
        if not self._kept.count.size:
            return self._prior_ne
        return np.average(self._kept.wind_ne_mps, axis=0, weights=self._kept.count)

    def _coordinates(self, kept: KeptStretches) -> tuple[Floats, Floats]:
        middle, first, last = (
            self._process.coordinates_s(
                FieldPoints(ends[:, 1:3], ends[:, 3], ends[:, 0] - self.now_s),
                self.mean_to_ne_mps,
            )
            for ends in (kept.middle, kept.first, kept.last)
        )
        # Its first telling is itself a mean over the seconds before it.
        span_s = np.linalg.norm(last - first, axis=1) + TELLING_S
        return middle, self._process.left_by_averaging(span_s)

    def _factored(self) -> list[tuple[Floats, Floats]]:
        """For each axis the lower Cholesky factor of what was told, and K^-1 (told - prior)."""
        kept = self._kept
        count = kept.count.size
        grown, doubt = self._process.shear(kept.middle[:, 3], self._height_m)
        common = self._scale * self._within
        common += self._level_m2ps2
        same = kept.member[:, None] == kept.member[None, :]
        noise = self._process.process.seen_noise_std_mps**2
        factors: list[tuple[Floats, Floats]] = []
        for axis in (0, 1):
            told = kept.wind_ne_mps[:, axis] / grown
            variance = kept.variance_ne_m2ps2[:, axis]
            if axis == 0 or self._front is not None or not self._is_round():
                fresh = np.minimum(variance, noise)
                lasting = np.sqrt(variance - fresh) / grown
                cov = common + np.where(same, np.outer(lasting, lasting), 0.0)
                if self._front is not None:
                    cov += self._front.cov_m2ps2(self._told_behind, self._told_behind, axis)
                own = fresh / kept.count / grown**2 + _JITTER_M2PS2
                own += (doubt * np.hypot(*self.mean_to_ne_mps)) ** 2
                cov[np.diag_indices(count)] += own
                lower = cholesky(cov, lower=True, overwrite_a=True, check_finite=False)
            else:
                lower = factors[0][0]
            off = told - self._prior_ne[axis] - self._front_ne_mps[:, axis]
            weighed = cho_solve((lower, True), off, check_finite=False)
            factors.append((lower, weighed))
        return factors

    def _behind(self, place_ne_m: Floats, t_s: Floats, span_s: Floats) -> Floats:
        """Probability to lie behind the front; nothing where there is none."""
        if self._front is None:
            return np.zeros(t_s.size)
        return self._front.behind(place_ne_m, t_s, span_s)

    @property
    def _front_ne_mps(self) -> Floats:
        """What the front is expected to have in what was told, (n, 2)."""
        if self._front is None:
            return np.zeros((self._told_behind.size, 2))
        return self._front.mean_ne_mps(self._told_behind)

    def _is_round(self) -> bool:
        """Whether all errors told are the same on both axes."""
        variance = self._kept.variance_ne_m2ps2
        return bool(np.array_equal(variance[:, 0], variance[:, 1]))
