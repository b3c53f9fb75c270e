"""PX4: modes, streams, commands and parameters, and its unreliable values.

Measured on PX4 1.18 (docs/reference/autopilots.md): VFR_HUD.airspeed is NaN without a sensor.
WIND_COV is sent only with drag fusion and points where the wind blows TO. Integer parameters are
stored bitwise in the float. Mission items count from 0. Jumps use MISSION_SET_CURRENT only.
"""

import math
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, CurrentMode, mavlink
from companion.core.mission.events import AutopilotKind, AutopilotWind, Event, Mode
from companion.core.mission.preflight_checks import (
    ParameterRequirement,
    ParameterValues,
    RouteProperties,
    battery_capacity_requirement,
    evaluate_parameter,
    single_parameter_requirement,
)

MAIN_NAMES = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
    9: "SIMULATION",
    10: "TERMINATION",
    11: "ALTITUDE_CRUISE",
}
POSITION_NAMES = {1: "ORBIT", 2: "POSITION_SLOW"}
POSITION_MODE = 3
AUTO_MODE = 4
AUTO_NAMES = {
    1: "AUTO.READY",
    2: "AUTO.TAKEOFF",
    3: "AUTO.HOLD",
    4: "AUTO.MISSION",
    5: "AUTO.RTL",
    6: "AUTO.LAND",
    8: "AUTO.FOLLOW",
    9: "AUTO.PRECLAND",
    10: "AUTO.VTOL_TAKEOFF",
    **{number: f"AUTO.EXTERNAL{number - 10}" for number in range(11, 19)},
    20: "AUTO.DESCEND",
}
"""Names of commander/px4_custom_mode.h; DESCEND was measured on main of 13 August 2026."""

AUTO_MODE_OF = {2: Mode.TAKEOFF, 3: Mode.HOLD, 4: Mode.MISSION, 5: Mode.RTL, 6: Mode.LAND}
AUTO_NUMBER_OF = {mode: number for number, mode in AUTO_MODE_OF.items()}
DESCEND_MODE = 20
"""Landing without a position; earlier versions report it as AUTO.LAND."""

OFFBOARD_MODE = 6

