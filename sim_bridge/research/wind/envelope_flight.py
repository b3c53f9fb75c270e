"""Flights over the envelope in the true world, for judging the wind estimator.

The vehicle is `sim_bridge.truth`'s, sensors, gusts and all, under a plain velocity hold: up, out on
a course for a minute, and back. What it flies in is drawn afresh for each flight: the wind's
direction, the gusts, the sensors' errors, and its drag about the shipped one (within what a careful
owner knows, DRAG_STD_FRAC and AXIS_STD_FRAC), since no airframe file is exact.
"""

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy import stats

from companion.core.base.arrays import Floats
from sim_bridge.truth.dryden import DrydenTurbulence
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.signals import Actuation, SensorReadings, Truth
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import WindField

DRAG_STD_FRAC = 0.05
AXIS_STD_FRAC = 0.03
HEIGHT_M = 30.0
CLIMB_S = 15.0
LEG_S = 60.0
SAMPLE_S = 0.1
STEP_S = 0.02
WIND_STEP_MPS = 5.0
WIND_STEP_AT_S = CLIMB_S + 30.0
WIND_STEP_LASTS_S = 10.0
END_S = CLIMB_S + 2.0 * LEG_S
MOST_SAMPLES = round(END_S / SAMPLE_S) + 2
_GRAVITY_MPS2 = 9.80665


@dataclass(frozen=True)
class Condition:
    """One place in the envelope. `airspeed_mps` None is a hover over one place."""

    airspeed_mps: float | None
    wind_mps: float
    wind_step: bool = False
    pitot: bool = False

    @property
    def name(self) -> str:
        speed = "hover" if self.airspeed_mps is None else f"{self.airspeed_mps:g} m/s"
        step = f", step of {WIND_STEP_MPS:g} m/s in {WIND_STEP_LASTS_S:g} s"
        return f"{speed}, wind {self.wind_mps:g} m/s{step if self.wind_step else ''}"


@dataclass(frozen=True, slots=True)
class Sample:
    """What was so, and what the sensors said of it, at one instant."""

    truth: Truth
    readings: SensorReadings
    thrust_n: float


@dataclass(frozen=True)
class EnvelopeFlight:
    """Samples every 0.1 s from take-off on, and the truth that was drawn for them."""

    condition: Condition
    params: AirframeTruth
    samples: list[Sample]
    wind_true_ne_mps: Floats  # (n, 2), at the vehicle
    mean_wind_ne_mps: Floats  # (n, 2), without gusts

    @property
    def t_s(self) -> Floats:
        return np.array([sample.truth.t_s for sample in self.samples])


class WalkingWind:
    """A mean wind that walks, and moves by one vector in `WIND_STEP_LASTS_S` besides."""

    def __init__(
        self, before_ne_mps: Floats, step_ne_mps: Floats, rng: np.random.Generator
    ) -> None:
        self._before, self._step = before_ne_mps, step_ne_mps
        wind_mps = float(np.linalg.norm(before_ne_mps))
        moves = rng.normal(0.0, math.sqrt(mean_walk_m2ps3(wind_mps) * SAMPLE_S), (MOST_SAMPLES, 2))
        self._walk = np.cumsum(moves, axis=0)

    def to_ne_mps(self, t_s: float) -> tuple[float, float]:
        share = min(max((t_s - WIND_STEP_AT_S) / WIND_STEP_LASTS_S, 0.0), 1.0)
        now = self._before + share * self._step + self._walk[int(t_s / SAMPLE_S)]
        return float(now[0]), float(now[1])


def mean_walk_m2ps3(wind_mps: float) -> float:
    """How fast the mean wind walks. From a recording on a coast at 1 Hz, 8.4 m/s in the mean: half
    the variance of the wind's change grows from 0.023 to 0.035 of the squared mean between 30 and
    300 s. Below 3 m/s it is taken as at 3 m/s."""
    return 2.0 * (0.035 - 0.023) / 270.0 * max(wind_mps, 3.0) ** 2


def drag_deviates(flights: int, rng: np.random.Generator) -> Floats:
    """What makes the drag of so many flights differ, standard normal (flights, 3): common, forward,
    right. Stratified (a Latin hypercube), as what a flight errs by hangs on its drag more than on
    anything else that is drawn: 64 plain draws were 1.17 times too wide, and so was the error.
    """
    return stats.norm.ppf(stats.qmc.LatinHypercube(3, rng=rng).random(flights))


def drawn_truth(params: AirframeTruth, deviates: Floats) -> AirframeTruth:
    """The airframe with a drag that its owner does not know exactly, see `drag_deviates`."""
    common = DRAG_STD_FRAC * deviates[0]
    forward, sideways = np.exp(common + AXIS_STD_FRAC * deviates[1:])
    drag = params.drag
    changed = msgspec.structs.replace(
        drag,
        rotor_forward_nspm=drag.rotor_forward_nspm * float(forward),
        parasite_forward_m2=drag.parasite_forward_m2 * float(forward),
        rotor_sideways_nspm=drag.rotor_sideways_nspm * float(sideways),
        parasite_sideways_m2=drag.parasite_sideways_m2 * float(sideways),
    )
    return msgspec.structs.replace(params, drag=changed)


