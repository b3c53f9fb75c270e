"""Faults of atmosphere and sensors: wind fronts, low air density, GNSS and compass errors."""

import math
from collections.abc import Iterator

import numpy as np

from sim_bridge.app.faults.fault import (
    AIRBORNE_PHASES_BEFORE_LANDING,
    FaultGroup,
    start_at_once,
)
from sim_bridge.app.flight.stage import FaultContext
from sim_bridge.app.flight.vehicle_process import location_ne_m
from sim_bridge.app.link.tap import message_with_changed_fields
from sim_bridge.app.world.vehicle_host import EXCHANGE_S
from sim_bridge.autopilot.base.readings import Readings
from sim_bridge.autopilot.mavlink.codec import Message

FAULTS = FaultGroup("air and sensors")

FRONT_WIND_RISE_MPS = 7.0
"""Added to the flight's wind of 5 m/s: a headwind of 12 m/s on the return leg."""

FRONT_DURATION_S = 10.0
"""Rise time of a gust front: tens of seconds for a cold front, seconds for an outflow."""

GNSS_JUMP_M = 30.0
GNSS_DRIFT_MPS = 0.3
YAW_SPIN_RPS = math.radians(90.0)
COMPASS_ERROR_RAD = math.radians(30.0)
DRIFT_STEPS = 200
ICED_FACTOR = 1.1
OBSERVED_SHARE = 0.6
"""Share of an injected error that is observed despite gusts and noise of the sensors."""

TILT_FIELDS = ("roll", "pitch")


def _depot_to_customer_unit_vector_ne(stage: FaultContext) -> tuple[float, float]:
    """Return the unit vector from depot to customer: direction to which a headwind home blows."""
    craft = stage.craft
    north, east = location_ne_m(craft.flight.site.customer, craft.depot)
    distance_m = math.hypot(north, east)
    return north / distance_m, east / distance_m


def ramp_up_return_headwind(
    stage: FaultContext, final_increase_mps: float, ramp_duration_s: float
) -> Iterator[None]:
    """Increase the return leg's headwind by `final_increase_mps` over `ramp_duration_s`."""
    north, east = _depot_to_customer_unit_vector_ne(stage)
    vehicle = stage.craft.vehicle
    limit_mps = OBSERVED_SHARE * final_increase_mps
    stage.expect_change("another wind", lambda: vehicle.truth.wind_to_ned_mps, by=limit_mps)
    steps = max(round(ramp_duration_s / EXCHANGE_S), 1)
    for step in range(1, steps + 1):
        speed = final_increase_mps * step / steps
        vehicle.wind_field.front_to_ne_mps = (speed * north, speed * east)
        yield


@FAULTS.register_procedure(32, "front", ("outbound", "drop", "return"))
def inject_return_headwind_front(stage: FaultContext) -> Iterator[None]:
    """A front: the headwind of the return leg rises to 12 m/s within 10 s."""
    yield from stage.wait_for_phase_and_record_fault_start()
    yield from ramp_up_return_headwind(stage, FRONT_WIND_RISE_MPS, FRONT_DURATION_S)


def _readings(stage: FaultContext) -> Readings:
    readings = stage.craft.autopilot.state.readings
    assert readings is not None
    return readings


def _expect_gnss_error(stage: FaultContext, offset_m: float) -> None:
    """Require that the autopilot's GNSS error changes by most of `offset_m`."""
    vehicle = stage.craft.vehicle
    stage.expect_change(
        "a GNSS error",
        lambda: np.subtract(_readings(stage).pos_ned_m, vehicle.pos_ned_m),
        by=OBSERVED_SHARE * offset_m,
    )


@FAULTS.register_procedure(35, "gnss-jump", AIRBORNE_PHASES_BEFORE_LANDING)
def offset_gnss_for_20_s(stage: FaultContext) -> Iterator[None]:
    """GNSS positions are offset by 30 m for 20 s."""
    yield from stage.wait_for_phase_and_record_fault_start()
    direction_rad = stage.rng.uniform(0.0, 2.0 * math.pi)
    sensors = stage.craft.vehicle.sensors
    _expect_gnss_error(stage, GNSS_JUMP_M)
    sensors.gnss_offset_ned_m = (
        GNSS_JUMP_M * math.cos(direction_rad),
        GNSS_JUMP_M * math.sin(direction_rad),
        0.0,
    )
    yield from stage.wait(20.0)
    sensors.gnss_offset_ned_m = (0.0, 0.0, 0.0)


@FAULTS.register_procedure(36, "gnss-drift", AIRBORNE_PHASES_BEFORE_LANDING)
def ramp_up_gnss_offset(stage: FaultContext) -> Iterator[None]:
    """GNSS positions drift by 6 m within 20 s and keep that offset."""
    yield from stage.wait_for_phase_and_record_fault_start()
    direction_rad = stage.rng.uniform(0.0, 2.0 * math.pi)
    sensors = stage.craft.vehicle.sensors
    _expect_gnss_error(stage, DRIFT_STEPS * EXCHANGE_S * GNSS_DRIFT_MPS)
    for step in range(1, DRIFT_STEPS + 1):
        offset_m = GNSS_DRIFT_MPS * EXCHANGE_S * step
        sensors.gnss_offset_ned_m = (
            offset_m * math.cos(direction_rad),
            offset_m * math.sin(direction_rad),
            0.0,
        )
        yield


