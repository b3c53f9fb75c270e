"""Reboots: what is kept, how long arming takes, and wind once drag fusion is configured."""

import math
import statistics
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.behaviour import REBOOT, Behaviours, Observation, field_of
from sim_bridge.conform.behaviours.mission import WAYPOINT
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.subject import Subject, observed_once

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

_LEAN_RAD = math.radians(0.4)
_SECONDS = {"unit": "s", "within": 12.0}
_PREARM_BIT = mavlink.MAV_SYS_STATUS_PREARM_CHECK
_DRAG = {
    "ardupilot": {"EK3_DRAG_BCOEF_X": 60.0, "EK3_DRAG_BCOEF_Y": 60.0, "EK3_DRAG_MCOEF": 0.2},
    "px4": {"EKF2_DRAG_CTRL": 1.0, "EKF2_BCOEF_X": 60.0, "EKF2_BCOEF_Y": 60.0, "EKF2_MCOEF": 0.2},
}


def reboot_and_wait(subject: Subject) -> None:
    """PREFLIGHT_REBOOT_SHUTDOWN, until it is back with a clock that began again."""
    client = subject.client
    response = client.send_command_and_wait_ack(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    if response != "ACCEPTED":
        raise ObservationError(f"the reboot is {response}")
    before_s = client.t_s
    client.wait_for_clock_after_reboot(before_s)
    subject.clear_requested_stream_record()
    subject.request_working_streams_once()


@dataclass(frozen=True, slots=True)
class _Boot:
    """Seconds from a boot to the pre-arm bit and to the first arming, and whether items remain."""

    prearm_bit_s: float
    armed_s: float
    is_mission_kept: bool


@observed_once
def _measure_boot(subject: Subject) -> _Boot:
    subject.upload([subject.item(WAYPOINT, 30.0 * n, 0.0, 20.0) for n in range(3)])
    reboot_and_wait(subject)
    kept = missions.request_count(subject.client)
    bit_s = subject.client.wait_until(
        lambda: _is_prearm_bit_set(subject) and subject.client.t_s, 90.0
    )
    subject.request_mode(subject.dialect.hold)
    subject.arm_with_retries()
    armed_s = subject.client.t_s
    subject.request_disarm()
    return _Boot(round(bit_s or math.nan, 1), round(armed_s, 1), (kept or 0) >= 3)


def _is_prearm_bit_set(subject: Subject) -> bool:
    status = subject.client.latest.get("SYS_STATUS")
    return status is not None and bool(status.onboard_control_sensors_health & _PREARM_BIT)


for _name, _description, _field, _tolerance in (
    ("reboot/prearm_bit", "SYS_STATUS's pre-arm bit is up after", "prearm_bit_s", _SECONDS),
    ("reboot/armable", "It arms after", "armed_s", _SECONDS),
    ("reboot/mission_kept", "A mission outlives a reboot", "is_mission_kept", {}),
):
    field = field_of(_measure_boot, _field)
    BEHAVIOURS.add(_name, _description, field, REBOOT, **_tolerance)


@behaviour("reboot/armed", "A reboot while armed is", REBOOT)
def _response_to_reboot_while_armed(subject: Subject) -> str:
    subject.arm_with_retries()
    response = subject.client.send_command_and_wait_ack(
        mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0
    )
    subject.request_disarm()
    return response


@behaviour("reboot/drag_fusion", "With drag coefficients set the wind is", REBOOT)
def _observe_wind_with_drag_fusion(subject: Subject) -> Observation:
    """Wind messages in the hover after a boot with drag coefficients set."""
    name = "WIND_COV" if subject.is_px4 else "WIND"
    try:
        for parameter, value in _DRAG[subject.dialect.name].items():
            subject.parameters.set_until_restored(parameter, value)
        reboot_and_wait(subject)
        subject.take_off_and_wait()
        subject.request_stream(name, 2.0)
        subject.client.collect_messages(30.0)
        message = subject.client.wait_next_message(name, 3.0)
        lean = _mean_hover_lean_ne_rad(subject)
    finally:
        subject.land_and_wait_disarmed()
        subject.parameters.restore()
        reboot_and_wait(subject)
    if message is None:
        return Observation("never sent")
    if subject.is_px4:
        north, east = message.wind_x, message.wind_y
    else:
        from_rad = math.radians(message.direction)
        north, east = message.speed * math.cos(from_rad), message.speed * math.sin(from_rad)
    note = f"{math.hypot(north, east):.1f} m/s, {math.degrees(math.atan2(east, north)):.0f} deg"
    if math.hypot(north, east) < 0.5 or math.hypot(*lean) < _LEAN_RAD:
        return Observation("told, too little to have a direction", note)
    into = north * lean[0] + east * lean[1]
    return Observation(
        "told: where it blows from" if into > 0.0 else "told: where it blows to", note
    )


def _mean_hover_lean_ne_rad(subject: Subject) -> tuple[float, float]:
    """Mean lean in the hover, north and east: a multirotor leans into the wind."""
    attitudes = subject.client.collect_messages(6.0, "ATTITUDE")
    norths = [-m.pitch * math.cos(m.yaw) - m.roll * math.sin(m.yaw) for m in attitudes]
    easts = [-m.pitch * math.sin(m.yaw) + m.roll * math.cos(m.yaw) for m in attitudes]
    return statistics.fmean(norths), statistics.fmean(easts)
