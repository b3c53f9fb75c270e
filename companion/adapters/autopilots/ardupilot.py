"""ArduCopter: its modes, streams, commands and parameters, and which of its values to distrust.

Measured on ArduCopter 4.7-dev (docs/reference/autopilots.md): WIND is sent even where no wind is
known (direction -180, speed 0). VFR_HUD.airspeed is the ground speed unless there is a sensor.
Parameters are integers cast to float. Mission item 0 is its own home. It jumps by
DO_SET_MISSION_CURRENT.
"""

import math
from typing import Any

from companion.adapters.autopilots.codec import mavlink
from companion.core.mission.events import AutopilotKind, AutopilotWind, Event, Mode
from companion.core.mission.preflight_checks import Requirement, RouteFacts, Values, known

MODE_NAMES = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    5: "LOITER",
    6: "RTL",
    7: "CIRCLE",
    9: "LAND",
    11: "DRIFT",
    13: "SPORT",
    16: "POSHOLD",
    17: "BRAKE",
    21: "SMART_RTL",
    27: "AUTO_RTL",
}
MODE_OF = {
    3: Mode.MISSION,
    4: Mode.GUIDED,
    5: Mode.HOLD,
    6: Mode.RTL,
    9: Mode.LAND,
}
NUMBER_OF = {mode: number for number, mode in MODE_OF.items()}

