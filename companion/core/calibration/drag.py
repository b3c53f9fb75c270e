"""Drag along both body axes, from tilt and acceleration, with the wind unknown and changing.

Per 2 s block and axis: `accel - thrust = -D(v - w) / m + g trim`. Drag is estimated by generalised
least squares (Aitken 1935) with everything that is random and lasts in the covariance: the wind's
departures from its mean over the flight (gusts and two slower Ornstein-Uhlenbeck parts), the trim,
the sensors. Each flight's mean wind and heading error are estimated beside the drag. The wind's
part of the covariance is drag's slope times the wind's covariance, at the estimate before, and not
a function of the parameters being fitted: so a noisy wind does not pull the drag (estimating the
wind as states beside the drag does, by its share of the variance).

The wind over the flight is then the best linear prediction from the same residuals (kriging).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares
from scipy.sparse import block_diag, csr_array, eye_array, hstack, issparse, vstack

from companion.core.base.arrays import Floats, Ints
from companion.core.calibration.records import BLOCK_S, Blocks
from companion.core.calibration.residual_scatter import widened_covariance
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import GRAVITY_MPS2

DRAG_KEYS = (
    "linear_forward_n_per_mps",
    "linear_right_n_per_mps",
    "quadratic_forward_n_per_mps2",
    "quadratic_right_n_per_mps2",
    "parcel_quadratic_n_per_mps2",
)
SYMMETRIC_RATIO_STD = 0.05
"""[est] Rotor drag has no preferred direction on four equal arms; landing gear, pack and sensors
make the body's frontal areas differ by some per cent."""
_NUISANCES = 4  # a flight's mean wind north, east (m/s), heading error (rad), velocity lag (s)
_ROUNDS = 3
_LEAST_SPEED_MPS = 0.5
_OPTIMISM = 1.5
"""Rms of error over stated std without it: four fits to three simulated flights each, drag ahead
and sideways at 4.9 and 14 m/s against the simulator's own (docs/results/calibration.md)."""
_SCALES = np.geomspace(0.1, 4.0, 10)


@dataclass(frozen=True, slots=True)
class DragPriors:
    """What is believed before the first flight, and how the air and the sensors err.

    `own_frac` is how wrong the start airframe's drag may be, `floor_per_s` and `floor_per_m`
    (times mass) keep a start value of nearly zero open; `axis_ratio_std` is how far forward and
    right may differ from the start's ratio. [est] unless said; winds as in WindEstimatorParams,
    from a recording at a coast (awegroup, 12 May 2023) at its mean of 8.6 m/s.
    """

    own_frac: float = 1.0
    floor_per_s: float = 0.05
    floor_per_m: float = 0.006
    axis_ratio_std: float = 0.25
    parcel_frac: float = 1.0
    mean_wind_std_mps: float = 8.0
    heading_std_rad: float = math.radians(2.5)
    trim_std_rad: float = math.radians(1.0)
    trim_wander_std_rad: float = math.radians(0.4)
    trim_wander_s: float = 300.0
    slow_wind_std_mps: tuple[float, float] = (1.5, 1.5)
    slow_wind_s: tuple[float, float] = (40.0, 400.0)
    gust_std_mps: float = 0.6
    gust_s: float = 4.0
    reference_wind_mps: float = 8.6
    least_wind_scale: float = 0.35
    sensor_std_mps2: float = 0.05
    lag_std_s: float = 0.15
    lag_left_std_s: float = 0.04

    @classmethod
    def symmetric(cls) -> "DragPriors":
        """For an airframe that looks alike from ahead and from the side.

        Courses flown nose first say little of drag to the right in fast air: with the axes free to
        differ by 25 %, 119 flights of an M100 gave no quadratic drag at all to the right, and
        winds that were 2 m/s too strong at 16 m/s of airspeed.
        """
        return cls(axis_ratio_std=SYMMETRIC_RATIO_STD)


@dataclass(frozen=True, slots=True)
class WindSeen:
    """The wind over one flight's blocks as the drag tells it, where it moves to; and its std."""

    to_north_mps: Floats
    to_east_mps: Floats
    std_mps: Floats
    mean_mps: float


@dataclass(frozen=True, slots=True)
class DragFit:
    """`values` and `cov` as in DRAG_KEYS; `prior_cov` what was believed before.

    `residual_mps2` per flight: (n, 2) measured less expected drag deceleration, wind explained;
    its mean over a flight is gravity times the trim beside the start airframe's.
    """

    values: Floats
    cov: Floats
    prior_cov: Floats
    winds: tuple[WindSeen, ...]
    residual_mps2: tuple[Floats, ...]


