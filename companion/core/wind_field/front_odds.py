"""How likely it is that a front has begun to pass over the members, by all that they told.

A front is a change of wind that begins at a line and moves along the line's normal: everybody feels
the like, each in turn. What is told is held against each of a few hundred fronts (direction, speed,
how long it takes to pass, when it first reached somebody) as a likelihood ratio: members' winds go
together as the wind process says, and the change, a vector, is integrated over its prior (linear
and Gaussian: Rasmussen and Williams 2006, eq. 2.42). The mean of these ratios is the odds of a
front (Shiryaev-Roberts: Roberts, Technometrics 8, 1966). So members whom a front should have
reached and who feel nothing speak against it, gusts that all feel count once, and members that
feel a little each count together; and where the ground slows the wind (`standing`), who flies into
a lee is no front.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from companion.core.base.arrays import Floats
from companion.core.wind_field import standing
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.tellings import TELLING_S, WindTelling

AGES_S = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0, 150.0)
"""What each member told so long ago: means over 10 s that do not overlap."""
KEPT_S = AGES_S[-1] + TELLING_S
BEFORE_S = 45.0
"""Less than that of somebody says nothing of the wind before."""
FEW = 4
"""So few of the newest ages may be of the wind behind a front: the mean wind is that of the
rest."""

CHANGE_MPS, CHANGE_STD_MPS = 7.0, 2.0
"""Gust fronts: a change of 5 to 10 m/s along the normal, known so well on each axis."""
LEVEL_STD_MPS = 2.0
"""Error of the mean wind of the last minutes on each axis."""

_DIRECTIONS_RAD = np.radians(np.arange(0.0, 360.0, 30.0))
_SPEEDS = (0.65, 0.85)
"""Over the wind behind it along its normal: Goff, Mon. Weather Rev. 104, 1976."""
_PASSING_S = (10.0, 30.0, 50.0)
_LEAST_SPEED_MPS = 2.0
_BEGAN_S: Floats = np.arange(8.0, 92.0, 6.0)
"""How long ago it first reached somebody."""

NOTICED_MPS = 3.5
"""A front is noticed at a place once the wind has changed by so much there."""
_MEAN_LAG_S = 4.0
"""A 10 s mean is behind the wind, by what fits a smooth change best."""

_MISFIT_PRIOR = 10.0
"""Weight of the process itself in how gusty it is, as so many values: few say little."""

_DIRECTION_STD_RAD, _SPEED_STD_FRAC, _NOTICED_STD_S = math.radians(10.0), 0.15, 3.0
"""Of what lies between the fronts that are tried."""


@dataclass(frozen=True, slots=True)
class FrontOdds:
    """Odds of a front, and the front if there is one.

    `log_odds`: natural logarithm; `alone_log_odds`: of a change that one member tells of and that
    comes to nobody, a fault or a lie of its own. `change_ne_mps` behind it. `t0_s`: when it is
    noticed at `origin_ne_m`; `slowness_spm` (2,) towards north and east, `cov` (3, 3) of (t0,
    slowness).
    """

    log_odds: float
    alone_log_odds: float
    change_ne_mps: tuple[float, float]
    origin_ne_m: Floats
    t0_s: float
    slowness_spm: Floats
    cov: Floats


@dataclass(frozen=True, slots=True)
class _Told:
    """What is judged, oldest first: places (n, 2), times, winds (n, 2), variances, how far each
    reaches over the ground, by whom, and the number of its age, (n,) each."""

    place_ne_m: Floats
    t_s: Floats
    wind_ne_mps: Floats
    variance_m2ps2: Floats
    way_m: Floats
    member: Floats
    age: Floats

    @classmethod
    def of(cls, members: Sequence[Sequence[WindTelling]], now_s: float) -> "_Told":
        """The tellings of those ages, of each member that has told for long enough."""
        rows: list[tuple[float, ...]] = []
        for number, told in enumerate(members):
            picked = _picked(told, now_s)
            if not picked or picked[0][1].t_s - picked[-1][1].t_s < BEFORE_S:
                continue
            before = [*(one for _, one in picked[1:]), picked[-2][1]]
            for (age, one), other in zip(picked, before, strict=True):
                variance = 0.5 * sum(one.variance_m2ps2)
                way_m = TELLING_S * math.dist(one.place_ne_m, other.place_ne_m)
                way_m /= max(abs(one.t_s - other.t_s), 1.0)  # one may be picked for two ages
                told_now = (*one.place_ne_m, one.t_s, *one.mean_to_ne_mps, variance)
                rows.append((*told_now, way_m, number, age))
        rows.sort(key=lambda row: -row[-1])
        a = np.array(rows).reshape(-1, 9)
        return cls(a[:, 0:2], a[:, 2], a[:, 3:5], a[:, 5], a[:, 6], a[:, 7], a[:, 8])


def _picked(told: Sequence[WindTelling], now_s: float) -> list[tuple[int, WindTelling]]:
    """For each age that somebody told at, the newest telling that is as old."""
    found: list[tuple[int, WindTelling]] = []
    at = len(told) - 1
    for number, age_s in enumerate(AGES_S):
        while at >= 0 and told[at].t_s > now_s - age_s + 0.5:
            at -= 1
        if at < 0:
            break
        if now_s - age_s - told[at].t_s < TELLING_S:
            found.append((number, told[at]))
    return found


def front_odds(
    members: Sequence[Sequence[WindTelling]],
    origin_ne_m: tuple[float, float],
    now_s: float,
    process: FieldProcess,
    gustier: float,
    standing_share: float = 0.0,
) -> FrontOdds | None:
    """The odds by what each of a few members told, oldest first; None: too little is known.

    `gustier`: the process's variances are so many times as large. `standing_share`: the standard
    deviation of what the ground does, over the mean wind.
    """
    told = _Told.of(members, now_s)
    before = told.age >= FEW
    if not before.any():
        return None
    mean = told.wind_ne_mps[before].mean(axis=0)
    directions, speeds, passing_s = _fronts(mean)
    slowness = directions / speeds[:, None]
    lag_s = told.place_ne_m @ slowness.T
    first_s = lag_s[told.age == told.age.min()].min(axis=0)
    since_s = told.t_s[:, None] - _MEAN_LAG_S - (now_s + lag_s - first_s)
    over = (passing_s + 2.0)[None, :, None]
    share = _smooth((since_s[:, :, None] + _BEGAN_S) / over).reshape(told.t_s.size, -1)
    stands_mps = standing_share * float(np.hypot(*mean))
    lower = _covariance_root(told, mean, process, gustier, stands_mps)
    known = np.concatenate([told.wind_ne_mps - mean, share], axis=1)
    white = solve_triangular(lower, known, lower=True, check_finite=False)
    misfit = _misfit(white[: np.count_nonzero(before), :2])
    white /= math.sqrt(misfit)
    wind, share = white[:, :2], white[:, 2:]
    logs, change = log_ratios(wind, share, np.repeat(directions.T, _BEGAN_S.size, axis=1))
    weights = np.exp(logs - logs.max())
    root = lower * math.sqrt(misfit)
    return _believed(
        weights / weights.sum(), change, _log_mean(logs), _alone_odds(told, now_s, root, wind),
        np.array(origin_ne_m), now_s, slowness, first_s, passing_s,
    )  # fmt: skip


def log_ratios(wind: Floats, share: Floats, towards: Floats) -> tuple[Floats, Floats]:
    """For each change that is tried, its likelihood ratio (logarithm) and the change (2, n).

    All are whitened; `share` (m, n) of the change is in each telling, `towards` (2, n) its
    expected direction.
    """
    precision = np.square(share).sum(axis=0)
    prior = 1.0 / CHANGE_STD_MPS**2
    expected = CHANGE_MPS * towards
    weighed = wind.T @ share + prior * expected
    logs = 0.5 * (weighed**2 / (precision + prior) - prior * expected**2).sum(axis=0)
    logs += np.log(prior / (precision + prior))  # half of it for each axis
    return logs, weighed / (precision + prior)


def _misfit(wind_before: Floats) -> float:
    """How much gustier it was before than the process says, at least 1."""
    count = len(wind_before)
    total = 0.5 * float(np.square(wind_before).sum())
    return max((total + _MISFIT_PRIOR) / (count + _MISFIT_PRIOR), 1.0)


def _log_mean(logs: Floats) -> float:
    most = float(logs.max())
    return most + math.log(float(np.exp(logs - most).mean()))


def _alone_odds(told: _Told, now_s: float, lower: Floats, wind: Floats) -> float:
    """The same odds (logarithm) of a change that one member alone tells of, whoever that is most
    likely to be."""
    since_s = told.t_s[:, None] - _MEAN_LAG_S - now_s + _BEGAN_S
    over = _smooth(since_s / (np.mean(_PASSING_S) + 2.0))
    members = np.unique(told.member)
    own = (told.member[:, None] == members)[:, :, None] * over[:, None, :]
    share = solve_triangular(lower, own.reshape(told.t_s.size, -1), lower=True, check_finite=False)
    directions = np.stack([np.cos(_DIRECTIONS_RAD), np.sin(_DIRECTIONS_RAD)])
    tried = np.tile(share, len(_DIRECTIONS_RAD))
    logs, _ = log_ratios(wind, tried, np.repeat(directions, share.shape[1], axis=1))
    each = logs.reshape(len(_DIRECTIONS_RAD), members.size, _BEGAN_S.size)
    return max(_log_mean(each[:, number].ravel()) for number in range(members.size))


def _fronts(mean_ne_mps: Floats) -> tuple[Floats, Floats, Floats]:
    """Each front that is tried: its normal (n, 2), its speed and how long it takes to pass."""
    normals = np.stack([np.cos(_DIRECTIONS_RAD), np.sin(_DIRECTIONS_RAD)], axis=1)
    behind = normals @ mean_ne_mps + CHANGE_MPS
    each = len(_SPEEDS) * len(_PASSING_S)
    factors = np.tile(np.repeat(_SPEEDS, len(_PASSING_S)), len(normals))
    speeds = np.maximum(factors * np.repeat(behind, each), _LEAST_SPEED_MPS)
    passing_s = np.tile(_PASSING_S, len(normals) * len(_SPEEDS))
    return np.repeat(normals, each, axis=0), speeds, passing_s


def _covariance_root(
    told: _Told, mean: Floats, process: FieldProcess, gustier: float, stands_mps: float
) -> Floats:
    """Lower Cholesky factor of the covariance of what was told, without a front."""
    count = told.t_s.size
    middle_s = told.t_s - 0.5 * TELLING_S - told.t_s.max()
    points = FieldPoints(told.place_ne_m, np.zeros(count), middle_s)
    at_s = process.coordinates_s(points, mean)
    left = process.left_by_averaging(np.full(count, TELLING_S))
    scale = gustier * process.process.variance_scale(float(np.hypot(*mean)))
    cov = scale * process.within(at_s, left) + LEVEL_STD_MPS**2
    if stands_mps > 0.0:
        stand_at = standing.coordinates(told.place_ne_m, np.zeros(count))
        stand_left = standing.left_by_averaging(told.way_m)
        cov += stands_mps**2 * standing.between(stand_at, stand_left, stand_at, stand_left)
    fresh = np.minimum(told.variance_m2ps2, process.process.seen_noise_std_mps**2)
    lasting = np.sqrt(told.variance_m2ps2 - fresh)
    same = told.member[:, None] == told.member
    cov += np.where(same, np.outer(lasting, lasting), 0.0)
    cov[np.diag_indices(count)] += fresh + 1e-6
    return cholesky(cov, lower=True, overwrite_a=True, check_finite=False)


def _believed(
    weights: Floats,
    change: Floats,
    log_odds: float,
    alone_log_odds: float,
    origin: Floats,
    now_s: float,
    slowness: Floats,
    first_s: Floats,
    passing_s: Floats,
) -> FrontOdds:
    """The mean front and its covariance, by weights over fronts and beginnings."""
    began = np.tile(_BEGAN_S, len(slowness))
    each = _BEGAN_S.size
    size = np.hypot(*change)
    part = _part_of(np.minimum(NOTICED_MPS / np.maximum(size, NOTICED_MPS), 0.9))
    t0_s = now_s - began + np.repeat(slowness @ origin - first_s, each)
    t0_s += part * np.repeat(passing_s, each) + _MEAN_LAG_S
    rows = np.column_stack([t0_s, np.repeat(slowness, each, axis=0)])
    mean = weights @ rows
    off = rows - mean
    cov = (weights[:, None] * off).T @ off
    slow = float(np.hypot(*mean[1:]))
    cov[0, 0] += _NOTICED_STD_S**2
    cov[1:, 1:] += slow**2 * (_DIRECTION_STD_RAD**2 + _SPEED_STD_FRAC**2) * np.eye(2)
    north, east = change @ weights
    return FrontOdds(
        log_odds, alone_log_odds, (float(north), float(east)),
        origin, float(mean[0]), mean[1:], 0.5 * (cov + cov.T),
    )  # fmt: skip


def _smooth(x: Floats) -> Floats:
    """0 before 0, 1 after 1, smooth between (cubic)."""
    x = np.clip(x, 0.0, 1.0)
    square = x * x
    x *= -2.0
    x += 3.0
    square *= x
    return square


def _part_of(share: Floats) -> Floats:
    """Where `_smooth` has a value: 1/2 - sin(asin(1 - 2 y) / 3)."""
    return 0.5 - np.sin(np.arcsin(1.0 - 2.0 * share) / 3.0)
