"""True parameters of an airframe (`truth/1`), read from `params/truth/NAME.toml`.

The simulated world uses these; the planner uses its own estimates (`params/airframes`). Every value
in a shipped file carries its source, or states that it is assumed, with the reason.
"""

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeVar, get_args, get_type_hints

import msgspec

from sim_bridge.truth.errors import TruthError


def check_range(key: str, value: float, low: float, high: float) -> None:
    """Raise ValueError naming `key` when `value` is not a finite number in [low, high]."""
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{key} = {value!r}: expected a number from {low:g} to {high:g}")


@dataclass(frozen=True, slots=True)
class Range:
    """Permitted values of a number, as an annotation: `Annotated[float, Range(0.0, 1.0)]`."""

    low: float
    high: float


@functools.cache
def _range_by_field(table: type) -> dict[str, Range]:
    hints = get_type_hints(table, include_extras=True)
    found = {key: get_args(hint)[1:] for key, hint in hints.items()}
    return {key: one for key, extras in found.items() for one in extras if isinstance(one, Range)}


class RangedTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of numbers, each with its permitted range; `table` is its name in messages."""

    table: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for key, permitted in _range_by_field(type(self)).items():
            name = f"{self.table}.{key}".removeprefix(".")
            check_range(name, getattr(self, key), permitted.low, permitted.high)


Table = TypeVar("Table", bound=RangedTable)


class RotorParams(RangedTable, frozen=True, kw_only=True):
    """All rotors together; coefficients are per rotor (thrust over rho A (Omega R)^2)."""

    table: ClassVar[str] = "rotors"

    count: Annotated[int, Range(3, 16)]
    """Number of rotors."""
    radius_m: Annotated[float, Range(0.03, 3.0)]
    """Radius of one rotor."""
    solidity: Annotated[float, Range(0.01, 0.4)]
    """Blade area over disc area."""
    profile_drag_coeff: Annotated[float, Range(0.005, 0.1)]
    """Mean profile drag coefficient of the blades."""
    thrust_coeff: Annotated[float, Range(0.001, 0.05)]
    """Thrust of a rotor over rho A (Omega R)^2."""
    induced_factor: Annotated[float, Range(1.0, 2.0)]
    """Induced power over that of an ideal rotor."""
    profile_speed_factor: Annotated[float, Range(0.0, 10.0)]
    """Growth of profile power with the square of the advance ratio."""
    static_thrust_max_n: Annotated[float, Range(1.0, 10_000.0)]
    """Largest thrust of all rotors in hover."""
    motor_lag_s: Annotated[float, Range(0.005, 1.0)]
    """Time constant of the thrust."""
    drive_efficiency_frac: Annotated[float, Range(0.2, 1.0)]
    """Shaft power over electrical power."""
    avionics_w: Annotated[float, Range(0.0, 1000.0)]
    """Power of all loads other than rotors."""


class DragParams(RangedTable, frozen=True, kw_only=True):
    """Drag by body axis: that of rotors is linear in speed, stated for an empty hover at sea level
    (ISA), the rest square.
    """

    table: ClassVar[str] = "drag"

    rotor_forward_nspm: Annotated[float, Range(0.0, 50.0)]
    """Rotor drag for each m/s along body forward."""
    rotor_sideways_nspm: Annotated[float, Range(0.0, 50.0)]
    """Rotor drag for each m/s along body right."""
    parasite_forward_m2: Annotated[float, Range(0.0, 10.0)]
    """Drag area along body forward."""
    parasite_sideways_m2: Annotated[float, Range(0.0, 10.0)]
    """Drag area along body right."""
    parasite_vertical_m2: Annotated[float, Range(0.0, 20.0)]
    """Drag area along body down."""
    parcel_area_m2: Annotated[float, Range(0.0, 5.0)]
    """Added to the forward and sideways areas while a parcel hangs below."""


class AttitudeParams(RangedTable, frozen=True, kw_only=True):
    """Tilt rate and tilt limit of the airframe. Angles in degrees, for human readers."""

    table: ClassVar[str] = "attitude"

    max_tilt_deg: Annotated[float, Range(5.0, 60.0)]
    """Largest lean angle."""
    angle_time_s: Annotated[float, Range(0.02, 2.0)]
    """Time constant of the angle."""
    rate_lag_s: Annotated[float, Range(0.005, 1.0)]
    """Time constant of the rate."""
    max_rate_degps: Annotated[float, Range(10.0, 1000.0)]
    """Largest roll and pitch rate."""
    max_yaw_rate_degps: Annotated[float, Range(5.0, 720.0)]
    """Largest yaw rate."""


class BatteryParams(RangedTable, frozen=True, kw_only=True):
    """A pack of `cells` in series. Resistances are the whole pack's, at 25 degrees C, new."""

    table: ClassVar[str] = "battery"

    cells: Annotated[int, Range(1, 48)]
    """Cells in series."""
    full_cell_v: Annotated[float, Range(4.0, 4.5)]
    """Resting voltage of a full cell."""
    capacity_ah: Annotated[float, Range(0.1, 1000.0)]
    """Charge of a new pack."""
    resistance_ohm: Annotated[float, Range(0.0, 2.0)]
    """Series resistance of the pack."""
    polarisation_ohm: Annotated[float, Range(0.0, 2.0)]
    """Resistance of the pack that follows the current slowly."""
    polarisation_time_s: Annotated[float, Range(0.1, 3600.0)]
    """Time constant of polarisation."""
    resistance_activation_k: Annotated[float, Range(0.0, 10_000.0)]
    """Growth of resistance in the cold: an Arrhenius temperature."""
    resistance_growth_per_fade: Annotated[float, Range(0.0, 50.0)]
    """Growth of resistance for each share of capacity that is lost."""
    cutoff_cell_v: Annotated[float, Range(2.5, 3.7)]
    """Voltage of one cell under load at which the pack shuts down."""
    cutoff_delay_s: Annotated[float, Range(0.0, 10.0)]
    """Duration of voltage below the cut-off before the pack switches off."""
    mass_kg: Annotated[float, Range(0.01, 200.0)]
    """Mass of the pack."""


