"""PX4's wind estimate from a multirotor's drag, as a benchmark.

Written from PX4's published equations (EKF2, multirotor drag fusion; parameters EKF2_BCOEF_X/Y,
EKF2_MCOEF, EKF2_DRAG_NOISE, EKF2_WIND_NSD with their defaults at 1.16): along each body axis the
specific force is predicted as
    a = -rho/2 v |v| / BCOEF - MCOEF sqrt(rho / rho_0) v,
and a filter with the wind as a random walk is corrected by either axis in turn, with a gate of five
sigma. Attitude and ground velocity are taken as known, accelerometer biases as none: the log has no
accelerometer, so specific force is the velocity's derivative less gravity.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats

_GRAVITY_MPS2 = 9.80665
_SEA_LEVEL_KGPM3 = 1.225


@dataclass(frozen=True)
class DragFusionParams:
    """PX4's defaults. `fusions_per_s` is how often it takes a sample of its own: a row of a slower
    log counts as several samples, of a faster one not every row is a sample.
    `bcoef_right_kgpm2`: `None` is as forward. The wind's variance stays above `least_std_mps`.
    """

    bcoef_kgpm2: float = 100.0
    bcoef_right_kgpm2: float | None = None
    mcoef_hz: float = 0.15
    drag_noise_m2ps4: float = 2.5
    wind_nsd_mps2_rthz: float = 0.05
    nsd_per_climb: float = 0.5
    initial_std_mps: float = 1.0
    gate_sigmas: float = 5.0
    fusions_per_s: float = 50.0
    least_std_mps: float = 0.0


def drag_fusion(
    t_s: Floats,
    velocity_ned_mps: Floats,
    attitude_rad: Floats,
    airborne: NDArray[np.bool_],
    density_kgpm3: float,
    params: DragFusionParams | None = None,
) -> tuple[Floats, Floats]:
    """Wind to north and east (n, 2) and its covariance (n, 2, 2) at each row.

    `attitude_rad` is roll, pitch, yaw.
    """
    p = params or DragFusionParams()
    accel = np.gradient(velocity_ned_mps, t_s, axis=0)
    wind, cov = np.zeros(2), p.initial_std_mps**2 * np.eye(2)
    means, covs = np.empty((len(t_s), 2)), np.empty((len(t_s), 2, 2))
    due = 0.0
    for i in range(len(t_s)):
        dt_s = float(t_s[i] - t_s[i - 1]) if i else 0.0
        if airborne[i]:
            axes = _body_axes(attitude_rad[i])
            force = axes @ (accel[i] - np.array([0.0, 0.0, _GRAVITY_MPS2]))
            due += p.fusions_per_s * dt_s
            times = round(due)
            due -= times
            nsd = p.wind_nsd_mps2_rthz * (1.0 + p.nsd_per_climb * abs(velocity_ned_mps[i, 2]))
            for _ in range(times):
                if np.trace(cov) < p.initial_std_mps**2:
                    cov = cov + nsd**2 / p.fusions_per_s * np.eye(2)
                for axis in (0, 1):
                    wind, cov = _fused(
                        wind, cov, axes, velocity_ned_mps[i], force, axis, density_kgpm3, p
                    )
        means[i], covs[i] = wind, cov
    return means, covs


def _fused(
    wind: Floats,
    cov: Floats,
    axes: Floats,
    velocity: Floats,
    force: Floats,
    axis: int,
    density_kgpm3: float,
    p: DragFusionParams,
) -> tuple[Floats, Floats]:
    expected, row = _expected(wind, axes, velocity, axis, density_kgpm3, p)
    gain = cov @ row
    variance = float(row @ gain) + p.drag_noise_m2ps4
    innovation = float(force[axis]) - expected
    if innovation**2 > p.gate_sigmas**2 * variance:
        return wind, cov
    cov = cov - np.outer(gain, gain) / variance
    cov[np.diag_indices(2)] = np.maximum(np.diag(cov), p.least_std_mps**2)
    return wind + gain * innovation / variance, cov


def _expected(
    wind: Floats,
    axes: Floats,
    velocity: Floats,
    axis: int,
    density_kgpm3: float,
    p: DragFusionParams,
) -> tuple[float, Floats]:
    """Specific force along a body axis, and its derivative by the wind to north and east."""
    air = axes @ (velocity - np.array([wind[0], wind[1], 0.0]))
    speed = max(float(np.linalg.norm(air)), 1e-6)
    bcoef = p.bcoef_kgpm2 if axis == 0 else p.bcoef_right_kgpm2 or p.bcoef_kgpm2
    bluff = 0.5 * density_kgpm3 / bcoef
    momentum = p.mcoef_hz * math.sqrt(density_kgpm3 / _SEA_LEVEL_KGPM3)
    along = float(air[axis])
    # d(air)/d(wind) = -axes[:, :2]; d|air| = air . d(air) / |air|
    change = -(bluff * speed + momentum) * -axes[axis, :2]
    change += -bluff * along * (air @ -axes[:, :2]) / speed
    return -(bluff * speed + momentum) * along, change


def _body_axes(attitude_rad: Floats) -> Floats:
    """Forward, right and down of the body in NED, as rows."""
    sr, cr = math.sin(attitude_rad[0]), math.cos(attitude_rad[0])
    sp, cp = math.sin(attitude_rad[1]), math.cos(attitude_rad[1])
    sy, cy = math.sin(attitude_rad[2]), math.cos(attitude_rad[2])
    return np.array(
        [
            [cp * cy, cp * sy, -sp],
            [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
            [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
        ]
    )
