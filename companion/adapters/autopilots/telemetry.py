"""Telemetry messages to core events: units converted once; what is unknown is `None`."""

import math
from typing import Any, Protocol

from companion.adapters.autopilots.codec import mavlink
from companion.core.base.safe_text import safe_text
from companion.core.mission.events import (
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
    Ground,
    GroundState,
    Home,
    ItemReached,
    MissionProgress,
    MissionTouched,
    Mode,
    ModeNow,
    Position,
    Throttle,
    VehicleState,
)
from companion.core.mission.preflight_checks import Requirement, RouteFacts, Values
from companion.core.vehicle.air import HIGHEST_AMSL_M, LOWEST_AMSL_M
from companion.core.vehicle.airframe import MULTIROTOR

READY_STATES = (
    mavlink.MAV_STATE_STANDBY,
    mavlink.MAV_STATE_ACTIVE,
    mavlink.MAV_STATE_CRITICAL,
    mavlink.MAV_STATE_EMERGENCY,
)
GROUND = {
    mavlink.MAV_LANDED_STATE_ON_GROUND: Ground.ON_GROUND,
    mavlink.MAV_LANDED_STATE_IN_AIR: Ground.IN_AIR,
    mavlink.MAV_LANDED_STATE_TAKEOFF: Ground.TAKING_OFF,
    mavlink.MAV_LANDED_STATE_LANDING: Ground.LANDING,
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
PLAIN_NAMES = {"surface boat": "boat", "ground rover": "rover"}
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
LEAST_UNIX_S = 1.0e9  # 2001: before that a clock counts from its own start
OTHER_PACKS = (mavlink.MAV_BATTERY_FUNCTION_AVIONICS, mavlink.MAV_BATTERY_FUNCTION_PAYLOAD)
"""Packs that no motor draws from."""
UNKNOWN_U16 = 65535
MISSION_CHANGED = "Auto mission changed"
"""How ArduCopter tells everybody that an item near the one that it flies was rewritten."""
UNKNOWN_I16 = 32767


class AutopilotProfile(Protocol):
    """What differs between PX4 and ArduPilot in what they send and understand.

    `ArduPilot` and `Px4` implement it.
    """

    autopilot_kind: AutopilotKind
    home_items: int
    free_yaw: float
    bytewise_parameters: bool
    reads_any_item: bool
    streams: tuple[tuple[str, int, float, bool], ...]
    unwanted_streams: tuple[int, ...]
    trust_parameters: tuple[str, ...]

    def mode(self, custom_mode: int, base_mode: int) -> tuple[Mode, str]: ...
    def mode_params(self, mode: Mode) -> tuple[float, float, float]: ...
    def jump(self, system_id: int, seq: int) -> tuple[Any, int | None]: ...
    def has_pitot(self, values: Values) -> bool: ...
    def wind(self, message: Any, values: Values, t_s: float) -> list[Event]: ...
    def position_ok(self, flags: int) -> bool: ...
    def requirements(self, facts: RouteFacts) -> tuple[Requirement, ...]: ...


def vehicle_kind(mav_type: int) -> str | None:
    """What kind of vehicle a MAV_TYPE is; `None` where it does not say (generic, or unknown)."""
    if mav_type in MULTIROTORS:
        return MULTIROTOR
    entry = mavlink.enums["MAV_TYPE"].get(mav_type)
    if entry is None or mav_type == mavlink.MAV_TYPE_GENERIC:
        return None
    name = entry.name.removeprefix("MAV_TYPE_").lower().replace("_", " ")
    return "VTOL" if name.startswith("vtol") else PLAIN_NAMES.get(name, name)


def boot_s(message: Any) -> float | None:
    """Return the time since boot that a message carries, `None` where it carries none."""
    stamp_ms = getattr(message, "time_boot_ms", None)
    if stamp_ms is None or (message.get_type() == "SYSTEM_TIME" and stamp_ms == 0):
        return None
    return stamp_ms / 1000.0


def translate(message: Any, profile: AutopilotProfile, values: Values, t_s: float) -> list[Event]:
    """Return what a message of the autopilot says; nothing where it says nothing usable."""
    match message.get_type():
        case "HEARTBEAT":
            mode, name = profile.mode(message.custom_mode, message.base_mode)
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
            return [ModeNow(t_s, *profile.mode(message.custom_mode, 0))]
        case "ATTITUDE":
            angles = (message.roll, message.pitch, message.yaw)
            rate_rps = message.yawspeed if math.isfinite(message.yawspeed) else None
            known = all(map(math.isfinite, angles))
            return [Attitude(t_s, *angles, rate_rps)] if known else []
        case "GLOBAL_POSITION_INT":
            return _position(message, t_s)
        case "GPS_RAW_INT":
            satellites = message.satellites_visible
            return [
                GnssFix(
                    t_s,
                    message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX,
                    None if satellites == 255 else satellites,
                )
            ]
        case "SYS_STATUS":
            return _system_status(message, t_s)
        case "BATTERY_STATUS":
            return _battery(message, t_s)
        case "VFR_HUD":
            return _hud(message, profile, values, t_s)
        case "SCALED_PRESSURE":
            return _pressure(message, t_s)
        case "MISSION_CURRENT":
            return [_progress(message, profile, t_s)]
        case "MISSION_ITEM_REACHED":
            index = message.seq - profile.home_items
            return [ItemReached(t_s, index)] if index >= 0 else []
        case "EXTENDED_SYS_STATE":
            ground = GROUND.get(message.landed_state)
            return [] if ground is None else [GroundState(t_s, ground)]
        case "HOME_POSITION":
            return _home(message, t_s)
        case "EKF_STATUS_REPORT" | "ESTIMATOR_STATUS":
            return [EstimatorHealth(t_s, profile.position_ok(message.flags))]
        case "SYSTEM_TIME":
            return _gnss_time(message, t_s)
        case "WIND" | "WIND_COV":
            return profile.wind(message, values, t_s)
        case "STATUSTEXT":
            text = safe_text(message.text.strip())
            events: list[Event] = [AutopilotText(t_s, message.severity, text)]
            if text.startswith(MISSION_CHANGED):
                events.append(MissionTouched(t_s, text))
            return events
        case _:
            return []


def _position(message: Any, t_s: float) -> list[Event]:
    if message.lat == 0 and message.lon == 0:
        return []  # no position yet: both autopilots send zeros
    if not (abs(message.lat) <= 900_000_000 and abs(message.lon) <= 1_800_000_000):
        return []
    if not LOWEST_AMSL_M <= message.alt / 1000.0 <= HIGHEST_AMSL_M:
        return []  # nowhere on Earth, as a latitude of 100 degrees
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


def _pressure(message: Any, t_s: float) -> list[Event]:
    """hPa and hundredths of a degree, in the messages of both autopilots; no pressure is 0."""
    pressure_pa = 100.0 * message.press_abs
    if not (math.isfinite(pressure_pa) and pressure_pa > 0.0):
        return []
    return [AirPressure(t_s, pressure_pa, message.temperature / 100.0)]


def _home(message: Any, t_s: float) -> list[Event]:
    if message.latitude == 0 and message.longitude == 0:
        return []  # no home yet: ArduCopter without a position sends zeros
    place = message.latitude * 1e-7, message.longitude * 1e-7
    return [Home(t_s, *place, message.altitude / 1000.0)]


def _gnss_time(message: Any, t_s: float) -> list[Event]:
    """Both stamps are of one moment; before a fix there is no calendar time (0, or near it)."""
    unix_s = message.time_unix_usec / 1e6
    return [GnssTime(t_s, unix_s)] if unix_s > LEAST_UNIX_S else []


def _system_status(message: Any, t_s: float) -> list[Event]:
    events: list[Event] = []
    if message.onboard_control_sensors_present & PREARM:
        events.append(ArmingReadiness(t_s, bool(message.onboard_control_sensors_health & PREARM)))
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


def _battery(message: Any, t_s: float) -> list[Event]:
    if message.battery_function in OTHER_PACKS:
        return []
    # Voltages of the cells: 65535 is "no such cell"; a value of 65534 continues in the next.
    cells = [mv for mv in message.voltages if mv < UNKNOWN_U16]
    voltage_v = sum(cells) / 1000.0 if cells and sum(cells) > 0 else None
    consumed_mah, consumed_hj = message.current_consumed, message.energy_consumed
    current_known = message.current_battery >= 0
    return [
        Battery(
            t_s,
            voltage_v=voltage_v,
            current_a=message.current_battery / 100.0 if current_known else None,
            # Without a current sensor a counter of 0 is not "nothing used" (PX4 SIH).
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


def _hud(message: Any, profile: AutopilotProfile, values: Values, t_s: float) -> list[Event]:
    events: list[Event] = []
    if 0 <= message.throttle <= 100:
        events.append(Throttle(t_s, message.throttle / 100.0))
    if profile.has_pitot(values) and math.isfinite(message.airspeed) and message.airspeed >= 0.0:
        events.append(Airspeed(t_s, float(message.airspeed)))
    return events


def _progress(message: Any, profile: AutopilotProfile, t_s: float) -> Event:
    index = message.seq - profile.home_items
    # `total` is a MAVLink 2 extension: 0 from those that do not send it, 65535 for no mission.
    total = {0: None, UNKNOWN_U16: 0}.get(message.total, message.total)
    # MISSION_CURRENT.mission_mode: 0 unknown, 1 in a mission mode, 2 suspended.
    in_mission = {1: True, 2: False}.get(message.mission_mode)
    return MissionProgress(
        t_s, index if index >= 0 else None, total, in_mission, _mission_id(message)
    )


def _mission_id(message: Any) -> int | None:
    """MISSION_CURRENT.mission_id, an extension that is younger than the dialect; 0 is unknown.

    MAVLink common.xml, message 42: seq, total, mission_state and mission_mode are 6 bytes; zeros at
    the end of a payload are not sent.
    """
    frame = bytes(message.get_msgbuf() or b"")
    if not frame or frame[0] != mavlink.PROTOCOL_MARKER_V2:
        return None
    payload = frame[mavlink.HEADER_LEN_V2 : mavlink.HEADER_LEN_V2 + frame[1]]
    return int.from_bytes(payload[6:10], "little") or None