STREAMS = (
    # HEARTBEAT stays at 1 Hz (MavlinkReceiver::set_message_interval refuses other rates), so a
    # pilot override would appear up to a second late. CURRENT_MODE is sent at every change.
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


SUPPLY_CHECK_OFF = 894281.0
"""Value of CBRK_SUPPLY_CHK that disables the check before arming."""

MAVLINK_INSTANCES = tuple((f"MAV_{n}_CONFIG", f"MAV_{n}_FORWARD") for n in range(3))
"""PX4's MAVLink instances: the parameters that enable each and that enable its forwarding."""


DESCRIBED_BY = (
    ("cells", "BAT1_N_CELLS", 1.0),
    ("capacity_mah", "BAT1_CAPACITY", 1.0),
    ("cruise_airspeed_mps", "MPC_XY_CRUISE", 1.0),
    ("max_ground_mps", "MPC_XY_VEL_MAX", 1.0),
    ("climb_mps", "MPC_Z_V_AUTO_UP", 1.0),
    ("descent_mps", "MPC_Z_V_AUTO_DN", 1.0),
    ("landing_mps", "MPC_LAND_SPEED", 1.0),
    ("max_tilt_deg", "MPC_TILTMAX_AIR", 1.0),
    ("rtl_height_m", "RTL_RETURN_ALT", 1.0),
    ("frame", "SYS_AUTOSTART", 1.0),
    ("gripper", "PD_GRIPPER_EN", 1.0),
    ("gripper", "PD_GRIPPER_TYPE", 1.0),
    ("fence", "GF_ACTION", 1.0),
    ("fence", "GF_MAX_HOR_DIST", 1.0),
    ("fence", "GF_MAX_VER_DIST", 1.0),
    *(("forwarding", name, 1.0) for pair in MAVLINK_INSTANCES for name in pair),
)


class Px4:
    """The profile of PX4 multirotors."""

    autopilot_kind = AutopilotKind.PX4
    home_item_count = 0
    free_yaw: float = math.nan  # 0 would be a heading: north
    bytewise_parameters = True
    supports_parallel_reads = False
    streams: tuple[tuple[str, int, float, bool], ...] = STREAMS
    trust_parameters: tuple[str, ...] = TRUST_PARAMETERS
    described_by: tuple[tuple[str, str, float], ...] = DESCRIBED_BY
    unwanted_streams: tuple[int, ...] = UNWANTED_STREAMS

    def decode_mode(self, custom_mode: int, base_mode: int) -> tuple[Mode, str]:
        """Return the meaning and the name of a heartbeat's mode."""
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        unknown = f"mode {main}.{sub}"
        if main == AUTO_MODE:
            mode = Mode.LAND if sub == DESCEND_MODE else AUTO_MODE_OF.get(sub, Mode.OTHER)
            return mode, AUTO_NAMES.get(sub, unknown)
        name = MAIN_NAMES.get(main, unknown)
        if main == POSITION_MODE:
            name = POSITION_NAMES.get(sub, name)
        return (Mode.GUIDED if main == OFFBOARD_MODE else Mode.OTHER), name

    def set_mode_command_params(self, mode: Mode) -> tuple[float, float, float]:
        """Return DO_SET_MODE's parameters."""
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        if mode is Mode.GUIDED:
            return (custom, float(OFFBOARD_MODE), 0.0)
        return (custom, float(AUTO_MODE), float(AUTO_NUMBER_OF[mode]))

    def jump_message_and_ack_command(
        self, system_id: int, seq: int, *, is_restart: bool
    ) -> tuple[Any, int | None]:
        """Return the message that jumps to an item; only MISSION_CURRENT confirms it.

        It also restarts a completed mission.
        """
        return mavlink.MAVLink_mission_set_current_message(system_id, AUTOPILOT, seq), None

    def has_pitot(self, values: ParameterValues) -> bool:
        """Return True if VFR_HUD.airspeed comes from a sensor (it is NaN otherwise)."""
        return bool(values.get("SYS_HAS_NUM_ASPD") or values.get("SENS_EN_MS4525DO"))

    def trusted_wind_events(self, message: Any, values: ParameterValues, t_s: float) -> list[Event]:
        """Use WIND_COV: it is sent only with drag fusion; accuracies of 0 are unknown."""
        if message.get_type() != "WIND_COV":
            return []
        if not (math.isfinite(message.wind_x) and math.isfinite(message.wind_y)):
            return []
        spread = message.var_horiz if math.isfinite(message.var_horiz) else 0.0
        std_mps = math.sqrt(spread) if spread > 0.0 else None
        return [AutopilotWind(t_s, float(message.wind_x), float(message.wind_y), std_mps)]

    def is_position_estimate_ok(self, estimator_flags: int) -> bool:
        """Check ESTIMATOR_STATUS flags."""
        need = mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_VELOCITY_HORIZ
        return (estimator_flags & need) == need

    def parameter_requirements(
        self, route_data: RouteProperties
    ) -> tuple[ParameterRequirement, ...]:
        """Return the requirements of the return guarantee on PX4's parameters."""
        fence_m = math.ceil(route_data.farthest_m + 200.0)
        battery = f"BAT{route_data.battery_monitor + 1}"
        sloped_or_all_items = "sloping legs' waypoints" if route_data.is_sloped else "items"
        return (
            _require_at_least("COM_LOW_BAT_ACT", 2.0, 3.0, "a low-battery action of the autopilot"),
            battery_capacity_requirement(f"{battery}_CAPACITY", route_data),
            _require_within_two_percent(
                f"{battery}_N_CELLS", float(route_data.battery_cells), "number of cells"
            ),
            ParameterRequirement(
                ("NAV_RCL_ACT", "COM_RCL_EXCEPT"),
                "a mission that continues after a loss of remote control",
                lambda v: (
                    True
                    if v.get("NAV_RCL_ACT") == 0.0
                    else evaluate_parameter(v, "COM_RCL_EXCEPT", lambda x: bool(int(x) & 1))
                ),
                lambda v: {"COM_RCL_EXCEPT": float(int(v.get("COM_RCL_EXCEPT") or 0) | 1)},
                True,
            ),
            ParameterRequirement(
                ("NAV_DLL_ACT", "COM_DLL_EXCEPT"),
                "a mission that continues after a loss of the ground station",
                lambda v: (
                    True
                    if int(v.get("COM_DLL_EXCEPT") or 0) & 1
                    else evaluate_parameter(v, "NAV_DLL_ACT", lambda x: x == 0.0)
                ),
                lambda v: {"NAV_DLL_ACT": 0.0},
                True,
            ),
            ParameterRequirement(
                ("RTL_RETURN_ALT",),
                route_data.rtl_requirement_text,
                lambda v: evaluate_parameter(
                    v, "RTL_RETURN_ALT", lambda x: route_data.is_clear_rtl_height(x + 1e-6)
                ),
                lambda _: (
                    {}
                    if (height_m := route_data.rtl_height_to_set_m) is None
                    else {"RTL_RETURN_ALT": height_m}
                ),
                True,
            ),
            ParameterRequirement(
                ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", "GF_ACTION"),
                "a geofence around the whole mission",
                lambda v: _is_route_inside_fence(v, route_data),
                lambda v: {
                    "GF_MAX_HOR_DIST": float(fence_m) if v.get("GF_MAX_HOR_DIST") else 0.0,
                    "GF_MAX_VER_DIST": route_data.fence_height_to_set_m
                    if v.get("GF_MAX_VER_DIST")
                    else 0.0,
                },
                True,
            ),
            ParameterRequirement(
                ("MIS_DIST_1WP",),
                "a first waypoint within the autopilot's distance limit",
                lambda v: (
                    (x := v.get("MIS_DIST_1WP") or 0.0) <= 0.0 or x > route_data.first_waypoint_m
                ),
                lambda v: {"MIS_DIST_1WP": math.ceil(route_data.first_waypoint_m + 100.0)},
                True,
            ),
            ParameterRequirement(
                ("NAV_MC_ALT_RAD",),
                f"{sloped_or_all_items} reached within"
                f" {route_data.waypoint_height_tolerance_m:g} m of their height",
                lambda v: _is_altitude_radius_ok(v, route_data),
                lambda v: {"NAV_MC_ALT_RAD": route_data.waypoint_height_tolerance_m},
                True,
            ),
            ParameterRequirement(
                ("PD_GRIPPER_EN", "PD_GRIPPER_TYPE"),
                "an enabled gripper",
                lambda v: not route_data.carries_parcel or _is_gripper_enabled(v),
                _gripper_enable_values,
                True,
            ),
            _require_at_least(
                "MPC_XY_VEL_MAX",
                route_data.max_ground_mps,
                route_data.max_ground_mps,
                f"a speed limit no lower than the energy model's ({route_data.max_ground_mps:g}"
                " m/s)",
            ),
            _require_within_two_percent(
                "MPC_TILTMAX_AIR", route_data.max_tilt_deg, "tilt limit", required=True
            ),
            _require_within_two_percent("MPC_TKO_SPEED", route_data.climb_mps, "take-off speed"),
            _require_within_two_percent("MPC_Z_V_AUTO_UP", route_data.climb_mps, "climb speed"),
            _require_within_two_percent("MPC_Z_V_AUTO_DN", route_data.descent_mps, "descent speed"),
            _require_within_two_percent("MPC_LAND_SPEED", route_data.landing_mps, "landing speed"),
            ParameterRequirement(
                ("COM_OBL_RC_ACT", "COM_OF_LOSS_T"),
                "a return to launch when set-points end",
                lambda v: not route_data.uses_setpoints or _does_offboard_loss_trigger_return(v),
                lambda v: {"COM_OBL_RC_ACT": 3.0, "COM_OF_LOSS_T": 1.0},
                True,
            ),
            ParameterRequirement(
                ("CBRK_SUPPLY_CHK",),
                "the autopilot's own checks of the power supply",
                lambda v: v.get("CBRK_SUPPLY_CHK") != SUPPLY_CHECK_OFF,
                lambda v: {"CBRK_SUPPLY_CHK": 0.0},
                False,
            ),
            _require_at_least(
                "COM_DISARM_LAND", 0.1, 2.0, "automatic disarming after a landing", required=False
            ),
            ParameterRequirement(
                tuple(name for pair in MAVLINK_INSTANCES for name in pair),
                "messages forwarded between ground station and companion",
                lambda v: not _forwarding_to_enable(v),
                _forwarding_to_enable,
                False,
                needs_reboot=True,
            ),
        )


def _forwarding_to_enable(values: ParameterValues) -> dict[str, float]:
    """Return MAV_n_FORWARD = 1 for each instance in use that forwards nothing."""
    return {on: 1.0 for used, on in MAVLINK_INSTANCES if values.get(used) and values.get(on) == 0.0}


def _require_at_least(
    parameter_name: str,
    lowest_accepted_value: float,
    target_value: float,
    description: str,
    *,
    required: bool = True,
) -> ParameterRequirement:
    return single_parameter_requirement(
        parameter_name,
        description,
        lambda x: x >= lowest_accepted_value - 1e-6,
        target_value,
        is_blocking=required,
    )


def _require_within_two_percent(
    parameter_name: str, target_value: float, description: str, *, required: bool = False
) -> ParameterRequirement:
    description = f"the {description} of the energy model ({target_value:g})"
    return single_parameter_requirement(
        parameter_name,
        description,
        lambda x: abs(x - target_value) <= 0.02 * target_value,
        target_value,
        is_blocking=required,
    )


def _is_altitude_radius_ok(values: ParameterValues, route_data: RouteProperties) -> bool | None:
    """Check NAV_MC_ALT_RAD: small enough for a low release, on slopes also large enough.

    PX4 accepts an item only within NAV_MC_ALT_RAD of its height. It flies past an item that it does
    not accept (1.18 before pull request 28409; observed on SIH).
    """
    height_m = values.get("NAV_MC_ALT_RAD")
    if height_m is None:
        return None if route_data.is_sloped else True
    least_m = route_data.waypoint_height_tolerance_m if route_data.is_sloped else 0.0
    return least_m - 1e-3 <= height_m <= route_data.waypoint_height_tolerance_m + 1e-3


def _is_route_inside_fence(values: ParameterValues, route_data: RouteProperties) -> bool | None:
    """A limit of 0 is disabled; GF_ACTION 0 disables the fence."""
    if values.get("GF_ACTION") == 0.0:
        return True
    radius_m, top_m = values.get("GF_MAX_HOR_DIST"), values.get("GF_MAX_VER_DIST")
    if radius_m and radius_m < route_data.farthest_m + 20.0:
        return False
    return not (top_m and top_m < route_data.cruise_height_m + 10.0)


def _does_offboard_loss_trigger_return(values: ParameterValues) -> bool | None:
    """Check for COM_OBL_RC_ACT 3: return; without RC PX4 returns in any case (measured)."""
    action, loss_s = values.get("COM_OBL_RC_ACT"), values.get("COM_OF_LOSS_T")
    return None if action is None or loss_s is None else action == 3.0 and loss_s <= 1.0


def _is_gripper_enabled(values: ParameterValues) -> bool | None:
    """Check the gripper: up to 1.15 PD_GRIPPER_EN enables it; 1.18 has only the type (-1: none)."""
    enabled = values.get("PD_GRIPPER_EN")
    if enabled is not None:
        return enabled > 0.0
    return evaluate_parameter(values, "PD_GRIPPER_TYPE", lambda x: x >= 0.0)


def _gripper_enable_values(values: ParameterValues) -> dict[str, float]:
    if values.get("PD_GRIPPER_EN") is not None:
        return {"PD_GRIPPER_EN": 1.0}
    return {"PD_GRIPPER_TYPE": 0.0}
