"""The posterior Cramer-Rao bound of the wind's centred 10 s mean, for the simulated truth.

Tichavsky, Muravchik, Nehorai, IEEE Trans. Signal Processing 46(5), 1998: the Fisher information of
the state given all data so far follows a recursion; with linear state dynamics of known noise and a
nonlinear measurement it is, by the matrix inversion lemma (their eq. 34),
    J(k+1) = (Q + F J(k)^-1 F')^-1 + E[H' R^-1 H].
No filter and none of the companion's equations enter: H is differentiated numerically from the
truth's own equation of motion.

What the expectation is over. Heading, course and speed are the vehicle's own commands: an estimator
knows them, so the bound is computed for each flight as it was flown, and the VARIANCES are averaged
over flights. Averaging the information over flights that head otherwise would be a bound, too, but
an empty one: it lets one estimator see all headings at once, which tells the tilt's bias from the
wind as nothing in one flight does (hover in calm: 0.08 m/s for 0.5 m/s). What remains inside
the expectation, H's own spread over gusts in one flight, is left at the flight's own value.

What is unknown, with the prior that the truth draws it from: the mean wind (std 8 m/s an axis),
which walks, and in a flight with a step ramps besides for 10 s by an unknown vector
(`wind_bound_step`); the gusts,
MIL-F-8785C's filters along and across the mean wind and down; a common and an own factor of
either axis's drag; the tilt's wandering bias and white noise; the heading's bias; white noise of
the velocities, 10 a second; with a pitot, its scale, its zero, and its noise. Thrust comes from the
vertical balance, which vertical gusts disturb. And the floor that an honest drag model has: it errs
by MODEL_STD_FRAC for seconds on end. The airframe file's two coefficients an axis leave as much of
the truth's own drag (0.7 % low at 5 m/s, 3 % at 18); an estimator that takes them for exact is
told a falsehood, and is worse. What helps an estimator and is given for nothing: the gusts'
spectrum, intensity and direction, how fast the mean walks, the velocity's latency, the noise of
heading and of vertical velocity. So no causal estimator in this world does better, on average over
flights; one that reaches the bound may not exist.

The error's quantity is the bound's: the mean of the wind at the vehicle over the 5 s before and the
5 s after. The past half is kept as sums of half seconds, so the bound is known every half second.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from sim_bridge.research.wind.envelope_flight import (
    AXIS_STD_FRAC,
    DRAG_STD_FRAC,
    SAMPLE_S,
    EnvelopeFlight,
    Sample,
    mean_walk_m2ps3,
)
from sim_bridge.research.wind.wind_bound_step import Steps
from sim_bridge.truth.airframe import Airframe
from sim_bridge.truth.atmosphere import GRAVITY_MPS2, air_density_kgpm3
from sim_bridge.truth.dryden import dryden_intensities_mps, dryden_scales_m
from sim_bridge.truth.params import AirframeTruth, SensorParams

HALF_WINDOW = 50  # samples in 5 s
BLOCK = 5  # samples that are kept as one sum
BLOCKS = HALF_WINDOW // BLOCK
WINDOW = 2 * HALF_WINDOW
PRIOR_WIND_STD_MPS = 8.0
MODEL_STD_FRAC = 0.01  # what params/airframes/m100.toml states of itself
MODEL_MEMORY_S = 5.0  # how long the drag model errs the same way
_DENSITY_KGPM3 = air_density_kgpm3(0.0, 20.0)  # the envelope's vehicles fly there
_LEAST_SPEED_MPS = 0.5
_ROOT3 = math.sqrt(3.0)
_LATERAL = np.array([[0.5, 0.25], [0.25, 0.25]])  # stationary spread of the lateral filter's states
_LATERAL_OUT = np.array([_ROOT3, 1.0 - _ROOT3])

# Where a state stands: mean wind (along, across), the gusts' filters (one along, two
# across, two down), velocity noise now and before (2 each), bias of pitch and roll, log drag
# factors, heading's bias, what the drag model errs by (north, east, in its standard deviation), log
# of the pitot's scale and its zero (Pa); then sums of the wind (along, across) over the running
# block and over the last ten.
MEAN, ALONG, ACROSS, DOWN, NOW, BEFORE, TRIM, GAIN, HEADING = 0, 2, 3, 5, 7, 9, 11, 13, 15
MODEL = 16
PITOT = 18
PAST = 20
SIZE = PAST + 2 * (1 + BLOCKS)


@dataclass(frozen=True)
class Bound:
    """Least mean square error of the vector (m2/s2) every half second of one flight: told whether
    and when the wind steps, and not told."""

    t_s: Floats
    told_m2ps2: Floats
    untold_m2ps2: Floats

    def between(self, first_s: float, last_s: float) -> tuple[float, float]:
        """Least mean square errors between two times, told and not told."""
        within = (self.t_s >= first_s - 1e-6) & (self.t_s <= last_s + 1e-6)
        return float(np.mean(self.told_m2ps2[within])), float(np.mean(self.untold_m2ps2[within]))


def least_errors_m2ps2(
    flights: Sequence[EnvelopeFlight], first_s: float, last_s: float, rng: np.random.Generator
) -> Floats:
    """Least mean square error of the vector in each flight (n, 2), between two times: told whether
    and when the wind steps, and not told."""
    return np.array([flight_bound(flight, rng).between(first_s, last_s) for flight in flights])


def flight_bound(flight: EnvelopeFlight, rng: np.random.Generator) -> Bound:
    """The bound in one flight, from the first whole window on. `rng` draws what an estimator that
    is told of no step may have seen."""
    truths = _Truths.of(flight.params)
    to_wind = _direction(flight)
    cov = _prior(flight.params.sensors)
    steps = Steps(flight.samples[0].truth.t_s, SIZE, rng)
    times, told, untold = [], [], []
    for k, sample in enumerate(flight.samples):
        t_s = sample.truth.t_s
        gusts = _gusts_at(flight, k)
        move, noise = _move(flight, gusts)
        cov = move @ cov @ move.T + noise
        rows = _rows(truths, sample, to_wind, gusts, pitot=flight.condition.pitot)
        gain, s = _gain(cov, rows)
        cov -= gain @ s @ gain.T
        steps.seen(t_s, move, rows, gain, s)
        if (k + 1) % BLOCK == 0:
            cov = _SHIFT @ cov @ _SHIFT.T
            steps.shifted(_SHIFT)
            if k + 1 >= HALF_WINDOW:
                window, to_come = _window(flight, gusts)
                least = float(np.trace(window @ cov @ window.T)) + to_come
                known, guessed = steps.added(t_s, window, flight.condition.wind_step)
                times.append(t_s)
                told.append(least + known)
                untold.append(least + guessed)
    return Bound(np.array(times), np.array(told), np.array(untold))


def _direction(flight: EnvelopeFlight) -> Floats:
    """Rotation from north-east to along and across the wind that the flight began in."""
    north, east = flight.mean_wind_ne_mps[0]
    size = math.hypot(north, east)
    cos, sin = (north / size, east / size) if size > 0.0 else (1.0, 0.0)
    return np.array([[cos, sin], [-sin, cos]])


def _prior(sensors: SensorParams) -> Floats:
    std = np.zeros(SIZE)
    std[MEAN : MEAN + 2] = PRIOR_WIND_STD_MPS
    std[ALONG] = 1.0
    std[NOW : NOW + 4] = sensors.gnss_velocity_noise_mps
    std[TRIM : TRIM + 2] = math.radians(sensors.tilt_bias_deg)
    std[HEADING] = math.radians(sensors.heading_bias_deg)
    std[MODEL : MODEL + 2] = 1.0
    std[PITOT : PITOT + 2] = sensors.pitot_scale_error_frac, sensors.pitot_bias_pa
    cov = np.diag(std**2)
    for at in (ACROSS, DOWN):  # the lateral filter's states, one behind the other
        cov[at : at + 2, at : at + 2] = _LATERAL
    common, own = DRAG_STD_FRAC**2, AXIS_STD_FRAC**2
    cov[GAIN : GAIN + 2, GAIN : GAIN + 2] = [[common + own, common], [common, common + own]]
    return cov


# -- how the wind and the sensors' errors move ----------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Gusts:
    """Intensity (m/s) and memory (s) of the gusts, level and vertical."""

    level_mps: float
    down_mps: float
    level_s: float
    down_s: float

    @property
    def wind_rows(self) -> Floats:
        """The wind at the vehicle, along, across and down, by the states before PAST."""
        rows = np.zeros((3, PAST))
        rows[0, MEAN] = rows[1, MEAN + 1] = 1.0
        rows[0, ALONG] = self.level_mps
        rows[1, ACROSS : ACROSS + 2] = self.level_mps * _LATERAL_OUT
        rows[2, DOWN : DOWN + 2] = self.down_mps * _LATERAL_OUT
        return rows


def _gusts_at(flight: EnvelopeFlight, k: int) -> _Gusts:
    so = flight.samples[k].truth
    height_m = -so.pos_ned_m[2]
    speed = max(math.dist(so.vel_ned_mps, so.wind_to_ned_mps), _LEAST_SPEED_MPS)
    level_m, down_m = dryden_scales_m(height_m)
    wind_mps = math.hypot(*flight.mean_wind_ne_mps[k])
    return _Gusts(*dryden_intensities_mps(height_m, wind_mps), level_m / speed, down_m / speed)


def _transition(flight: EnvelopeFlight, gusts: _Gusts) -> tuple[Floats, Floats]:
    """F and Q of the states before PAST over a sample."""
    sensors = flight.params.sensors
    f, q = np.eye(PAST), np.zeros((PAST, PAST))
    walk = mean_walk_m2ps3(flight.condition.wind_mps) * SAMPLE_S
    q[MEAN, MEAN] = q[MEAN + 1, MEAN + 1] = walk
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
    model_keep = math.exp(-SAMPLE_S / MODEL_MEMORY_S)
    for axis in (0, 1):  # noise of this sample is new, that of the one before is remembered
        f[NOW + axis, NOW + axis] = 0.0
        f[BEFORE + axis, BEFORE + axis] = 0.0
        f[BEFORE + axis, NOW + axis] = 1.0
        q[NOW + axis, NOW + axis] = sensors.gnss_velocity_noise_mps**2
        f[MODEL + axis, MODEL + axis] = model_keep
        q[MODEL + axis, MODEL + axis] = 1.0 - model_keep**2
        f[TRIM + axis, TRIM + axis] = trim_keep
        q[TRIM + axis, TRIM + axis] = math.radians(sensors.tilt_bias_deg) ** 2 * (1 - trim_keep**2)
    return f, q


def _move(flight: EnvelopeFlight, gusts: _Gusts) -> tuple[Floats, Floats]:
    """One sample on, F and Q of all states; the new wind is added to the running block."""
    f, q = _transition(flight, gusts)
    wind = gusts.wind_rows[:2]
    whole = np.eye(SIZE)
    whole[:PAST, :PAST] = f
    whole[PAST : PAST + 2, :PAST] = wind @ f
    lift = np.zeros((SIZE, PAST))
    lift[:PAST] = np.eye(PAST)
    lift[PAST : PAST + 2] = wind
    return whole, lift @ q @ lift.T


def _shift() -> Floats:
    """The running block becomes the newest of the whole ones, and begins again at 0."""
    move = np.eye(SIZE)
    move[PAST:, PAST:] = np.eye(SIZE - PAST, k=-2)
    return move


_SHIFT = _shift()


# -- what is measured ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Truths:
    """The truth's own body, as it is and with more drag along one axis."""

    params: AirframeTruth
    usual: Airframe
    more_drag: tuple[Airframe, Airframe]

    MORE = 0.01

    @classmethod
    def of(cls, params: AirframeTruth) -> "_Truths":
        drag, factor = params.drag, 1.0 + cls.MORE
        forward = msgspec.structs.replace(
            drag,
            rotor_forward_nspm=drag.rotor_forward_nspm * factor,
            parasite_forward_m2=drag.parasite_forward_m2 * factor,
        )
        right = msgspec.structs.replace(
            drag,
            rotor_sideways_nspm=drag.rotor_sideways_nspm * factor,
            parasite_sideways_m2=drag.parasite_sideways_m2 * factor,
        )
        changed = [
            Airframe(msgspec.structs.replace(params, drag=drag)) for drag in (forward, right)
        ]
        return cls(params, Airframe(params), (changed[0], changed[1]))


