"""Interface of the simulated world: measurements and truth out."""

from dataclasses import dataclass
from typing import NamedTuple

Vec3 = tuple[float, float, float]


class SensorReadings(NamedTuple):  # made 100 times a second: a fifth of a frozen dataclass's time
    """Readings of the vehicle's sensors, with noise, bias and delay.

    Positions and velocities are NED about the depot's ground point, from the latest GNSS fix (10
    Hz, delayed by the receiver's latency, held during an outage). `accel_frd_mps2` is the specific
    force in body axes (forward, right, down). `airspeed_mps` is from a pitot on the forward axis,
    `None` without one; `voltage_v` and `current_a` are `None` without a sensor. `temperature_c` is
    the pack's; `board_temperature_c` is from the barometer's own thermometer, which is warmer than
    the air.
    """

    t_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    rollspeed_rps: float
    pitchspeed_rps: float
    yawspeed_rps: float
    accel_frd_mps2: Vec3
    gnss_ok: bool
    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    alt_amsl_m: float
    airspeed_mps: float | None
    voltage_v: float | None
    current_a: float | None
    temperature_c: float
    air_pressure_pa: float
    board_temperature_c: float
    touching_ground: bool
    parcel_aboard: bool


@dataclass(frozen=True, slots=True)
class Truth:
    """The true state, for evaluation and display; never for an autopilot or a companion.

    `usable_wh` is the energy that the battery can deliver until cut-off at the power of a hover
    without parcel (the reference draw). `airborne` is false while any weight is on the ground.
    """

    t_s: float
    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    wind_to_ned_mps: Vec3
    power_w: float
    energy_used_wh: float
    usable_wh: float
    charge_frac: float
    parcel_aboard: bool
    airborne: bool
    motors_failed: bool
    crashed: bool
