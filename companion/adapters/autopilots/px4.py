"""PX4: its modes, streams, commands and parameters, and which of its values to distrust.

Measured on PX4 1.18 (docs/reference/autopilots.md): VFR_HUD.airspeed is NaN without a sensor.
WIND_COV comes only with drag fusion and points where the wind blows TO. Integer parameters lie
bitwise in the float. Mission items count from 0. It jumps by MISSION_SET_CURRENT only.
"""

import math
from typing import Any

from companion.adapters.autopilots.codec import CurrentMode, mavlink
from companion.core.mission.events import AutopilotKind, AutopilotWind, Event, Mode
from companion.core.mission.preflight_checks import Requirement, RouteFacts, Values, known

MAIN_NAMES = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
}
AUTO = 4
AUTO_NAMES = {
    1: "AUTO.READY",
    2: "AUTO.TAKEOFF",
    3: "AUTO.HOLD",
    4: "AUTO.MISSION",
    5: "AUTO.RTL",
    6: "AUTO.LAND",
    8: "AUTO.FOLLOW",
    9: "AUTO.PRECLAND",
}
AUTO_MODE_OF = {2: Mode.TAKEOFF, 3: Mode.HOLD, 4: Mode.MISSION, 5: Mode.RTL, 6: Mode.LAND}
AUTO_NUMBER_OF = {mode: number for number, mode in AUTO_MODE_OF.items()}
OFFBOARD = 6

STREAMS = (
    # HEARTBEAT stays at 1 Hz whatever is asked (MavlinkReceiver::set_message_interval refuses it):
    # a pilot's take-over would show up to a second late. CURRENT_MODE comes with every change.
    ("CURRENT_MODE", CurrentMode.id, 10.0, False),
    ("ATTITUDE", mavlink.MAVLINK_MSG_ID_ATTITUDE, 20.0, True),
    ("GLOBAL_POSITION_INT", mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 10.0, True),
    ("SYS_STATUS", mavlink.MAVLINK_MSG_ID_SYS_STATUS, 2.0, True),
    ("BATTERY_STATUS", mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 2.0, False),
    ("GPS_RAW_INT", mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 2.0, True),
    ("VFR_HUD", mavlink.MAVLINK_MSG_ID_VFR_HUD, 5.0, False),
    ("EXTENDED_SYS_STATE", mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 2.0, True),
    ("ESTIMATOR_STATUS", mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS, 1.0, False),
    ("SYSTEM_TIME", mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 1.0, False),
    ("SCALED_PRESSURE", mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, 1.0, False),
    ("HOME_POSITION", mavlink.MAVLINK_MSG_ID_HOME_POSITION, 0.5, False),
    ("WIND_COV", mavlink.MAVLINK_MSG_ID_WIND_COV, 2.0, False),
)

UNWANTED_STREAMS = (
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
    mavlink.MAVLINK_MSG_ID_ODOMETRY,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
    mavlink.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET,
)
TRUST_PARAMETERS = ("EKF2_DRAG_CTRL", "SYS_HAS_NUM_ASPD", "SENS_EN_MS4525DO")


LINKS = tuple((f"MAV_{n}_CONFIG", f"MAV_{n}_FORWARD") for n in range(3))
"""PX4's MAVLink instances: whether one runs, and whether it passes messages on to the others."""