@dataclass(frozen=True, slots=True)
class _Shift:
    """What is otherwise than it was: wind (NED, m/s), and roll, pitch, yaw (rad)."""

    wind_ned_mps: Floats
    attitude_rad: Floats


_NOWHERE = np.zeros(3)
_DT_S = 1e-3
_SMALL = 1e-4


def _measured(body: Airframe, mass_kg: float, sample: Sample, shift: _Shift) -> Floats:
    """North and east acceleration that the REPORTED attitude and the vertical balance leave
    unexplained (m/s2), and the speed into the pitot (m/s), had the truth been shifted."""
    so = sample.truth
    lean = _lean(so.roll_rad, so.pitch_rad, so.yaw_rad)
    body.north_mps, body.east_mps, body.down_mps = so.vel_ned_mps
    body.roll_rad = so.roll_rad + shift.attitude_rad[0]
    body.pitch_rad = so.pitch_rad + shift.attitude_rad[1]
    body.yaw_rad = so.yaw_rad + shift.attitude_rad[2]
    body.thrust_n = sample.thrust_n
    north, east, down = (np.array(so.wind_to_ned_mps) + shift.wind_ned_mps).tolist()
    body.move(sample.thrust_n, mass_kg, (north, east, down), _DENSITY_KGPM3, 0.0, _DT_S)
    lift = (body.down_mps - so.vel_ned_mps[2]) / _DT_S - GRAVITY_MPS2
    return np.array(
        [
            (body.north_mps - so.vel_ned_mps[0]) / _DT_S - lean[0] * lift,
            (body.east_mps - so.vel_ned_mps[1]) / _DT_S - lean[1] * lift,
            body.forward_airspeed_mps,
        ]
    )


