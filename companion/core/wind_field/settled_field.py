"""Estimate of the wind over a site at one moment.

Kriging with the covariance of `field_process` (Rasmussen and Williams 2006, ch. 2). Both axes share
the covariance of the wind. Reports have an error of their own: an independent part, and a lasting
part common to all reports of a member. A single member obtains the forecast of the wind process.
The terrain effect is added where members observe one (`terrain_effect`).
"""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field import terrain_effect
from companion.core.wind_field.agreement import MIN_REPORTS, RECENT_S
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.front_term import FrontTerm
from companion.core.wind_field.linear_algebra import (
    lower_cholesky_factor,
    solve_lower_triangular,
    solve_with_cholesky_factor,
)
from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S, SegmentArrays

_MISFIT_PRIOR = 20.0
"""Weight of the process in the gustiness, as a number of values: few reports have little weight."""

_JITTER_M2PS2 = 1e-6


@dataclass(frozen=True, slots=True)
class WindPrior:
    """Wind expected without reports: a forecast's mean at a height, and its error on each axis."""

    mean_to_ne_mps: tuple[float, float]
    std_mps: float
    height_m: float = 10.0


@dataclass(frozen=True, slots=True)
class FieldForecast:
    """Joint distribution of the wind at points: means (n, 2), covariances of the independent north
    and east winds (n, n) each."""

    mean_to_ne_mps: Floats
    north_cov_m2ps2: Floats
    east_cov_m2ps2: Floats


@dataclass(frozen=True, slots=True)
class AirState:
    """State of the air over the whole site.

    `gust_factor`: factor of the process's variances. `terrain_share`: standard deviation of the
    terrain effect over the mean wind. `front`: one that passes.
    """

    gust_factor: float = 1.0
    terrain_share: float = 0.0
    front: FrontTerm | None = None


@dataclass(frozen=True, slots=True)
class ReportCovariance:
    """Covariance of the reports, independent of the state of the air.

    `at_s` (n, 4) and `left` (n, parts) of the eddies, `terrain_at` (n, 3) and `terrain_factor` (n,)
    of the terrain effect. Covariances (n, n): `eddies_m2ps2` at the reference wind, that of the
    terrain effect over its variance, `errors_m2ps2` of each axis, the same object if equal.
    """

    at_s: Floats
    left: Floats
    eddies_m2ps2: Floats
    terrain_at: Floats
    terrain_factor: Floats
    terrain_cov: Floats
    errors_m2ps2: tuple[Floats, Floats]

    @classmethod
    def from_segments(
        cls,
        segments: SegmentArrays,
        process: FieldProcess,
        mean_ne_mps: Floats,
        height_m: float,
        now_s: float,
    ) -> "ReportCovariance":
        """Compute it for stored reports and a mean wind that refers to a height."""
        middle, first, last = (
            process.eddy_distance_coordinates_s(
                FieldPoints(ends[:, 1:3], ends[:, 3], ends[:, 0] - now_s), mean_ne_mps
            )
            for ends in (segments.middle, segments.first, segments.last)
        )
        # The first report is itself a mean over the seconds before it.
        left = process.averaging_std_factor_by_part(
            np.linalg.norm(last - first, axis=1) + REPORT_AVERAGING_S
        )
        span_s = segments.last[:, 0] - segments.first[:, 0]
        path_m = np.linalg.norm((segments.last - segments.first)[:, 1:3], axis=1)
        path_m *= 1.0 + REPORT_AVERAGING_S / np.maximum(span_s, REPORT_AVERAGING_S)
        terrain_at = terrain_effect.terrain_correlation_coordinates(
            segments.middle[:, 1:3], segments.middle[:, 3]
        )
        terrain_factor = terrain_effect.averaging_std_factor_along_path(path_m)
        speed_mps = float(np.hypot(*mean_ne_mps))
        shear_ratio, shear_error = process.wind_shear_ratio_and_error(
            segments.middle[:, 3], height_m
        )
        noise = process.process.seen_noise_std_mps**2

        def error_covariance(variance: Floats) -> Floats:
            uncorrelated_variance = np.minimum(variance, noise)
            correlated_std_mps = np.sqrt(variance - uncorrelated_variance) / shear_ratio
            cov = np.outer(correlated_std_mps, correlated_std_mps)
            cov *= segments.member[:, None] == segments.member[None, :]
            own = uncorrelated_variance / segments.count / shear_ratio**2 + _JITTER_M2PS2
            cov[np.diag_indices(variance.size)] += own + (shear_error * speed_mps) ** 2
            return cov

        variance = segments.variance_ne_m2ps2
        north = error_covariance(variance[:, 0])
        round_errors = np.array_equal(variance[:, 0], variance[:, 1])
        east = north if round_errors else error_covariance(variance[:, 1])
        return cls(
            middle,
            left,
            process.covariance_within(middle, left),
            terrain_at,
            terrain_factor,
            terrain_effect.relative_terrain_covariance(
                terrain_at, terrain_factor, terrain_at, terrain_factor
            ),
            (north, east),
        )