class SensorParams(RangedTable, frozen=True, kw_only=True):
    """Spreads (one standard deviation) and correlation times of the sensors' errors."""

    table: ClassVar[str] = "sensors"

    gnss_rate_hz: Annotated[float, Range(1.0, 50.0)]
    """Fixes a second."""
    gnss_latency_s: Annotated[float, Range(0.0, 1.0)]
    """Latency of a fix at its output."""
    gnss_horizontal_bias_m: Annotated[float, Range(0.0, 20.0)]
    """Slowly varying position error, each horizontal axis."""
    gnss_vertical_bias_m: Annotated[float, Range(0.0, 40.0)]
    """Slow error of the height."""
    gnss_bias_time_s: Annotated[float, Range(1.0, 1e5)]
    """Correlation time of both."""
    gnss_position_noise_m: Annotated[float, Range(0.0, 10.0)]
    """Position noise, independent for each fix."""
    gnss_velocity_noise_mps: Annotated[float, Range(0.0, 5.0)]
    """Error of the velocity."""
    tilt_bias_deg: Annotated[float, Range(0.0, 10.0)]
    """Slow error of roll and pitch."""
    tilt_bias_time_s: Annotated[float, Range(1.0, 1e5)]
    """Correlation time of the slow error."""
    tilt_noise_deg: Annotated[float, Range(0.0, 5.0)]
    """Error of roll and pitch that is new each time."""
    heading_bias_deg: Annotated[float, Range(0.0, 30.0)]
    """Constant error of the heading."""
    heading_noise_deg: Annotated[float, Range(0.0, 10.0)]
    """Error of the heading that is new each time."""
    gyro_noise_degps: Annotated[float, Range(0.0, 20.0)]
    """Error of the rates."""
    accel_bias_mps2: Annotated[float, Range(0.0, 1.0)]
    """Constant error of each accelerometer."""
    accel_noise_mps2: Annotated[float, Range(0.0, 5.0)]
    """Error of each accelerometer that is new each time."""
    baro_drift_m: Annotated[float, Range(0.0, 50.0)]
    """Slow error of the barometric height."""
    baro_drift_time_s: Annotated[float, Range(1.0, 1e5)]
    """Correlation time of the slow error."""
    baro_noise_m: Annotated[float, Range(0.0, 5.0)]
    """Error of the barometric height that is new each time."""
    board_warmth_c: Annotated[float, Range(0.0, 60.0)]
    """The barometer's own thermometer over the air, of a board that is powered."""
    board_warmth_std_c: Annotated[float, Range(0.0, 20.0)]
    """Variation between vehicles."""
    pitot_scale_error_frac: Annotated[float, Range(0.0, 0.5)]
    """Error of the dynamic pressure, of itself."""
    pitot_bias_pa: Annotated[float, Range(0.0, 50.0)]
    """Constant error of the dynamic pressure."""
    pitot_noise_pa: Annotated[float, Range(0.0, 50.0)]
    """Error of the dynamic pressure that is new each time."""
    voltage_noise_v: Annotated[float, Range(0.0, 5.0)]
    """Error of the voltage."""
    voltage_scale_error_frac: Annotated[float, Range(0.0, 0.2)]
    """Error of the voltage, of itself."""
    current_noise_a: Annotated[float, Range(0.0, 20.0)]
    """Error of the current."""
    current_scale_error_frac: Annotated[float, Range(0.0, 0.5)]
    """Error of the current, of itself."""


