"""Translate telemetry messages to core events; units are converted once, unknown is `None`."""

import math
from typing import Any, Protocol

from companion.adapters.autopilots.codec import COMPONENT, mavlink
from companion.core.base.safe_text import safe_text
from companion.core.mission.events import (
    CONTROL_CLAIM,
    CONTROL_CLAIM_STEP_S,
    AirPressure,
    Airspeed,
    ArmingReadiness,
    Attitude,
    AutopilotKind,
    AutopilotText,
    Battery,
    EstimatorHealth,
    Event,
    GnssFix,
    GnssTime,
    GroundState,
    Home,
    ItemReached,
    MissionProgress,
    MissionState,
    MissionWriteDetected,
    Mode,
    ModeReport,
    OtherCompanionReport,
    Position,
    ReleaseFeedback,
    Throttle,
    VehicleLandedState,
    VehicleState,
)
from companion.core.mission.preflight_checks import (
    ParameterRequirement,
    ParameterValues,
    RouteProperties,
)
from companion.core.vehicle.air import HIGHEST_AMSL_M, LOWEST_AMSL_M
from companion.core.vehicle.airframe import MULTIROTOR

READY_STATES = (
    mavlink.MAV_STATE_STANDBY,
    mavlink.MAV_STATE_ACTIVE,
    mavlink.MAV_STATE_CRITICAL,
    mavlink.MAV_STATE_EMERGENCY,
)
GROUND_OF_LANDED_STATE = {
    mavlink.MAV_LANDED_STATE_ON_GROUND: VehicleLandedState.ON_GROUND,
    mavlink.MAV_LANDED_STATE_IN_AIR: VehicleLandedState.IN_AIR,
    mavlink.MAV_LANDED_STATE_TAKEOFF: VehicleLandedState.TAKEOFF,
    mavlink.MAV_LANDED_STATE_LANDING: VehicleLandedState.LANDING,
}
MULTIROTORS = (
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_COAXIAL,
    mavlink.MAV_TYPE_DECAROTOR,
    mavlink.MAV_TYPE_DODECAROTOR,
)
SHORT_VEHICLE_NAMES = {"surface boat": "boat", "ground rover": "rover"}
PREARM_CHECK = mavlink.MAV_SYS_STATUS_PREARM_CHECK
MIN_UNIX_S = 1.0e9  # 2001: before that a clock counts from its own start
NON_MOTOR_PACKS = (mavlink.MAV_BATTERY_FUNCTION_AVIONICS, mavlink.MAV_BATTERY_FUNCTION_PAYLOAD)
"""Battery functions that do not supply motors."""
UNKNOWN_U16 = 65535
MISSION_CHANGED_TEXT = "Auto mission changed"
"""ArduCopter's STATUSTEXT when an item near the current one was rewritten."""
RELEASED_TEXT = "Gripper load released"
"""ArduCopter's STATUSTEXT at the end of a release."""

UNKNOWN_I16 = 32767
MISSION_STATES = dict(enumerate(MissionState, start=1))
"""State by MISSION_CURRENT.mission_state; 0 is unknown."""


class AutopilotProfile(Protocol):
    """The differences between PX4 and ArduPilot in messages sent and understood.

    `ArduPilot` and `Px4` implement it.
    """

    autopilot_kind: AutopilotKind
    home_item_count: int
    free_yaw: float
    bytewise_parameters: bool
    supports_parallel_reads: bool
    streams: tuple[tuple[str, int, float, bool], ...]
    unwanted_streams: tuple[int, ...]
    trust_parameters: tuple[str, ...]
    described_by: tuple[tuple[str, str, float], ...]
    """Parameters that describe the vehicle: quantity, name and factor to SI or degrees. Of several
    for one quantity the first that is known and above 0 counts."""

    def decode_mode(self, custom_mode: int, base_mode: int) -> tuple[Mode, str]: ...
    def set_mode_command_params(self, mode: Mode) -> tuple[float, float, float]: ...
    def jump_message_and_ack_command(
        self, system_id: int, seq: int, *, is_restart: bool
    ) -> tuple[Any, int | None]: ...
    def has_pitot(self, values: ParameterValues) -> bool: ...
    def trusted_wind_events(
        self, message: Any, values: ParameterValues, t_s: float
    ) -> list[Event]: ...
    def is_position_estimate_ok(self, estimator_flags: int) -> bool: ...
    def parameter_requirements(
        self, route_data: RouteProperties
    ) -> tuple[ParameterRequirement, ...]: ...