class Px4:
    """What is special about PX4 multirotors."""

    autopilot_kind = AutopilotKind.PX4
    home_items = 0
    free_yaw: float = math.nan  # 0 would be a heading: north
    bytewise_parameters = True
    reads_any_item = False
    streams: tuple[tuple[str, int, float, bool], ...] = STREAMS
    trust_parameters: tuple[str, ...] = TRUST_PARAMETERS
    unwanted_streams: tuple[int, ...] = UNWANTED_STREAMS

    def mode(self, custom_mode: int, base_mode: int) -> tuple[Mode, str]:
        """Return what a heartbeat's mode means, and its name."""
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        if main == AUTO:
            return AUTO_MODE_OF.get(sub, Mode.OTHER), AUTO_NAMES.get(sub, f"AUTO.{sub}")
        name = MAIN_NAMES.get(main, f"mode {main}.{sub}")
        return (Mode.GUIDED if main == OFFBOARD else Mode.OTHER), name

    def mode_params(self, mode: Mode) -> tuple[float, float, float]:
        """Return DO_SET_MODE's parameters."""
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        if mode is Mode.GUIDED:
            return (custom, float(OFFBOARD), 0.0)
        return (custom, float(AUTO), float(AUTO_NUMBER_OF[mode]))

    def jump(self, system_id: int, seq: int) -> tuple[Any, int | None]:
        """Return the message that jumps to an item; nothing acknowledges it but MISSION_CURRENT."""
        message = mavlink.MAVLink_mission_set_current_message(
            system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, seq
        )
        return message, None

    def has_pitot(self, values: Values) -> bool:
        """Tell whether VFR_HUD.airspeed comes from a sensor (it is NaN otherwise)."""
        return bool(values.get("SYS_HAS_NUM_ASPD") or values.get("SENS_EN_MS4525DO"))

    def wind(self, message: Any, values: Values, t_s: float) -> list[Event]:
        """Take WIND_COV: it is sent only with drag fusion; accuracies of 0 are unknown."""
        if message.get_type() != "WIND_COV":
            return []
        if not (math.isfinite(message.wind_x) and math.isfinite(message.wind_y)):
            return []
        spread = message.var_horiz if math.isfinite(message.var_horiz) else 0.0
        std_mps = math.sqrt(spread) if spread > 0.0 else None
        return [AutopilotWind(t_s, float(message.wind_x), float(message.wind_y), std_mps)]

    def position_ok(self, flags: int) -> bool:
        """Judge ESTIMATOR_STATUS flags."""
        need = mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_VELOCITY_HORIZ
        return (flags & need) == need

    def requirements(self, facts: RouteFacts) -> tuple[Requirement, ...]:
        """Return what the promise asks of PX4's parameters."""
        fence_m = math.ceil(facts.farthest_m + 200.0)
        return (
            _at_least(
                "COM_LOW_BAT_ACT", 2.0, 3.0, "a low-battery action of the autopilot's own", True
            ),
            Requirement(
                ("BAT1_CAPACITY",),
                f"a percentage that counts from the pack's {facts.battery_capacity_mah:.0f} mAh",
                lambda v: known(
                    v, "BAT1_CAPACITY", lambda x: abs(x / facts.battery_capacity_mah - 1.0) < 0.1
                ),
                lambda v: {"BAT1_CAPACITY": facts.battery_capacity_mah},
                False,
            ),
            _near("BAT1_N_CELLS", float(facts.battery_cells), "number of cells"),
            Requirement(
                ("NAV_RCL_ACT", "COM_RCL_EXCEPT"),
                "a mission that goes on when the remote control is lost",
                lambda v: (
                    True
                    if v.get("NAV_RCL_ACT") == 0.0
                    else known(v, "COM_RCL_EXCEPT", lambda x: bool(int(x) & 1))
                ),
                lambda v: {"COM_RCL_EXCEPT": float(int(v.get("COM_RCL_EXCEPT") or 0) | 1)},
                True,
            ),
            Requirement(
                ("NAV_DLL_ACT", "COM_DLL_EXCEPT"),
                "a mission that goes on when the ground station is lost",
                lambda v: (
                    True
                    if int(v.get("COM_DLL_EXCEPT") or 0) & 1
                    else known(v, "NAV_DLL_ACT", lambda x: x == 0.0)
                ),
                lambda v: {"NAV_DLL_ACT": 0.0},
                True,
            ),
            Requirement(
                ("RTL_RETURN_ALT",),
                facts.rtl_words,
                lambda v: known(v, "RTL_RETURN_ALT", lambda x: facts.is_rtl_height(x + 1e-6)),
                lambda v: {"RTL_RETURN_ALT": math.ceil(facts.rtl_height_m)},
                True,
            ),
            Requirement(
                ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", "GF_ACTION"),
                "a fence that holds the whole mission",
                lambda v: _inside_fence(v, facts),
                lambda v: {
                    "GF_MAX_HOR_DIST": float(fence_m) if v.get("GF_MAX_HOR_DIST") else 0.0,
                    "GF_MAX_VER_DIST": math.ceil(
                        max(facts.cruise_height_m, facts.rtl_height_m) + 30.0
                    )
                    if v.get("GF_MAX_VER_DIST")
                    else 0.0,
                },
                True,
            ),
            Requirement(
                ("MIS_DIST_1WP",),
                "a first waypoint that the autopilot does not call too far",
                lambda v: (
                    v.get("MIS_DIST_1WP") is None
                    or (v.get("MIS_DIST_1WP") or 0.0) <= 0.0
                    or (v.get("MIS_DIST_1WP") or 0.0) > facts.first_waypoint_m
                ),
                lambda v: {"MIS_DIST_1WP": math.ceil(facts.first_waypoint_m + 100.0)},
                True,
            ),
            Requirement(
                ("NAV_MC_ALT_RAD",),
                _height_words(facts),
                lambda v: _takes_in_height(v, facts),
                lambda v: {"NAV_MC_ALT_RAD": facts.taken_within_m},
                True,
            ),
            Requirement(
                ("PD_GRIPPER_EN", "PD_GRIPPER_TYPE"),
                "a gripper that lets the parcel go",
                lambda v: not facts.carries_parcel or _has_gripper(v),
                _switch_gripper_on,
                True,
            ),
            _at_least(
                "MPC_XY_VEL_MAX",
                facts.max_ground_mps,
                facts.max_ground_mps,
                f"leave to fly as fast as the energy model thinks ({facts.max_ground_mps:g} m/s)",
                True,
            ),
            _near("MPC_TILTMAX_AIR", facts.max_tilt_deg, "tilt limit", True),
            _near("MPC_TKO_SPEED", facts.climb_mps, "take-off speed"),
            _near("MPC_Z_V_AUTO_UP", facts.climb_mps, "climb speed"),
            _near("MPC_Z_V_AUTO_DN", facts.descent_mps, "descent speed"),
            _near("MPC_LAND_SPEED", facts.landing_mps, "landing speed"),
            Requirement(
                ("COM_OBL_RC_ACT", "COM_OF_LOSS_T"),
                "a return to launch when set-points stop",
                lambda v: not facts.set_points or _offboard_loss_returns(v),
                lambda v: {"COM_OBL_RC_ACT": 3.0, "COM_OF_LOSS_T": 1.0},
                True,
            ),
            _at_least("COM_DISARM_LAND", 0.1, 2.0, "disarming by itself after a landing", False),
            Requirement(
                tuple(name for pair in LINKS for name in pair),
                "messages forwarded between ground station and companion: MAV_n_FORWARD = 1 on"
                " both links, then reboot",
                lambda v: not any(v.get(config) and v.get(on) == 0.0 for config, on in LINKS),
                lambda _: {},
                False,
            ),
        )


