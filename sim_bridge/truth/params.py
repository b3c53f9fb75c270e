"""The true numbers of an airframe (`truth/1`), read from `params/truth/NAME.toml`.

These are what the world does, not what the planner believes (`params/airframes`). Every value
in a shipped file carries its source, or says that it is assumed and why.
"""

import math
from pathlib import Path
from typing import Literal

import msgspec

from sim_bridge.truth.errors import TruthError


def check_range(key: str, value: float, low: float, high: float) -> None:
    """Raise ValueError naming `key` when `value` is not a finite number in [low, high]."""
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{key} = {value!r}: expected a number from {low:g} to {high:g}")


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of numbers, each with its permitted range in `_ranges`."""

    def check(self, table: str, ranges: dict[str, tuple[float, float]]) -> None:
        for key, (low, high) in ranges.items():
            check_range(f"{table}.{key}", getattr(self, key), low, high)


class RotorParams(_Table, frozen=True):
    """All rotors together; coefficients are a rotor's (thrust over rho A (Omega R)^2)."""

    count: int
    radius_m: float
    solidity: float
    profile_drag_coeff: float
    thrust_coeff: float
    induced_factor: float
    profile_speed_factor: float
    static_thrust_max_n: float
    motor_lag_s: float
    drive_efficiency_frac: float
    avionics_w: float

    def __post_init__(self) -> None:
        ranges = {
            "count": (3, 16),
            "radius_m": (0.03, 3.0),
            "solidity": (0.01, 0.4),
            "profile_drag_coeff": (0.005, 0.1),
            "thrust_coeff": (0.001, 0.05),
            "induced_factor": (1.0, 2.0),
            "profile_speed_factor": (0.0, 10.0),
            "static_thrust_max_n": (1.0, 10_000.0),
            "motor_lag_s": (0.005, 1.0),
            "drive_efficiency_frac": (0.2, 1.0),
            "avionics_w": (0.0, 1000.0),
        }
        self.check("rotors", ranges)


class DragParams(_Table, frozen=True):
    """Drag by body axis: rotors linear in speed (at the empty vehicle's hover thrust), rest square.

    `parcel_area_m2` is added to the forward and sideways areas while a parcel hangs below.
    """

    rotor_forward_nspm: float
    rotor_sideways_nspm: float
    parasite_forward_m2: float
    parasite_sideways_m2: float
    parasite_vertical_m2: float
    parcel_area_m2: float

    def __post_init__(self) -> None:
        ranges = {
            "rotor_forward_nspm": (0.0, 50.0),
            "rotor_sideways_nspm": (0.0, 50.0),
            "parasite_forward_m2": (0.0, 10.0),
            "parasite_sideways_m2": (0.0, 10.0),
            "parasite_vertical_m2": (0.0, 20.0),
            "parcel_area_m2": (0.0, 5.0),
        }
        self.check("drag", ranges)


class AttitudeParams(_Table, frozen=True):
    """How fast and how far the airframe tilts. Angles in degrees, as people write them."""

    max_tilt_deg: float
    angle_time_s: float
    rate_lag_s: float
    max_rate_degps: float
    max_yaw_rate_degps: float

    def __post_init__(self) -> None:
        ranges = {
            "max_tilt_deg": (5.0, 60.0),
            "angle_time_s": (0.02, 2.0),
            "rate_lag_s": (0.005, 1.0),
            "max_rate_degps": (10.0, 1000.0),
            "max_yaw_rate_degps": (5.0, 720.0),
        }
        self.check("attitude", ranges)


class BatteryParams(_Table, frozen=True):
    """A pack of `cells` in series. Resistances are the whole pack's, at 25 degrees C, new."""

    cells: int
    full_cell_v: float
    capacity_ah: float
    resistance_ohm: float
    polarisation_ohm: float
    polarisation_time_s: float
    resistance_activation_k: float
    resistance_growth_per_fade: float
    cutoff_cell_v: float
    cutoff_delay_s: float
    mass_kg: float

    def __post_init__(self) -> None:
        ranges = {
            "cells": (1, 48),
            "full_cell_v": (4.0, 4.5),
            "capacity_ah": (0.1, 1000.0),
            "resistance_ohm": (0.0, 2.0),
            "polarisation_ohm": (0.0, 2.0),
            "polarisation_time_s": (0.1, 3600.0),
            "resistance_activation_k": (0.0, 10_000.0),
            "resistance_growth_per_fade": (0.0, 50.0),
            "cutoff_cell_v": (2.5, 3.7),
            "cutoff_delay_s": (0.0, 10.0),
            "mass_kg": (0.01, 200.0),
        }
        self.check("battery", ranges)