def vehicle_kind(mav_type: int) -> str | None:
    """Return the vehicle kind of a MAV_TYPE; `None` for generic or unknown types."""
    if mav_type in MULTIROTORS:
        return MULTIROTOR
    entry = mavlink.enums["MAV_TYPE"].get(mav_type)
    if entry is None or mav_type == mavlink.MAV_TYPE_GENERIC:
        return None
    name = entry.name.removeprefix("MAV_TYPE_").lower().replace("_", " ")
    return "VTOL" if name.startswith("vtol") else SHORT_VEHICLE_NAMES.get(name, name)


def message_time_since_boot_s(message: Any) -> float | None:
    """Return the time since boot in a message, `None` if it has none."""
    stamp_ms = getattr(message, "time_boot_ms", None)
    if stamp_ms is None or (message.get_type() == "SYSTEM_TIME" and stamp_ms == 0):
        return None
    return stamp_ms / 1000.0


def events_from_message(
    message: Any, profile: AutopilotProfile, values: ParameterValues, t_s: float
) -> list[Event]:
    """Return the events of a message of the autopilot; none if it holds nothing usable."""
    match message.get_type():
        case "HEARTBEAT":
            mode, name = profile.decode_mode(message.custom_mode, message.base_mode)
            return [
                VehicleState(
                    t_s,
                    mode,
                    name,
                    armed=bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
                    failsafe=message.system_status
                    in (mavlink.MAV_STATE_CRITICAL, mavlink.MAV_STATE_EMERGENCY),
                    ready_state=message.system_status in READY_STATES,
                )
            ]
        case "CURRENT_MODE":
            return [ModeReport(t_s, *profile.decode_mode(message.custom_mode, 0))]
        case "ATTITUDE":
            angles = (message.roll, message.pitch, message.yaw)
            roll_rps, pitch_rps, yaw_rps = (
                rate if math.isfinite(rate) else None
                for rate in (message.rollspeed, message.pitchspeed, message.yawspeed)
            )
            known = all(map(math.isfinite, angles))
            rates = (roll_rps, pitch_rps)
            return [Attitude(t_s, *angles, yaw_rps, tilt_rates_rps=rates)] if known else []
        case "GLOBAL_POSITION_INT":
            return _position_events(message, t_s)
        case "GPS_RAW_INT":
            return [_gnss_fix(message, t_s)]
        case "SYS_STATUS":
            return _system_status_events(message, t_s)
        case "BATTERY_STATUS":
            return _battery_events(message, t_s)
        case "VFR_HUD":
            return _vfr_hud_events(message, profile, values, t_s)
        case "SCALED_PRESSURE":
            return _pressure_events(message, t_s)
        case "MISSION_CURRENT":
            return [_mission_progress(message, profile, t_s)]
        case "MISSION_ITEM_REACHED":
            index = message.seq - profile.home_item_count
            return [ItemReached(t_s, index)] if index >= 0 else []
        case "EXTENDED_SYS_STATE":
            ground = GROUND_OF_LANDED_STATE.get(message.landed_state)
            return [] if ground is None else [GroundState(t_s, ground)]
        case "HOME_POSITION":
            return _home_events(message, t_s)
        case "EKF_STATUS_REPORT" | "ESTIMATOR_STATUS":
            return [EstimatorHealth(t_s, profile.is_position_estimate_ok(message.flags))]
        case "SYSTEM_TIME":
            return _gnss_time_events(message, t_s)
        case "WIND" | "WIND_COV":
            return profile.trusted_wind_events(message, values, t_s)
        case "STATUSTEXT":
            text = safe_text(message.text.strip())
            events: list[Event] = [AutopilotText(t_s, message.severity, text)]
            if text.startswith(MISSION_CHANGED_TEXT):
                events.append(MissionWriteDetected(t_s, text))
            elif text == RELEASED_TEXT:
                events.append(ReleaseFeedback(t_s))
            return events
        case _:
            return []


