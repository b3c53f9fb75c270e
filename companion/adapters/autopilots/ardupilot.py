"""ArduCopter: modes, streams, commands and parameters, and its unreliable values.

Measured on ArduCopter 4.7-dev (docs/reference/autopilots.md): WIND is sent even when the wind is
unknown (direction -180, speed 0). VFR_HUD.airspeed is the ground speed without a sensor. Parameters
are integers cast to float. Mission item 0 is the autopilot's home. Jumps use
DO_SET_MISSION_CURRENT.
"""

import math
from collections.abc import Callable
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, mavlink
from companion.core.mission.events import AutopilotKind, AutopilotWind, Event, Mode
from companion.core.mission.preflight_checks import (
    ParameterRequirement,
    ParameterValues,
    RouteProperties,
    battery_capacity_requirement,
    evaluate_parameter,
    single_parameter_requirement,
)

MODE_NAMES = {
    number: entry.name.removeprefix("COPTER_MODE_")
    for number, entry in mavlink.enums["COPTER_MODE"].items()
} | {29: "RATE_ACRO"}
"""Names of the flight modes; the dialect lacks that of 4.7."""

MODE_OF = {3: Mode.MISSION, 4: Mode.GUIDED, 5: Mode.HOLD, 6: Mode.RTL, 9: Mode.LAND}
NUMBER_OF = {mode: number for number, mode in MODE_OF.items()}

STREAMS = (
    # A pilot override appears in the heartbeat: 1 Hz would be late.
    ("HEARTBEAT", mavlink.MAVLINK_MSG_ID_HEARTBEAT, 4.0, False),
    ("ATTITUDE", mavlink.MAVLINK_MSG_ID_ATTITUDE, 10.0, True),
    ("GLOBAL_POSITION_INT", mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 10.0, True),
    ("SYS_STATUS", mavlink.MAVLINK_MSG_ID_SYS_STATUS, 2.0, True),
    ("BATTERY_STATUS", mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 2.0, False),
    ("MISSION_CURRENT", mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, 5.0, True),
    ("GPS_RAW_INT", mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 2.0, True),
    ("VFR_HUD", mavlink.MAVLINK_MSG_ID_VFR_HUD, 5.0, False),
    ("EXTENDED_SYS_STATE", mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 2.0, True),
    ("EKF_STATUS_REPORT", mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, 1.0, False),
    ("SYSTEM_TIME", mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 1.0, False),
    ("SCALED_PRESSURE", mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, 1.0, False),
    ("HOME_POSITION", mavlink.MAVLINK_MSG_ID_HOME_POSITION, 0.5, False),
    ("WIND", mavlink.MAVLINK_MSG_ID_WIND, 2.0, False),
)

TRUST_PARAMETERS = ("EK3_DRAG_BCOEF_X", "EK3_DRAG_BCOEF_Y", "ARSPD_TYPE")
"""Parameters that indicate whether wind and airspeed are measured."""

EKF_POSITION_OK = mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_VELOCITY_HORIZ
EKF_NOT_READY = mavlink.ESTIMATOR_CONST_POS_MODE


DESCRIBED_BY = (
    ("capacity_mah", "BATT_CAPACITY", 1.0),
    ("cruise_airspeed_mps", "WP_SPD", 1.0),
    ("cruise_airspeed_mps", "WPNAV_SPEED", 0.01),
    ("climb_mps", "WP_SPD_UP", 1.0),
    ("climb_mps", "WPNAV_SPEED_UP", 0.01),
    ("descent_mps", "WP_SPD_DN", 1.0),
    ("descent_mps", "WPNAV_SPEED_DN", 0.01),
    ("landing_mps", "LAND_SPD_MS", 1.0),
    ("landing_mps", "LAND_SPEED", 0.01),
    ("max_tilt_deg", "ATC_ANGLE_MAX", 1.0),
    ("max_tilt_deg", "ANGLE_MAX", 0.01),
    ("rtl_height_m", "RTL_ALT_M", 1.0),
    ("rtl_height_m", "RTL_ALT", 0.01),
    ("frame", "FRAME_CLASS", 1.0),
    ("frame", "FRAME_TYPE", 1.0),
    ("gripper", "GRIP_ENABLE", 1.0),
    ("fence", "FENCE_ENABLE", 1.0),
    ("fence", "FENCE_TYPE", 1.0),
    ("fence", "FENCE_RADIUS", 1.0),
    ("fence", "FENCE_ALT_MAX", 1.0),
)


