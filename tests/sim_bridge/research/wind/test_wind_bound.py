"""The bound against a Gaussian problem solved whole: no recursion, no state space, no truth's move.

A hover whose drag is linear and the same on both axes is linear and Gaussian, so its bound is the
covariance of the window's mean given all measurements, which the covariance functions of wind,
gusts and sensor errors give at once (conditioning of a joint Gaussian). The gusts' functions are
the transforms of MIL-F-8785C's spectra: exp(-s), and (1 - s/2) exp(-s) across.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import softmax

from sim_bridge.research.wind.envelope_flight import END_S, Condition, EnvelopeFlight, Sample
from sim_bridge.research.wind.wind_bound import flight_bound
from sim_bridge.truth.params import AirframeTruth, load_airframe
from sim_bridge.truth.signals import SensorReadings, Truth

Floats = NDArray[np.float64]

ROOT = Path(__file__).parents[4]
WIND_MPS, HEIGHT_M, SAMPLES, FIRST_S, DT_S = 4.0, 30.0, 160, 38.1, 0.1
DRAG_NSPM, GRAVITY = 1.5, 9.80665


def plain_truth() -> AirframeTruth:
    """The shipped airframe with one drag, linear, the same on both axes."""
    params = load_airframe(ROOT / "params" / "truth" / "m100.toml")
    drag = msgspec.structs.replace(
        params.drag,
        rotor_forward_nspm=DRAG_NSPM,
        rotor_sideways_nspm=DRAG_NSPM,
        parasite_forward_m2=0.0,
        parasite_sideways_m2=0.0,
        parasite_vertical_m2=0.0,
    )
    return msgspec.structs.replace(params, drag=drag)


def hover(params: AirframeTruth, *, wind_step: bool) -> EnvelopeFlight:
    """Level, nose to the north, at one place in wind to the north."""
    weight_n = params.empty_mass_kg * GRAVITY
    samples = []
    for k in range(SAMPLES):
        t_s = FIRST_S + k * DT_S
        so = Truth(
            t_s=t_s,
            pos_ned_m=(0.0, 0.0, -HEIGHT_M),
            vel_ned_mps=(0.0, 0.0, 0.0),
            roll_rad=0.0,
            pitch_rad=0.0,
            yaw_rad=0.0,
            wind_to_ned_mps=(WIND_MPS, 0.0, 0.0),
            power_w=0.0,
            energy_used_wh=0.0,
            usable_wh=0.0,
            charge_frac=1.0,
            parcel_aboard=False,
            airborne=True,
            motors_failed=False,
            crashed=False,
        )
        samples.append(Sample(so, _unread(t_s), weight_n))
    winds = np.tile([WIND_MPS, 0.0], (SAMPLES, 1))
    return EnvelopeFlight(Condition(None, WIND_MPS, wind_step), params, samples, winds, winds)


def _unread(t_s: float) -> SensorReadings:
    """The bound looks at no reading."""
    nan3 = (math.nan, math.nan, math.nan)
    nan = math.nan
    return SensorReadings(
        t_s, nan, nan, nan, nan, nan, nan, nan3, True, nan3, nan3, nan, None, None, None, nan,
        nan, nan, touching_ground=False, parcel_aboard=False,
    )  # fmt: skip


@dataclass(frozen=True)
class Joint:
    """Gaussian of one axis: what is seen to a sample, and the window's mean about it."""

    seen: Floats
    cross: Floats
    mean: float

    @property
    def weights(self) -> Floats:
        """Of what is seen, in the best estimate of the mean."""
        return np.asarray(np.linalg.solve(self.seen, self.cross), np.float64)

    @property
    def least_variance(self) -> float:
        return self.mean - float(self.cross @ self.weights)


