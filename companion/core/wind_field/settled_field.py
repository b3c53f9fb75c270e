"""The wind over a site as it is believed at one moment.

Kriging with the covariance of `field_process` (Rasmussen and Williams 2006, ch. 2). Both axes share
the covariance of the wind. What is told of them has an error of its own: a part that is new each
time, and a lasting one, the same in all that a member tells. A member alone gives itself the
forecast that the wind process gives. Where members see the ground change the wind, that comes on
top (`standing`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from companion.core.base.arrays import Floats
from companion.core.wind_field import standing
from companion.core.wind_field.agreement import LEAST_TELLINGS, NEW_S
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.front_term import FrontTerm
from companion.core.wind_field.tellings import TELLING_S, KeptStretches

_MISFIT_PRIOR = 20.0
"""Weight of the process itself in how gusty it is, as so many values: few say little."""

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


@dataclass(frozen=True, slots=True)
class AirState:
    """What is believed of the air as a whole.

    `gustier`: the process's variances are so many times as large. `standing_share`: the standard
    deviation of what the ground does, over the mean wind. `front`: one that passes.
    """

    gustier: float = 1.0
    standing_share: float = 0.0
    front: FrontTerm | None = None


@dataclass(frozen=True, slots=True)
class ToldLaw:
    """How what was told goes together, whatever the state of the air.

    `at_s` (n, 4) and `left` (n, parts) of the eddies, `stand_at` (n, 3) and `stand_left` (n,) of
    what stands. Covariances (n, n): `eddies_m2ps2` at the reference wind, `stands` over the
    variance of what stands, `errors_m2ps2` of what was told on each axis, one where they are alike.
    """

    at_s: Floats
    left: Floats
    eddies_m2ps2: Floats
    stand_at: Floats
    stand_left: Floats
    stands: Floats
    errors_m2ps2: tuple[Floats, Floats]

    @classmethod
    def of(
        cls,
        kept: KeptStretches,
        process: FieldProcess,
        mean_ne_mps: Floats,
        height_m: float,
        now_s: float,
    ) -> "ToldLaw":
        """Of what is kept, in a mean wind that belongs to a height."""
        middle, first, last = (
            process.coordinates_s(
                FieldPoints(ends[:, 1:3], ends[:, 3], ends[:, 0] - now_s), mean_ne_mps
            )
            for ends in (kept.middle, kept.first, kept.last)
        )
        # Its first telling is itself a mean over the seconds before it.
        left = process.left_by_averaging(np.linalg.norm(last - first, axis=1) + TELLING_S)
        span_s = kept.last[:, 0] - kept.first[:, 0]
        way_m = np.linalg.norm((kept.last - kept.first)[:, 1:3], axis=1)
        way_m *= 1.0 + TELLING_S / np.maximum(span_s, TELLING_S)
        stand_at = standing.coordinates(kept.middle[:, 1:3], kept.middle[:, 3])
        stand_left = standing.left_by_averaging(way_m)
        speed_mps = float(np.hypot(*mean_ne_mps))
        grown, doubt = process.shear(kept.middle[:, 3], height_m)
        noise = process.process.seen_noise_std_mps**2

        def errors(variance: Floats) -> Floats:
            fresh = np.minimum(variance, noise)
            lasting = np.sqrt(variance - fresh) / grown
            cov = np.outer(lasting, lasting)
            cov *= kept.member[:, None] == kept.member[None, :]
            own = fresh / kept.count / grown**2 + _JITTER_M2PS2
            cov[np.diag_indices(variance.size)] += own + (doubt * speed_mps) ** 2
            return cov

        variance = kept.variance_ne_m2ps2
        north = errors(variance[:, 0])
        round_errors = np.array_equal(variance[:, 0], variance[:, 1])
        east = north if round_errors else errors(variance[:, 1])
        return cls(
            middle,
            left,
            process.within(middle, left),
            stand_at,
            stand_left,
            standing.between(stand_at, stand_left, stand_at, stand_left),
            (north, east),
        )


class SettledField:
    """The belief as it stands after what was kept; `left_out` says who, and why."""

    def __init__(
        self,
        process: FieldProcess,
        prior: WindPrior,
        kept: KeptStretches,
        now_s: float,
        air: AirState,
        same: "SettledField | None" = None,
    ) -> None:
        """`same`: another of what is kept, whose law need not be worked out again."""
        self.left_out: dict[str, str] = {}
        self.now_s = now_s
        self.air = air
        self._process, self._kept = process, kept
        self._height_m = float(kept.middle[:, 3].mean()) if kept.count.size else prior.height_m
        grown, doubt = process.shear(np.array([self._height_m]), prior.height_m)
        self._prior_ne = float(grown[0]) * np.array(prior.mean_to_ne_mps)
        doubt_mps = float(doubt[0] * np.hypot(*self._prior_ne))
        self._level_m2ps2 = prior.std_mps**2 + doubt_mps**2
        self.mean_to_ne_mps = self._mean_wind()
        speed = float(np.hypot(*self.mean_to_ne_mps))
        self._scale = air.gustier * process.process.variance_scale(speed)
        self._standing_m2ps2 = (air.standing_share * speed) ** 2
        self._law = same._law if same is not None else self._law_of(kept)
        ends = kept.middle
        span_s = kept.last[:, 0] - kept.first[:, 0] + TELLING_S
        self._told_behind = self._behind(ends[:, 1:3], ends[:, 0], span_s)
        grown, _ = process.shear(ends[:, 3], self._height_m)
        self._off = kept.wind_ne_mps / grown[:, None] - self._prior_ne - self._front_ne_mps
        """What was told less what is expected of it before, (n, 2)."""
        self._factors = self._factored()

    @property
    def members(self) -> tuple[str, ...]:
        """Who is believed."""
        return tuple(self._kept.members[k] for k in np.unique(self._kept.member))

    def leaving_out(self, why: dict[str, str]) -> "SettledField":
        """The same, saying who was left out."""
        self.left_out = dict(why)
        return self

    def forecast(
        self,
        points: FieldPoints,
        averaged_s: float = TELLING_S,
        way_m: Floats | None = None,
    ) -> FieldForecast:
        """The wind at points, as means over `averaged_s` about each time.

        `way_m` (n,): how far each mean reaches over the ground, for who moves meanwhile.
        """
        moved = FieldPoints(points.place_ne_m, points.height_m, points.t_s - self.now_s)
        asked_s = self._process.coordinates_s(moved, self.mean_to_ne_mps)
        left = self._process.left_by_averaging(np.full(points.count, averaged_s))
        level = self._level_m2ps2
        grown, doubt = self._process.shear(points.height_m, self._height_m)
        cov = self._scale * self._process.within(asked_s, left) + level
        with_told = self._scale * self._process.between(
            asked_s, left, self._law.at_s, self._law.left
        )
        with_told += level
        if self._standing_m2ps2 > 0.0:
            at = standing.coordinates(points.place_ne_m, points.height_m)
            stand_left = standing.left_by_averaging(
                np.zeros(points.count) if way_m is None else way_m
            )
            cov += self._standing_m2ps2 * standing.between(at, stand_left, at, stand_left)
            with_told += self._standing_m2ps2 * standing.between(
                at, stand_left, self._law.stand_at, self._law.stand_left
            )
        span_s = np.full(points.count, averaged_s)
        behind = self._behind(points.place_ne_m, points.t_s, span_s)
        means: list[Floats] = []
        covs: list[Floats] = []
        for axis, (lower, weighed) in enumerate(self._factors):
            mean, to_told, own = self._prior_ne[axis], with_told, cov
            if self.air.front is not None:
                mean = mean + self.air.front.mean_ne_mps(behind)[:, axis]
                to_told = to_told + self.air.front.cov_m2ps2(behind, self._told_behind, axis)
                own = own + self.air.front.cov_m2ps2(behind, behind, axis)
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
        return (0.5 * self._square() + _MISFIT_PRIOR) / (count + _MISFIT_PRIOR)

    def log_likelihoods(self) -> Floats:
        """Of each stretch (n,), given what was told before it, but for a constant.

        With r = L z, in order of time, it is -z^2 / 2 - log L_ii on each axis (Rasmussen and
        Williams 2006, eq. 5.8 and A.4).
        """
        total = np.zeros(self._kept.count.size)
        for axis, (lower, _) in enumerate(self._factors):
            white = solve_triangular(lower, self._off[:, axis], lower=True, check_finite=False)
            total -= 0.5 * white**2 + np.log(np.diag(lower))
        return total

    def _square(self) -> float:
        """r' K^-1 r of both axes together."""
        off = self._off
        return sum(float(off[:, k] @ weighed) for k, (_, weighed) in enumerate(self._factors))

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
        return self.air.gustier * float(self.mean_shift_squares(groups).max())

    def _mean_wind(self) -> Floats:
        """What carries the eddies: the mean of what was told, or the prior."""
        if not self._kept.count.size:
            return self._prior_ne
        return np.average(self._kept.wind_ne_mps, axis=0, weights=self._kept.count)

    def _law_of(self, kept: KeptStretches) -> ToldLaw:
        return ToldLaw.of(kept, self._process, self.mean_to_ne_mps, self._height_m, self.now_s)

    def _factored(self) -> list[tuple[Floats, Floats]]:
        """For each axis the lower Cholesky factor of what was told, and K^-1 (told - prior)."""
        law, front = self._law, self.air.front
        common = self._scale * law.eddies_m2ps2
        common += self._level_m2ps2
        if self._standing_m2ps2 > 0.0:
            common += self._standing_m2ps2 * law.stands
        factors: list[tuple[Floats, Floats]] = []
        for axis, errors in enumerate(law.errors_m2ps2):
            if axis == 0 or front is not None or errors is not law.errors_m2ps2[0]:
                cov = common + errors
                if front is not None:
                    cov += front.cov_m2ps2(self._told_behind, self._told_behind, axis)
                lower = cholesky(cov, lower=True, overwrite_a=True, check_finite=False)
            else:
                lower = factors[0][0]
            weighed = cho_solve((lower, True), self._off[:, axis], check_finite=False)
            factors.append((lower, weighed))
        return factors

    def _behind(self, place_ne_m: Floats, t_s: Floats, span_s: Floats) -> Floats:
        """Probability to lie behind the front; nothing where there is none."""
        if self.air.front is None:
            return np.zeros(t_s.size)
        return self.air.front.behind(place_ne_m, t_s, span_s)

    @property
    def _front_ne_mps(self) -> Floats:
        """What the front is expected to have in what was told, (n, 2)."""
        if self.air.front is None:
            return np.zeros((self._told_behind.size, 2))
        return self.air.front.mean_ne_mps(self._told_behind)