class ArduPilot:
    """The profile of ArduCopter."""

    autopilot_kind = AutopilotKind.ARDUPILOT
    home_item_count = 1
    free_yaw: float = 0.0  # ArduCopter refuses NaN in TAKEOFF (AP_Mission::sanity_check_params)
    bytewise_parameters = False
    supports_parallel_reads = True
    streams: tuple[tuple[str, int, float, bool], ...] = STREAMS
    trust_parameters: tuple[str, ...] = TRUST_PARAMETERS
    described_by: tuple[tuple[str, str, float], ...] = DESCRIBED_BY
    unwanted_streams: tuple[int, ...] = ()

    def decode_mode(self, custom_mode: int, base_mode: int) -> tuple[Mode, str]:
        """Return the meaning and the name of a heartbeat's mode."""
        name = MODE_NAMES.get(custom_mode, f"mode {custom_mode}")
        return MODE_OF.get(custom_mode, Mode.OTHER), name

    def set_mode_command_params(self, mode: Mode) -> tuple[float, float, float]:
        """Return DO_SET_MODE's parameters."""
        return (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(NUMBER_OF[mode]), 0.0)

    def jump_message_and_ack_command(
        self, system_id: int, seq: int, *, is_restart: bool
    ) -> tuple[Any, int | None]:
        """Return the message that jumps to an item, and the command of its acknowledgement."""
        command, params = mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, (seq, is_restart, *([0] * 5))
        message = mavlink.MAVLink_command_long_message(
            system_id, AUTOPILOT, command, 0, *map(float, params)
        )
        return message, command

    def has_pitot(self, values: ParameterValues) -> bool:
        """Return True if VFR_HUD.airspeed comes from a sensor."""
        return bool(values.get("ARSPD_TYPE"))

    def trusted_wind_events(self, message: Any, values: ParameterValues, t_s: float) -> list[Event]:
        """Use WIND only if drag fusion is enabled and it is not the default -180/0."""
        if message.get_type() != "WIND" or message.speed <= 0.0:
            return []
        if not (values.get("EK3_DRAG_BCOEF_X") or values.get("EK3_DRAG_BCOEF_Y")):
            return []
        if not (math.isfinite(message.speed) and math.isfinite(message.direction)):
            return []
        from_rad = math.radians(message.direction)
        return [
            AutopilotWind(
                t_s, -message.speed * math.cos(from_rad), -message.speed * math.sin(from_rad)
            )
        ]

    def is_position_estimate_ok(self, estimator_flags: int) -> bool:
        """Check EKF_STATUS_REPORT flags (measured: 167 at 36 s was not ready, 831 was)."""
        return (
            estimator_flags & EKF_POSITION_OK
        ) == EKF_POSITION_OK and not estimator_flags & EKF_NOT_READY

    def parameter_requirements(
        self, route_data: RouteProperties
    ) -> tuple[ParameterRequirement, ...]:
        """Return the requirements of the return guarantee on ArduCopter's parameters."""
        battery = (
            "BATT" if not route_data.battery_monitor else f"BATT{route_data.battery_monitor + 1}"
        )
        return (
            _require_bits_set(
                "AUTO_OPTIONS", 3, "arming in AUTO and take-off without raising the throttle"
            ),
            single_parameter_requirement(
                "MIS_RESTART",
                "a mission that resumes at its last item after a detour",
                lambda x: x == 0.0,
                0.0,
            ),
            ParameterRequirement(
                ("FS_THR_ENABLE", "FS_OPTIONS"),
                "a mission that continues after a loss of remote control",
                lambda v: _does_mission_continue_after_link_loss(v, "FS_THR_ENABLE", 1),
                lambda v: {"FS_OPTIONS": float(int(v.get("FS_OPTIONS") or 0) | 1)},
                True,
            ),
            ParameterRequirement(
                ("FS_GCS_ENABLE", "FS_OPTIONS"),
                "a mission that continues after a loss of the ground station",
                lambda v: _does_mission_continue_after_link_loss(v, "FS_GCS_ENABLE", 2),
                lambda v: {"FS_OPTIONS": float(int(v.get("FS_OPTIONS") or 0) | 3)},
                True,
            ),
            single_parameter_requirement(
                f"{battery}_FS_LOW_ACT",
                "a low-battery action of the autopilot",
                lambda x: x > 0.0,
                2.0,
            ),
            single_parameter_requirement(
                f"{battery}_LOW_VOLT",
                f"a low-battery voltage near the pack's cut-off ({route_data.battery_low_v:.1f} V)",
                lambda x: (
                    0.97 * route_data.battery_cutoff_v <= x <= route_data.battery_low_v + 0.05
                ),
                round(route_data.battery_low_v, 2),
            ),
            battery_capacity_requirement(f"{battery}_CAPACITY", route_data),
            _require_rtl_height(route_data),
            ParameterRequirement(
                ("FENCE_ENABLE", "FENCE_TYPE", "FENCE_RADIUS", "FENCE_ALT_MAX"),
                "a geofence around the whole mission",
                lambda v: _is_route_inside_fence(v, route_data),
                lambda v: {
                    "FENCE_RADIUS": math.ceil(route_data.farthest_m + 200.0),
                    "FENCE_ALT_MAX": route_data.fence_height_to_set_m,
                },
                True,
            ),
            ParameterRequirement(
                ("GRIP_ENABLE",),
                "an enabled gripper",
                lambda v: (
                    not route_data.carries_parcel
                    or evaluate_parameter(v, "GRIP_ENABLE", lambda x: x > 0.0)
                ),
                lambda v: {"GRIP_ENABLE": 1.0},
                True,
            ),
            _require_value_under_either_name(
                "ANGLE_MAX", "ATC_ANGLE_MAX", route_data.max_tilt_deg, "tilt limit", required=True
            ),
            _require_value_under_either_name(
                "WPNAV_SPEED_UP", "WP_SPD_UP", route_data.climb_mps, "climb speed"
            ),
            _require_value_under_either_name(
                "WPNAV_SPEED_DN", "WP_SPD_DN", route_data.descent_mps, "descent speed"
            ),
            _require_value_under_either_name(
                "LAND_SPEED", "LAND_SPD_MS", route_data.landing_mps, "landing speed"
            ),
            ParameterRequirement(
                ("GUID_TIMEOUT",),
                "a stop when set-points end",
                lambda v: (
                    not route_data.uses_setpoints
                    or evaluate_parameter(v, "GUID_TIMEOUT", lambda x: 0.0 < x <= 3.0)
                ),
                lambda v: {"GUID_TIMEOUT": 3.0},
                True,
            ),
            ParameterRequirement(
                ARMING_CHECKS,
                "the autopilot's own arming checks",
                lambda v: _are_all_arming_checks_on(v) is not False,
                lambda v: {"ARMING_CHECK": 1.0, "ARMING_SKIPCHK": 0.0},
                False,
            ),
        )


