"""PX4's and ArduPilot's wind estimate from a multirotor's drag, as a benchmark.

Written from PX4's published equations (EKF2, multirotor drag fusion; parameters EKF2_BCOEF_X/Y,
EKF2_MCOEF, EKF2_DRAG_NOISE, EKF2_WIND_NSD with their defaults at 1.16): along each body axis the
specific force is predicted as
    a = -rho/2 v |v| / BCOEF - MCOEF sqrt(rho / rho_0) v,
and a filter with the wind as a random walk is corrected by either axis in turn, with a gate of five
sigma. Attitude and ground velocity are assumed known, accelerometer biases zero: the log has no
accelerometer, so specific force is the velocity's derivative minus gravity.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from companion.analysis.replay.replayed_wind import FilteredWind
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.observation import WindObservation

_GRAVITY_MPS2 = 9.80665
_STANDARD_DENSITY_KGPM3 = 1.225
_GATE_SIGMAS = 5.0
_NSD_PER_CLIMB = 0.5
"""Increase of the wind's noise density per m/s of vertical speed."""

ARDUPILOT_STEP_S = 0.01
ARDUPILOT_WIND_NOISE_MPS2 = 0.2
"""EK3_WIND_P_NSE of ArduCopter: the variance grows by (noise x step)^2 per 10 ms step."""


@dataclass(frozen=True)
class DragFusionParams:
    """PX4's parameters and defaults. `fusions_per_s`: rate of drag fusion in PX4; rows of a slower
    log are fused several times, of a faster one not every row is fused. `least_std_mps`: lower
    limit of the wind std.
    """

    bcoef_forward_kgpm2: float = 100.0
    bcoef_right_kgpm2: float = 100.0
    mcoef_hz: float = 0.15
    drag_noise_m2ps4: float = 2.5
    wind_nsd_mps2_rthz: float = 0.05
    initial_std_mps: float = 1.0
    fusions_per_s: float = 50.0
    least_std_mps: float = 0.0


def px4_drag_params_from_airframe(airframe: Airframe) -> DragFusionParams:
    """Return PX4's coefficients from the airframe's drag: EKF2_BCOEF_X, _Y and EKF2_MCOEF."""
    drag, mass_kg = airframe.drag, airframe.mass.empty_kg
    forward, right = (
        0.5 * REFERENCE_DENSITY_KGPM3 * mass_kg / max(one, 1e-4)
        for one in (drag.quadratic_forward_n_per_mps2, drag.quadratic_right_n_per_mps2)
    )
    momentum = 0.5 * (drag.linear_forward_n_per_mps + drag.linear_right_n_per_mps) / mass_kg
    return DragFusionParams(forward, right, momentum)


def ardupilot_drag_params_from_airframe(airframe: Airframe) -> DragFusionParams:
    """Return the parameters with ArduPilot's noises: EK3_DRAG_M_NSE 0.5 m/s2, samples at 5 Hz."""
    return replace(
        px4_drag_params_from_airframe(airframe),
        drag_noise_m2ps4=0.5**2,
        wind_nsd_mps2_rthz=ARDUPILOT_WIND_NOISE_MPS2 * math.sqrt(ARDUPILOT_STEP_S),
        initial_std_mps=20.0,
        fusions_per_s=5.0,
        least_std_mps=0.5,
    )


