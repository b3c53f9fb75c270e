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
from typing import NamedTuple

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
    belief = _Belief(0.0, 0.0, p.initial_std_mps**2, 0.0, p.initial_std_mps**2)
    means, covs = np.empty((len(t_s), 2)), np.empty((len(t_s), 2, 2))
    due = 0.0
    for i in range(len(t_s)):
        dt_s = float(t_s[i] - t_s[i - 1]) if i else 0.0
        if airborne[i]:
            axes = _body_axes(attitude_rad[i])
            force = axes @ (accel[i] - np.array([0.0, 0.0, _GRAVITY_MPS2]))
            air = axes @ velocity_ned_mps[i]
            due += p.fusions_per_s * dt_s
            times = round(due)
            due -= times
            nsd = p.wind_nsd_mps2_rthz * (1.0 + p.nsd_per_climb * abs(velocity_ned_mps[i, 2]))
            flow = _Flow(axes[:, :2].tolist(), air.tolist(), force.tolist(), density_kgpm3)
            belief = _fused(belief, flow, times, nsd**2 / p.fusions_per_s, p)
        means[i] = belief.north, belief.east
        covs[i] = (belief.nn, belief.ne), (belief.ne, belief.ee)
    return means, covs


class _Belief(NamedTuple):
    """Wind to north and east, and its covariance."""

    north: float
    east: float
    nn: float
    ne: float
    ee: float


class _Flow(NamedTuple):
    """Of one row: north and east in body axes (3, 2), velocity over ground and specific force along
    them, the air's density."""

    axes: list[list[float]]
    velocity: list[float]
    force: list[float]
    density_kgpm3: float


def _fused(
    belief: _Belief, flow: _Flow, times: int, walk_m2ps2: float, p: DragFusionParams
) -> _Belief:
    """So many times a prediction and a correction by either axis.

    Written out in scalars: with matrices it takes ten times as long.
    """
    north, east, nn, ne, ee = belief
    momentum = p.mcoef_hz * math.sqrt(flow.density_kgpm3 / _SEA_LEVEL_KGPM3)
    (fn, fe), (rn, re), (dn, de) = flow.axes
    vel_f, vel_r, vel_d = flow.velocity
    forces = flow.force
    bluffs = [
        0.5 * flow.density_kgpm3 / bcoef
        for bcoef in (p.bcoef_kgpm2, p.bcoef_right_kgpm2 or p.bcoef_kgpm2)
    ]
    least_m2ps2, most, gate = p.least_std_mps**2, p.initial_std_mps**2, p.gate_sigmas**2
    for _ in range(times):
        if nn + ee < most:
            nn, ee = nn + walk_m2ps2, ee + walk_m2ps2
        for axis in (0, 1):
            bluff = bluffs[axis]
            air_f = vel_f - fn * north - fe * east
            air_r = vel_r - rn * north - re * east
            air_d = vel_d - dn * north - de * east
            along, an, ae = (air_r, rn, re) if axis else (air_f, fn, fe)
            speed = max(math.hypot(air_f, air_r, air_d), 1e-6)
            # d(air)/d(wind) = -axes; d|air| = air . d(air) / |air|
            slope, turned = bluff * speed + momentum, bluff * along / speed
            row_n = slope * an + turned * (air_f * fn + air_r * rn + air_d * dn)
            row_e = slope * ae + turned * (air_f * fe + air_r * re + air_d * de)
            gain_n, gain_e = nn * row_n + ne * row_e, ne * row_n + ee * row_e
            variance = row_n * gain_n + row_e * gain_e + p.drag_noise_m2ps4
            innovation = forces[axis] + slope * along
            if innovation**2 > gate * variance:
                continue
            nn = max(nn - gain_n * gain_n / variance, least_m2ps2)
            ee = max(ee - gain_e * gain_e / variance, least_m2ps2)
            ne -= gain_n * gain_e / variance
            north += gain_n * innovation / variance
            east += gain_e * innovation / variance
    return _Belief(north, east, nn, ne, ee)


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