def drag_values(airframe: Airframe) -> Floats:
    """The airframe's own numbers in the order of DRAG_KEYS."""
    return np.array([getattr(airframe.drag, key) for key in DRAG_KEYS])


def fit_drag(
    flights: list[Blocks], airframe: Airframe, priors: DragPriors | None = None
) -> DragFit:
    """Drag from flights; the start airframe is the prior."""
    return _fit(flights, airframe, priors or DragPriors(), fixed=False)


def see_wind(blocks: Blocks, airframe: Airframe, priors: DragPriors | None = None) -> WindSeen:
    """The wind over a flight, by an airframe whose drag is taken as known."""
    return _fit([blocks], airframe, priors or DragPriors(), fixed=True).winds[0]


def drag_prior_cov(airframe: Airframe, priors: DragPriors) -> Floats:
    """Prior covariance of DRAG_KEYS: each of its own size, right tied to forward."""
    mass = airframe.mass.empty_kg
    value = drag_values(airframe)
    linear = max(priors.own_frac * value[0], priors.floor_per_s * mass)
    quadratic = max(priors.own_frac * value[2], priors.floor_per_m * mass)
    own = np.array([linear, quadratic])
    cov = np.zeros((5, 5))
    for axis, std, ratio in zip((0, 2), own, _ratios(value), strict=True):
        apart = (priors.axis_ratio_std * max(value[axis], std)) ** 2
        cov[axis, axis] = std**2
        cov[axis, axis + 1] = cov[axis + 1, axis] = ratio * std**2
        cov[axis + 1, axis + 1] = ratio**2 * std**2 + apart
    cov[4, 4] = (max(priors.parcel_frac * value[4], 0.002 * mass)) ** 2
    return cov


def _ratios(value: Floats) -> tuple[float, ...]:
    """Right over forward, of the linear and of the quadratic part."""
    return tuple(value[i + 1] / value[i] if value[i] > 0.0 else 1.0 for i in (0, 2))


def _fit(flights: list[Blocks], airframe: Airframe, priors: DragPriors, fixed: bool) -> DragFit:
    models = [_FlightModel(b.pick(b.airborne), airframe, priors) for b in flights]
    start = drag_values(airframe)
    prior_cov = drag_prior_cov(airframe, priors)
    globals_ = 0 if fixed else len(start)
    nuisance_std = [priors.mean_wind_std_mps] * 2 + [priors.heading_std_rad, priors.lag_std_s]
    x = np.r_[start[:globals_], np.zeros(_NUISANCES * len(models))]
    prior_root = np.linalg.inv(np.linalg.cholesky(prior_cov))

    def split(x: Floats) -> tuple[Floats, Floats]:
        drag = start if fixed else x[:globals_]
        return drag, x[globals_:].reshape(-1, _NUISANCES)

    def residuals(x: Floats) -> Floats:
        drag, own = split(x)
        parts = [m.whitened(drag, mine) for m, mine in zip(models, own, strict=True)]
        parts.append((own / nuisance_std).ravel())
        if not fixed:
            parts.append(prior_root @ (drag - start))
        return np.concatenate(parts)

    low = np.r_[np.zeros(globals_), np.full(len(x) - globals_, -np.inf)]
    pattern = _pattern([m.size for m in models], globals_) if len(models) > 1 else None
    solution = None
    for turn in range(_ROUNDS):
        drag, own = split(x)
        for model, mine in zip(models, own, strict=True):
            model.weigh(drag, mine, settle=turn == 1)
        solution = least_squares(
            residuals,
            np.maximum(x, low + 1e-9),
            bounds=(low, np.inf),
            x_scale="jac",
            jac_sparsity=pattern,
        )
        x = solution.x
    assert solution is not None
    drag, own = split(x)
    cov = widened_covariance(_dense(solution.jac), solution.fun, _clusters(models), _OPTIMISM)
    cov = cov[:globals_, :globals_]
    winds = tuple(m.wind(drag, mine) for m, mine in zip(models, own, strict=True))
    left = tuple(m.unexplained(drag, mine) for m, mine in zip(models, own, strict=True))
    return DragFit(drag, cov, prior_cov, winds, left)


def _pattern(rows: list[int], globals_: int) -> csr_array:
    """Which residual depends on what: a flight's on drag and on its own, priors on one each."""
    own = block_diag([np.ones((count, _NUISANCES)) for count in rows])
    shared = np.ones((sum(rows), globals_))
    nuisances = _NUISANCES * len(rows)
    width = globals_ + nuisances
    priors = [eye_array(nuisances, width, k=globals_)]
    drag = csr_array(np.c_[np.ones((globals_, globals_)), np.zeros((globals_, width - globals_))])
    return csr_array(vstack([hstack([shared, own]), *priors, drag]))


