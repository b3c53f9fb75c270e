"""Drag along both body axes, from tilt and acceleration, with the wind unknown and changing.

Per 2 s block and axis: `accel - thrust = -D(v - w) / m + g trim`. Drag is estimated by generalised
least squares (Aitken 1935) with all correlated random terms in the covariance: deviations of the
wind from its flight mean (gusts and two slower Ornstein-Uhlenbeck parts), the trim, the sensors.
Each flight's mean wind and heading error are estimated together with the drag. The wind part of
the covariance is the slope of drag times the wind's covariance at the previous estimate, and not a
function of the fitted parameters: a noisy wind does not bias the drag (estimation of the wind as
states does, by its share of the variance).

The wind over the flight is the best linear prediction from the same residuals (kriging).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares
from scipy.sparse import block_diag, csr_array, eye_array, hstack, issparse, vstack

from companion.analysis.calibration.records import BLOCK_S, Blocks
from companion.analysis.calibration.residual_scatter import covariance_widened_by_cluster_scatter
from companion.core.base.arrays import Floats, Ints
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
_NUISANCE_COUNT = 4  # a flight's mean wind north, east (m/s), heading error (rad), velocity lag (s)
_FIT_ITERATIONS = 3
_MIN_SPEED_MPS = 0.5
_STD_INFLATION = 1.5
"""Rms of error over stated std without it: four fits to three simulated flights, drag forward
and sideways at 4.9 and 14 m/s against the simulator's own (docs/results/real-flights.md)."""
_WIND_SCALES = np.geomspace(0.1, 4.0, 10)


@dataclass(frozen=True, slots=True)
class DragPriors:
    """Priors of drag and wind, and sensor errors.

    `drag_std_frac` is the relative uncertainty of the start airframe's drag, `min_linear_std_per_s`
    and `min_quadratic_std_per_m` (times mass) its lower bound; `axis_ratio_std` is the uncertainty
    of the ratio of right to forward drag. [est] unless noted; winds as in WindEstimatorParams, from
    a recording at a coast (awegroup, 12 May 2023) at its mean of 8.6 m/s.
    """

    drag_std_frac: float = 1.0
    min_linear_std_per_s: float = 0.05
    min_quadratic_std_per_m: float = 0.006
    axis_ratio_std: float = 0.25
    parcel_drag_std_frac: float = 1.0
    mean_wind_std_mps: float = 8.0
    heading_std_rad: float = math.radians(2.5)
    trim_std_rad: float = math.radians(1.0)
    trim_drift_std_rad: float = math.radians(0.4)
    trim_drift_s: float = 300.0
    slow_wind_std_mps: tuple[float, float] = (1.5, 1.5)
    slow_wind_s: tuple[float, float] = (40.0, 400.0)
    gust_std_mps: float = 0.6
    gust_s: float = 4.0
    reference_wind_mps: float = 8.6
    min_wind_scale: float = 0.35
    sensor_std_mps2: float = 0.05
    lag_std_s: float = 0.15
    residual_lag_std_s: float = 0.04

    @classmethod
    def for_symmetric_airframe(cls) -> "DragPriors":
        """Return priors for an airframe with similar front and side views.

        Nose-first flight contains little information on drag to the right at high airspeed: with
        an axis ratio free by 25 %, 119 flights of an M100 gave zero quadratic drag to the right,
        and winds 2 m/s too strong at 16 m/s of airspeed.
        """
        return cls(axis_ratio_std=SYMMETRIC_RATIO_STD)


@dataclass(frozen=True, slots=True)
class EstimatedWind:
    """Wind (direction to) over one flight's blocks, estimated from drag, with its std."""

    to_north_mps: Floats
    to_east_mps: Floats
    std_mps: Floats
    mean_mps: float


@dataclass(frozen=True, slots=True)
class DragFit:
    """Fitted drag; `values`, `cov` and `prior_cov` in the order of DRAG_KEYS.

    `residual_mps2` per flight: (n, 2) measured minus expected drag deceleration, wind removed; its
    mean over a flight is gravity times the trim in addition to the start airframe's.
    """

    values: Floats
    cov: Floats
    prior_cov: Floats
    winds: tuple[EstimatedWind, ...]
    residual_mps2: tuple[Floats, ...]


def drag_parameter_vector(airframe: Airframe) -> Floats:
    """Return the airframe's drag parameters in the order of DRAG_KEYS."""
    return np.array([getattr(airframe.drag, key) for key in DRAG_KEYS])