def _at_least(name: str, least: float, wanted: float, words: str, required: bool) -> Requirement:
    return Requirement(
        (name,),
        words,
        lambda v: known(v, name, lambda x: x >= least - 1e-6),
        lambda v: {name: wanted},
        required,
    )


def _near(name: str, wanted: float, words: str, required: bool = False) -> Requirement:
    return Requirement(
        (name,),
        f"the {words} that the energy model knows ({wanted:g})",
        lambda v: known(v, name, lambda x: abs(x - wanted) <= 0.02 * wanted),
        lambda v: {name: wanted},
        required,
    )


def _takes_in_height(values: Values, facts: RouteFacts) -> bool | None:
    """Not from so far above that a release after its hold would be too high; on slopes as much.

    PX4 takes an item within NAV_MC_ALT_RAD of its height only. Past one that it does not take it
    flies on (1.18 before pull request 28409; seen on SIH).
    """
    height_m = values.get("NAV_MC_ALT_RAD")
    if height_m is None:
        return None if facts.slopes else True
    least_m = facts.taken_within_m if facts.slopes else 0.0
    return least_m - 1e-3 <= height_m <= facts.taken_within_m + 1e-3


def _height_words(facts: RouteFacts) -> str:
    if facts.slopes:
        return f"waypoints of sloping legs taken within {facts.taken_within_m:g} m of their height"
    return f"items taken within {facts.taken_within_m:g} m of their height"


def _inside_fence(values: Values, facts: RouteFacts) -> bool | None:
    """0 switches a limit off; GF_ACTION 0 switches the fence off."""
    if values.get("GF_ACTION") == 0.0:
        return True
    radius_m, top_m = values.get("GF_MAX_HOR_DIST"), values.get("GF_MAX_VER_DIST")
    if radius_m and radius_m < facts.farthest_m + 20.0:
        return False
    return not (top_m and top_m < facts.cruise_height_m + 10.0)


def _offboard_loss_returns(values: Values) -> bool | None:
    """COM_OBL_RC_ACT 3: return; without a pilot's radio PX4 returns anyway (measured)."""
    action, loss_s = values.get("COM_OBL_RC_ACT"), values.get("COM_OF_LOSS_T")
    return None if action is None or loss_s is None else action == 3.0 and loss_s <= 1.0


def _has_gripper(values: Values) -> bool | None:
    """PX4 up to 1.15 switches it on by PD_GRIPPER_EN; 1.18 has only the type (-1: none; flown)."""
    enabled = values.get("PD_GRIPPER_EN")
    if enabled is not None:
        return enabled > 0.0
    return known(values, "PD_GRIPPER_TYPE", lambda x: x >= 0.0)


def _switch_gripper_on(values: Values) -> dict[str, float]:
    if values.get("PD_GRIPPER_EN") is not None:
        return {"PD_GRIPPER_EN": 1.0}
    return {"PD_GRIPPER_TYPE": 0.0}