class GroundParams(RangedTable, frozen=True, kw_only=True):
    """Load limits of the landing gear."""

    table: ClassVar[str] = "ground"

    crash_sink_mps: Annotated[float, Range(0.5, 20.0)]
    """Sink rate at touchdown above which it crashes."""
    crash_drift_mps: Annotated[float, Range(0.2, 20.0)]
    """Horizontal speed at touchdown above which it crashes."""
    friction_coeff: Annotated[float, Range(0.1, 2.0)]
    """Friction on the ground."""


class AirframeTruth(RangedTable, frozen=True, kw_only=True):
    """A `truth/1` file: what the simulated world does with an airframe."""

    format: Literal["truth/1"]
    """The kind of file and its version."""
    name: str
    """The airframe's name."""
    empty_mass_kg: Annotated[float, Range(0.05, 500.0)]
    """Mass ready to fly, battery in, no parcel."""
    max_payload_kg: Annotated[float, Range(0.0, 500.0)]
    """Heaviest parcel."""
    rotors: RotorParams
    """Rotors and motors."""
    drag: DragParams
    """Drag by body axis."""
    attitude: AttitudeParams
    """Attitude dynamics and tilt limit."""
    battery: BatteryParams
    """The pack."""
    sensors: SensorParams
    """Errors of the sensors (one sigma) and their correlation times."""
    ground: GroundParams
    """Load limits of the landing gear."""

    def __post_init__(self) -> None:
        RangedTable.__post_init__(self)
        if self.battery.mass_kg >= self.empty_mass_kg:
            raise ValueError("battery.mass_kg: expected less than empty_mass_kg")


def load_table(path: Path, table: type[Table]) -> Table:
    """The table in a TOML file; TruthError names file and key of a mistake."""
    try:
        return msgspec.toml.decode(path.read_bytes(), type=table, strict=True)
    except OSError as error:
        raise TruthError(f"{path}: cannot be read ({error.strerror})") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise TruthError(f"{path}: {error}") from error


def load_airframe(path: Path) -> AirframeTruth:
    """The airframe in a `truth/1` TOML file; TruthError names file and key of a mistake."""
    return load_table(path, AirframeTruth)
