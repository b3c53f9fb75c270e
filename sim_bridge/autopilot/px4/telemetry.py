"""What PX4 sends: the messages that only it has, and what flows unasked on which link."""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.battery import Px4Cells
from sim_bridge.autopilot.flight.modes import px4_custom_mode
from sim_bridge.autopilot.kinds import BatterySensing, LinkKind
from sim_bridge.autopilot.mavlink import status
from sim_bridge.autopilot.mavlink.parameters import ParameterStore

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_WIND_SHOWN_AFTER_S = 3.0


def cells(params: ParameterStore) -> Px4Cells:
    """BAT1_*."""
    return Px4Cells(
        int(params["BAT1_N_CELLS"]),
        params["BAT1_V_CHARGED"],
        params["BAT1_V_EMPTY"],
        params["BAT1_CAPACITY"],
        params["BAT1_R_INTERNAL"],
    )


def battery_status(ap: "Autopilot") -> status.Fields:
    """BATTERY_STATUS: energy is never known; SIH knows no current and has consumed 0."""
    fields = status.battery_status(ap)
    fields["energy_consumed"] = -1
    if ap.battery_sensing is BatterySensing.SIH_TIMER:
        fields["current_consumed"] = 0
        return fields
    capacity, current = ap.params["BAT1_CAPACITY"], ap.battery.current_avg_a
    remaining = ap.battery_remaining_frac
    if capacity > 0.0 and current > 0.1 and remaining is not None and ap.is_armed:
        fields["time_remaining"] = round(remaining * capacity * 3.6 / current)
    return fields


def wind_cov(ap: "Autopilot") -> status.Fields | None:
    """WIND_COV: where it blows TO; only with drag fusion, and only once it flies."""
    wind = ap.wind
    if wind is None or wind.flown_s < _WIND_SHOWN_AFTER_S:
        return None
    return {
        "time_usec": ap.time_boot_ms * 1000,
        "wind_x": wind.north_mps,
        "wind_y": wind.east_mps,
        "wind_z": 0.0,
        "var_horiz": wind.variance_m2ps2,
        "var_vert": 0.0,
        "wind_alt": ap.frame.alt_amsl_m - ap.pos_ned_m[2],
        "horiz_accuracy": 0.0,
        "vert_accuracy": 0.0,
    }


def altitude(ap: "Autopilot") -> status.Fields:
    """ALTITUDE."""
    down = ap.pos_ned_m[2]
    return {
        "time_usec": ap.time_boot_ms * 1000,
        "altitude_monotonic": ap.frame.alt_amsl_m - down,
        "altitude_amsl": ap.frame.alt_amsl_m - down,
        "altitude_local": ap.ekf_origin_ned_m[2] - down,
        "altitude_relative": ap.home_ned_m[2] - down,
        "altitude_terrain": math.nan,
        "bottom_clearance": math.nan,
    }


def estimator_status(ap: "Autopilot") -> status.Fields:
    """ESTIMATOR_STATUS."""
    good = ap.has_position
    return {
        "time_usec": ap.time_boot_ms * 1000,
        "flags": int(status.ekf_flags(ap)),
        "vel_ratio": 0.05,
        "pos_horiz_ratio": 0.05,
        "pos_vert_ratio": 0.02,
        "mag_ratio": 0.03,
        "hagl_ratio": 0.0,
        "tas_ratio": 0.0,
        "pos_horiz_accuracy": 0.8 if good else 50.0,
        "pos_vert_accuracy": 1.0,
    }


def current_mode(ap: "Autopilot") -> status.Fields:
    """CURRENT_MODE."""
    return {
        "standard_mode": 0,
        "custom_mode": px4_custom_mode(ap.mode),
        "intended_custom_mode": px4_custom_mode(ap.px4.intended_mode(ap)),
    }


STREAMS: dict[str, status.Builder] = {
    **status.COMMON,
    "BATTERY_STATUS": battery_status,
    "WIND_COV": wind_cov,
    "ALTITUDE": altitude,
    "ESTIMATOR_STATUS": estimator_status,
    "CURRENT_MODE": current_mode,
    "HIGHRES_IMU": status.highres_imu,
}
del STREAMS["NAV_CONTROLLER_OUTPUT"]

NOT_ON_REQUEST = frozenset({"MISSION_CURRENT", "HEARTBEAT"})
"""Sent, but at a rate of its own: no interval can be set for it (flown on PX4 1.18)."""

DEFAULT_RATES_HZ = {
    LinkKind.ONBOARD: {
        "HEARTBEAT": 1.0,
        "ATTITUDE": 100.0,
        "GLOBAL_POSITION_INT": 50.0,
        "LOCAL_POSITION_NED": 30.0,
        "VFR_HUD": 10.0,
        "SYS_STATUS": 5.0,
        "EXTENDED_SYS_STATE": 5.0,
        "ESTIMATOR_STATUS": 1.0,
        "GPS_RAW_INT": 8.0,
        "BATTERY_STATUS": 0.5,
        "HOME_POSITION": 0.5,
        "MISSION_CURRENT": 1.0,
        "SYSTEM_TIME": 1.0,
        "ALTITUDE": 10.0,
    },
    LinkKind.GCS: {
        "HEARTBEAT": 1.0,
        "ATTITUDE": 15.0,
        "GLOBAL_POSITION_INT": 5.0,
        "LOCAL_POSITION_NED": 1.0,
        "VFR_HUD": 4.0,
        "SYS_STATUS": 1.0,
        "EXTENDED_SYS_STATE": 1.0,
        "ESTIMATOR_STATUS": 0.5,
        "GPS_RAW_INT": 1.0,
        "BATTERY_STATUS": 0.5,
        "HOME_POSITION": 0.5,
        "MISSION_CURRENT": 1.0,
        "SYSTEM_TIME": 1.0,
        "ALTITUDE": 1.0,
    },
}
"""The rates in the measured facts; the others from PX4, src/modules/mavlink/mavlink_main.cpp
(configure_streams_to_default). Of its onboard profile, HIGHRES_IMU, ATTITUDE_QUATERNION, RC and
servo streams are left out: 130 messages a second that carry nothing a companion lacks."""
