"""Telemetry of ArduCopter: its own messages, fields and stream groups."""

import math
from collections.abc import Mapping

from sim_bridge.autopilot.ardupilot.checks import ArduPilotChecks
from sim_bridge.autopilot.ardupilot.mode_numbers import base_mode_of, custom_mode_of
from sim_bridge.autopilot.base.goals import Descend
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.battery import BatteryMonitor
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.flight.wind import WindFusion
from sim_bridge.autopilot.kinds import LinkKind
from sim_bridge.autopilot.mavlink.enums import LandedState
from sim_bridge.autopilot.mavlink.links import LinkState
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mission.executor import MissionExecutor, Phase
from sim_bridge.autopilot.services.radio import Builder, Fields
from sim_bridge.autopilot.services.status import CommonTelemetry, ekf_flags
from sim_bridge.autopilot.state import VehicleState

_STREAM_GROUPS = {
    1: ("SCALED_PRESSURE",),
    2: ("SYS_STATUS", "MISSION_CURRENT", "GPS_RAW_INT", "NAV_CONTROLLER_OUTPUT"),
    3: ("SERVO_OUTPUT_RAW", "RC_CHANNELS"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE",),
    11: ("VFR_HUD",),
    12: ("SYSTEM_TIME", "WIND", "BATTERY_STATUS", "EKF_STATUS_REPORT"),
}


def message_names_of_stream_group(stream_id: int) -> tuple[str, ...]:
    """Messages of a MAV_DATA_STREAM; 0 is all of them."""
    if stream_id == 0:
        return tuple(name for group in _STREAM_GROUPS.values() for name in group)
    return _STREAM_GROUPS.get(stream_id, ())


class ArduPilotLinkPolicy:
    """Link behaviour of ArduCopter."""

    def default_message_intervals_s(self, kind: LinkKind) -> dict[str, float]:
        """HEARTBEAT at 1 Hz and nothing else until requested."""
        return {"HEARTBEAT": 1.0}

    def status_text_and_target_links(
        self, text: str, links: Mapping[int, LinkState], t_s: float
    ) -> tuple[str, list[int]]:
        """STATUSTEXT goes to every link."""
        return text, list(links)

    def parameter_list_names(self, params: ParameterStore) -> list[str]:
        """Names in the order of a parameter list."""
        return [name for i in range(len(params)) if (name := params.name_at(i)) is not None]

    def is_forwarding_enabled(self, kind: LinkKind, params: ParameterStore) -> bool:
        """Forward messages from every link."""
        return True

    def hash_check_param_value(self, params: ParameterStore) -> float:
        """Return 0: ArduCopter has no parameter hash."""
        return 0.0


class ArduPilotTelemetry:
    """ArduCopter's values in the common messages, and its own messages; builders in `streams`."""

    autopilot_id = 3

    def __init__(
        self,
        state: VehicleState,
        executor: MissionExecutor,
        battery: BatteryMonitor,
        wind: WindFusion,
        rc: RcInput,
        targets: ModeTargets,
        checks: ArduPilotChecks,
    ) -> None:
        self._state = state
        self._executor = executor
        self._battery = battery
        self._wind = wind
        self._targets = targets
        self._checks = checks
        common = CommonTelemetry(state, executor, battery, rc, self)
        self.streams: dict[str, Builder] = {
            **common.streams,
            "WIND": self.wind_message_fields,
            "AIRSPEED": self.airspeed_message_fields,
            "EKF_STATUS_REPORT": self.ekf_status_report_fields,
        }

    def base_mode(self, mode: Mode, armed: bool) -> int:
        """HEARTBEAT.base_mode."""
        return base_mode_of(mode, armed)

    def custom_mode(self, mode: Mode) -> int:
        """HEARTBEAT.custom_mode."""
        return custom_mode_of(mode)

    def high_latency_custom_mode(self, mode: Mode) -> int:
        """HIGH_LATENCY2.custom_mode: the same number."""
        return custom_mode_of(mode)

    def high_latency_airspeed_field(self) -> int:
        """HIGH_LATENCY2.airspeed, in 0.2 m/s."""
        return min(255, round(5.0 * self.hud_airspeed_mps()))

    def high_latency_wind_mps_and_direction(self) -> tuple[float, int]:
        """Speed, and where it blows FROM in units of 2 degrees."""
        wind = self.wind_message_fields()
        return wind["speed"], round(wind["direction"] % 360.0 / 2.0) % 180

    def battery_status_voltages_mv(self, pack_voltage_v: float | None) -> tuple[int, ...]:
        """Return the pack voltage in the first cell's field (split where it exceeds 16 bits)."""
        rest = [65535] * 9
        if pack_voltage_v is None:
            return (65535, *rest)
        total = round(pack_voltage_v * 1000.0)
        first = min(total, 65534)
        if total > first:
            rest[0] = total - first
        return (first, *rest)

    def remaining_frac(self) -> float | None:
        """BATT_CAPACITY less what was drawn since boot."""
        return self._battery.ardupilot_remaining_frac(self._state.params["BATT_CAPACITY"])

    def landed_state_in_air(self) -> LandedState:
        """Landing only in LAND and at the end of RTL."""
        if isinstance(self._state.goal, Descend):
            return LandedState.LANDING
        is_takeoff = self._targets.takeoff_down_m is not None
        leg = self._executor.leg
        if self._state.mode is Mode.AUTO and leg is not None:
            is_takeoff = leg.phase is Phase.CLIMB
        return LandedState.TAKEOFF if is_takeoff else LandedState.IN_AIR

    def is_prearm_bit_set(self) -> bool:
        """Return the pre-arm bit of SYS_STATUS, which ignores the requirements of the mode."""
        return self._state.is_armed or self._checks.prearm_problem() is None

    def _has_airspeed_sensor(self) -> bool:
        """Return True if a pitot is fitted and configured."""
        state = self._state
        fitted = state.readings is not None and state.readings.airspeed_mps is not None
        return fitted and state.params["ARSPD_TYPE"] > 0

    def wind_message_fields(self) -> Fields:
        """WIND: where it blows FROM. Without an estimate: direction -180, speed 0, in any wind."""
        estimate = self._wind.estimator
        if estimate is None or estimate.flown_s == 0.0:
            return {"direction": -180.0, "speed": 0.0, "speed_z": 0.0}
        return {
            "direction": math.degrees(math.atan2(-estimate.east_mps, -estimate.north_mps)),
            "speed": math.hypot(estimate.north_mps, estimate.east_mps),
            "speed_z": 0.0,
        }

    def hud_airspeed_mps(self) -> float:
        """VFR_HUD.airspeed: sensor (forward axis), else velocity through the estimated air.

        Without a wind estimate that is the 3-D velocity over ground.
        """
        state = self._state
        if self._has_airspeed_sensor() and state.readings is not None:
            return state.readings.airspeed_mps or 0.0
        vn, ve, vd = state.vel_ned_mps
        wind = self._wind.estimator
        if wind is not None and wind.flown_s > 0.0:
            vn, ve = vn - wind.north_mps, ve - wind.east_mps
        return math.sqrt(vn * vn + ve * ve + vd * vd)

    def airspeed_message_fields(self) -> Fields | None:
        """AIRSPEED, from a sensor only."""
        state = self._state
        if not self._has_airspeed_sensor() or state.readings is None:
            return None
        speed = state.readings.airspeed_mps or 0.0
        return {
            "id": 0,
            "airspeed": speed,
            "temperature": round(state.readings.temperature_c * 100.0),
            "raw_press": 0.5 * 1.225 * speed * speed,
            "flags": 2,
        }

    def ekf_status_report_fields(self) -> Fields:
        """EKF_STATUS_REPORT."""
        lost = 0.0 if self._state.has_position else 1.0
        return {
            "flags": int(ekf_flags(self._state)),
            "velocity_variance": 0.05 + lost,
            "pos_horiz_variance": 0.05 + lost,
            "pos_vert_variance": 0.03,
            "compass_variance": 0.02,
            "terrain_alt_variance": 0.0,
            "airspeed_variance": 0.0,
        }

    def mission_current_total(self, item_count: int) -> int:
        """Without home; an empty mission has 0."""
        return max(item_count - 1, 0)

    def mission_id(self) -> int:
        """Return no id: ArduCopter does not send one."""
        return 0
