"""Odds that a front has started to pass over the members, from all their reports.

A front is a change of wind that starts at a line and moves along the line's normal: all members
feel a similar change in sequence. The reports are compared with each of a few hundred fronts
(direction, speed, duration, first contact) by a likelihood ratio: the members' winds are correlated
as in the wind process, and the change, a vector, is integrated over its prior (linear and Gaussian:
Rasmussen and Williams 2006, eq. 2.42). The mean of these ratios is the odds of a front
(Shiryaev-Roberts: Roberts, Technometrics 8, 1966). Members that a front should have reached and
that report no change are evidence against it, common gusts count once, and small changes of several
members add up. A member that enters a wake (`terrain_effect`) does not indicate a front.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field import terrain_effect
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.linear_algebra import lower_cholesky_factor, solve_lower_triangular
from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S, MemberWindReport

AGES_S = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0, 150.0)
"""Ages of the reports used of each member: means over 10 s that do not overlap."""
KEPT_S = AGES_S[-1] + REPORT_AVERAGING_S
BEFORE_S = 45.0
"""Minimum duration of a member's reports that determines the earlier wind."""
MAX_POST_FRONT_AGES = 4
"""Number of latest ages that may lie behind a front: the mean wind is that of the others."""

CHANGE_MPS, CHANGE_STD_MPS = 7.0, 2.0
"""Gust fronts: a change of 5 to 10 m/s along the normal, with the error on each axis."""
LEVEL_STD_MPS = 2.0
"""Error of the mean wind of the last minutes on each axis."""

_DIRECTIONS_RAD = np.radians(np.arange(0.0, 360.0, 30.0))
_SPEEDS = (0.65, 0.85)
"""Over the wind behind the front along its normal: Goff, Mon. Weather Rev. 104, 1976."""
_DURATIONS_S = (10.0, 30.0, 50.0)
_MIN_SPEED_MPS = 2.0
_START_AGES_S: Floats = np.arange(8.0, 92.0, 6.0)
"""Time since the front first reached a member."""

DETECTION_MPS = 3.5
"""Change of the wind at which a front is detected at a position."""
_MEAN_LAG_S = 4.0
"""Lag of a 10 s mean behind the wind, from the best fit to a smooth change."""

_MISFIT_PRIOR = 10.0
"""Weight of the process in the gustiness, as a number of values: few reports have little weight."""

_DIRECTION_STD_RAD, _SPEED_STD_FRAC, _DETECTION_STD_S = math.radians(10.0), 0.15, 3.0
"""Error from the spacing of the tested fronts."""


@dataclass(frozen=True, slots=True)
class FrontOdds:
    """Odds of a front, and the front that they refer to.

    `log_odds`: natural logarithm; `single_member_log_odds`: of a change at a single member that
    reaches no other, by a fault or false reports. `change_ne_mps` behind the front. `t0_s`: its
    detection time at `origin_ne_m`; `slowness_spm` (2,) towards north and east, `cov` (3, 3) of
    (t0, slowness).
    """

    log_odds: float
    single_member_log_odds: float
    change_ne_mps: tuple[float, float]
    origin_ne_m: Floats
    t0_s: float
    slowness_spm: Floats
    cov: Floats


@dataclass(frozen=True, slots=True)
class _Reports:
    """The evaluated reports, oldest first: positions (n, 2), times, winds (n, 2), variances, path
    lengths of the averages, numbers of the members and ages, (n,) each."""

    position_ne_m: Floats
    t_s: Floats
    wind_ne_mps: Floats
    variance_m2ps2: Floats
    path_m: Floats
    member: Floats
    age: Floats

    @classmethod
    def select_from_members_by_age(
        cls, reports_by_member: Sequence[Sequence[MemberWindReport]], now_s: float
    ) -> "_Reports":
        """Select the reports by age, of each member with reports over enough time."""
        rows: list[tuple[float, ...]] = []
        for number, reports in enumerate(reports_by_member):
            selected = _select_latest_report_at_each_age(reports, now_s)
            if not selected or selected[0][1].t_s - selected[-1][1].t_s < BEFORE_S:
                continue
            before = [*(one for _, one in selected[1:]), selected[-2][1]]
            for (age, one), other in zip(selected, before, strict=True):
                variance = 0.5 * sum(one.conservative_variance_ne_m2ps2)
                path_m = REPORT_AVERAGING_S * math.dist(one.position_ne_m, other.position_ne_m)
                path_m /= max(
                    abs(one.t_s - other.t_s), 1.0
                )  # a report may be selected for two ages
                report_row = (*one.position_ne_m, one.t_s, *one.mean_to_ne_mps, variance)
                rows.append((*report_row, path_m, number, age))
        rows.sort(key=lambda row: -row[-1])
        a = np.array(rows).reshape(-1, 9)
        return cls(a[:, 0:2], a[:, 2], a[:, 3:5], a[:, 5], a[:, 6], a[:, 7], a[:, 8])


