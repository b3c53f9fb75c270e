"""Reboots: what is kept, how long arming takes, and wind once drag fusion is configured."""

import math
import statistics
from typing import cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.behaviour import Behaviour, Finding, Where
from sim_bridge.conform.behaviours.mission import waypoint
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.subject import Subject

_LEAN_RAD = math.radians(0.4)
_PREARM_BIT = mavlink.MAV_SYS_STATUS_PREARM_CHECK
_DRAG = {
    "ardupilot": {"EK3_DRAG_BCOEF_X": 60.0, "EK3_DRAG_BCOEF_Y": 60.0, "EK3_DRAG_MCOEF": 0.2},
    "px4": {"EKF2_DRAG_CTRL": 1.0, "EKF2_BCOEF_X": 60.0, "EKF2_BCOEF_Y": 60.0, "EKF2_MCOEF": 0.2},
}


def reboot(s: Subject) -> None:
    """PREFLIGHT_REBOOT_SHUTDOWN, until it is back with a clock that began again."""
    client = s.client
    answer = client.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    if answer != "ACCEPTED":
        raise CannotSee(f"the reboot is {answer}")
    before_s = client.t_s
    client.wait_for_new_clock(before_s)
    s.forget_intervals()
    s.see()


def _after_boot(s: Subject) -> tuple[float, float, int]:
    """Boot times of the pre-arm bit and of the first arming, and items kept."""

    def look() -> tuple[float, float, int]:
        s.upload([waypoint(s, 30.0 * n, 0.0) for n in range(3)])
        reboot(s)
        kept = missions.count(s.client)
        bit_s = s.client.until(lambda: _prearm_bit(s) and s.client.t_s, 90.0)
        s.set_mode(s.dialect.hold)
        s.arm()
        armed_s = s.client.t_s
        s.disarm_once()
        return bit_s or math.nan, armed_s, -1 if kept is None else kept

    return cast(tuple[float, float, int], s.remember("a reboot", look))


def _prearm_bit(s: Subject) -> bool:
    status = s.client.latest.get("SYS_STATUS")
    return status is not None and bool(status.onboard_control_sensors_health & _PREARM_BIT)


def _bit_after(s: Subject) -> float:
    return round(_after_boot(s)[0], 1)


def _armed_after(s: Subject) -> float:
    return round(_after_boot(s)[1], 1)


def _mission_kept(s: Subject) -> bool:
    return _after_boot(s)[2] >= 3


def _reboot_armed(s: Subject) -> str:
    s.arm()
    answer = s.client.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    s.disarm_once()
    return answer


def _drag_fusion(s: Subject) -> Finding:
    """Wind messages in the hover after a boot with drag coefficients set."""
    name = "WIND_COV" if s.is_px4 else "WIND"
    try:
        for parameter, value in _DRAG[s.dialect.name].items():
            s.set_parameter(parameter, value)
        reboot(s)
        s.take_off()
        s.stream(name, 2.0)
        s.client.collect(30.0)
        message = s.client.hear(name, 3.0)
        lean = _lean(s)
    finally:
        s.land()
        s.restore()
        reboot(s)
    if message is None:
        return Finding("never sent")
    if s.is_px4:
        north, east = message.wind_x, message.wind_y
    else:
        from_rad = math.radians(message.direction)
        north, east = message.speed * math.cos(from_rad), message.speed * math.sin(from_rad)
    note = f"{math.hypot(north, east):.1f} m/s, {math.degrees(math.atan2(east, north)):.0f} deg"
    if math.hypot(north, east) < 0.5 or math.hypot(*lean) < _LEAN_RAD:
        return Finding("told, too little to have a direction", note)
    into = north * lean[0] + east * lean[1]
    return Finding("told: where it blows from" if into > 0.0 else "told: where it blows to", note)


def _lean(s: Subject) -> tuple[float, float]:
    """Mean lean in the hover, north and east: a multirotor leans into the wind."""
    heard = s.client.collect(6.0, "ATTITUDE")
    norths = [-m.pitch * math.cos(m.yaw) - m.roll * math.sin(m.yaw) for m in heard]
    easts = [-m.pitch * math.sin(m.yaw) + m.roll * math.cos(m.yaw) for m in heard]
    return statistics.fmean(norths), statistics.fmean(easts)


BEHAVIOURS = (
    Behaviour("reboot/armed", "A reboot while armed is", _reboot_armed, Where.REBOOT),
    Behaviour(
        "reboot/prearm_bit",
        "SYS_STATUS's pre-arm bit is up after",
        _bit_after,
        Where.REBOOT,
        unit="s",
        within=12.0,
    ),
    Behaviour("reboot/armable", "It arms after", _armed_after, Where.REBOOT, unit="s", within=12.0),
    Behaviour("reboot/mission_kept", "A mission outlives a reboot", _mission_kept, Where.REBOOT),
    Behaviour(
        "reboot/drag_fusion", "With drag coefficients set the wind is", _drag_fusion, Where.REBOOT
    ),
)
