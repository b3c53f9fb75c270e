"""Telemetry of PX4: its own messages, fields, and default streams of each link."""

import math
from collections.abc import Mapping

from sim_bridge.autopilot.base.goals import Descend
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.battery import BatteryMonitor, Px4Cells
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.wind import WindFusion
from sim_bridge.autopilot.kinds import BatterySensing, LinkKind
from sim_bridge.autopilot.mavlink.enums import LandedState
from sim_bridge.autopilot.mavlink.links import LinkState
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mission.executor import MissionExecutor, Phase
from sim_bridge.autopilot.mission.items import MissionStore
from sim_bridge.autopilot.px4.failsafe import Px4Failsafe
from sim_bridge.autopilot.px4.mission import mission_current_total, mission_items_crc32
from sim_bridge.autopilot.px4.mode_numbers import (
    base_mode_of,
    custom_mode_of,
    high_latency_custom_mode_of,
)
from sim_bridge.autopilot.services.radio import Builder, Fields
from sim_bridge.autopilot.services.status import CommonTelemetry, ekf_flags
from sim_bridge.autopilot.state import VehicleState

_WIND_SHOWN_AFTER_S = 3.0


def battery_cell_params(params: ParameterStore) -> Px4Cells:
    """BAT1_*."""
    return Px4Cells(
        int(params["BAT1_N_CELLS"]),
        params["BAT1_V_CHARGED"],
        params["BAT1_V_EMPTY"],
        params["BAT1_CAPACITY"],
        params["BAT1_R_INTERNAL"],
    )


NOT_ON_REQUEST = frozenset({"MISSION_CURRENT", "HEARTBEAT"})
"""Sent at a fixed rate: no interval can be set for it (flown on PX4 1.18)."""

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
        "SCALED_PRESSURE": 1.0,
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
        "SCALED_PRESSURE": 1.0,
        "ALTITUDE": 1.0,
    },
}
"""Measured rates; the others from PX4, src/modules/mavlink/mavlink_main.cpp
(configure_streams_to_default). The onboard profile omits HIGHRES_IMU, ATTITUDE_QUATERNION, RC and
servo streams: 130 messages a second that a companion does not need."""


class Px4LinkPolicy:
    """Link behaviour of PX4."""

    def default_message_intervals_s(self, kind: LinkKind) -> dict[str, float]:
        """The profile of the link."""
        return {name: 1.0 / rate for name, rate in DEFAULT_RATES_HZ[kind].items()}

    def status_text_and_target_links(
        self, text: str, links: Mapping[int, LinkState], t_s: float
    ) -> tuple[str, list[int]]:
        """Send text only on links with a ground station's HEARTBEAT; texts end with a tab."""
        return text + "\t", [link.id for link in links.values() if link.is_gcs_connected(t_s)]

    def parameter_list_names(self, params: ParameterStore) -> list[str]:
        """A list begins with the checksum."""
        names = [name for i in range(len(params)) if (name := params.name_at(i)) is not None]
        return ["_HASH_CHECK", *names]

    def is_forwarding_enabled(self, kind: LinkKind, params: ParameterStore) -> bool:
        """By MAV_n_FORWARD: instance 0 is the ground station's link, 1 the companion's."""
        return params["MAV_0_FORWARD" if kind is LinkKind.GCS else "MAV_1_FORWARD"] > 0.0

    def hash_check_param_value(self, params: ParameterStore) -> float:
        """The checksum's bytes, as a float's."""
        return params.checksum_bits_as_float()