class FieldEstimate:
    """The estimated field; `excluded` holds the excluded members with the reason."""

    def __init__(
        self,
        process: FieldProcess,
        prior: WindPrior,
        segments: SegmentArrays,
        now_s: float,
        air: AirState,
        estimate_with_reusable_covariance: "FieldEstimate | None" = None,
    ) -> None:
        """`estimate_with_reusable_covariance`: an estimate from the same reports."""
        self.excluded: dict[str, str] = {}
        self.now_s = now_s
        self.air = air
        self._process, self._segments = process, segments
        self._height_m = (
            float(segments.middle[:, 3].mean()) if segments.count.size else prior.height_m
        )
        shear_ratio, shear_error = process.wind_shear_ratio_and_error(
            np.array([self._height_m]), prior.height_m
        )
        self._prior_ne = float(shear_ratio[0]) * np.array(prior.mean_to_ne_mps)
        shear_error_mps = float(shear_error[0] * np.hypot(*self._prior_ne))
        self._level_m2ps2 = prior.std_mps**2 + shear_error_mps**2
        self.mean_to_ne_mps = self._eddy_carrying_wind_ne_mps()
        speed = float(np.hypot(*self.mean_to_ne_mps))
        self._scale = air.gust_factor * process.process.variance_scale(speed)
        self._terrain_m2ps2 = (air.terrain_share * speed) ** 2
        self._report_cov = (
            estimate_with_reusable_covariance._report_cov
            if estimate_with_reusable_covariance is not None
            else self._compute_report_cov(segments)
        )
        ends = segments.middle
        span_s = segments.last[:, 0] - segments.first[:, 0] + REPORT_AVERAGING_S
        self._report_passed = self._probability_behind_front(ends[:, 1:3], ends[:, 0], span_s)
        shear_ratio, _ = process.wind_shear_ratio_and_error(ends[:, 3], self._height_m)
        self._residuals = (
            segments.wind_ne_mps / shear_ratio[:, None]
            - self._prior_ne
            - self._front_mean_in_reports_ne_mps
        )
        """Reports less their prior expectation, (n, 2)."""
        self._factors = self._factorise_report_covariance_by_axis()

    @property
    def accepted_members(self) -> tuple[str, ...]:
        """Accepted members."""
        return tuple(self._segments.members[k] for k in np.unique(self._segments.member))

    def forecast_at_points(
        self,
        points: FieldPoints,
        averaging_time_s: float = REPORT_AVERAGING_S,
        path_m: Floats | None = None,
    ) -> FieldForecast:
        """Return the wind at points, as means over `averaging_time_s` about each time.

        `path_m` (n,): path length of each mean over the ground, for a moving vehicle.
        """
        moved = FieldPoints(points.position_ne_m, points.height_m, points.t_s - self.now_s)
        point_coordinates_s = self._process.eddy_distance_coordinates_s(moved, self.mean_to_ne_mps)
        left = self._process.averaging_std_factor_by_part(
            np.full(points.point_count, averaging_time_s)
        )
        level = self._level_m2ps2
        shear_ratio, shear_error = self._process.wind_shear_ratio_and_error(
            points.height_m, self._height_m
        )
        cov = self._scale * self._process.covariance_within(point_coordinates_s, left) + level
        cross_cov = self._scale * self._process.covariance_between(
            point_coordinates_s, left, self._report_cov.at_s, self._report_cov.left
        )
        cross_cov += level
        if self._terrain_m2ps2 > 0.0:
            at = terrain_effect.terrain_correlation_coordinates(
                points.position_ne_m, points.height_m
            )
            terrain_factor = terrain_effect.averaging_std_factor_along_path(
                np.zeros(points.point_count) if path_m is None else path_m
            )
            cov += self._terrain_m2ps2 * terrain_effect.relative_terrain_covariance(
                at, terrain_factor, at, terrain_factor
            )
            cross_cov += self._terrain_m2ps2 * terrain_effect.relative_terrain_covariance(
                at, terrain_factor, self._report_cov.terrain_at, self._report_cov.terrain_factor
            )
        span_s = np.full(points.point_count, averaging_time_s)
        passed_probability = self._probability_behind_front(
            points.position_ne_m, points.t_s, span_s
        )
        mean_winds: list[Floats] = []
        covs: list[Floats] = []
        for axis, (lower, weighed) in enumerate(self._factors):
            mean, axis_cross_cov, own = self._prior_ne[axis], cross_cov, cov
            if self.air.front is not None:
                mean = mean + self.air.front.mean_wind_increase_ne_mps(passed_probability)[:, axis]
                axis_cross_cov = axis_cross_cov + self.air.front.covariance_increase_m2ps2(
                    passed_probability, self._report_passed, axis
                )
                own = own + self.air.front.covariance_increase_m2ps2(
                    passed_probability, passed_probability, axis
                )
            mean = mean + axis_cross_cov @ weighed
            known = solve_lower_triangular(lower, axis_cross_cov.T)
            left_over = np.outer(shear_ratio, shear_ratio) * (own - known.T @ known)
            mean_winds.append(shear_ratio * mean)
            covs.append(left_over + np.diag((shear_error * shear_ratio * mean) ** 2))
        return FieldForecast(np.stack(mean_winds, axis=1), covs[0], covs[1])

    def variance_misfit_ratio(self) -> float:
        """Mean square of the reports over its expectation: 1 where the process holds.

        r' K^-1 r over the number of values (Rasmussen and Williams 2006, eq. 5.8: its share in the
        likelihood).
        """
        count = self._segments.count.size
        if not count:
            return 1.0
        off = self._residuals
        square = sum(float(off[:, k] @ weighed) for k, (_, weighed) in enumerate(self._factors))
        return (0.5 * square + _MISFIT_PRIOR) / (count + _MISFIT_PRIOR)

    def segment_log_likelihoods(self) -> Floats:
        """Return the log likelihood of each segment (n,) given the earlier ones, up to a constant.

        With r = L z, in order of time, it is -z^2 / 2 - log L_ii on each axis (Rasmussen and
        Williams 2006, eq. 5.8 and A.4).
        """
        total = np.zeros(self._segments.count.size)
        for axis, (lower, _) in enumerate(self._factors):
            white = solve_lower_triangular(lower, self._residuals[:, axis])
            total -= 0.5 * white**2 + np.log(np.diag(lower))
        return total

    def mean_shift_chi_squares(self, group_indicators: Floats) -> Floats:
        """Return the significance of a mean shift in each group (n, groups) of values.

        Chi-square of two degrees each: see `agreement`.
        """
        total = np.zeros(group_indicators.shape[1])
        for lower, weighed in self._factors:
            known = solve_lower_triangular(lower, group_indicators)
            error = np.square(known).sum(axis=0)
            shift = group_indicators.T @ weighed
            total += np.divide(shift**2, error, out=np.zeros_like(error), where=error > 0.0)
        return total

    def chi_square_of_member_against_others(self, member: str) -> float | None:
        """Return chi-square (two degrees) of a member's reports against all others: of all its
        reports or those of the last minute, whichever is larger. None: too few reports.

        Uses the unscaled process: false reports make the air look gustier and would then fit.
        """
        segments = self._segments
        if member not in segments.members:
            return None
        own = segments.member == segments.members.index(member)
        if min(segments.count[own].sum(), segments.count[~own].sum()) < MIN_REPORTS:
            return None
        new_part = own & (self.now_s - segments.last[:, 0] <= RECENT_S)
        groups = np.stack([own, new_part] if new_part.any() else [own], axis=1).astype(np.float64)
        return self.air.gust_factor * float(self.mean_shift_chi_squares(groups).max())

    def _eddy_carrying_wind_ne_mps(self) -> Floats:
        """Return the wind that carries the eddies: the mean of the reports, or the prior."""
        if not self._segments.count.size:
            return self._prior_ne
        return np.average(self._segments.wind_ne_mps, axis=0, weights=self._segments.count)

    def _compute_report_cov(self, segments: SegmentArrays) -> ReportCovariance:
        return ReportCovariance.from_segments(
            segments, self._process, self.mean_to_ne_mps, self._height_m, self.now_s
        )

    def _factorise_report_covariance_by_axis(self) -> list[tuple[Floats, Floats]]:
        """Return for each axis the reports' lower Cholesky factor and K^-1 (reports - prior)."""
        report_cov, front = self._report_cov, self.air.front
        common = self._scale * report_cov.eddies_m2ps2
        common += self._level_m2ps2
        if self._terrain_m2ps2 > 0.0:
            common += self._terrain_m2ps2 * report_cov.terrain_cov
        factors: list[tuple[Floats, Floats]] = []
        for axis, errors in enumerate(report_cov.errors_m2ps2):
            if axis == 0 or front is not None or errors is not report_cov.errors_m2ps2[0]:
                cov = common + errors
                if front is not None:
                    cov += front.covariance_increase_m2ps2(
                        self._report_passed, self._report_passed, axis
                    )
                lower = lower_cholesky_factor(cov)
            else:
                lower = factors[0][0]
            weighed = solve_with_cholesky_factor(lower, self._residuals[:, axis])
            factors.append((lower, weighed))
        return factors

    def _probability_behind_front(
        self, position_ne_m: Floats, t_s: Floats, averaging_time_s: Floats
    ) -> Floats:
        """Return the probability to lie behind the front; zeros without one."""
        if self.air.front is None:
            return np.zeros(t_s.size)
        return self.air.front.probability_behind_front(position_ne_m, t_s, averaging_time_s)

    @property
    def _front_mean_in_reports_ne_mps(self) -> Floats:
        """Expected part of the front in the reports, (n, 2)."""
        if self.air.front is None:
            return np.zeros((self._report_passed.size, 2))
        return self.air.front.mean_wind_increase_ne_mps(self._report_passed)