def _gnss_fix(message: Any, t_s: float) -> Event:
    """The height's accuracy is a MAVLink 2 extension: 0 from those that do not send it."""
    usable = message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX
    satellites = None if message.satellites_visible == 255 else message.satellites_visible
    if not usable or (message.lat == 0 and message.lon == 0):
        return GnssFix(t_s, usable, satellites)
    std_m = message.v_acc / 1000.0 or None
    lat_lon_deg = (message.lat * 1e-7, message.lon * 1e-7)
    return GnssFix(t_s, usable, satellites, message.alt / 1000.0, std_m, lat_lon_deg)


def _position_events(message: Any, t_s: float) -> list[Event]:
    if message.lat == 0 and message.lon == 0:
        return []  # no position yet: both autopilots send zeros
    if not (abs(message.lat) <= 900_000_000 and abs(message.lon) <= 1_800_000_000):
        return []
    if not LOWEST_AMSL_M <= message.alt / 1000.0 <= HIGHEST_AMSL_M:
        return []  # outside the Earth's range, like a latitude of 100 degrees
    return [
        Position(
            t_s,
            message.lat * 1e-7,
            message.lon * 1e-7,
            message.alt / 1000.0,
            message.relative_alt / 1000.0,
            message.vx / 100.0,
            message.vy / 100.0,
            message.vz / 100.0,
        )
    ]


def _pressure_events(message: Any, t_s: float) -> list[Event]:
    """Convert hPa and hundredths of a degree, as both autopilots send; 0 is unknown pressure."""
    pressure_pa = 100.0 * message.press_abs
    if not (math.isfinite(pressure_pa) and pressure_pa > 0.0):
        return []
    return [AirPressure(t_s, pressure_pa, message.temperature / 100.0)]


def _home_events(message: Any, t_s: float) -> list[Event]:
    if message.latitude == 0 and message.longitude == 0:
        return []  # no home yet: ArduCopter without a position sends zeros
    lat_lon_deg = message.latitude * 1e-7, message.longitude * 1e-7
    return [Home(t_s, *lat_lon_deg, message.altitude / 1000.0)]


def _gnss_time_events(message: Any, t_s: float) -> list[Event]:
    """Both stamps are of one instant; before a fix the calendar time is invalid (0, or near it)."""
    unix_s = message.time_unix_usec / 1e6
    return [GnssTime(t_s, unix_s)] if unix_s > MIN_UNIX_S else []


def _system_status_events(message: Any, t_s: float) -> list[Event]:
    events: list[Event] = []
    if message.onboard_control_sensors_present & PREARM_CHECK:
        events.append(
            ArmingReadiness(t_s, bool(message.onboard_control_sensors_health & PREARM_CHECK))
        )
    voltage_mv = message.voltage_battery
    known = 0 < voltage_mv < UNKNOWN_U16
    events.append(
        Battery(
            t_s,
            voltage_v=voltage_mv / 1000.0 if known else None,
            current_a=message.current_battery / 100.0 if message.current_battery >= 0 else None,
            remaining_frac=(
                message.battery_remaining / 100.0 if 0 <= message.battery_remaining <= 100 else None
            ),
        )
    )
    return events