ARMING_CHECKS = ("ARMING_SKIPCHK", "ARMING_CHECK")
"""Checks to skip (since 4.7; -1: all), or checks to run (up to 4.6; 1: all, 0: none)."""


def _are_all_arming_checks_on(values: ParameterValues) -> bool | None:
    """Return whether no arming check is off; `None` if the autopilot reports neither parameter."""
    skipped, run = (values.get(name) for name in ARMING_CHECKS)
    if skipped is not None:
        return skipped == 0.0
    return None if run is None else bool(int(run) & 1)


def _require_bits_set(parameter_name: str, bits: int, description: str) -> ParameterRequirement:
    return ParameterRequirement(
        (parameter_name,),
        description,
        lambda v: evaluate_parameter(v, parameter_name, lambda x: int(x) & bits == bits),
        lambda v: {parameter_name: float(int(v.get(parameter_name) or 0) | bits)},
        True,
    )


def _does_mission_continue_after_link_loss(
    values: ParameterValues, enable_parameter_name: str, fs_options_bit: int
) -> bool | None:
    """Check FS_OPTIONS bit 0: continue in AUTO without RC; bit 1: without the ground station."""
    if values.get(enable_parameter_name) == 0.0:
        return True
    return evaluate_parameter(values, "FS_OPTIONS", lambda x: bool(int(x) & fs_options_bit))


def _require_rtl_height(route_data: RouteProperties) -> ParameterRequirement:
    # RTL_ALT 0 returns at the current height, which fails where the cruise is below an obstacle.
    need_m = route_data.rtl_height_to_set_m
    names = "RTL_ALT", "RTL_ALT_M"
    return ParameterRequirement(
        names,
        route_data.rtl_requirement_text,
        lambda v: _evaluate_under_either_name(v, names, route_data.is_clear_rtl_height),
        lambda v: {} if need_m is None else {"RTL_ALT": need_m * 100.0, "RTL_ALT_M": need_m},
        True,
    )


def _is_route_inside_fence(values: ParameterValues, route_data: RouteProperties) -> bool | None:
    enabled = values.get("FENCE_ENABLE")
    if not enabled:
        return True
    kind = int(values.get("FENCE_TYPE") or 0)
    radius_m, top_m = values.get("FENCE_RADIUS"), values.get("FENCE_ALT_MAX")
    if kind & 2 and (radius_m is None or radius_m < route_data.farthest_m + 20.0):
        return False
    return not (kind & 1 and (top_m is None or top_m < route_data.cruise_height_m + 10.0))


def _evaluate_under_either_name(
    values: ParameterValues, names: tuple[str, str], is_acceptable: Callable[[float], bool]
) -> bool | None:
    """Evaluate a value by its name since 4.7, or its old name (in centi-units)."""
    centi, raw = (values.get(name) for name in names)
    value = raw if raw is not None else None if centi is None else centi / 100.0
    return None if value is None else is_acceptable(value)


def _require_value_under_either_name(
    old_name_in_centi_units: str,
    new_name: str,
    target_value: float,
    description: str,
    *,
    required: bool = False,
) -> ParameterRequirement:
    """Require a value under its old name (in centi-units) or its name since 4.7."""
    names = old_name_in_centi_units, new_name
    return ParameterRequirement(
        names,
        f"the {description} of the energy model ({target_value:g})",
        lambda v: _evaluate_under_either_name(
            v, names, lambda x: abs(x - target_value) <= 0.02 * target_value
        ),
        lambda v: {old_name_in_centi_units: round(target_value * 100.0), new_name: target_value},
        required,
    )