def _dense(jac: Any) -> Floats:
    """The Jacobian as least_squares leaves it: sparse where it was told a pattern."""
    return jac.toarray() if issparse(jac) else jac


def _clusters(models: list["_FlightModel"]) -> Iterator[Ints]:
    """Rows of all flights, minute by minute."""
    at = 0
    for model in models:
        for rows in model.clusters():
            yield at + rows
        at += model.size


class _FlightModel:
    """One flight: expected drag decelerations, their covariance, and its square root."""

    def __init__(self, blocks: Blocks, airframe: Airframe, priors: DragPriors) -> None:
        self._b, self._priors = blocks, priors
        drag, empty_kg = airframe.drag, airframe.mass.empty_kg
        self._trim_mps2 = GRAVITY_MPS2 * np.radians([drag.trim_forward_deg, drag.trim_right_deg])
        self._mass = empty_kg + blocks.payload_kg
        self._mass_root = np.sqrt(self._mass / empty_kg)
        self._parcel = blocks.payload_kg > 0.001 * empty_kg
        lag = np.abs(blocks.t_s[:, None] - blocks.t_s[None, :])
        self._slow, self._gust = _wind_kernels(lag, priors)
        self._trim = GRAVITY_MPS2**2 * (
            priors.trim_std_rad**2
            + priors.trim_wander_std_rad**2 * np.exp(-lag / priors.trim_wander_s)
        )
        transient = priors.lag_left_std_s / BLOCK_S * blocks.swing_mps2
        self._own_variance = np.tile(priors.sensor_std_mps2**2 + transient**2, 2)
        self.scale = 1.0
        self._root: Floats = np.eye(self.size)
        self._slopes: Floats = np.zeros((len(blocks.t_s), 2, 2))
        self._wind_cov: Floats = self._slow

    @property
    def size(self) -> int:
        """Residuals of this flight: forward ones, then right ones."""
        return 2 * len(self._b.t_s)

    def clusters(self) -> list[Ints]:
        """Rows of each minute."""
        minute = (self._b.t_s // 60.0).astype(int)
        both = np.tile(minute, 2)
        return [np.flatnonzero(both == m) for m in np.unique(minute)]

    def _air(self, own: Floats) -> tuple[Floats, Floats]:
        """Mean air velocity past the body, along true forward and right."""
        b, (wind_n, wind_e, error, lag_s) = self._b, own
        forward = (
            b.forward_mps + lag_s * b.accel_forward_mps2 - (b.cos_yaw * wind_n + b.sin_yaw * wind_e)
        )
        right = b.right_mps + lag_s * b.accel_right_mps2 - (b.cos_yaw * wind_e - b.sin_yaw * wind_n)
        return forward + error * right, right - error * forward

    def _gains(self, drag: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Linear forward, right; quadratic forward, right, at each block's mass in its air."""
        parcel = np.where(self._parcel, drag[4], 0.0)
        ratio = self._b.density_kgpm3 / REFERENCE_DENSITY_KGPM3
        flow = self._mass_root * math.sqrt(ratio)
        return (
            drag[0] * flow,
            drag[1] * flow,
            ratio * (drag[2] + parcel),
            ratio * (drag[3] + parcel),
        )

    def difference(self, drag: Floats, own: Floats) -> Floats:
        """Measured less expected deceleration by drag, forward then right, m/s^2."""
        b, error, lag_s = self._b, own[2], own[3]
        forward, right = self._air(own)
        speed = np.hypot(forward, right)
        k_f, k_r, q_f, q_r = self._gains(drag)
        expected_f = -(k_f + q_f * speed) * forward / self._mass
        expected_r = -(k_r + q_r * speed) * right / self._mass
        ahead_f = b.accel_forward_mps2 + lag_s * b.jerk_forward_mps3
        ahead_r = b.accel_right_mps2 + lag_s * b.jerk_right_mps3
        accel_f = ahead_f + error * ahead_r
        accel_r = ahead_r - error * ahead_f
        return np.r_[
            accel_f - b.thrust_forward_mps2 - self._trim_mps2[0] - expected_f,
            accel_r - b.thrust_right_mps2 - self._trim_mps2[1] - expected_r,
        ]

    def _wind_slopes(self, drag: Floats, own: Floats) -> Floats:
        """d expected / d wind (north, east): (n, 2 axes, 2)."""
        b = self._b
        forward, right = self._air(own)
        speed = np.maximum(np.hypot(forward, right), _LEAST_SPEED_MPS)
        k_f, k_r, q_f, q_r = self._gains(drag)
        ff = (k_f + q_f * (speed + forward**2 / speed)) / self._mass
        fr = q_f * forward * right / speed / self._mass
        rr = (k_r + q_r * (speed + right**2 / speed)) / self._mass
        rf = q_r * forward * right / speed / self._mass
        cos, sin = b.cos_yaw, b.sin_yaw
        return np.stack(
            [
                np.stack([ff * cos - fr * sin, ff * sin + fr * cos], -1),
                np.stack([rf * cos - rr * sin, rf * sin + rr * cos], -1),
            ],
            1,
        )

    def weigh(self, drag: Floats, own: Floats, settle: bool) -> None:
        """Set the covariance at an estimate; `settle`: the wind's part follows the residuals."""
        p, n = self._priors, len(self._b.t_s)
        self._slopes = self._wind_slopes(drag, own)
        level = max(math.hypot(own[0], own[1]) / p.reference_wind_mps, p.least_wind_scale)
        wind_cov = level**2 * (self._slow + self._gust)
        by_wind, rest = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
        for a in (0, 1):
            for c in (0, 1):
                rows, cols = slice(a * n, a * n + n), slice(c * n, c * n + n)
                projected = self._slopes[:, a] @ self._slopes[:, c].T
                by_wind[rows, cols] = projected * wind_cov
            rest[a * n : a * n + n, a * n : a * n + n] = self._trim
        rest[np.diag_indices(2 * n)] += self._own_variance
        if settle:
            self.scale = _likeliest_scale(by_wind, rest, self.difference(drag, own))
        self._wind_cov = self.scale**2 * wind_cov
        self._root = np.asarray(np.linalg.cholesky(self.scale**2 * by_wind + rest), np.float64)

    def whitened(self, drag: Floats, own: Floats) -> Floats:
        """Residuals of unit variance, uncorrelated if the covariance is right."""
        return solve_triangular(self._root, self.difference(drag, own), lower=True)

    def wind(self, drag: Floats, own: Floats) -> WindSeen:
        """Mean wind of the flight plus its departures as predicted from the residuals."""
        n = len(self._b.t_s)
        white = self.whitened(drag, own)
        parts, variance = [], np.zeros(n)
        for c in (0, 1):
            # Cov(wind_c at i, residual_a at j) = K(i, j) slope_a,c at j
            cross = np.hstack([self._wind_cov * self._slopes[None, :, a, c] for a in (0, 1)])
            gain = solve_triangular(self._root, cross.T, lower=True)
            parts.append(own[c] + gain.T @ white)
            explained = np.sum(gain**2, axis=0)
            variance += 0.5 * np.maximum(np.diag(self._wind_cov) - explained, 0.0)
        mean = math.hypot(own[0], own[1])
        return WindSeen(parts[0], parts[1], np.sqrt(variance), mean)

    def unexplained(self, drag: Floats, own: Floats) -> Floats:
        """(n, 2) residuals with the predicted wind taken out; trim stays in."""
        n, wind = len(self._b.t_s), self.wind(drag, own)
        difference = self.difference(drag, own).reshape(2, n).T
        departure = np.stack([wind.to_north_mps - own[0], wind.to_east_mps - own[1]], -1)
        return difference - np.einsum("nac,nc->na", self._slopes, departure)


def _likeliest_scale(by_wind: Floats, rest: Floats, left: Floats) -> float:
    """How much stronger than assumed the wind varies (a standard deviation), by likelihood."""
    losses = []
    for scale in _SCALES:
        root = np.linalg.cholesky(scale**2 * by_wind + rest)
        white = solve_triangular(root, left, lower=True)
        losses.append(float(white @ white) + 2.0 * float(np.log(np.diag(root)).sum()))
    return float(_SCALES[int(np.argmin(losses))])


def _wind_kernels(lag_s: Floats, p: DragPriors) -> tuple[Floats, Floats]:
    """Covariances of slow wind and of gusts (2 s means) over time, m^2/s^2, per component."""
    slow = sum(
        std**2 * np.exp(-lag_s / memory)
        for std, memory in zip(p.slow_wind_std_mps, p.slow_wind_s, strict=True)
    )
    return np.asarray(slow), p.gust_std_mps**2 * np.exp(-lag_s / p.gust_s)