def _lean(roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, float]:
    """Horizontal over vertical part of the thrust's axis, north and east (ZYX Euler angles)."""
    side = math.tan(roll_rad) / math.cos(pitch_rad)
    along = math.tan(pitch_rad)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return along * cos + side * sin, along * sin - side * cos


def _rows(
    truths: _Truths, sample: Sample, to_wind: Floats, gusts: _Gusts, *, pitot: bool
) -> Floats:
    """Derivatives of what is measured by the states before PAST, in the noise's unit."""
    params = truths.params
    mass, sensors = params.empty_mass_kg, params.sensors

    def at(wind: Floats, attitude: Floats) -> Floats:
        return _measured(truths.usual, mass, sample, _Shift(wind, attitude))

    small = _SMALL * np.eye(3)
    by_wind = [(at(d, _NOWHERE) - at(-d, _NOWHERE)) / (2.0 * _SMALL) for d in small]
    # a reported angle is the true one and its bias, so the true one is the less
    by_bias = [(at(_NOWHERE, -d) - at(_NOWHERE, d)) / (2.0 * _SMALL) for d in small]
    usual = at(_NOWHERE, _NOWHERE)
    unshifted = _Shift(_NOWHERE, _NOWHERE)
    by_drag = [
        (_measured(body, mass, sample, unshifted) - usual) / _Truths.MORE
        for body in truths.more_drag
    ]
    turn = np.eye(3)
    turn[:2, :2] = to_wind.T
    h = np.zeros((3, PAST))
    h += np.stack(by_wind, axis=1) @ turn @ gusts.wind_rows
    h[:2, NOW : NOW + 2] = to_wind.T / SAMPLE_S
    h[:2, BEFORE : BEFORE + 2] = -to_wind.T / SAMPLE_S
    h[:, TRIM], h[:, TRIM + 1], h[:, HEADING] = by_bias[1], by_bias[0], by_bias[2]
    h[:, GAIN], h[:, GAIN + 1] = by_drag
    h[0, MODEL] = h[1, MODEL + 1] = MODEL_STD_FRAC * math.hypot(*(by_drag[0] + by_drag[1])[:2])
    ram = float(usual[2])
    pressure_per_mps = _DENSITY_KGPM3 * ram
    h[2] *= pressure_per_mps
    h[2, PITOT], h[2, PITOT + 1] = pressure_per_mps * ram, 1.0
    h[:2] /= GRAVITY_MPS2 * math.radians(sensors.tilt_noise_deg)
    h[2] /= sensors.pitot_noise_pa
    return h if pitot and ram > 0.0 else h[:2]


def _gain(cov: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Kalman's gain for noise of unit variance, and the innovations' covariance."""
    across = cov[:, :PAST] @ rows.T
    s = np.asarray(rows @ across[:PAST] + np.eye(len(rows)), dtype=np.float64)
    gain = np.asarray(np.linalg.solve(s, across.T).T, dtype=np.float64)
    return gain, s


def _window(flight: EnvelopeFlight, gusts: _Gusts) -> tuple[Floats, float]:
    """The mean over the 5 s past and the 5 s to come: its rows by all states, and the variance,
    both axes together, that is still to come."""
    wind = gusts.wind_rows[:2]
    rows = np.zeros((2, SIZE))
    rows[0, PAST + 2 :: 2] = rows[1, PAST + 3 :: 2] = 1.0
    to_come = 0.0
    later = np.zeros((2, PAST))  # what the states at a sample add to the winds from it on
    f, q = _transition(flight, gusts)
    for _ in range(HALF_WINDOW):
        later = later + wind
        to_come += float(np.trace(later @ q @ later.T))
        later = later @ f
    rows[:, :PAST] = later
    return rows / WINDOW, to_come / WINDOW**2
