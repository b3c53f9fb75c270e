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
    """Number of rotors."""
    radius_m: float
    """Radius of one rotor."""
    solidity: float
    """Blade area over disc area."""
    profile_drag_coeff: float
    """Mean profile drag coefficient of the blades."""
    thrust_coeff: float
    """Thrust of a rotor over rho A (Omega R)^2."""
    induced_factor: float
    """Induced power over that of an ideal rotor."""
    profile_speed_factor: float
    """Growth of profile power with the square of the advance ratio."""
    static_thrust_max_n: float
    """Largest thrust of all rotors in hover."""
    motor_lag_s: float
    """Time constant of the thrust."""
    drive_efficiency_frac: float
    """Shaft power over electrical power."""
    avionics_w: float
    """Power of everything that does not turn a rotor."""

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
    """Drag by body axis: that of rotors is linear in speed, stated for an empty hover at sea level
    (ISA), the rest square.
    """

    rotor_forward_nspm: float
    """Rotor drag for each m/s along body forward."""
    rotor_sideways_nspm: float
    """Rotor drag for each m/s along body right."""
    parasite_forward_m2: float
    """Drag area along body forward."""
    parasite_sideways_m2: float
    """Drag area along body right."""
    parasite_vertical_m2: float
    """Drag area along body down."""
    parcel_area_m2: float
    """Added to the forward and sideways areas while a parcel hangs below."""

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
    """Largest lean angle."""
    angle_time_s: float
    """Time constant of the angle."""
    rate_lag_s: float
    """Time constant of the rate."""
    max_rate_degps: float
    """Largest roll and pitch rate."""
    max_yaw_rate_degps: float
    """Largest yaw rate."""

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
    """Cells in series."""
    full_cell_v: float
    """Resting voltage of a full cell."""
    capacity_ah: float
    """Charge of a new pack."""
    resistance_ohm: float
    """Series resistance of the pack."""
    polarisation_ohm: float
    """Resistance of the pack that follows the current slowly."""
    polarisation_time_s: float
    """Its time constant."""
    resistance_activation_k: float
    """Growth of resistance in the cold: an Arrhenius temperature."""
    resistance_growth_per_fade: float
    """Growth of resistance for each share of capacity that is lost."""
    cutoff_cell_v: float
    """Voltage of one cell under load at which the pack shuts down."""
    cutoff_delay_s: float
    """How long the voltage must be below that."""
    mass_kg: float
    """Mass of the pack."""

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
    """Fixes a second."""
    gnss_latency_s: float
    """Age of a fix when it is told."""
    gnss_horizontal_bias_m: float
    """Slow error of the place, each horizontal axis."""
    gnss_vertical_bias_m: float
    """Slow error of the height."""
    gnss_bias_time_s: float
    """Correlation time of both."""
    gnss_position_noise_m: float
    """Error of the place that is new each time."""
    gnss_velocity_noise_mps: float
    """Error of the velocity."""
    tilt_bias_deg: float
    """Slow error of roll and pitch."""
    tilt_bias_time_s: float
    """Its correlation time."""
    tilt_noise_deg: float
    """Error of roll and pitch that is new each time."""
    heading_bias_deg: float
    """Constant error of the heading."""
    heading_noise_deg: float
    """Error of the heading that is new each time."""
    gyro_noise_degps: float
    """Error of the rates."""
    accel_bias_mps2: float
    """Constant error of each accelerometer."""
    accel_noise_mps2: float
    """Error of each accelerometer that is new each time."""
    baro_drift_m: float
    """Slow error of the barometric height."""
    baro_drift_time_s: float
    """Its correlation time."""
    baro_noise_m: float
    """Error of the barometric height that is new each time."""
    board_warmth_c: float
    """The barometer's own thermometer over the air, of a board that is powered."""
    board_warmth_std_c: float
    """From vehicle to vehicle."""
    pitot_scale_error_frac: float
    """Error of the dynamic pressure, of itself."""
    pitot_bias_pa: float
    """Constant error of the dynamic pressure."""
    pitot_noise_pa: float
    """Error of the dynamic pressure that is new each time."""
    voltage_noise_v: float
    """Error of the voltage."""
    voltage_scale_error_frac: float
    """Error of the voltage, of itself."""
    current_noise_a: float
    """Error of the current."""
    current_scale_error_frac: float
    """Error of the current, of itself."""

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
            "board_warmth_c": (0.0, 60.0),
            "board_warmth_std_c": (0.0, 20.0),
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
    """Sink rate at touchdown above which it crashes."""
    crash_drift_mps: float
    """Horizontal speed at touchdown above which it crashes."""
    friction_coeff: float
    """Friction on the ground."""

    def __post_init__(self) -> None:
        ranges = {
            "crash_sink_mps": (0.5, 20.0),
            "crash_drift_mps": (0.2, 20.0),
            "friction_coeff": (0.1, 2.0),
        }
        self.check("ground", ranges)


class AirframeTruth(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A `truth/1` file: what the simulated world does with an airframe."""

    format: Literal["truth/1"]
    """The kind of file and its version."""
    name: str
    """The airframe's name."""
    empty_mass_kg: float
    """Mass ready to fly, battery in, no parcel."""
    max_payload_kg: float
    """Heaviest parcel."""
    rotors: RotorParams
    """Rotors and motors."""
    drag: DragParams
    """Drag by body axis."""
    attitude: AttitudeParams
    """How fast, and how far, it leans."""
    battery: BatteryParams
    """The pack."""
    sensors: SensorParams
    """Errors of the sensors (one sigma) and their correlation times."""
    ground: GroundParams
    """What the landing gear bears."""

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
