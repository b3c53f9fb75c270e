"""Status messages of both autopilots: one function for each message.

Differences come from `StatusSource`, or from an autopilot's own function that replaces the common
one under the name of the message. Fields keep their wire units.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import FollowLine, HoldPoint
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.battery import BatteryMonitor
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.mavlink.enums import (
    EkfFlag,
    LandedState,
    Sensor,
    SystemStatus,
)
from sim_bridge.autopilot.mission.executor import MissionExecutor
from sim_bridge.autopilot.services.radio import Builder, Fields
from sim_bridge.autopilot.state import VehicleState


class StatusSource(Protocol):
    """Values in the common messages that each autopilot computes differently."""

    @property
    def autopilot_id(self) -> int:
        """MAV_AUTOPILOT."""
        ...

    def base_mode(self, mode: Mode, armed: bool) -> int:
        """HEARTBEAT.base_mode."""
        ...

    def custom_mode(self, mode: Mode) -> int:
        """HEARTBEAT.custom_mode."""
        ...

    def high_latency_custom_mode(self, mode: Mode) -> int:
        """HIGH_LATENCY2.custom_mode."""
        ...

    def high_latency_airspeed_field(self) -> int:
        """HIGH_LATENCY2.airspeed, in 0.2 m/s."""
        ...

    def high_latency_wind_mps_and_direction(self) -> tuple[float, int]:
        """Wind speed in m/s, and its direction in units of 2 degrees."""
        ...

    def hud_airspeed_mps(self) -> float:
        """VFR_HUD.airspeed."""
        ...

    def battery_status_voltages_mv(self, pack_voltage_v: float | None) -> tuple[int, ...]:
        """BATTERY_STATUS.voltages (10), then the cells of voltages_ext (at most 4)."""
        ...

    def landed_state_in_air(self) -> LandedState:
        """MAV_LANDED_STATE in the air."""
        ...

    def is_prearm_bit_set(self) -> bool:
        """SYS_STATUS's pre-arm bit."""
        ...

    def mission_current_total(self, item_count: int) -> int:
        """MISSION_CURRENT.total for a plan of `item_count` items."""
        ...

    def mission_id(self) -> int:
        """MISSION_CURRENT.mission_id; 0: none is sent."""
        ...


def _round_and_clamp_to_int16(value: float) -> int:
    return max(-32768, min(32767, round(value)))


def _round_and_clamp_to_uint16(value: float) -> int:
    return max(0, min(65535, round(value)))


def _heading_cdeg(yaw_rad: float) -> int:
    return round(math.degrees(yaw_rad) * 100.0) % 36000


def attitude_quaternion_wxyz(
    roll_rad: float, pitch_rad: float, yaw_rad: float
) -> tuple[float, float, float, float]:
    """Unit quaternion w, x, y, z of an attitude (aerospace order yaw, pitch, roll)."""
    sr, cr = math.sin(roll_rad / 2), math.cos(roll_rad / 2)
    sp, cp = math.sin(pitch_rad / 2), math.cos(pitch_rad / 2)
    sy, cy = math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def ekf_flags(state: VehicleState) -> EkfFlag:
    """Return the estimator's flags: 831 when fully valid, 167 while it has no position."""
    flags = EkfFlag.ATTITUDE | EkfFlag.VELOCITY_VERT | EkfFlag.POS_VERT_ABS
    if not state.has_position:
        return flags | EkfFlag.VELOCITY_HORIZ | EkfFlag.CONST_POS_MODE
    return (
        flags
        | EkfFlag.VELOCITY_HORIZ
        | EkfFlag.POS_HORIZ_REL
        | EkfFlag.POS_HORIZ_ABS
        | EkfFlag.PRED_POS_HORIZ_REL
        | EkfFlag.PRED_POS_HORIZ_ABS
    )


def mission_current_seq(executor: MissionExecutor) -> int:
    """MISSION_CURRENT.seq; 0 without a mission."""
    return 0 if executor.plan.is_empty else executor.index


def mission_current_fields(executor: MissionExecutor, item_total: int, mission_id: int) -> Fields:
    """MISSION_CURRENT; `item_total` is the number of items as the autopilot counts them.

    `mission_id` changes with the stored list; 0 where the autopilot sends none.
    """
    return {
        "seq": mission_current_seq(executor),
        "total": item_total,
        "mission_state": int(executor.reported_state),
        "mission_mode": 1 if executor.is_active else 2,
        "mission_id": mission_id,
        "fence_id": 0,
        "rally_points_id": 0,
    }