def _select_latest_report_at_each_age(
    reports: Sequence[MemberWindReport], now_s: float
) -> list[tuple[int, MemberWindReport]]:
    """Return for each age the latest report that is as old, if there is one."""
    found: list[tuple[int, MemberWindReport]] = []
    at = len(reports) - 1
    for number, age_s in enumerate(AGES_S):
        while at >= 0 and reports[at].t_s > now_s - age_s + 0.5:
            at -= 1
        if at < 0:
            break
        if now_s - age_s - reports[at].t_s < REPORT_AVERAGING_S:
            found.append((number, reports[at]))
    return found


def compute_front_odds(
    reports_by_member: Sequence[Sequence[MemberWindReport]],
    origin_ne_m: tuple[float, float],
    now_s: float,
    process: FieldProcess,
    gust_factor: float,
    terrain_share: float = 0.0,
) -> FrontOdds | None:
    """Return the odds from the reports of a few members, oldest first; None: too few data.

    `gust_factor`: factor of the process's variances. `terrain_share`: standard deviation of the
    terrain effect over the mean wind.
    """
    reports = _Reports.select_from_members_by_age(reports_by_member, now_s)
    before = reports.age >= MAX_POST_FRONT_AGES
    if not before.any():
        return None
    mean = reports.wind_ne_mps[before].mean(axis=0)
    directions, speeds, durations_s = _candidate_front_normals_and_speeds(mean)
    slowness = directions / speeds[:, None]
    lag_s = reports.position_ne_m @ slowness.T
    first_s = lag_s[reports.age == reports.age.min()].min(axis=0)
    since_s = reports.t_s[:, None] - _MEAN_LAG_S - (now_s + lag_s - first_s)
    over = (durations_s + 2.0)[None, :, None]
    share = _smooth_step((since_s[:, :, None] + _START_AGES_S) / over).reshape(reports.t_s.size, -1)
    terrain_std_mps = terrain_share * float(np.hypot(*mean))
    lower = _report_covariance_root(reports, mean, process, gust_factor, terrain_std_mps)
    known = np.concatenate([reports.wind_ne_mps - mean, share], axis=1)
    white = solve_lower_triangular(lower, known)
    misfit = _variance_misfit_ratio(white[: np.count_nonzero(before), :2])
    white /= math.sqrt(misfit)
    wind, share = white[:, :2], white[:, 2:]
    logs, change = change_log_likelihood_ratios(
        wind, share, np.repeat(directions.T, _START_AGES_S.size, axis=1)
    )
    weights = np.exp(logs - logs.max())
    root = lower * math.sqrt(misfit)
    return _weighted_mean_front(
        weights / weights.sum(), change, _log_mean_of_exponentials(logs),
        _single_member_log_odds(reports, now_s,
        root, wind),
        np.array(origin_ne_m), now_s, slowness, first_s, durations_s,
    )  # fmt: skip


def change_log_likelihood_ratios(
    whitened_winds: Floats, whitened_change_shares: Floats, change_directions: Floats
) -> tuple[Floats, Floats]:
    """Return the log likelihood ratio of each tested change, and the change (2, n).

    All inputs are whitened; `whitened_change_shares` (m, n) is the part of the change in each
    report, `change_directions` (2, n) its expected direction.
    """
    precision = np.square(whitened_change_shares).sum(axis=0)
    prior = 1.0 / CHANGE_STD_MPS**2
    expected = CHANGE_MPS * change_directions
    weighed = whitened_winds.T @ whitened_change_shares + prior * expected
    logs = 0.5 * (weighed**2 / (precision + prior) - prior * expected**2).sum(axis=0)
    logs += np.log(prior / (precision + prior))  # half of it for each axis
    return logs, weighed / (precision + prior)


def _variance_misfit_ratio(whitened_wind_before: Floats) -> float:
    """Return the ratio of the earlier mean square to the process's, at least 1."""
    count = len(whitened_wind_before)
    total = 0.5 * float(np.square(whitened_wind_before).sum())
    return max((total + _MISFIT_PRIOR) / (count + _MISFIT_PRIOR), 1.0)


def _log_mean_of_exponentials(log_values: Floats) -> float:
    most = float(log_values.max())
    return most + math.log(float(np.exp(log_values - most).mean()))


def _single_member_log_odds(
    reports: _Reports, now_s: float, covariance_root: Floats, whitened_winds: Floats
) -> float:
    """Return the log odds of a change at a single member, maximised over the members."""
    since_s = reports.t_s[:, None] - _MEAN_LAG_S - now_s + _START_AGES_S
    over = _smooth_step(since_s / (np.mean(_DURATIONS_S) + 2.0))
    members = np.unique(reports.member)
    own = (reports.member[:, None] == members)[:, :, None] * over[:, None, :]
    share = solve_lower_triangular(covariance_root, own.reshape(reports.t_s.size, -1))
    directions = np.stack([np.cos(_DIRECTIONS_RAD), np.sin(_DIRECTIONS_RAD)])
    candidate_shares = np.tile(share, len(_DIRECTIONS_RAD))
    logs, _ = change_log_likelihood_ratios(
        whitened_winds, candidate_shares, np.repeat(directions, share.shape[1], axis=1)
    )
    each = logs.reshape(len(_DIRECTIONS_RAD), members.size, _START_AGES_S.size)
    return max(_log_mean_of_exponentials(each[:, number].ravel()) for number in range(members.size))