def fit_drag(
    flights: list[Blocks], airframe: Airframe, priors: DragPriors | None = None
) -> DragFit:
    """Fit drag to flights; the start airframe is the prior."""
    return _fit_drag_and_wind(flights, airframe, priors or DragPriors(), is_drag_fixed=False)


def estimate_wind(
    blocks: Blocks, airframe: Airframe, priors: DragPriors | None = None
) -> EstimatedWind:
    """Estimate the wind over a flight; the airframe's drag counts as exact."""
    return _fit_drag_and_wind([blocks], airframe, priors or DragPriors(), is_drag_fixed=True).winds[
        0
    ]


def drag_prior_cov(airframe: Airframe, priors: DragPriors) -> Floats:
    """Return the prior covariance of DRAG_KEYS; right is correlated with forward."""
    mass = airframe.mass.empty_kg
    value = drag_parameter_vector(airframe)
    linear = max(priors.drag_std_frac * value[0], priors.min_linear_std_per_s * mass)
    quadratic = max(priors.drag_std_frac * value[2], priors.min_quadratic_std_per_m * mass)
    own = np.array([linear, quadratic])
    cov = np.zeros((5, 5))
    for axis, std, ratio in zip((0, 2), own, _right_to_forward_drag_ratios(value), strict=True):
        axis_variance = (priors.axis_ratio_std * max(value[axis], std)) ** 2
        cov[axis, axis] = std**2
        cov[axis, axis + 1] = cov[axis + 1, axis] = ratio * std**2
        cov[axis + 1, axis + 1] = ratio**2 * std**2 + axis_variance
    cov[4, 4] = (max(priors.parcel_drag_std_frac * value[4], 0.002 * mass)) ** 2
    return cov


def _right_to_forward_drag_ratios(drag_parameters: Floats) -> tuple[float, ...]:
    """Return right over forward, of the linear and of the quadratic part."""
    return tuple(
        drag_parameters[i + 1] / drag_parameters[i] if drag_parameters[i] > 0.0 else 1.0
        for i in (0, 2)
    )


def _fit_drag_and_wind(
    flights: list[Blocks], airframe: Airframe, priors: DragPriors, is_drag_fixed: bool
) -> DragFit:
    models = [_FlightModel(b.select(b.airborne), airframe, priors) for b in flights]
    start = drag_parameter_vector(airframe)
    prior_cov = drag_prior_cov(airframe, priors)
    globals_ = 0 if is_drag_fixed else len(start)
    nuisance_std = [priors.mean_wind_std_mps] * 2 + [priors.heading_std_rad, priors.lag_std_s]
    x = np.r_[start[:globals_], np.zeros(_NUISANCE_COUNT * len(models))]
    prior_root = np.linalg.inv(np.linalg.cholesky(prior_cov))

    def split_drag_and_nuisances(x: Floats) -> tuple[Floats, Floats]:
        drag = start if is_drag_fixed else x[:globals_]
        return drag, x[globals_:].reshape(-1, _NUISANCE_COUNT)

    def whitened_residuals_and_priors(x: Floats) -> Floats:
        drag, own = split_drag_and_nuisances(x)
        parts = [
            m.whitened_residuals(drag, flight_nuisances)
            for m, flight_nuisances in zip(models, own, strict=True)
        ]
        parts.append((own / nuisance_std).ravel())
        if not is_drag_fixed:
            parts.append(prior_root @ (drag - start))
        return np.concatenate(parts)

    low = np.r_[np.zeros(globals_), np.full(len(x) - globals_, -np.inf)]
    pattern = _jacobian_sparsity([m.size for m in models], globals_) if len(models) > 1 else None
    solution = None
    for iteration in range(_FIT_ITERATIONS):
        drag, own = split_drag_and_nuisances(x)
        for model, flight_nuisances in zip(models, own, strict=True):
            model.update_covariance(drag, flight_nuisances, fit_wind_scale=iteration == 1)
        solution = least_squares(
            whitened_residuals_and_priors,
            np.maximum(x, low + 1e-9),
            bounds=(low, np.inf),
            x_scale="jac",
            jac_sparsity=pattern,
        )
        x = solution.x
    assert solution is not None
    drag, own = split_drag_and_nuisances(x)
    jacobian = solution.jac.toarray() if issparse(solution.jac) else solution.jac
    cov = covariance_widened_by_cluster_scatter(
        jacobian, solution.fun, _row_indices_by_minute(models), _STD_INFLATION
    )
    cov = cov[:globals_, :globals_]
    winds = tuple(
        m.predict_wind(drag, flight_nuisances)
        for m, flight_nuisances in zip(models, own, strict=True)
    )
    residual_values = tuple(
        m.residuals_without_wind(drag, flight_nuisances)
        for m, flight_nuisances in zip(models, own, strict=True)
    )
    return DragFit(drag, cov, prior_cov, winds, residual_values)