@dataclass(slots=True)
class CommonTelemetry:
    """Builders of the common messages by name, in `streams`."""

    _state: VehicleState
    _executor: MissionExecutor
    _battery: BatteryMonitor
    _rc: RcInput
    _own: StatusSource
    streams: dict[str, Builder] = field(init=False)

    def __post_init__(self) -> None:
        self.streams = {
            "HEARTBEAT": self.heartbeat_fields,
            "SYS_STATUS": self.sys_status_fields,
            "SYSTEM_TIME": self.system_time_fields,
            "ATTITUDE": self.attitude_fields,
            "ATTITUDE_QUATERNION": self.attitude_quaternion_fields,
            "GLOBAL_POSITION_INT": self.global_position_int_fields,
            "LOCAL_POSITION_NED": self.local_position_ned_fields,
            "VFR_HUD": self.vfr_hud_fields,
            "GPS_RAW_INT": self.gps_raw_int_fields,
            "GPS_GLOBAL_ORIGIN": self.gps_global_origin_fields,
            "BATTERY_STATUS": self.battery_status_fields,
            "HOME_POSITION": self.home_position_fields,
            "EXTENDED_SYS_STATE": self.extended_sys_state_fields,
            "SCALED_PRESSURE": self.scaled_pressure_fields,
            "MISSION_CURRENT": self.mission_current_message_fields,
            "RC_CHANNELS": self.rc_channels_fields,
            "SERVO_OUTPUT_RAW": self.servo_output_raw_fields,
            "NAV_CONTROLLER_OUTPUT": self.nav_controller_output_fields,
            "HIGH_LATENCY2": self.high_latency2_fields,
        }

    def heartbeat_fields(self) -> Fields:
        """HEARTBEAT."""
        state = self._state
        if state.failsafe_reason is not None and state.is_armed:
            status = SystemStatus.CRITICAL
        else:
            status = SystemStatus.STANDBY if state.is_landed else SystemStatus.ACTIVE
        return {
            "type": state.vehicle_type,
            "autopilot": self._own.autopilot_id,
            "base_mode": self._own.base_mode(state.mode, state.is_armed),
            "custom_mode": self._own.custom_mode(state.mode),
            "system_status": int(status),
        }

    def sys_status_fields(self) -> Fields:
        """SYS_STATUS."""
        state = self._state
        present = (
            Sensor.GYRO
            | Sensor.ACCEL
            | Sensor.MAG
            | Sensor.ABSOLUTE_PRESSURE
            | Sensor.GPS
            | Sensor.ATTITUDE_STABILIZATION
            | Sensor.YAW_POSITION
            | Sensor.Z_ALTITUDE_CONTROL
            | Sensor.XY_POSITION_CONTROL
            | Sensor.MOTOR_OUTPUTS
            | Sensor.AHRS
            | Sensor.BATTERY
            | Sensor.PREARM_CHECK
        )
        if self._rc.was_present:
            present |= Sensor.RC_RECEIVER
        if state.readings is not None and state.readings.airspeed_mps is not None:
            present |= Sensor.DIFFERENTIAL_PRESSURE
        health = present
        if not state.gnss_ok:
            health &= ~(Sensor.GPS | Sensor.XY_POSITION_CONTROL)
        if not state.ekf_is_ready:
            health &= ~(Sensor.AHRS | Sensor.XY_POSITION_CONTROL)
        if not self._own.is_prearm_bit_set():
            health &= ~Sensor.PREARM_CHECK
        if self._rc.channels is None:
            health &= ~Sensor.RC_RECEIVER
        voltage, current = self._battery.voltage_v, self._battery.reported_current_a
        remaining = self._battery.remaining_frac
        return {
            "onboard_control_sensors_present": int(present),
            "onboard_control_sensors_enabled": int(present),
            "onboard_control_sensors_health": int(health),
            "load": 250,
            "voltage_battery": 65535
            if voltage is None
            else _round_and_clamp_to_uint16(voltage * 1000.0),
            "current_battery": -1
            if current is None
            else _round_and_clamp_to_int16(current * 100.0),
            "battery_remaining": -1 if remaining is None else int(remaining * 100.0),
            "drop_rate_comm": 0,
            "errors_comm": 0,
            "errors_count1": 0,
            "errors_count2": 0,
            "errors_count3": 0,
            "errors_count4": 0,
        }

    def system_time_fields(self) -> Fields:
        """SYSTEM_TIME; without a fix since boot there is no calendar time."""
        state = self._state
        known = state.ekf_is_ready
        return {
            "time_unix_usec": round((state.epoch_unix_s + state.t_s) * 1e6) if known else 0,
            "time_boot_ms": state.time_boot_ms,
        }

    def attitude_fields(self) -> Fields | None:
        """ATTITUDE."""
        r = self._state.readings
        if r is None:
            return None
        return {
            "time_boot_ms": self._state.time_boot_ms,
            "roll": r.roll_rad,
            "pitch": r.pitch_rad,
            "yaw": r.yaw_rad,
            "rollspeed": r.rollspeed_rps,
            "pitchspeed": r.pitchspeed_rps,
            "yawspeed": r.yawspeed_rps,
        }

    def attitude_quaternion_fields(self) -> Fields | None:
        """ATTITUDE_QUATERNION."""
        r = self._state.readings
        if r is None:
            return None
        q1, q2, q3, q4 = attitude_quaternion_wxyz(r.roll_rad, r.pitch_rad, r.yaw_rad)
        return {
            "time_boot_ms": self._state.time_boot_ms,
            "q1": q1,
            "q2": q2,
            "q3": q3,
            "q4": q4,
            "rollspeed": r.rollspeed_rps,
            "pitchspeed": r.pitchspeed_rps,
            "yawspeed": r.yawspeed_rps,
        }

    def global_position_int_fields(self) -> Fields | None:
        """GLOBAL_POSITION_INT; hdg in centidegrees. Silent until there is a position."""
        state = self._state
        if state.readings is None or not state.ekf_is_ready:
            return None
        north, east, down = state.pos_ned_m
        lat, lon = state.frame.to_lat_lon_deg(north, east)
        vn, ve, vd = state.vel_ned_mps
        return {
            "time_boot_ms": state.time_boot_ms,
            "lat": round(lat * 1e7),
            "lon": round(lon * 1e7),
            "alt": round((state.frame.alt_amsl_m - down) * 1e3),
            "relative_alt": round((state.home_ned_m[2] - down) * 1e3),
            "vx": _round_and_clamp_to_int16(vn * 100.0),
            "vy": _round_and_clamp_to_int16(ve * 100.0),
            "vz": _round_and_clamp_to_int16(vd * 100.0),
            "hdg": _heading_cdeg(state.readings.yaw_rad),
        }

    def local_position_ned_fields(self) -> Fields | None:
        """LOCAL_POSITION_NED, about the estimator's own origin."""
        state = self._state
        if state.readings is None or not state.ekf_is_ready:
            return None
        origin = state.ekf_origin_ned_m
        north, east, down = state.pos_ned_m
        vn, ve, vd = state.vel_ned_mps
        return {
            "time_boot_ms": state.time_boot_ms,
            "x": north - origin[0],
            "y": east - origin[1],
            "z": down - origin[2],
            "vx": vn,
            "vy": ve,
            "vz": vd,
        }

    def vfr_hud_fields(self) -> Fields | None:
        """VFR_HUD."""
        state = self._state
        if state.readings is None:
            return None
        vn, ve, vd = state.vel_ned_mps
        return {
            "airspeed": self._own.hud_airspeed_mps(),
            "groundspeed": math.hypot(vn, ve),
            "heading": round(math.degrees(state.readings.yaw_rad)) % 360,
            "throttle": round(100.0 * state.actuation.thrust_frac),
            "alt": state.frame.alt_amsl_m - state.pos_ned_m[2],
            "climb": -vd,
        }

    def gps_raw_int_fields(self) -> Fields | None:
        """GPS_RAW_INT: the receiver's own figures, not the estimate."""
        state = self._state
        r = state.readings
        if r is None:
            return None
        ok = r.gnss_ok and state.t_since_boot_s > 3.0
        north, east, down = r.pos_ned_m
        lat, lon = state.frame.to_lat_lon_deg(north, east) if ok else (0.0, 0.0)
        vn, ve, _ = r.vel_ned_mps
        return {
            "time_usec": state.time_boot_ms * 1000,
            "fix_type": 3 if ok else 1,
            "lat": round(lat * 1e7),
            "lon": round(lon * 1e7),
            "alt": round((state.frame.alt_amsl_m - down) * 1e3) if ok else 0,
            "eph": 80 if ok else 65535,
            "epv": 120 if ok else 65535,
            "vel": _round_and_clamp_to_uint16(math.hypot(vn, ve) * 100.0) if ok else 65535,
            "cog": _heading_cdeg(math.atan2(ve, vn)) if ok else 65535,
            "satellites_visible": 12 if ok else 0,
            "h_acc": 900 if ok else 0,
            "v_acc": 1500 if ok else 0,
            "vel_acc": 200 if ok else 0,
        }

    def battery_status_fields(self) -> Fields:
        """BATTERY_STATUS: unknown is -1 or 65535."""
        voltage, current = self._battery.voltage_v, self._battery.reported_current_a
        battery = self._battery
        counted = battery.has_current and current is not None
        remaining = self._battery.remaining_frac
        temperature = battery.temperature_c
        voltages_mv = self._own.battery_status_voltages_mv(voltage)
        return {
            "id": 0,
            "battery_function": 0,
            "type": 0,
            "temperature": 32767
            if temperature is None
            else _round_and_clamp_to_int16(temperature * 100.0),
            "voltages": voltages_mv[:10],
            "voltages_ext": (*voltages_mv[10:14], *(0,) * (14 - len(voltages_mv))),
            "current_battery": -1
            if current is None
            else _round_and_clamp_to_int16(current * 100.0),
            "current_consumed": round(battery.consumed_mah) if counted else -1,
            "energy_consumed": round(battery.consumed_j / 100.0) if counted else -1,
            "battery_remaining": -1 if remaining is None else math.ceil(remaining * 100.0),
            "time_remaining": 0,
            "charge_state": 1,
        }

    def home_position_fields(self) -> Fields | None:
        """HOME_POSITION, once home is known."""
        state = self._state
        if not state.home_is_set:
            return None
        north, east, down = state.home_ned_m
        lat, lon = state.frame.to_lat_lon_deg(north, east)
        origin = state.ekf_origin_ned_m
        return {
            "latitude": round(lat * 1e7),
            "longitude": round(lon * 1e7),
            "altitude": round((state.frame.alt_amsl_m - down) * 1e3),
            "x": north - origin[0],
            "y": east - origin[1],
            "z": down - origin[2],
            "q": (1.0, 0.0, 0.0, 0.0),
            "approach_x": 0.0,
            "approach_y": 0.0,
            "approach_z": 0.0,
            "time_usec": state.time_boot_ms * 1000,
        }

    def gps_global_origin_fields(self) -> Fields | None:
        """GPS_GLOBAL_ORIGIN: where LOCAL_POSITION_NED is zero."""
        state = self._state
        if not state.home_is_set:
            return None
        north, east, down = state.ekf_origin_ned_m
        lat, lon = state.frame.to_lat_lon_deg(north, east)
        return {
            "latitude": round(lat * 1e7),
            "longitude": round(lon * 1e7),
            "altitude": round((state.frame.alt_amsl_m - down) * 1e3),
            "time_usec": state.time_boot_ms * 1000,
        }

    def extended_sys_state_fields(self) -> Fields:
        """EXTENDED_SYS_STATE."""
        return {"vtol_state": 0, "landed_state": int(self.landed_state())}

    def landed_state(self) -> LandedState:
        """MAV_LANDED_STATE as the landing detector has it."""
        if self._state.is_landed:
            return LandedState.ON_GROUND
        return self._own.landed_state_in_air()

    def rc_channels_fields(self) -> Fields:
        """RC_CHANNELS."""
        channels = self._rc.channels or [0] * 18
        fields: Fields = {f"chan{i + 1}_raw": value for i, value in enumerate(channels)}
        fields["time_boot_ms"] = self._state.time_boot_ms
        fields["chancount"] = 0 if self._rc.channels is None else 16
        fields["rssi"] = 255 if self._rc.channels is None else 200
        return fields

    def servo_output_raw_fields(self) -> Fields:
        """SERVO_OUTPUT_RAW: the motors' common part."""
        state = self._state
        pulse = (
            1000 + round(1000.0 * state.actuation.thrust_frac)
            if state.actuation.motors_on
            else 1000
        )
        fields: Fields = {f"servo{i}_raw": pulse if i <= 4 else 0 for i in range(1, 9)}
        return {"time_usec": state.time_boot_ms * 1000 % 2**32, "port": 0, **fields}

    def scaled_pressure_fields(self) -> Fields | None:
        """SCALED_PRESSURE: hPa, and the barometer's own temperature, which is its board's.

        Both autopilots send the sensor's figure as it is (ArduPilot GCS_MAVLINK,
        send_scaled_pressure_instance; PX4 SCALED_PRESSURE.hpp, from sensor_baro).
        """
        r = self._state.readings
        if r is None:
            return None
        return {
            "time_boot_ms": self._state.time_boot_ms,
            "press_abs": r.air_pressure_pa / 100.0,
            "press_diff": 0.0,
            "temperature": _round_and_clamp_to_int16(r.board_temperature_c * 100.0),
        }

    def nav_controller_output_fields(self) -> Fields:
        """NAV_CONTROLLER_OUTPUT."""
        state = self._state
        target = self._goal_target_ned_m()
        north, east, down = state.pos_ned_m
        distance, bearing, climb = 0.0, 0.0, 0.0
        if target is not None:
            distance = math.hypot(target[0] - north, target[1] - east)
            bearing = math.degrees(math.atan2(target[1] - east, target[0] - north))
            climb = down - target[2]
        return {
            "nav_roll": math.degrees(state.actuation.roll_rad),
            "nav_pitch": math.degrees(state.actuation.pitch_rad),
            "nav_bearing": round(bearing) % 360,
            "target_bearing": round(bearing) % 360,
            "wp_dist": _round_and_clamp_to_uint16(distance),
            "alt_error": climb,
            "aspd_error": 0.0,
            "xtrack_error": 0.0,
        }

    def high_latency2_fields(self) -> Fields | None:
        """HIGH_LATENCY2; wind, airspeed and mode differ between the autopilots."""
        state = self._state
        position = self.global_position_int_fields()
        if position is None or state.readings is None:
            return None
        wind_mps, wind_heading = self._own.high_latency_wind_mps_and_direction()
        remaining = self._battery.remaining_frac
        target = self._goal_target_ned_m()
        distance = 0.0
        if target is not None:
            distance = math.hypot(target[0] - state.pos_ned_m[0], target[1] - state.pos_ned_m[1])
        return {
            "timestamp": state.time_boot_ms,
            "type": state.vehicle_type,
            "autopilot": self._own.autopilot_id,
            "custom_mode": self._own.high_latency_custom_mode(state.mode),
            "latitude": position["lat"],
            "longitude": position["lon"],
            "altitude": _round_and_clamp_to_int16(position["alt"] / 1e3),
            "target_altitude": _round_and_clamp_to_int16(position["alt"] / 1e3),
            "heading": round(position["hdg"] / 200.0) % 180,
            "target_heading": round(position["hdg"] / 200.0) % 180,
            "target_distance": _round_and_clamp_to_uint16(distance / 10.0),
            "throttle": round(100.0 * state.actuation.thrust_frac),
            "airspeed": self._own.high_latency_airspeed_field(),
            "airspeed_sp": 0,
            "groundspeed": min(255, round(5.0 * math.hypot(*state.vel_ned_mps[:2]))),
            "windspeed": min(255, round(5.0 * wind_mps)),
            "wind_heading": wind_heading,
            "eph": 8,
            "epv": 12,
            "temperature_air": _round_and_clamp_to_int16(state.readings.temperature_c),
            "climb_rate": max(-127, min(127, round(-10.0 * state.vel_ned_mps[2]))),
            "battery": -1 if remaining is None else int(remaining * 100.0),
            "wp_num": mission_current_seq(self._executor),
            "failure_flags": 0 if state.gnss_ok else 1,
            "custom0": 0,
            "custom1": 0,
            "custom2": 0,
        }

    def mission_current_message_fields(self) -> Fields:
        """MISSION_CURRENT."""
        total = self._own.mission_current_total(len(self._executor.plan))
        return mission_current_fields(self._executor, total, self._own.mission_id())

    def _goal_target_ned_m(self) -> Vec3 | None:
        goal = self._state.goal
        if isinstance(goal, FollowLine):
            return goal.end
        return goal.point if isinstance(goal, HoldPoint) else None