class SensorParams(_Table, frozen=True):
    """Spreads (one standard deviation) and correlation times of the sensors' errors."""

    gnss_rate_hz: float
    gnss_latency_s: float
    gnss_horizontal_bias_m: float
    gnss_vertical_bias_m: float
    gnss_bias_time_s: float
    gnss_position_noise_m: float
    gnss_velocity_noise_mps: float
    tilt_bias_deg: float
    tilt_bias_time_s: float
    tilt_noise_deg: float
    heading_bias_deg: float
    heading_noise_deg: float
    gyro_noise_degps: float
    accel_bias_mps2: float
    accel_noise_mps2: float
    baro_drift_m: float
    baro_drift_time_s: float
    baro_noise_m: float
    pitot_scale_error_frac: float
    pitot_bias_pa: float
    pitot_noise_pa: float
    voltage_noise_v: float
    voltage_scale_error_frac: float
    current_noise_a: float
    current_scale_error_frac: float

    def __post_init__(self) -> None:
        ranges = {
            "gnss_rate_hz": (1.0, 50.0),
            "gnss_latency_s": (0.0, 1.0),
            "gnss_horizontal_bias_m": (0.0, 20.0),
            "gnss_vertical_bias_m": (0.0, 40.0),
            "gnss_bias_time_s": (1.0, 1e5),
            "gnss_position_noise_m": (0.0, 10.0),
            "gnss_velocity_noise_mps": (0.0, 5.0),
            "tilt_bias_deg": (0.0, 10.0),
            "tilt_bias_time_s": (1.0, 1e5),
            "tilt_noise_deg": (0.0, 5.0),
            "heading_bias_deg": (0.0, 30.0),
            "heading_noise_deg": (0.0, 10.0),
            "gyro_noise_degps": (0.0, 20.0),
            "accel_bias_mps2": (0.0, 1.0),
            "accel_noise_mps2": (0.0, 5.0),
            "baro_drift_m": (0.0, 50.0),
            "baro_drift_time_s": (1.0, 1e5),
            "baro_noise_m": (0.0, 5.0),
            "pitot_scale_error_frac": (0.0, 0.5),
            "pitot_bias_pa": (0.0, 50.0),
            "pitot_noise_pa": (0.0, 50.0),
            "voltage_noise_v": (0.0, 5.0),
            "voltage_scale_error_frac": (0.0, 0.2),
            "current_noise_a": (0.0, 20.0),
            "current_scale_error_frac": (0.0, 0.5),
        }
        self.check("sensors", ranges)


class GroundParams(_Table, frozen=True):
    """What the landing gear withstands."""

    crash_sink_mps: float
    crash_drift_mps: float
    friction_coeff: float

    def __post_init__(self) -> None:
        ranges = {
            "crash_sink_mps": (0.5, 20.0),
            "crash_drift_mps": (0.2, 20.0),
            "friction_coeff": (0.1, 2.0),
        }
        self.check("ground", ranges)


class AirframeTruth(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A whole vehicle. `empty_mass_kg` is ready to fly, battery included, without parcel."""

    format: Literal["truth/1"]
    name: str
    empty_mass_kg: float
    max_payload_kg: float
    rotors: RotorParams
    drag: DragParams
    attitude: AttitudeParams
    battery: BatteryParams
    sensors: SensorParams
    ground: GroundParams

    def __post_init__(self) -> None:
        check_range("empty_mass_kg", self.empty_mass_kg, 0.05, 500.0)
        check_range("max_payload_kg", self.max_payload_kg, 0.0, 500.0)
        if self.battery.mass_kg >= self.empty_mass_kg:
            raise ValueError("battery.mass_kg: expected less than empty_mass_kg")


def load_airframe(path: Path) -> AirframeTruth:
    """The airframe in a `truth/1` TOML file; TruthError names file and key of a mistake."""
    try:
        return msgspec.toml.decode(path.read_bytes(), type=AirframeTruth, strict=True)
    except OSError as error:
        raise TruthError(f"{path}: cannot be read ({error.strerror})") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise TruthError(f"{path}: {error}") from error
