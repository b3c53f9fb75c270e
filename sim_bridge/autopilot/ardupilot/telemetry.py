"""What ArduCopter sends: the messages that only it has, its groups of streams."""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.mavlink import status

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot


def has_airspeed_sensor(ap: "Autopilot") -> bool:
    """Whether a pitot is fitted and configured."""
    fitted = ap.readings is not None and ap.readings.airspeed_mps is not None
    return fitted and ap.params["ARSPD_TYPE"] > 0


def wind(ap: "Autopilot") -> status.Fields:
    """WIND: where it blows FROM. Without an estimate: direction -180, speed 0, in any wind."""
    estimate = ap.wind
    if estimate is None or estimate.flown_s == 0.0:
        return {"direction": -180.0, "speed": 0.0, "speed_z": 0.0}
    return {
        "direction": math.degrees(math.atan2(-estimate.east_mps, -estimate.north_mps)),
        "speed": math.hypot(estimate.north_mps, estimate.east_mps),
        "speed_z": 0.0,
    }


def hud_airspeed_mps(ap: "Autopilot") -> float:
    """VFR_HUD.airspeed: sensor (forward axis), else velocity through the estimated air.

    Without a wind estimate that is the 3-D velocity over ground.
    """
    if has_airspeed_sensor(ap) and ap.readings is not None:
        return ap.readings.airspeed_mps or 0.0
    vn, ve, vd = ap.vel_ned_mps
    if ap.wind is not None and ap.wind.flown_s > 0.0:
        vn, ve = vn - ap.wind.north_mps, ve - ap.wind.east_mps
    return math.sqrt(vn * vn + ve * ve + vd * vd)


def airspeed(ap: "Autopilot") -> status.Fields | None:
    """AIRSPEED, from a sensor only."""
    if not has_airspeed_sensor(ap) or ap.readings is None:
        return None
    speed = ap.readings.airspeed_mps or 0.0
    return {
        "id": 0,
        "airspeed": speed,
        "temperature": round(ap.readings.temperature_c * 100.0),
        "raw_press": 0.5 * 1.225 * speed * speed,
        "flags": 2,
    }


def ekf_status_report(ap: "Autopilot") -> status.Fields:
    """EKF_STATUS_REPORT."""
    lost = 0.0 if ap.has_position else 1.0
    return {
        "flags": int(status.ekf_flags(ap)),
        "velocity_variance": 0.05 + lost,
        "pos_horiz_variance": 0.05 + lost,
        "pos_vert_variance": 0.03,
        "compass_variance": 0.02,
        "terrain_alt_variance": 0.0,
        "airspeed_variance": 0.0,
    }


STREAMS: dict[str, status.Builder] = {
    **status.COMMON,
    "WIND": wind,
    "AIRSPEED": airspeed,
    "EKF_STATUS_REPORT": ekf_status_report,
    "RAW_IMU": status.raw_imu,
    "POWER_STATUS": status.power_status,
    "MEMINFO": status.meminfo,
}

_GROUPS = {
    1: ("RAW_IMU",),
    2: (
        "SYS_STATUS",
        "POWER_STATUS",
        "MEMINFO",
        "MISSION_CURRENT",
        "GPS_RAW_INT",
        "NAV_CONTROLLER_OUTPUT",
    ),
    3: ("SERVO_OUTPUT_RAW", "RC_CHANNELS"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE",),
    11: ("VFR_HUD",),
    12: ("SYSTEM_TIME", "WIND", "BATTERY_STATUS", "EKF_STATUS_REPORT", "VIBRATION"),
}


def data_stream(stream_id: int) -> tuple[str, ...]:
    """Messages of a MAV_DATA_STREAM; 0 is all of them."""
    if stream_id == 0:
        return tuple(name for group in _GROUPS.values() for name in group)
    return _GROUPS.get(stream_id, ())