def _jacobian_sparsity(
    residual_count_by_flight: list[int], shared_parameter_count: int
) -> csr_array:
    """Sparsity of the Jacobian: a flight's residuals depend on drag and its own nuisances."""
    own = block_diag([np.ones((count, _NUISANCE_COUNT)) for count in residual_count_by_flight])
    shared = np.ones((sum(residual_count_by_flight), shared_parameter_count))
    nuisances = _NUISANCE_COUNT * len(residual_count_by_flight)
    width = shared_parameter_count + nuisances
    priors = [eye_array(nuisances, width, k=shared_parameter_count)]
    drag = csr_array(
        np.c_[
            np.ones((shared_parameter_count, shared_parameter_count)),
            np.zeros((shared_parameter_count, width - shared_parameter_count)),
        ]
    )
    return csr_array(vstack([hstack([shared, own]), *priors, drag]))


def _row_indices_by_minute(models: list["_FlightModel"]) -> Iterator[Ints]:
    """Yield the rows of each minute of all flights."""
    at = 0
    for model in models:
        for rows in model.row_indices_by_minute():
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
        self._slow, self._gust = _slow_and_gust_wind_covariance_m2ps2(lag, priors)
        self._trim = GRAVITY_MPS2**2 * (
            priors.trim_std_rad**2
            + priors.trim_drift_std_rad**2 * np.exp(-lag / priors.trim_drift_s)
        )
        transient = priors.residual_lag_std_s / BLOCK_S * blocks.swing_mps2
        self._own_variance = np.tile(priors.sensor_std_mps2**2 + transient**2, 2)
        self.scale = 1.0
        self._root: Floats = np.eye(self.size)
        self._slopes: Floats = np.zeros((len(blocks.t_s), 2, 2))
        self._wind_cov: Floats = self._slow

    @property
    def size(self) -> int:
        """Residuals of this flight: forward ones, then right ones."""
        return 2 * len(self._b.t_s)

    def row_indices_by_minute(self) -> list[Ints]:
        """Return the rows of each minute."""
        minute = (self._b.t_s // 60.0).astype(int)
        both = np.tile(minute, 2)
        return [np.flatnonzero(both == m) for m in np.unique(minute)]

    def _air_velocity_forward_right_mps(self, flight_nuisances: Floats) -> tuple[Floats, Floats]:
        """Return the mean velocity through the air along true forward and right."""
        b, (wind_n, wind_e, error, lag_s) = self._b, flight_nuisances
        forward = (
            b.forward_mps + lag_s * b.accel_forward_mps2 - (b.cos_yaw * wind_n + b.sin_yaw * wind_e)
        )
        right = b.right_mps + lag_s * b.accel_right_mps2 - (b.cos_yaw * wind_e - b.sin_yaw * wind_n)
        return forward + error * right, right - error * forward

    def _drag_coefficients_by_block(self, drag: Floats) -> tuple[Floats, Floats, Floats, Floats]:
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

    def drag_deceleration_residuals_mps2(self, drag: Floats, flight_nuisances: Floats) -> Floats:
        """Measured less expected deceleration by drag, forward then right, m/s^2."""
        b, error, lag_s = self._b, flight_nuisances[2], flight_nuisances[3]
        forward, right = self._air_velocity_forward_right_mps(flight_nuisances)
        speed = np.hypot(forward, right)
        k_f, k_r, q_f, q_r = self._drag_coefficients_by_block(drag)
        expected_f = -(k_f + q_f * speed) * forward / self._mass
        expected_r = -(k_r + q_r * speed) * right / self._mass
        predicted_accel_f = b.accel_forward_mps2 + lag_s * b.jerk_forward_mps3
        predicted_accel_r = b.accel_right_mps2 + lag_s * b.jerk_right_mps3
        accel_f = predicted_accel_f + error * predicted_accel_r
        accel_r = predicted_accel_r - error * predicted_accel_f
        return np.r_[
            accel_f - b.thrust_forward_mps2 - self._trim_mps2[0] - expected_f,
            accel_r - b.thrust_right_mps2 - self._trim_mps2[1] - expected_r,
        ]

    def _deceleration_derivatives_by_wind(self, drag: Floats, flight_nuisances: Floats) -> Floats:
        """d expected / d wind (north, east): (n, 2 axes, 2)."""
        b = self._b
        forward, right = self._air_velocity_forward_right_mps(flight_nuisances)
        speed = np.maximum(np.hypot(forward, right), _MIN_SPEED_MPS)
        k_f, k_r, q_f, q_r = self._drag_coefficients_by_block(drag)
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

    def update_covariance(
        self, drag: Floats, flight_nuisances: Floats, fit_wind_scale: bool
    ) -> None:
        """Set the covariance at an estimate; `fit_wind_scale`: fit the wind part to residuals."""
        p, n = self._priors, len(self._b.t_s)
        self._slopes = self._deceleration_derivatives_by_wind(drag, flight_nuisances)
        level = max(
            math.hypot(flight_nuisances[0], flight_nuisances[1]) / p.reference_wind_mps,
            p.min_wind_scale,
        )
        wind_cov = level**2 * (self._slow + self._gust)
        by_wind, rest = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
        for a in (0, 1):
            for c in (0, 1):
                rows, cols = slice(a * n, a * n + n), slice(c * n, c * n + n)
                projected = self._slopes[:, a] @ self._slopes[:, c].T
                by_wind[rows, cols] = projected * wind_cov
            rest[a * n : a * n + n, a * n : a * n + n] = self._trim
        rest[np.diag_indices(2 * n)] += self._own_variance
        if fit_wind_scale:
            self.scale = _fit_wind_scale(
                by_wind, rest, self.drag_deceleration_residuals_mps2(drag, flight_nuisances)
            )
        self._wind_cov = self.scale**2 * wind_cov
        self._root = np.asarray(np.linalg.cholesky(self.scale**2 * by_wind + rest), np.float64)

    def whitened_residuals(self, drag: Floats, flight_nuisances: Floats) -> Floats:
        """Residuals of unit variance, uncorrelated if the covariance is right."""
        return solve_triangular(
            self._root, self.drag_deceleration_residuals_mps2(drag, flight_nuisances), lower=True
        )

    def predict_wind(self, drag: Floats, flight_nuisances: Floats) -> EstimatedWind:
        """Return the mean wind plus its deviations predicted from the residuals."""
        n = len(self._b.t_s)
        white = self.whitened_residuals(drag, flight_nuisances)
        parts, variance = [], np.zeros(n)
        for c in (0, 1):
            # Cov(wind_c at i, residual_a at j) = K(i, j) slope_a,c at j
            cross = np.hstack([self._wind_cov * self._slopes[None, :, a, c] for a in (0, 1)])
            gain = solve_triangular(self._root, cross.T, lower=True)
            parts.append(flight_nuisances[c] + gain.T @ white)
            explained = np.sum(gain**2, axis=0)
            variance += 0.5 * np.maximum(np.diag(self._wind_cov) - explained, 0.0)
        mean = math.hypot(flight_nuisances[0], flight_nuisances[1])
        return EstimatedWind(parts[0], parts[1], np.sqrt(variance), mean)

    def residuals_without_wind(self, drag: Floats, flight_nuisances: Floats) -> Floats:
        """Return residuals (n, 2) without the predicted wind, including trim."""
        n, wind = len(self._b.t_s), self.predict_wind(drag, flight_nuisances)
        difference = self.drag_deceleration_residuals_mps2(drag, flight_nuisances).reshape(2, n).T
        departure = np.stack(
            [wind.to_north_mps - flight_nuisances[0], wind.to_east_mps - flight_nuisances[1]], -1
        )
        return difference - np.einsum("nac,nc->na", self._slopes, departure)


def _fit_wind_scale(
    unit_wind_cov: Floats, cov_without_wind: Floats, residual_values: Floats
) -> float:
    """Return the maximum-likelihood factor on the wind's standard deviation."""
    losses = []
    for scale in _WIND_SCALES:
        root = np.linalg.cholesky(scale**2 * unit_wind_cov + cov_without_wind)
        white = solve_triangular(root, residual_values, lower=True)
        losses.append(float(white @ white) + 2.0 * float(np.log(np.diag(root)).sum()))
    return float(_WIND_SCALES[int(np.argmin(losses))])


def _slow_and_gust_wind_covariance_m2ps2(
    lag_s: Floats, priors: DragPriors
) -> tuple[Floats, Floats]:
    """Return covariances of slow wind and gusts (2 s means) over time, m^2/s^2 per component."""
    slow = sum(
        std**2 * np.exp(-lag_s / memory)
        for std, memory in zip(priors.slow_wind_std_mps, priors.slow_wind_s, strict=True)
    )
    return np.asarray(slow), priors.gust_std_mps**2 * np.exp(-lag_s / priors.gust_s)