def _battery_events(message: Any, t_s: float) -> list[Event]:
    if message.battery_function in NON_MOTOR_PACKS:
        return []
    # Voltages of the cells: 65535 is "no such cell"; a value of 65534 continues in the next.
    # Cells 11 to 14 are an extension, where 0 is "no such cell".
    cells = [mv for mv in (*message.voltages, *message.voltages_ext) if mv < UNKNOWN_U16]
    voltage_v = sum(cells) / 1000.0 if cells and sum(cells) > 0 else None
    consumed_mah, consumed_hj = message.current_consumed, message.energy_consumed
    current_known = message.current_battery >= 0
    return [
        Battery(
            t_s,
            voltage_v=voltage_v,
            current_a=message.current_battery / 100.0 if current_known else None,
            # Without a current sensor a counter of 0 does not mean no consumption (PX4 SIH).
            consumed_ah=consumed_mah / 1000.0 if consumed_mah >= 0 and current_known else None,
            consumed_j=consumed_hj * 100.0 if consumed_hj >= 0 and current_known else None,
            remaining_frac=(
                message.battery_remaining / 100.0 if 0 <= message.battery_remaining <= 100 else None
            ),
            temperature_c=(
                message.temperature / 100.0 if message.temperature != UNKNOWN_I16 else None
            ),
            pack=message.id,
        )
    ]


def _vfr_hud_events(
    message: Any, profile: AutopilotProfile, values: ParameterValues, t_s: float
) -> list[Event]:
    events: list[Event] = []
    if 0 <= message.throttle <= 100:
        events.append(Throttle(t_s, message.throttle / 100.0))
    if profile.has_pitot(values) and math.isfinite(message.airspeed) and message.airspeed >= 0.0:
        events.append(Airspeed(t_s, float(message.airspeed)))
    return events


def _mission_progress(message: Any, profile: AutopilotProfile, t_s: float) -> Event:
    index = message.seq - profile.home_item_count
    # `total` is a MAVLink 2 extension: 0 from those that do not send it, 65535 for no mission.
    total = {0: None, UNKNOWN_U16: 0}.get(message.total, message.total)
    # MISSION_CURRENT.mission_mode: 0 unknown, 1 in a mission mode, 2 suspended.
    in_mission = {1: True, 2: False}.get(message.mission_mode)
    state, index = MISSION_STATES.get(message.mission_state), index if index >= 0 else None
    return MissionProgress(t_s, index, total, in_mission, _mission_id(message), state)


def _mission_id(message: Any) -> int | None:
    """MISSION_CURRENT.mission_id, an extension newer than the dialect; 0 is unknown.

    MAVLink common.xml, message 42: seq, total, mission_state and mission_mode are 6 bytes; trailing
    zeros of a payload are not sent.
    """
    frame = bytes(message.get_msgbuf() or b"")
    if not frame or frame[0] != mavlink.PROTOCOL_MARKER_V2:
        return None
    payload = frame[mavlink.HEADER_LEN_V2 : mavlink.HEADER_LEN_V2 + frame[1]]
    return int.from_bytes(payload[6:10], "little") or None


def other_companion_events(message: Any, t_s: float) -> list[Event]:
    """Return the state of a second onboard computer: from its heartbeat or its named value.

    ArduPilot forwards no heartbeat to a link that has the same component, so none of a second
    companion arrives here. It forwards named values.
    """
    component = message.get_srcComponent()
    match message.get_type():
        case "HEARTBEAT":
            has_control = bool(message.base_mode & mavlink.MAV_MODE_FLAG_AUTO_ENABLED)
            onboard = message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
            if component != COMPONENT and not (onboard and has_control):
                return []  # neither a companion nor a computer that claims to fly
            status = message.system_status
            return [
                OtherCompanionReport(
                    t_s,
                    active=status not in (mavlink.MAV_STATE_STANDBY, mavlink.MAV_STATE_BOOT),
                    booting=status == mavlink.MAV_STATE_BOOT,
                    component=component,
                    has_control=has_control,
                    control_since_ms=message.custom_mode or None,
                )
            ]
        case "NAMED_VALUE_FLOAT" if message.name == CONTROL_CLAIM and 0.0 <= message.value < 1e7:
            since_ms = round(message.value / CONTROL_CLAIM_STEP_S) * round(
                1000.0 * CONTROL_CLAIM_STEP_S
            )
            claim = {"has_control": since_ms > 0, "control_since_ms": since_ms or None}
            return [OtherCompanionReport(t_s, active=True, component=component, **claim)]
        case _:
            return []
