"""The posterior Cramer-Rao bound of the wind's 10 s mean, for the simulated truth.

Tichavsky, Muravchik, Nehorai, IEEE Trans. Signal Processing 46(5), 1998: the Fisher information of
the state given all data so far follows a recursion; with linear state dynamics of known noise and a
nonlinear measurement it is, by the matrix inversion lemma (their eq. 34),
    J(k+1) = (Q + F J(k)^-1 F')^-1 + E[H' R^-1 H],
the expectation over flights of H at the TRUE state. No filter and none of the companion's equations
enter: H is differentiated numerically from the truth's own drag.

The model for which it is a bound: the mean wind is unknown (std 8 m/s an axis) and walks, or ramps
besides for 10 s at a known time by an unknown vector; gusts are MIL-F-8785C's filters along and
across the mean wind, of known intensity, scale and direction; each drag coefficient set is known to
a common and an own factor; tilt carries a wandering bias and white noise, heading a constant one;
velocity is sampled at 10 Hz with white noise. Thrust comes from the vertical balance, which
vertical gusts disturb. What helps an estimator and is given to it for nothing: the velocity's
latency, the heading's and the vertical velocity's noise, the time of the ramp. So no causal
estimator in this world does better, on average over flights; one that reaches the bound may not
exist.
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
    mean_walk_m2ps3,
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
_LATERAL = np.array([[0.5, 0.25], [0.25, 0.25]])  # stationary spread of the lateral filter's states
_LATERAL_OUT = np.array([_ROOT3, 1.0 - _ROOT3])

# Where a state stands: mean wind (along, across), its rate, the gusts' filters (one along, two
# across, two down), velocity noise now and before (2 each), trims, log drag factors, heading bias;
# then the wind at the last 50 samples, newest first, along and across in turn.
MEAN, RATE, ALONG, ACROSS, DOWN, NOW, BEFORE, TRIM, GAIN, HEADING = 0, 2, 4, 5, 7, 9, 11, 13, 15, 17
PAST = 18
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
        gusts = _gusts(flights, k)
        cov = _moved(cov, flights[0].params, gusts, float(t_s[k]))
        information = np.mean(
            [_information(f, k, d, gusts) for f, d in zip(flights, directions, strict=True)], axis=0
        )
        cov = _corrected(cov, information)
        rmse[k] = math.sqrt(_mean_variance(cov, flights[0].params, gusts))
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
    for at in (ACROSS, DOWN):
        cov[at : at + 2, at : at + 2] = _LATERAL
    common, own = DRAG_STD_FRAC**2, AXIS_STD_FRAC**2
    cov[GAIN : GAIN + 2, GAIN : GAIN + 2] = [[common + own, common], [common, common + own]]
    return cov


@dataclass(frozen=True, slots=True)
class _Gusts:
    """Intensity (m/s) and memory (s) of the gusts, level and vertical, and the walk of the mean."""

    level_mps: float
    down_mps: float
    level_s: float
    down_s: float
    mean_walk_m2ps3: float


def _gusts(flights: Sequence[EnvelopeFlight], k: int) -> _Gusts:
    """Over the flights."""
    found = []
    for flight in flights:
        so = flight.samples[k].truth
        height, wind = -so.pos_ned_m[2], float(np.linalg.norm(flight.mean_wind_ne_mps[k]))
        speed = max(_airspeed(flight.samples[k]), _LEAST_SPEED_MPS)
        level_m, down_m = dryden_scales_m(height)
        walk = mean_walk_m2ps3(flight.condition.wind_mps)
        found.append([*dryden_intensities_mps(height, wind), level_m / speed, down_m / speed, walk])
    return _Gusts(*np.mean(found, axis=0).tolist())


def _airspeed(sample: Sample) -> float:
    so = sample.truth
    return math.dist(so.vel_ned_mps, so.wind_to_ned_mps)


def _transition(params: AirframeTruth, gusts: _Gusts, *, ramping: bool) -> tuple[Floats, Floats]:
    """F and Q of the states before PAST over one sample."""
    sensors = params.sensors
    f, q = np.eye(PAST), np.zeros((PAST, PAST))
    for axis in (0, 1):
        q[MEAN + axis, MEAN + axis] = gusts.mean_walk_m2ps3 * SAMPLE_S
    if ramping:
        f[MEAN, RATE] = f[MEAN + 1, RATE + 1] = SAMPLE_S
    f[ALONG, ALONG] = math.exp(-SAMPLE_S / gusts.level_s)
    q[ALONG, ALONG] = 1.0 - f[ALONG, ALONG] ** 2
    # x1 = noise through 1 / (1 + tau s), x2 = x1 through the same; stationary S, so Q = S - F S F'
    for at, memory_s in ((ACROSS, gusts.level_s), (DOWN, gusts.down_s)):
        phase = SAMPLE_S / memory_s
        keep = math.exp(-phase)
        move = np.array([[keep, 0.0], [keep * phase, keep]])
        f[at : at + 2, at : at + 2] = move
        q[at : at + 2, at : at + 2] = _LATERAL - move @ _LATERAL @ move.T
    trim_keep = math.exp(-SAMPLE_S / sensors.tilt_bias_time_s)
    for axis in (0, 1):  # noise of this sample is new, that of the one before is remembered
        f[NOW + axis, NOW + axis] = 0.0
        f[BEFORE + axis, BEFORE + axis] = 0.0
        f[BEFORE + axis, NOW + axis] = 1.0
        q[NOW + axis, NOW + axis] = sensors.gnss_velocity_noise_mps**2
        f[TRIM + axis, TRIM + axis] = trim_keep
        q[TRIM + axis, TRIM + axis] = math.radians(sensors.tilt_bias_deg) ** 2 * (1 - trim_keep**2)
    return f, q


def _moved(cov: Floats, params: AirframeTruth, gusts: _Gusts, t_s: float) -> Floats:
    ramping = WIND_STEP_AT_S < t_s <= WIND_STEP_AT_S + WIND_STEP_LASTS_S + 1e-6
    f, q = _transition(params, gusts, ramping=ramping)
    wind = _wind_rows(gusts)[:2]
    whole = np.zeros((SIZE, SIZE))
    whole[:PAST, :PAST] = f
    whole[PAST : PAST + 2, :PAST] = wind @ f
    whole[PAST + 2 :, PAST:-2] = np.eye(SIZE - PAST - 2)
    lift = np.zeros((SIZE, PAST))
    lift[:PAST] = np.eye(PAST)
    lift[PAST : PAST + 2] = wind
    return whole @ cov @ whole.T + lift @ q @ lift.T


def _wind_rows(gusts: _Gusts) -> Floats:
    """The wind at the vehicle, along, across and down, as a function of the states before PAST."""
    rows = np.zeros((3, PAST))
    rows[0, MEAN] = rows[1, MEAN + 1] = 1.0
    rows[0, ALONG] = gusts.level_mps
    rows[1, ACROSS : ACROSS + 2] = gusts.level_mps * _LATERAL_OUT
    rows[2, DOWN : DOWN + 2] = gusts.down_mps * _LATERAL_OUT
    return rows


def _information(flight: EnvelopeFlight, k: int, to_wind: Floats, gusts: _Gusts) -> Floats:
    """H' R^-1 H of the horizontal acceleration that tilt does not explain, at the true state.

    That acceleration is the difference of two velocities less the thrust's, whose size the vertical
    balance gives; so what drag does to that balance is in it, too.
    """
    sample = flight.samples[k]
    so, params = sample.truth, flight.params
    mass = params.empty_mass_kg
    axes = _body_axes(sample)
    lean = axes[2, :2] / axes[2, 2]  # horizontal over vertical thrust

    def unexplained(shift_ned: Floats, factors: tuple[float, float]) -> Floats:
        force = _drag_n(sample, params, axes, shift_ned, factors)
        return (force[:2] - lean * force[2]) / mass

    still = np.zeros(3)
    slope = np.stack(
        [
            (unexplained(shift, (1.0, 1.0)) - unexplained(-shift, (1.0, 1.0))) / 2e-4
            for shift in 1e-4 * np.eye(3)
        ],
        axis=1,
    )
    turn = np.eye(3)
    turn[:2, :2] = to_wind.T
    forward = np.array([math.cos(so.yaw_rad), math.sin(so.yaw_rad)])
    right = np.array([-forward[1], forward[0]])
    lift = _GRAVITY_MPS2
    h = np.zeros((2, PAST))  # in north and east
    h += -slope @ turn @ _wind_rows(gusts)
    h[:, NOW : NOW + 2] = to_wind.T / SAMPLE_S
    h[:, BEFORE : BEFORE + 2] = -to_wind.T / SAMPLE_S
    h[:, TRIM], h[:, TRIM + 1] = lift * forward, lift * right
    for axis, (up, down) in enumerate(
        (((1.0001, 1.0), (0.9999, 1.0)), ((1.0, 1.0001), (1.0, 0.9999)))
    ):
        h[:, GAIN + axis] = (unexplained(still, up) - unexplained(still, down)) / 2e-4
    h[:, HEADING] = lift * np.array([-lean[1], lean[0]])
    noise = (lift * math.radians(params.sensors.tilt_noise_deg)) ** 2
    return h.T @ h / noise


def _body_axes(sample: Sample) -> Floats:
    """Forward, right and down of the body in NED, as rows."""
    so = sample.truth
    sr, cr = math.sin(so.roll_rad), math.cos(so.roll_rad)
    sp, cp = math.sin(so.pitch_rad), math.cos(so.pitch_rad)
    sy, cy = math.sin(so.yaw_rad), math.cos(so.yaw_rad)
    return np.array(
        [
            [cp * cy, cp * sy, -sp],
            [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
            [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
        ]
    )


def _drag_n(
    sample: Sample,
    params: AirframeTruth,
    axes: Floats,
    shift_ned: Floats,
    factors: tuple[float, float],
) -> Floats:
    """The truth's drag force in NED (N) with the air velocity shifted: rotor drag linear along body
    axes and growing with the root of thrust, parasite drag square (truth.airframe)."""
    so, drag = sample.truth, params.drag
    body = axes @ (np.array(so.vel_ned_mps) - np.array(so.wind_to_ned_mps) + shift_ned)
    rotor = math.sqrt(max(sample.thrust_n, 0.0) / (params.empty_mass_kg * _GRAVITY_MPS2))
    linear = rotor * np.array([drag.rotor_forward_nspm, drag.rotor_sideways_nspm, 0.0])
    areas = [drag.parasite_forward_m2, drag.parasite_sideways_m2, drag.parasite_vertical_m2]
    pressure = 0.5 * _DENSITY_KGPM3 * float(np.linalg.norm(body))
    force = -(linear + pressure * np.array(areas)) * body * np.array([*factors, 1.0])
    return axes.T @ force


def _corrected(cov: Floats, information: Floats) -> Floats:
    """(P^-1 + I)^-1, where I is known of the states before PAST only."""
    values, vectors = np.linalg.eigh(information)
    kept = values > 1e-12 * max(float(values[-1]), 1e-300)
    rows = np.sqrt(values[kept])[:, None] * vectors[:, kept].T  # I = rows' rows
    gain = cov[:, :PAST] @ rows.T
    s = rows @ gain[:PAST] + np.eye(len(rows))
    moved = cov - gain @ np.linalg.solve(s, gain.T)
    return 0.5 * (moved + moved.T)


def _mean_variance(cov: Floats, params: AirframeTruth, gusts: _Gusts) -> float:
    """Variance, both axes together, of the mean over the 5 s past and the 5 s to come."""
    f, q = _transition(params, gusts, ramping=False)
    wind = _wind_rows(gusts)[:2]
    rows = np.zeros((2, SIZE))
    rows[0, PAST::2] = rows[1, PAST + 1 :: 2] = 1.0
    to_come = np.zeros((2, 2))
    later = wind  # what a noise adds to the sum of winds after it, the last noise first
    for _ in range(HALF_WINDOW):
        to_come += later @ q @ later.T
        later = wind + later @ f
    rows[:, :PAST] = later - wind
    size = 2 * HALF_WINDOW
    return float(np.trace(rows @ cov @ rows.T + to_come)) / size**2
