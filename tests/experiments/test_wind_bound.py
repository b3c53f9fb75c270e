"""The bound against a Gaussian problem solved whole: no recursion, no state space, no truth's move.

A hover whose drag is linear and the same on both axes is linear and Gaussian, so its bound is the
covariance of the window's mean given all measurements, which the covariance functions of wind,
gusts and sensor errors give at once (conditioning of a joint Gaussian). The gusts' functions are
the transforms of MIL-F-8785C's spectra: exp(-s), and (1 - s/2) exp(-s) across.
"""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from sim_bridge.experiments.envelope_flight import Condition, EnvelopeFlight, Sample
from sim_bridge.experiments.wind_bound import flight_bound
from sim_bridge.truth.params import AirframeTruth, load_airframe
from sim_bridge.truth.signals import SensorReadings, Truth

ROOT = Path(__file__).parents[2]
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
        touching_ground=False, parcel_aboard=False,
    )  # fmt: skip


def least_variance(params: AirframeTruth, k: int, *, wind_step: bool) -> float:
    """Of the mean over samples k-49 to k+50, both axes, given the measurements to sample k."""
    feet = HEIGHT_M / 0.3048
    shape = 0.177 + 0.000823 * feet
    sigma = 0.1 * WIND_MPS / shape**0.4
    memory_s = 0.3048 * feet / shape**1.2 / WIND_MPS
    walk = 2.0 * (0.035 - 0.023) / 270.0 * WIND_MPS**2  # envelope_flight: the coast recording's
    t = DT_S * np.arange(1, SAMPLES + 1)
    lag = np.abs(t[:, None] - t[None, :])
    ramped = np.clip(FIRST_S - DT_S + t - 45.0, 0.0, 10.0) if wind_step else np.zeros(SAMPLES)
    mean = 8.0**2 + walk * np.minimum(t[:, None], t[None, :])
    mean += (0.5**2 / 2.0) * np.outer(ramped, ramped)
    s = lag / memory_s
    gusts = (np.exp(-s), (1.0 - 0.5 * s) * np.exp(-s))
    sensors, slope = params.sensors, DRAG_NSPM / params.empty_mass_kg
    trim = (GRAVITY * math.radians(sensors.tilt_bias_deg)) ** 2 * np.exp(
        -lag / sensors.tilt_bias_time_s
    )
    jitter = sensors.gnss_velocity_noise_mps**2 / DT_S**2
    velocity = jitter * (2.0 * np.eye(SAMPLES) - np.eye(SAMPLES, k=1) - np.eye(SAMPLES, k=-1))
    white = (GRAVITY * math.radians(sensors.tilt_noise_deg)) ** 2 * np.eye(SAMPLES)
    gain = (0.05**2 + 0.03**2) * (slope * WIND_MPS) ** 2  # along the wind only: none blows across
    window = np.zeros(SAMPLES)
    window[k - 49 : k + 51] = 0.01
    total = 0.0
    for axis in (0, 1):
        wind = mean + sigma**2 * gusts[axis]
        seen = slope**2 * wind + trim + velocity + white
        if axis == 0:
            seen = seen + gain
        known, cross = seen[: k + 1, : k + 1], slope * (wind @ window)[: k + 1]
        total += float(window @ wind @ window - cross @ np.linalg.solve(known, cross))
    return total


@pytest.mark.parametrize("wind_step", [False, True])
def test_where_all_is_linear_and_gaussian_the_bound_is_the_conditional_covariance(
    wind_step: bool,
) -> None:
    params = plain_truth()
    bound = flight_bound(hover(params, wind_step=wind_step))
    for k in (49, 59, 74, 99):  # 43 s, 44 s, 45.5 s and 48 s: before and in the ramp
        at = int(np.argmin(np.abs(bound.t_s - (FIRST_S + k * DT_S))))
        assert bound.mse_m2ps2[at] == pytest.approx(
            least_variance(params, k, wind_step=wind_step), rel=1e-4
        )