def _candidate_front_normals_and_speeds(mean_ne_mps: Floats) -> tuple[Floats, Floats, Floats]:
    """Return each tested front: normals (n, 2), speeds and durations."""
    normals = np.stack([np.cos(_DIRECTIONS_RAD), np.sin(_DIRECTIONS_RAD)], axis=1)
    normal_wind_mps = normals @ mean_ne_mps + CHANGE_MPS
    each = len(_SPEEDS) * len(_DURATIONS_S)
    factors = np.tile(np.repeat(_SPEEDS, len(_DURATIONS_S)), len(normals))
    speeds = np.maximum(factors * np.repeat(normal_wind_mps, each), _MIN_SPEED_MPS)
    durations_s = np.tile(_DURATIONS_S, len(normals) * len(_SPEEDS))
    return np.repeat(normals, each, axis=0), speeds, durations_s


def _report_covariance_root(
    reports: _Reports,
    mean_wind_ne_mps: Floats,
    process: FieldProcess,
    gust_factor: float,
    terrain_std_mps: float,
) -> Floats:
    """Return the lower Cholesky factor of the reports' covariance without a front."""
    count = reports.t_s.size
    middle_s = reports.t_s - 0.5 * REPORT_AVERAGING_S - reports.t_s.max()
    points = FieldPoints(reports.position_ne_m, np.zeros(count), middle_s)
    at_s = process.eddy_distance_coordinates_s(points, mean_wind_ne_mps)
    left = process.averaging_std_factor_by_part(np.full(count, REPORT_AVERAGING_S))
    scale = gust_factor * process.process.variance_scale(float(np.hypot(*mean_wind_ne_mps)))
    cov = scale * process.covariance_within(at_s, left) + LEVEL_STD_MPS**2
    if terrain_std_mps > 0.0:
        terrain_at = terrain_effect.terrain_correlation_coordinates(
            reports.position_ne_m, np.zeros(count)
        )
        terrain_factor = terrain_effect.averaging_std_factor_along_path(reports.path_m)
        cov += terrain_std_mps**2 * terrain_effect.relative_terrain_covariance(
            terrain_at, terrain_factor, terrain_at, terrain_factor
        )
    independent = np.minimum(reports.variance_m2ps2, process.process.seen_noise_std_mps**2)
    persistent = np.sqrt(reports.variance_m2ps2 - independent)
    same = reports.member[:, None] == reports.member
    cov += np.where(same, np.outer(persistent, persistent), 0.0)
    cov[np.diag_indices(count)] += independent + 1e-6
    return lower_cholesky_factor(cov)


def _weighted_mean_front(
    weights: Floats,
    change_by_candidate_ne_mps: Floats,
    log_odds: float,
    single_member_log_odds: float,
    origin_ne_m: Floats,
    now_s: float,
    slowness_spm: Floats,
    first_contact_lag_s: Floats,
    durations_s: Floats,
) -> FrontOdds:
    """Return the mean front and its covariance, by weights over fronts and start times."""
    start_ages_s = np.tile(_START_AGES_S, len(slowness_spm))
    each = _START_AGES_S.size
    size = np.hypot(*change_by_candidate_ne_mps)
    part = _inverse_smooth_step(np.minimum(DETECTION_MPS / np.maximum(size, DETECTION_MPS), 0.9))
    t0_s = now_s - start_ages_s + np.repeat(slowness_spm @ origin_ne_m - first_contact_lag_s, each)
    t0_s += part * np.repeat(durations_s, each) + _MEAN_LAG_S
    rows = np.column_stack([t0_s, np.repeat(slowness_spm, each, axis=0)])
    mean = weights @ rows
    off = rows - mean
    cov = (weights[:, None] * off).T @ off
    slow = float(np.hypot(*mean[1:]))
    cov[0, 0] += _DETECTION_STD_S**2
    cov[1:, 1:] += slow**2 * (_DIRECTION_STD_RAD**2 + _SPEED_STD_FRAC**2) * np.eye(2)
    north, east = change_by_candidate_ne_mps @ weights
    return FrontOdds(
        log_odds, single_member_log_odds, (float(north), float(east)),
        origin_ne_m, float(mean[0]), mean[1:], 0.5 * (cov + cov.T),
    )  # fmt: skip


def _smooth_step(x: Floats) -> Floats:
    """Return 0 below 0, 1 above 1 and a cubic between."""
    x = np.clip(x, 0.0, 1.0)
    square = x * x
    x *= -2.0
    x += 3.0
    square *= x
    return square


def _inverse_smooth_step(share: Floats) -> Floats:
    """Return the inverse of `_smooth_step`: 1/2 - sin(asin(1 - 2 y) / 3)."""
    return 0.5 - np.sin(np.arcsin(1.0 - 2.0 * share) / 3.0)