class Px4Telemetry:
    """PX4's values in the common messages, and its own messages; all builders in `streams`."""

    autopilot_id = 12

    def __init__(
        self,
        state: VehicleState,
        executor: MissionExecutor,
        battery: BatteryMonitor,
        wind: WindFusion,
        rc: RcInput,
        failsafe: Px4Failsafe,
        store: MissionStore,
    ) -> None:
        self._store = store
        self._state = state
        self._executor = executor
        self._battery = battery
        self._wind = wind
        self._failsafe = failsafe
        self._common = CommonTelemetry(state, executor, battery, rc, self)
        self.streams: dict[str, Builder] = {
            **self._common.streams,
            "BATTERY_STATUS": self.battery_status_fields,
            "WIND_COV": self.wind_cov_fields,
            "ALTITUDE": self.altitude_fields,
            "ESTIMATOR_STATUS": self.estimator_status_fields,
            "CURRENT_MODE": self.current_mode_fields,
        }
        del self.streams["NAV_CONTROLLER_OUTPUT"]

    def base_mode(self, mode: Mode, armed: bool) -> int:
        """HEARTBEAT.base_mode."""
        return base_mode_of(mode, armed)

    def custom_mode(self, mode: Mode) -> int:
        """HEARTBEAT.custom_mode."""
        return custom_mode_of(mode)

    def high_latency_custom_mode(self, mode: Mode) -> int:
        """HIGH_LATENCY2.custom_mode: packed otherwise."""
        return high_latency_custom_mode_of(mode)

    def hud_airspeed_mps(self) -> float:
        """VFR_HUD.airspeed: NaN on a multirotor without a sensor."""
        readings = self._state.readings
        if readings is None or readings.airspeed_mps is None:
            return math.nan
        return readings.airspeed_mps

    def high_latency_airspeed_field(self) -> int:
        """HIGH_LATENCY2.airspeed: always 0."""
        return 0

    def high_latency_wind_mps_and_direction(self) -> tuple[float, int]:
        """Speed, and where it blows TO in units of 2 degrees."""
        wind = self._wind.estimator
        if wind is None:
            return 0.0, 0
        heading = math.degrees(math.atan2(wind.east_mps, wind.north_mps)) % 360.0
        return math.hypot(wind.north_mps, wind.east_mps), round(heading / 2.0) % 180

    def battery_status_voltages_mv(self, pack_voltage_v: float | None) -> tuple[int, ...]:
        """Return each cell's mean if the cell count is known, else the pack voltage in the first
        field."""
        count = min(int(self._state.params["BAT1_N_CELLS"]), 14)
        if pack_voltage_v is None:
            return (65535,) * 10
        if count <= 0:
            return (min(round(pack_voltage_v * 1000.0), 65534), *(65535,) * 9)
        cells = int(self._state.params["BAT1_N_CELLS"])
        return (round(pack_voltage_v * 1000.0 / cells),) * count + (65535,) * (10 - count)

    def update_remaining_battery_frac(self) -> float | None:
        """By voltage and counted charge; SIH's is a timer, and its voltage follows the timer.

        Source of SIH's: PX4, src/modules/simulation/battery_simulator.
        """
        state = self._state
        if self._battery.sensing is BatterySensing.SIH_TIMER:
            least = state.params["SIM_BAT_MIN_PCT"] / 100.0
            frac = self._battery.sih_timer_remaining_frac(state.params["SIM_BAT_DRAIN"], least)
            cells = battery_cell_params(state.params)
            cell_v = cells.empty_v + frac * (cells.full_v - cells.empty_v)
            self._battery.voltage_v = max(cells.cells, 1) * cell_v
            return frac
        return self._battery.update_px4_remaining_frac(battery_cell_params(state.params))

    def landed_state_in_air(self) -> LandedState:
        """Taking off, landing, or in the air."""
        state = self._state
        if isinstance(state.goal, Descend):
            return LandedState.LANDING
        leg = self._executor.leg
        climbing = state.mode is Mode.AUTO and leg is not None and leg.phase is Phase.CLIMB
        if state.mode is Mode.TAKEOFF or climbing:
            return LandedState.TAKEOFF
        return LandedState.IN_AIR

    def is_prearm_bit_set(self) -> bool:
        """SYS_STATUS's pre-arm bit: everything that does not depend on the mode."""
        return self._state.is_armed or self._state.ekf_is_ready

    def battery_status_fields(self) -> Fields:
        """BATTERY_STATUS: energy is never known; SIH knows no current and has consumed 0."""
        fields = self._common.battery_status_fields()
        fields["energy_consumed"] = -1
        if self._battery.sensing is BatterySensing.SIH_TIMER:
            fields["current_consumed"] = 0
            return fields
        capacity, current = self._state.params["BAT1_CAPACITY"], self._battery.current_avg_a
        remaining = self._battery.remaining_frac
        if capacity > 0.0 and current > 0.1 and remaining is not None and self._state.is_armed:
            fields["time_remaining"] = round(remaining * capacity * 3.6 / current)
        return fields

    def wind_cov_fields(self) -> Fields | None:
        """WIND_COV: where it blows TO; only with drag fusion, and only once it flies."""
        state = self._state
        wind = self._wind.estimator
        if wind is None or wind.flown_s < _WIND_SHOWN_AFTER_S:
            return None
        return {
            "time_usec": state.time_boot_ms * 1000,
            "wind_x": wind.north_mps,
            "wind_y": wind.east_mps,
            "wind_z": 0.0,
            "var_horiz": wind.variance_m2ps2,
            "var_vert": 0.0,
            "wind_alt": state.frame.alt_amsl_m - state.pos_ned_m[2],
            "horiz_accuracy": 0.0,
            "vert_accuracy": 0.0,
        }

    def altitude_fields(self) -> Fields:
        """ALTITUDE."""
        state = self._state
        down = state.pos_ned_m[2]
        return {
            "time_usec": state.time_boot_ms * 1000,
            "altitude_monotonic": state.frame.alt_amsl_m - down,
            "altitude_amsl": state.frame.alt_amsl_m - down,
            "altitude_local": state.ekf_origin_ned_m[2] - down,
            "altitude_relative": state.home_ned_m[2] - down,
            "altitude_terrain": math.nan,
            "bottom_clearance": math.nan,
        }

    def estimator_status_fields(self) -> Fields:
        """ESTIMATOR_STATUS."""
        good = self._state.has_position
        return {
            "time_usec": self._state.time_boot_ms * 1000,
            "flags": int(ekf_flags(self._state)),
            "vel_ratio": 0.05,
            "pos_horiz_ratio": 0.05,
            "pos_vert_ratio": 0.02,
            "mag_ratio": 0.03,
            "hagl_ratio": 0.0,
            "tas_ratio": 0.0,
            "pos_horiz_accuracy": 0.8 if good else 50.0,
            "pos_vert_accuracy": 1.0,
        }

    def current_mode_fields(self) -> Fields:
        """CURRENT_MODE."""
        return {
            "standard_mode": 0,
            "custom_mode": custom_mode_of(self._state.mode),
            "intended_custom_mode": custom_mode_of(self._failsafe.interrupted or self._state.mode),
        }

    def mission_current_total(self, item_count: int) -> int:
        """Return the number of all items; 65535 for none."""
        return mission_current_total(item_count)

    def mission_id(self) -> int:
        """Return the id of the stored list."""
        return mission_items_crc32(self._store.mission)