@FAULTS.register_procedure(37, "attitude-frozen", ("outbound", "drop"))
def freeze_attitude_and_ramp_up_headwind(stage: FaultContext) -> Iterator[None]:
    """Reported roll and pitch freeze while the return leg's headwind rises by 7 m/s."""
    yield from stage.wait_for_phase_and_record_fault_start()
    first_messages: list[Message] = []

    def freeze_roll_and_pitch(message: Message) -> list[Message] | None:
        if message.msg_name != "ATTITUDE":
            return None
        first_messages.append(message)
        return [
            message_with_changed_fields(
                message, **{name: getattr(first_messages[0], name) for name in TILT_FIELDS}
            )
        ]

    stage.expect_messages_changed("ATTITUDE")
    stage.tap.to_companion = freeze_roll_and_pitch
    yield from ramp_up_return_headwind(stage, FRONT_WIND_RISE_MPS, 60.0)


@FAULTS.register_procedure(38, "compass-off", AIRBORNE_PHASES_BEFORE_LANDING)
def add_compass_heading_bias(stage: FaultContext) -> Iterator[None]:
    """The compass has an error of 30 degrees."""
    yield from stage.wait_for_phase_and_record_fault_start()
    craft = stage.craft

    def read_heading_error() -> tuple[float, float]:
        error_rad = _readings(stage).yaw_rad - craft.vehicle.truth.yaw_rad
        return math.cos(error_rad), math.sin(error_rad)

    stage.expect_change(
        "a heading error", read_heading_error, by=OBSERVED_SHARE * COMPASS_ERROR_RAD
    )
    craft.vehicle.sensors.heading_bias_rad += stage.rng.choice([-1.0, 1.0]) * COMPASS_ERROR_RAD


@FAULTS.register_procedure(34, "yaw-spin", AIRBORNE_PHASES_BEFORE_LANDING)
def spin_vehicle_about_yaw(stage: FaultContext) -> Iterator[None]:
    """The vehicle spins about its yaw axis for 20 s."""
    yield from stage.wait_for_phase_and_record_fault_start()
    vehicle = stage.craft.vehicle
    limit_rps = OBSERVED_SHARE * YAW_SPIN_RPS
    stage.expect_change("a yaw rate", lambda: _readings(stage).yawspeed_rps, by=limit_rps)
    vehicle.yaw_spin_rps = YAW_SPIN_RPS * stage.rng.choice([-1.0, 1.0])
    yield from stage.wait(20.0)
    vehicle.yaw_spin_rps = None


@FAULTS.register_procedure(39, "icing", AIRBORNE_PHASES_BEFORE_LANDING)
def ramp_up_drag_and_draw_by_icing(stage: FaultContext) -> Iterator[None]:
    """Icing: within a minute drag rises to 1.5 times and power draw to 1.4 times."""
    yield from stage.wait_for_phase_and_record_fault_start()
    vehicle = stage.craft.vehicle
    stage.expect_effect(
        "drag and draw", lambda: vehicle.drag_factor > ICED_FACTOR < vehicle.draw_factor
    )
    steps = round(60.0 / EXCHANGE_S)
    for step in range(1, steps + 1):
        vehicle.drag_factor = 1.0 + 0.5 * step / steps
        vehicle.draw_factor = 1.0 + 0.4 * step / steps
        yield


HIGH_DENSITY_ALTITUDE = {
    "site": {"depot": {"alt_amsl_m": 3000.0}},
    "vehicle": {"temperature_c": 40.0},
}
SHEAR_WIND = {"kind": "steady", "speed_mps": 5.0, "from_deg": 70.0, "turbulence": "dryden"}

THIN_AIR_KGPM3 = 0.9


def _is_wind_sheared(stage: FaultContext) -> bool:
    field = stage.craft.vehicle.wind_field
    low, high = (math.hypot(*field.mean_wind_to_ne_mps(stage.t_s, h)) for h in (5.0, 30.0))
    return high > 1.5 * low


FAULTS.add_case(
    31, "hot-and-high", "A depot at 3,000 m and 40 degrees C.",
    start_at_once("thin air", lambda stage: stage.craft.vehicle.density_kgpm3 < THIN_AIR_KGPM3),
    ("ready",),
    flight=HIGH_DENSITY_ALTITUDE,
)  # fmt: skip
FAULTS.add_case(
    33, "shear", "Wind profile of a town: power law with exponent 0.4.",
    start_at_once("wind that rises with height", _is_wind_sheared),
    ("ready",), flight={"wind": SHEAR_WIND | {"profile_exponent": 0.4}},
)  # fmt: skip