def fly_envelope(
    params: AirframeTruth,
    condition: Condition,
    rng: np.random.Generator,
    deviates: Floats | None = None,
) -> EnvelopeFlight:
    """One flight under `condition`; its drag by a row of `drag_deviates`, else drawn."""
    drawn = drawn_truth(params, rng.standard_normal(3) if deviates is None else deviates)
    toward = rng.uniform(-math.pi, math.pi)
    wind = condition.wind_mps * np.array([math.cos(toward), math.sin(toward)])
    turn = rng.uniform(-math.pi, math.pi)
    step = WIND_STEP_MPS * np.array([math.cos(turn), math.sin(turn)])
    mean = WalkingWind(wind, step if condition.wind_step else np.zeros(2), rng)
    course = rng.uniform(-math.pi, math.pi)
    field = WindField(mean, turbulence=DrydenTurbulence(rng))
    vehicle = Vehicle(drawn, field, rng, pitot=condition.pitot, start_yaw_rad=course)
    pilot = _VelocityHold(drawn)
    samples: list[Sample] = []
    readings = None
    per_sample = round(SAMPLE_S / STEP_S)
    for k in range(round(END_S / STEP_S)):
        t_s = (k + 1) * STEP_S
        heading = course if t_s < CLIMB_S + LEG_S else course + math.pi
        target = _target_ne(condition, heading, mean.to_ne_mps(t_s), t_s)
        command = pilot.command(vehicle.truth, target, heading)
        readings = vehicle.step(command, STEP_S)
        if (k + 1) % per_sample == 0 and vehicle.truth.airborne:
            samples.append(Sample(vehicle.truth, readings, pilot.thrust_n))
    true = np.array([sample.truth.wind_to_ned_mps[:2] for sample in samples])
    means = np.array([mean.to_ne_mps(sample.truth.t_s) for sample in samples])
    return EnvelopeFlight(condition, drawn, samples, true, means)


def _target_ne(
    condition: Condition, heading: float, wind_ne: tuple[float, float], t_s: float
) -> Floats:
    """The ground velocity to hold: that of the airspeed in the mean wind, once it is up."""
    if condition.airspeed_mps is None or t_s < CLIMB_S:
        return np.zeros(2)
    air = condition.airspeed_mps * np.array([math.cos(heading), math.sin(heading)])
    return air + np.array(wind_ne)


class _VelocityHold:
    """Velocity in, attitude and thrust out: proportional and integral, as any autopilot."""

    SPEED_GAIN = 1.2
    INTEGRAL_GAIN = 0.4
    MOST_MPS2 = 3.0
    MOST_CLIMB_MPS = 3.0
    YAW_RATE_RADPS = math.radians(40.0)

    def __init__(self, params: AirframeTruth) -> None:
        self._mass_kg = params.empty_mass_kg
        self._most_n = params.rotors.static_thrust_max_n
        self._trim = np.zeros(2)
        self._ramped = np.zeros(2)
        self._yaw: float | None = None
        self.thrust_n = 0.0

    def command(self, so: Truth, target_ne: Floats, heading_rad: float) -> Actuation:
        change = target_ne - self._ramped
        size = float(np.linalg.norm(change))
        self._ramped = self._ramped + change * min(1.0, self.MOST_MPS2 * STEP_S / max(size, 1e-9))
        error = self._ramped - np.array(so.vel_ned_mps[:2])
        self._trim = np.clip(self._trim + self.INTEGRAL_GAIN * error * STEP_S, -7.0, 7.0)
        pull = self.SPEED_GAIN * error + self._trim
        yaw = self._turned(heading_rad)
        cos, sin = math.cos(so.yaw_rad), math.sin(so.yaw_rad)
        forward, right = cos * pull[0] + sin * pull[1], cos * pull[1] - sin * pull[0]
        pitch = -math.atan(forward / _GRAVITY_MPS2)
        roll = math.atan(right / _GRAVITY_MPS2 * math.cos(pitch))
        climb = max(min(HEIGHT_M + so.pos_ned_m[2], self.MOST_CLIMB_MPS), -self.MOST_CLIMB_MPS)
        lift = self._mass_kg * (_GRAVITY_MPS2 + 2.0 * (climb + so.vel_ned_mps[2]))
        level = max(math.cos(so.roll_rad) * math.cos(so.pitch_rad), 0.5)
        self.thrust_n = min(max(lift / level, 0.0), self._most_n)
        return Actuation(roll, pitch, yaw, self.thrust_n / self._most_n, motors_on=True)

    def _turned(self, heading_rad: float) -> float:
        if self._yaw is None:
            self._yaw = heading_rad
        left = math.remainder(heading_rad - self._yaw, math.tau)
        step = self.YAW_RATE_RADPS * STEP_S
        self._yaw += max(min(left, step), -step)
        return self._yaw