STREAMS = (
    # A pilot's take-over shows in the heartbeat: once a second is late.
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
"""Parameters that tell whether wind and airspeed are real."""

EKF_POSITION_OK = mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_VELOCITY_HORIZ
EKF_NOT_READY = mavlink.ESTIMATOR_CONST_POS_MODE


class ArduPilot:
    """What is special about ArduCopter."""

    autopilot_kind = AutopilotKind.ARDUPILOT
    home_items = 1
    free_yaw: float = 0.0  # it refuses NaN in TAKEOFF (AP_Mission::sanity_check_params)
    bytewise_parameters = False
    reads_any_item = True
    streams: tuple[tuple[str, int, float, bool], ...] = STREAMS
    trust_parameters: tuple[str, ...] = TRUST_PARAMETERS
    unwanted_streams: tuple[int, ...] = ()

    def mode(self, custom_mode: int, base_mode: int) -> tuple[Mode, str]:
        """Return what a heartbeat's mode means, and its name."""
        name = MODE_NAMES.get(custom_mode, f"mode {custom_mode}")
        return MODE_OF.get(custom_mode, Mode.OTHER), name

    def mode_params(self, mode: Mode) -> tuple[float, float, float]:
        """Return DO_SET_MODE's parameters."""
        return (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(NUMBER_OF[mode]), 0.0)

    def jump(self, system_id: int, seq: int) -> tuple[Any, int | None]:
        """Return the message that jumps to an item, and the command that is acknowledged."""
        message = mavlink.MAVLink_command_long_message(
            system_id,
            mavlink.MAV_COMP_ID_AUTOPILOT1,
            mavlink.MAV_CMD_DO_SET_MISSION_CURRENT,
            0,
            float(seq),
            *([0.0] * 6),
        )
        return message, mavlink.MAV_CMD_DO_SET_MISSION_CURRENT

    def has_pitot(self, values: Values) -> bool:
        """Tell whether VFR_HUD.airspeed comes from a sensor."""
        return bool(values.get("ARSPD_TYPE"))

    def wind(self, message: Any, values: Values, t_s: float) -> list[Event]:
        """Take WIND only when drag fusion is on and it is not the default -180/0."""
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

    def position_ok(self, flags: int) -> bool:
        """Judge EKF_STATUS_REPORT flags (167 at 36 s was not ready, 831 was)."""
        return (flags & EKF_POSITION_OK) == EKF_POSITION_OK and not flags & EKF_NOT_READY

    def requirements(self, facts: RouteFacts) -> tuple[Requirement, ...]:
        """Return what the promise asks of ArduCopter's parameters."""
        return (
            _bits("AUTO_OPTIONS", 3, "arming in AUTO and take-off without raising the throttle"),
            _equal("MIS_RESTART", 0.0, "a mission that resumes where it was after a detour"),
            Requirement(
                ("FS_THR_ENABLE", "FS_OPTIONS"),
                "a mission that goes on when the remote control is lost",
                lambda v: _loss_keeps_mission(v, "FS_THR_ENABLE", 1),
                lambda v: {"FS_OPTIONS": float(int(v.get("FS_OPTIONS") or 0) | 1)},
                True,
            ),
            Requirement(
                ("FS_GCS_ENABLE", "FS_OPTIONS"),
                "a mission that goes on when the ground station is lost",
                lambda v: _loss_keeps_mission(v, "FS_GCS_ENABLE", 2),
                lambda v: {"FS_OPTIONS": float(int(v.get("FS_OPTIONS") or 0) | 3)},
                True,
            ),
            Requirement(
                ("BATT_FS_LOW_ACT",),
                "a low-battery action of the autopilot's own",
                lambda v: known(v, "BATT_FS_LOW_ACT", lambda x: x > 0.0),
                lambda v: {"BATT_FS_LOW_ACT": 2.0},
                True,
            ),
            Requirement(
                ("BATT_LOW_VOLT",),
                f"a low-battery voltage near the pack's cut-off ({facts.battery_low_v:.1f} V)",
                lambda v: known(
                    v,
                    "BATT_LOW_VOLT",
                    lambda x: 0.97 * facts.battery_cutoff_v <= x <= facts.battery_low_v + 0.05,
                ),
                lambda v: {"BATT_LOW_VOLT": round(facts.battery_low_v, 2)},
                True,
            ),
            Requirement(
                ("BATT_CAPACITY",),
                f"a percentage that counts from the pack's {facts.battery_capacity_mah:.0f} mAh",
                lambda v: known(
                    v, "BATT_CAPACITY", lambda x: abs(x / facts.battery_capacity_mah - 1.0) < 0.1
                ),
                lambda v: {"BATT_CAPACITY": facts.battery_capacity_mah},
                False,
            ),
            _rtl_height(facts),
            Requirement(
                ("FENCE_ENABLE", "FENCE_TYPE", "FENCE_RADIUS", "FENCE_ALT_MAX"),
                "a fence that holds the whole mission",
                lambda v: _inside_fence(v, facts),
                lambda v: {
                    "FENCE_RADIUS": math.ceil(facts.farthest_m + 200.0),
                    "FENCE_ALT_MAX": math.ceil(
                        max(facts.cruise_height_m, facts.rtl_height_m) + 30.0
                    ),
                },
                True,
            ),
            Requirement(
                ("GRIP_ENABLE",),
                "a gripper that lets the parcel go",
                lambda v: not facts.carries_parcel or known(v, "GRIP_ENABLE", lambda x: x > 0.0),
                lambda v: {"GRIP_ENABLE": 1.0},
                True,
            ),
            _either(
                ("ANGLE_MAX", 100.0),
                ("ATC_ANGLE_MAX", 1.0),
                facts.max_tilt_deg,
                "the tilt limit that the energy model knows",
                required=True,
            ),
            _either(
                ("WPNAV_SPEED_UP", 100.0),
                ("WP_SPD_UP", 1.0),
                facts.climb_mps,
                "the climb speed that the energy model knows",
            ),
            _either(
                ("WPNAV_SPEED_DN", 100.0),
                ("WP_SPD_DN", 1.0),
                facts.descent_mps,
                "the descent speed that the energy model knows",
            ),
            _either(
                ("LAND_SPEED", 100.0),
                ("LAND_SPD_MS", 1.0),
                facts.landing_mps,
                "the landing speed that the energy model knows",
            ),
            Requirement(
                ("GUID_TIMEOUT",),
                "a halt when set-points stop",
                lambda v: (
                    not facts.set_points or known(v, "GUID_TIMEOUT", lambda x: 0.0 < x <= 3.0)
                ),
                lambda v: {"GUID_TIMEOUT": 3.0},
                True,
            ),
            Requirement(
                ("ARMING_CHECK",),
                "the autopilot's own arming checks",
                lambda v: v.get("ARMING_CHECK") is None or bool(v.get("ARMING_CHECK")),
                lambda v: {"ARMING_CHECK": 1.0},
                False,
            ),
        )


def _bits(name: str, bits: int, words: str) -> Requirement:
    return Requirement(
        (name,),
        words,
        lambda v: known(v, name, lambda x: int(x) & bits == bits),
        lambda v: {name: float(int(v.get(name) or 0) | bits)},
        True,
    )


def _equal(name: str, value: float, words: str) -> Requirement:
    return Requirement(
        (name,),
        words,
        lambda v: known(v, name, lambda x: x == value),
        lambda v: {name: value},
        True,
    )


def _loss_keeps_mission(values: Values, enable: str, bit: int) -> bool | None:
    """FS_OPTIONS bit 0: go on in AUTO without RC; bit 1: without the ground station."""
    if values.get(enable) == 0.0:
        return True
    return known(values, "FS_OPTIONS", lambda x: bool(int(x) & bit))


def _rtl_height(facts: RouteFacts) -> Requirement:
    # RTL_ALT 0 returns at the present height, which a cruise height below an obstacle is not.
    need_m = facts.rtl_height_m

    def height(values: Values) -> float | None:
        metres = values.get("RTL_ALT_M")
        centimetres = values.get("RTL_ALT")
        return metres if metres is not None else None if centimetres is None else centimetres / 100

    return Requirement(
        ("RTL_ALT", "RTL_ALT_M"),
        facts.rtl_words,
        lambda v: None if (h := height(v)) is None else facts.is_rtl_height(h),
        lambda v: {"RTL_ALT": math.ceil(need_m) * 100.0, "RTL_ALT_M": float(math.ceil(need_m))},
        True,
    )


def _inside_fence(values: Values, facts: RouteFacts) -> bool | None:
    enabled = values.get("FENCE_ENABLE")
    if not enabled:
        return True
    kind = int(values.get("FENCE_TYPE") or 0)
    radius_m, top_m = values.get("FENCE_RADIUS"), values.get("FENCE_ALT_MAX")
    if kind & 2 and (radius_m is None or radius_m < facts.farthest_m + 20.0):
        return False
    return not (kind & 1 and (top_m is None or top_m < facts.cruise_height_m + 10.0))


def _either(
    old: tuple[str, float],
    new: tuple[str, float],
    wanted: float,
    words: str,
    *,
    required: bool = False,
) -> Requirement:
    """A number under its old name (in centi-units) or the one that 4.7 gave it."""

    def value(values: Values) -> float | None:
        raw = values.get(new[0])
        if raw is not None:
            return raw / new[1]
        raw = values.get(old[0])
        return None if raw is None else raw / old[1]

    return Requirement(
        (old[0], new[0]),
        f"{words} ({wanted:g})",
        lambda v: None if (x := value(v)) is None else abs(x - wanted) <= 0.02 * wanted,
        lambda v: {old[0]: round(wanted * old[1]), new[0]: wanted * new[1]},
        required,
    )