def replay_drag_fusion(
    observations: Sequence[WindObservation], params: DragFusionParams
) -> FilteredWind:
    """Return the estimate at each row, from rows with velocity and attitude, held in between."""
    rows = [
        i
        for i, s in enumerate(observations)
        if s.vel_ned_mps is not None and None not in (s.roll_rad, s.pitch_rad, s.yaw_rad)
    ]
    seen = [observations[i] for i in rows]
    t_s, velocity = np.array([s.t_s for s in seen]), np.array([s.vel_ned_mps for s in seen])
    yaw_pitch_roll = np.array([(s.yaw_rad, s.pitch_rad, s.roll_rad) for s in seen], float)
    axes = Rotation.from_euler("ZYX", yaw_pitch_roll).inv().as_matrix()  # NED to body
    specific_force = np.gradient(velocity, t_s, axis=0) - np.array([0.0, 0.0, _GRAVITY_MPS2])
    estimate = 0.0, 0.0, params.initial_std_mps**2, 0.0, params.initial_std_mps**2
    mean, cov = np.empty((len(seen), 2)), np.empty((len(seen), 2, 2))
    fusions_due = 0.0
    for i, observation in enumerate(seen):
        if observation.airborne:
            fusions_due += params.fusions_per_s * (float(t_s[i] - t_s[i - 1]) if i else 0.0)
            count = round(fusions_due)
            fusions_due -= count
            nsd = params.wind_nsd_mps2_rthz * (1.0 + _NSD_PER_CLIMB * abs(velocity[i, 2]))
            estimate = _predict_and_correct_repeatedly(
                estimate,
                count,
                axes[i, :, :2].tolist(),
                (axes[i] @ velocity[i]).tolist(),
                (axes[i] @ specific_force[i]).tolist(),
                seen[0].density_kgpm3,
                nsd**2 / params.fusions_per_s,
                params,
            )
        north, east, nn, ne, ee = estimate
        mean[i], cov[i] = (north, east), ((nn, ne), (ne, ee))
    at = np.clip(np.searchsorted(rows, np.arange(len(observations)), side="right") - 1, 0, None)
    return FilteredWind(mean[at], cov[at])


WindEstimate = tuple[float, float, float, float, float]
"""Wind to north and east, and its covariance: north, mixed, east."""


def _predict_and_correct_repeatedly(
    estimate: WindEstimate,
    count: int,
    axes: list[list[float]],
    velocity_mps: list[float],
    specific_force_mps2: list[float],
    density_kgpm3: float,
    process_noise_m2ps2: float,
    params: DragFusionParams,
) -> WindEstimate:
    """Run `count` predictions, each with a correction by both axes.

    `axes`: north and east in body axes (3, 2). Scalar code, since matrices are ten times slower.
    """
    north, east, nn, ne, ee = estimate
    momentum = params.mcoef_hz * math.sqrt(density_kgpm3 / _STANDARD_DENSITY_KGPM3)
    (fn, fe), (rn, re), (dn, de) = axes
    vel_f, vel_r, vel_d = velocity_mps
    bluffs = [
        0.5 * density_kgpm3 / bcoef
        for bcoef in (params.bcoef_forward_kgpm2, params.bcoef_right_kgpm2)
    ]
    least_m2ps2, most_m2ps2 = params.least_std_mps**2, params.initial_std_mps**2
    for _ in range(count):
        if nn + ee < most_m2ps2:
            nn, ee = nn + process_noise_m2ps2, ee + process_noise_m2ps2
        for axis in (0, 1):
            bluff = bluffs[axis]
            air_f = vel_f - fn * north - fe * east
            air_r = vel_r - rn * north - re * east
            air_d = vel_d - dn * north - de * east
            axis_airspeed, an, ae = (air_r, rn, re) if axis else (air_f, fn, fe)
            speed = max(math.hypot(air_f, air_r, air_d), 1e-6)
            # d(air)/d(wind) = -axes; d|air| = air . d(air) / |air|
            slope, cross_slope = bluff * speed + momentum, bluff * axis_airspeed / speed
            row_n = slope * an + cross_slope * (air_f * fn + air_r * rn + air_d * dn)
            row_e = slope * ae + cross_slope * (air_f * fe + air_r * re + air_d * de)
            gain_n, gain_e = nn * row_n + ne * row_e, ne * row_n + ee * row_e
            variance = row_n * gain_n + row_e * gain_e + params.drag_noise_m2ps4
            innovation = specific_force_mps2[axis] + slope * axis_airspeed
            if innovation**2 > _GATE_SIGMAS**2 * variance:
                continue
            nn = max(nn - gain_n * gain_n / variance, least_m2ps2)
            ee = max(ee - gain_e * gain_e / variance, least_m2ps2)
            ne -= gain_n * gain_e / variance
            north += gain_n * innovation / variance
            east += gain_e * innovation / variance
    return north, east, nn, ne, ee
