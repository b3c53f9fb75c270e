"""The posterior Cramer-Rao bound of the wind's 10 s mean, for the simulated truth.

Tichavsky, Muravchik, Nehorai, IEEE Trans. Signal Processing 46(5), 1998: the Fisher information of
the state given all data so far follows a recursion; with linear state dynamics of known noise and a
nonlinear measurement it is, by the matrix inversion lemma (their eq. 34),
    J(k+1) = (Q + F J(k)^-1 F')^-1 + E[H' R^-1 H],
the expectation over flights of H at the TRUE state. No filter and none of the companion's equations
enter: H is differentiated numerically from the truth's own drag.

The model for which it is a bound: the mean wind is unknown (std 8 m/s an axis) and steady, or ramps
for 10 s at a known time by an unknown vector; gusts are MIL-F-8785C's filters along and across the
mean wind, of known intensity, scale and direction; each drag coefficient set is known to a common and
an own factor; tilt carries a wandering bias and white noise, heading a constant one; velocity is
sampled at 10 Hz with white noise. What helps an estimator and is given to it for nothing: thrust and
vertical wind, the velocity's latency, the heading's noise, the time of the ramp. So no causal
estimator in this world does better, on average over flights; one that reaches the bound may not exist.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_bridge.experiments.envelope_flight import (
    AXIS_STD_FRAC,
    DRAG_STD_FRAC,
    SAMPLE_S,
    WIND_STEP_AT_S,
    WIND_STEP_LASTS_S,
    WIND_STEP_MPS,
    EnvelopeFlight,
    Sample,
)
from sim_bridge.truth.dryden import dryden_intensities_mps, dryden_scales_m
from sim_bridge.truth.params import AirframeTruth

Floats = NDArray[np.float64]

HALF_WINDOW = 50  # samples in 5 s
PRIOR_WIND_STD_MPS = 8.0
_GRAVITY_MPS2 = 9.80665
_DENSITY_KGPM3 = 1.2041  # the vehicle's air: sea level, 20 deg C
_LEAST_SPEED_MPS = 0.5
_ROOT3 = math.sqrt(3.0)

# Where a state stands: mean wind (along, across), its rate, the gusts' filters (one along, two
# across), velocity noise now and before (2 each), trims, log drag factors, heading bias; then the
# wind at the last 50 samples, newest first, along and across in turn.
MEAN, RATE, ALONG, ACROSS, NOW, BEFORE, TRIM, GAIN, HEADING, PAST = 0, 2, 4, 5, 7, 9, 11, 13, 15, 16
SIZE = PAST + 2 * HALF_WINDOW


@dataclass(frozen=True)
class Bound:
    """Least RMSE of the vector (m/s) at each sample of the flights."""

    t_s: Floats
    rmse_mps: Floats


def wind_bound(flights: Sequence[EnvelopeFlight]) -> Bound:
    """The bound over flights of one condition; they share their times."""
    count = min(len(flight.samples) for flight in flights)
    directions = [_direction(flight) for flight in flights]
    cov = _prior(flights[0].params)
    t_s = flights[0].t_s[:count]
    rmse = np.empty(count)
    for k in range(count):
        sigma, memory_s = _gusts(flights, k)
        cov = _moved(cov, flights[0].params, sigma, memory_s, float(t_s[k]))
        information = np.mean(
            [_information(f, k, d) for f, d in zip(flights, directions, strict=True)], axis=0
        )
        cov = _corrected(cov, information)
        rmse[k] = math.sqrt(_mean_variance(cov, flights[0].params, sigma, memory_s))
    return Bound(t_s, rmse)


def _direction(flight: EnvelopeFlight) -> Floats:
    """Rotation from north-east to along and across the wind that the flight began in."""
    north, east = flight.mean_wind_ne_mps[0]
    size = math.hypot(north, east)
    cos, sin = (north / size, east / size) if size > 0.0 else (1.0, 0.0)
    return np.array([[cos, sin], [-sin, cos]])


def _prior(params: AirframeTruth) -> Floats:
    sensors = params.sensors
    trim = math.radians(sensors.tilt_bias_deg)
    cov = np.zeros((SIZE, SIZE))
    std = np.zeros(PAST)
    std[MEAN : MEAN + 2] = PRIOR_WIND_STD_MPS
    std[RATE : RATE + 2] = WIND_STEP_MPS / WIND_STEP_LASTS_S / math.sqrt(2.0)
    std[NOW : NOW + 4] = sensors.gnss_velocity_noise_mps
    std[TRIM : TRIM + 2] = trim
    std[HEADING] = math.radians(sensors.heading_bias_deg)
    cov[:PAST, :PAST] = np.diag(std**2)
    cov[ALONG, ALONG] = 1.0
    # the lateral filter's states, one behind the other, in their stationary spread
    cov[ACROSS : ACROSS + 2, ACROSS : ACROSS + 2] = [[0.5, 0.25], [0.25, 0.25]]
    common, own = DRAG_STD_FRAC**2, AXIS_STD_FRAC**2
    cov[GAIN : GAIN + 2, GAIN : GAIN + 2] = [[common + own, common], [common, common + own]]
    return cov


def _gusts(flights: Sequence[EnvelopeFlight], k: int) -> tuple[float, float]:
    """Gust intensity (m/s) and memory (s) at sample k, over the flights."""
    sigma, memory = [], []
    for flight in flights:
        so = flight.samples[k].truth
        height = -so.pos_ned_m[2]
        sigma.append(
            dryden_intensities_mps(height, float(np.linalg.norm(flight.mean_wind_ne_mps[k])))[0]
        )
        memory.append(dryden_scales_m(height)[0] / max(_airspeed(flight.samples[k]), _LEAST_SPEED_MPS))
    return float(np.mean(sigma)), float(np.mean(memory))


def _airspeed(sample: Sample) -> float:
    so = sample.truth
    return math.dist(so.vel_ned_mps, so.wind_to_ned_mps)


def _transition(memory_s: float, trim_time_s: float, ramping: bool) -> tuple[Floats, Floats]:
    """F and Q of the states before PAST over one sample."""
    keep = math.exp(-SAMPLE_S / memory_s)
    phase = SAMPLE_S / memory_s
    f, q = np.eye(PAST), np.zeros((PAST, PAST))
    if ramping:
        f[MEAN, RATE] = f[MEAN + 1, RATE + 1] = SAMPLE_S
    f[ALONG, ALONG] = keep
    q[ALONG, ALONG] = 1.0 - keep**2
    # x1 = noise through 1 / (1 + tau s), x2 = x1 through the same; stationary S, so Q = S - F S F'
    block = slice(ACROSS, ACROSS + 2)
    f[block, block] = [[keep, 0.0], [keep * phase, keep]]
    spread = np.array([[0.5, 0.25], [0.25, 0.25]])
    q[block, block] = spread - f[block, block] @ spread @ f[block, block].T
    trim_keep = math.exp(-SAMPLE_S / trim_time_s)
    f[TRIM, TRIM] = f[TRIM + 1, TRIM + 1] = trim_keep
    for axis in (0, 1):  # noise of this sample is new, that of the one before is remembered
        f[NOW + axis, NOW + axis] = 0.0
        f[BEFORE + axis, BEFORE + axis] = 0.0
        f[BEFORE + axis, NOW + axis] = 1.0
    return f, q


def _moved(cov: Floats, params: AirframeTruth, sigma: float, memory_s: float, t_s: float) -> Floats:
    sensors = params.sensors
    ramping = WIND_STEP_AT_S < t_s <= WIND_STEP_AT_S + WIND_STEP_LASTS_S + 1e-6
    f, q = _transition(memory_s, sensors.tilt_bias_time_s, ramping)
    trim_keep = f[TRIM, TRIM]
    bias = math.radians(sensors.tilt_bias_deg) ** 2 * (1.0 - trim_keep**2)
    for axis in (0, 1):
        q[NOW + axis, NOW + axis] = sensors.gnss_velocity_noise_mps**2
        q[TRIM + axis, TRIM + axis] = bias
    whole = np.zeros((SIZE, SIZE))
    whole[:PAST, :PAST] = f
    whole[PAST : PAST + 2, :PAST] = _wind_rows(sigma) @ f
    whole[PAST + 2 :, PAST:-2] = np.eye(SIZE - PAST - 2)
    lift = np.zeros((SIZE, PAST))
    lift[:PAST] = np.eye(PAST)
    lift[PAST : PAST + 2] = _wind_rows(sigma)
    return whole @ cov @ whole.T + lift @ q @ lift.T


def _wind_rows(sigma: float) -> Floats:
    """The wind at the vehicle, along and across, as a function of the states before PAST."""
    rows = np.zeros((2, PAST))
    rows[0, MEAN] = rows[1, MEAN + 1] = 1.0
    rows[0, ALONG] = sigma
    rows[1, ACROSS : ACROSS + 2] = sigma * _ROOT3, sigma * (1.0 - _ROOT3)
    return rows


def _information(flight: EnvelopeFlight, k: int, to_wind: Floats) -> Floats:
    """H' R^-1 H of the horizontal acceleration that tilt does not explain, at the true state.

    That acceleration is measured as the difference of two velocities less the thrust's.
    """
    sample = flight.samples[k]
    so, params = sample.truth, flight.params
    mass = params.empty_mass_kg
    slope = np.empty((2, 2))
    for axis in (0, 1):
        shift = np.zeros(3)
        shift[axis] = 1e-4
        slope[:, axis] = (_drag(sample, params, shift) - _drag(sample, params, -shift)) / 2e-4
    forward = np.array([math.cos(so.yaw_rad), math.sin(so.yaw_rad)])
    right = np.array([-forward[1], forward[0]])
    drag = _drag(sample, params, np.zeros(3)) / mass
    pull = sample.thrust_n / mass * math.cos(so.roll_rad) * math.cos(so.pitch_rad)
    across = np.array([[0.0, -1.0], [1.0, 0.0]]) @ _thrust_h(sample) / mass
    h = np.zeros((2, PAST))  # in north and east
    on_wind = -slope / mass @ to_wind.T  # the wind's columns are along and across
    sigma = dryden_intensities_mps(
        -so.pos_ned_m[2], float(np.linalg.norm(flight.mean_wind_ne_mps[k]))
    )[0]
    h[:, :PAST] = on_wind @ _wind_rows(sigma)
    h[:, NOW : NOW + 2] = to_wind.T / SAMPLE_S
    h[:, BEFORE : BEFORE + 2] = -to_wind.T / SAMPLE_S
    h[:, TRIM], h[:, TRIM + 1] = pull * forward, pull * right
    h[:, GAIN] = forward * float(forward @ drag)
    h[:, GAIN + 1] = right * float(right @ drag)
    h[:, HEADING] = across
    noise = (pull * math.radians(params.sensors.tilt_noise_deg)) ** 2
    return h.T @ h / noise


def _thrust_h(sample: Sample) -> Floats:
    so = sample.truth
    sr, cr = math.sin(so.roll_rad), math.cos(so.roll_rad)
    sp, cp = math.sin(so.pitch_rad), math.cos(so.pitch_rad)
    sy, cy = math.sin(so.yaw_rad), math.cos(so.yaw_rad)
    return -sample.thrust_n * np.array([cr * sp * cy + sr * sy, cr * sp * sy - sr * cy])


def _drag(sample: Sample, params: AirframeTruth, shift: Floats) -> Floats:
    """The truth's drag force to north and east (N) with the air velocity shifted: rotor drag linear
    along body axes and growing with the root of thrust, parasite drag square (truth.airframe)."""
    so = sample.truth
    air = np.array(so.vel_ned_mps) - np.array(so.wind_to_ned_mps) + shift
    sr, cr = math.sin(so.roll_rad), math.cos(so.roll_rad)
    sp, cp = math.sin(so.pitch_rad), math.cos(so.pitch_rad)
    sy, cy = math.sin(so.yaw_rad), math.cos(so.yaw_rad)
    axes = np.array(
        [
            [cp * cy, cp * sy, -sp],
            [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
            [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
        ]
    )
    body = axes @ air
    speed = float(np.linalg.norm(air))
    drag = params.drag
    rotor = math.sqrt(max(sample.thrust_n, 0.0) / (params.empty_mass_kg * _GRAVITY_MPS2))
    linear = rotor * np.array([drag.rotor_forward_nspm, drag.rotor_sideways_nspm, 0.0])
    areas = [drag.parasite_forward_m2, drag.parasite_sideways_m2, drag.parasite_vertical_m2]
    force = -(linear + 0.5 * _DENSITY_KGPM3 * speed * np.array(areas)) * body
    return (axes.T @ force)[:2]


def _corrected(cov: Floats, information: Floats) -> Floats:
    """(P^-1 + I)^-1, where I is known of the states before PAST only."""
    values, vectors = np.linalg.eigh(information)
    kept = values > 1e-12 * max(float(values[-1]), 1e-300)
    rows = np.sqrt(values[kept])[:, None] * vectors[:, kept].T  # I = rows' rows
    gain = cov[:, :PAST] @ rows.T
    s = rows @ gain[:PAST] + np.eye(len(rows))
    moved = cov - gain @ np.linalg.solve(s, gain.T)
    return 0.5 * (moved + moved.T)


def _mean_variance(cov: Floats, params: AirframeTruth, sigma: float, memory_s: float) -> float:
    """Variance, both axes together, of the mean over the 5 s past and the 5 s to come."""
    f, q = _transition(memory_s, params.sensors.tilt_bias_time_s, ramping=False)
    wind = _wind_rows(sigma)
    ahead = np.zeros((2, PAST))
    power = np.eye(PAST)
    powers = []
    for _ in range(HALF_WINDOW):
        power = f @ power
        powers.append(power)
        ahead += wind @ power
    rows = np.zeros((2, SIZE))
    rows[:, :PAST] = ahead
    rows[0, PAST::2] = rows[1, PAST + 1 :: 2] = 1.0
    rows /= 2 * HALF_WINDOW
    to_come = np.zeros((2, 2))
    left = wind.copy()  # what noise of the last step adds, then of the one before, ...
    for power in powers:
        to_come += left @ q @ left.T
        left = left + wind @ power
    to_come /= (2 * HALF_WINDOW) ** 2
    return float(np.trace(rows @ cov @ rows.T + to_come))