def joints(params: AirframeTruth, k: int, begin_s: float | None) -> list[Joint]:
    """The mean over samples k-49 to k+50, and the measurements to sample k; the wind's mean ramps
    for 10 s from a time on, or never."""
    feet = HEIGHT_M / 0.3048
    shape = 0.177 + 0.000823 * feet
    sigma = 0.1 * WIND_MPS / shape**0.4
    memory_s = 0.3048 * feet / shape**1.2 / WIND_MPS
    walk = 2.0 * (0.035 - 0.023) / 270.0 * WIND_MPS**2  # envelope_flight: the coast recording's
    t = DT_S * np.arange(1, SAMPLES + 1)
    lag = np.abs(t[:, None] - t[None, :])
    ramped = np.clip(FIRST_S - DT_S + t - (begin_s or math.inf), 0.0, 10.0)
    mean = 8.0**2 + walk * np.minimum(t[:, None], t[None, :])
    mean += (0.5**2 / 2.0) * np.outer(ramped, ramped)
    s = lag / memory_s
    gusts = (np.exp(-s), (1.0 - 0.5 * s) * np.exp(-s))
    # Rotor drag goes with the root of density: dry air at sea level and 20 degrees C, over 1.225.
    thin = math.sqrt(101_325.0 / (287.05 * 293.15) / 1.225)
    sensors, slope = params.sensors, thin * DRAG_NSPM / params.empty_mass_kg
    trim = (GRAVITY * math.radians(sensors.tilt_bias_deg)) ** 2 * np.exp(
        -lag / sensors.tilt_bias_time_s
    )
    jitter = sensors.gnss_velocity_noise_mps**2 / DT_S**2
    velocity = jitter * (2.0 * np.eye(SAMPLES) - np.eye(SAMPLES, k=1) - np.eye(SAMPLES, k=-1))
    white = (GRAVITY * math.radians(sensors.tilt_noise_deg)) ** 2 * np.eye(SAMPLES)
    floor = (0.01 * slope * WIND_MPS) ** 2 * np.exp(-lag / 5.0)  # m100.toml's model_std_frac
    gain = (0.05**2 + 0.03**2) * (slope * WIND_MPS) ** 2  # along the wind only: none blows across
    window = np.zeros(SAMPLES)
    window[k - 49 : k + 51] = 0.01
    found = []
    for axis in (0, 1):
        wind = mean + sigma**2 * gusts[axis]
        seen = slope**2 * wind + trim + velocity + white + floor
        if axis == 0:
            seen = seen + gain
        cross = slope * (wind @ window)[: k + 1]
        found.append(Joint(seen[: k + 1, : k + 1], cross, float(window @ wind @ window)))
    return found


@pytest.mark.parametrize("wind_step", [False, True])
def test_where_all_is_linear_and_gaussian_the_bound_is_the_conditional_covariance(
    wind_step: bool,
) -> None:
    params = plain_truth()
    bound = flight_bound(hover(params, wind_step=wind_step), np.random.default_rng(0))
    for k in (49, 59, 74, 99):  # 43 s, 44 s, 45.5 s and 48 s: before and in the ramp
        at = int(np.argmin(np.abs(bound.t_s - (FIRST_S + k * DT_S))))
        least = sum(j.least_variance for j in joints(params, k, 45.0 if wind_step else None))
        assert bound.told_m2ps2[at] == pytest.approx(least, rel=1e-4)


def test_who_is_not_told_of_a_step_weighs_every_beginning_by_what_is_seen() -> None:
    # Bayes' estimate, by every beginning's joint Gaussian: half of all flights step, each second
    # to the end of the flight alike, and the beginnings to come look like none.
    params, k, draws = plain_truth(), 99, 2000  # 48 s: in the ramp
    begins = [*np.arange(FIRST_S, FIRST_S + k * DT_S, 1.0), 45.0]
    count = np.arange(FIRST_S, END_S, 1.0).size + 1
    chance = np.full(1 + len(begins), 0.5 / count)
    chance[0] = 1.0 - chance[1:].sum()
    every = [joints(params, k, None)] + [joints(params, k, begin) for begin in begins]
    rng = np.random.default_rng(1)
    data = [np.linalg.cholesky(j.seen) @ rng.standard_normal((k + 1, draws)) for j in every[-1]]
    fit, estimates = np.tile(np.log(chance)[:, None], draws), []
    for row, hypothesis in enumerate(every):
        for joint, seen in zip(hypothesis, data, strict=True):
            fit[row] -= 0.5 * np.einsum("kd,kd->d", seen, np.linalg.solve(joint.seen, seen))
            fit[row] -= 0.5 * np.linalg.slogdet(joint.seen)[1]
        estimates.append([j.weights @ seen for j, seen in zip(hypothesis, data, strict=True)])
    best = np.einsum("hd,had->ad", softmax(fit, axis=0), np.array(estimates))
    off_m2ps2 = float(((best - estimates[-1]) ** 2).sum(axis=0).mean())
    bound = flight_bound(hover(params, wind_step=True), np.random.default_rng(0))
    at = int(np.argmin(np.abs(bound.t_s - (FIRST_S + k * DT_S))))
    added = bound.untold_m2ps2[at] - bound.told_m2ps2[at]
    assert added == pytest.approx(off_m2ps2, rel=0.3)  # 100 draws there: 10 % one sigma
