"""What an autopilot tells of itself: one function for each message, from its state to fields.

Where the two autopilots differ in a message, the flavour's own module says so and overrides it
here by name. Fields keep their wire units.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from sim_bridge.autopilot.mavlink.enums import (
    EkfFlag,
    LandedState,
    MissionState,
    Sensor,
    SystemStatus,
)

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

Fields = dict[str, Any]
Builder = Callable[["Autopilot"], Fields | None]


def _i16(value: float) -> int:
    return max(-32768, min(32767, round(value)))


def _u16(value: float) -> int:
    return max(0, min(65535, round(value)))


def _heading_cdeg(yaw_rad: float) -> int:
    return round(math.degrees(yaw_rad) * 100.0) % 36000


def heartbeat(ap: "Autopilot") -> Fields:
    """HEARTBEAT."""
    if ap.failsafe_reason is not None and ap.is_armed:
        status = SystemStatus.CRITICAL
    else:
        status = SystemStatus.STANDBY if ap.is_landed else SystemStatus.ACTIVE
    return {
        "type": ap.vehicle_type,
        "autopilot": ap.behaviour.autopilot_id,
        "base_mode": ap.behaviour.base_mode(ap.mode, ap.is_armed),
        "custom_mode": ap.behaviour.custom_mode(ap.mode),
        "system_status": int(status),
    }


def sys_status(ap: "Autopilot") -> Fields:
    """SYS_STATUS."""
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
    if ap.pilot.was_present:
        present |= Sensor.RC_RECEIVER
    if ap.readings is not None and ap.readings.airspeed_mps is not None:
        present |= Sensor.DIFFERENTIAL_PRESSURE
    health = present
    if not ap.gnss_ok:
        health &= ~(Sensor.GPS | Sensor.XY_POSITION_CONTROL)
    if not ap.ekf_is_ready:
        health &= ~(Sensor.AHRS | Sensor.XY_POSITION_CONTROL)
    if not ap.behaviour.prearm_ok(ap):
        health &= ~Sensor.PREARM_CHECK
    if ap.pilot.channels is None:
        health &= ~Sensor.RC_RECEIVER
    voltage, current = ap.battery_voltage_v, ap.battery_current_a
    remaining = ap.battery_remaining_frac
    return {
        "onboard_control_sensors_present": int(present),
        "onboard_control_sensors_enabled": int(present),
        "onboard_control_sensors_health": int(health),
        "load": 250,
        "voltage_battery": 65535 if voltage is None else _u16(voltage * 1000.0),
        "current_battery": -1 if current is None else _i16(current * 100.0),
        "battery_remaining": -1 if remaining is None else int(remaining * 100.0),
        "drop_rate_comm": 0,
        "errors_comm": 0,
        "errors_count1": 0,
        "errors_count2": 0,
        "errors_count3": 0,
        "errors_count4": 0,
    }


def system_time(ap: "Autopilot") -> Fields:
    """SYSTEM_TIME; without a fix since boot there is no calendar time."""
    known = ap.ekf_is_ready
    return {
        "time_unix_usec": round((ap.epoch_unix_s + ap.t_s) * 1e6) if known else 0,
        "time_boot_ms": ap.time_boot_ms,
    }


def attitude(ap: "Autopilot") -> Fields | None:
    """ATTITUDE."""
    r = ap.readings
    if r is None:
        return None
    return {
        "time_boot_ms": ap.time_boot_ms,
        "roll": r.roll_rad,
        "pitch": r.pitch_rad,
        "yaw": r.yaw_rad,
        "rollspeed": r.rollspeed_rps,
        "pitchspeed": r.pitchspeed_rps,
        "yawspeed": r.yawspeed_rps,
    }


def attitude_quaternion(ap: "Autopilot") -> Fields | None:
    """ATTITUDE_QUATERNION."""
    r = ap.readings
    if r is None:
        return None
    q1, q2, q3, q4 = quaternion(r.roll_rad, r.pitch_rad, r.yaw_rad)
    return {
        "time_boot_ms": ap.time_boot_ms,
        "q1": q1,
        "q2": q2,
        "q3": q3,
        "q4": q4,
        "rollspeed": r.rollspeed_rps,
        "pitchspeed": r.pitchspeed_rps,
        "yawspeed": r.yawspeed_rps,
    }


def quaternion(
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


def global_position_int(ap: "Autopilot") -> Fields | None:
    """GLOBAL_POSITION_INT; hdg in centidegrees. Silent until there is a position."""
    if ap.readings is None or not ap.ekf_is_ready:
        return None
    north, east, down = ap.pos_ned_m
    lat, lon = ap.frame.to_lat_lon_deg(north, east)
    vn, ve, vd = ap.vel_ned_mps
    return {
        "time_boot_ms": ap.time_boot_ms,
        "lat": round(lat * 1e7),
        "lon": round(lon * 1e7),
        "alt": round((ap.frame.alt_amsl_m - down) * 1e3),
        "relative_alt": round((ap.home_ned_m[2] - down) * 1e3),
        "vx": _i16(vn * 100.0),
        "vy": _i16(ve * 100.0),
        "vz": _i16(vd * 100.0),
        "hdg": _heading_cdeg(ap.readings.yaw_rad),
    }


def local_position_ned(ap: "Autopilot") -> Fields | None:
    """LOCAL_POSITION_NED, about the estimator's own origin."""
    if ap.readings is None or not ap.ekf_is_ready:
        return None
    origin = ap.ekf_origin_ned_m
    north, east, down = ap.pos_ned_m
    vn, ve, vd = ap.vel_ned_mps
    return {
        "time_boot_ms": ap.time_boot_ms,
        "x": north - origin[0],
        "y": east - origin[1],
        "z": down - origin[2],
        "vx": vn,
        "vy": ve,
        "vz": vd,
    }


def vfr_hud(ap: "Autopilot") -> Fields | None:
    """VFR_HUD."""
    if ap.readings is None:
        return None
    vn, ve, vd = ap.vel_ned_mps
    return {
        "airspeed": ap.behaviour.hud_airspeed_mps(ap),
        "groundspeed": math.hypot(vn, ve),
        "heading": round(math.degrees(ap.readings.yaw_rad)) % 360,
        "throttle": round(100.0 * ap.actuation.thrust_frac),
        "alt": ap.frame.alt_amsl_m - ap.pos_ned_m[2],
        "climb": -vd,
    }


def gps_raw_int(ap: "Autopilot") -> Fields | None:
    """GPS_RAW_INT: the receiver itself, not the estimate."""
    r = ap.readings
    if r is None:
        return None
    ok = r.gnss_ok and ap.t_since_boot_s > 3.0
    north, east, down = r.pos_ned_m
    lat, lon = ap.frame.to_lat_lon_deg(north, east) if ok else (0.0, 0.0)
    vn, ve, _ = r.vel_ned_mps
    return {
        "time_usec": ap.time_boot_ms * 1000,
        "fix_type": 3 if ok else 1,
        "lat": round(lat * 1e7),
        "lon": round(lon * 1e7),
        "alt": round((ap.frame.alt_amsl_m - down) * 1e3) if ok else 0,
        "eph": 80 if ok else 65535,
        "epv": 120 if ok else 65535,
        "vel": _u16(math.hypot(vn, ve) * 100.0) if ok else 65535,
        "cog": _heading_cdeg(math.atan2(ve, vn)) if ok else 65535,
        "satellites_visible": 12 if ok else 0,
        "h_acc": 900 if ok else 0,
        "v_acc": 1500 if ok else 0,
        "vel_acc": 200 if ok else 0,
    }


def battery_status(ap: "Autopilot") -> Fields:
    """BATTERY_STATUS: unknown is -1 or 65535."""
    voltage, current = ap.battery_voltage_v, ap.battery_current_a
    battery = ap.battery
    counted = battery.knows_current and current is not None
    remaining = ap.battery_remaining_frac
    temperature = battery.temperature_c
    return {
        "id": 0,
        "battery_function": 0,
        "type": 0,
        "temperature": 32767 if temperature is None else _i16(temperature * 100.0),
        "voltages": ap.behaviour.cell_voltages_mv(ap, voltage),
        "current_battery": -1 if current is None else _i16(current * 100.0),
        "current_consumed": round(battery.consumed_mah) if counted else -1,
        "energy_consumed": round(battery.consumed_j / 100.0) if counted else -1,
        "battery_remaining": -1 if remaining is None else math.ceil(remaining * 100.0),
        "time_remaining": 0,
        "charge_state": 1,
    }


def home_position(ap: "Autopilot") -> Fields | None:
    """HOME_POSITION, once home is known."""
    if not ap.home_is_set:
        return None
    north, east, down = ap.home_ned_m
    lat, lon = ap.frame.to_lat_lon_deg(north, east)
    origin = ap.ekf_origin_ned_m
    return {
        "latitude": round(lat * 1e7),
        "longitude": round(lon * 1e7),
        "altitude": round((ap.frame.alt_amsl_m - down) * 1e3),
        "x": north - origin[0],
        "y": east - origin[1],
        "z": down - origin[2],
        "q": (1.0, 0.0, 0.0, 0.0),
        "approach_x": 0.0,
        "approach_y": 0.0,
        "approach_z": 0.0,
        "time_usec": ap.time_boot_ms * 1000,
    }


def gps_global_origin(ap: "Autopilot") -> Fields | None:
    """GPS_GLOBAL_ORIGIN: where LOCAL_POSITION_NED is zero."""
    if not ap.home_is_set:
        return None
    north, east, down = ap.ekf_origin_ned_m
    lat, lon = ap.frame.to_lat_lon_deg(north, east)
    return {
        "latitude": round(lat * 1e7),
        "longitude": round(lon * 1e7),
        "altitude": round((ap.frame.alt_amsl_m - down) * 1e3),
        "time_usec": ap.time_boot_ms * 1000,
    }


def extended_sys_state(ap: "Autopilot") -> Fields:
    """EXTENDED_SYS_STATE."""
    return {"vtol_state": 0, "landed_state": int(landed_state(ap))}


def landed_state(ap: "Autopilot") -> LandedState:
    """MAV_LANDED_STATE as the landing detector has it."""
    if ap.is_landed:
        return LandedState.ON_GROUND
    return ap.behaviour.airborne_state(ap)


def mission_current(ap: "Autopilot") -> Fields:
    """MISSION_CURRENT."""
    executor = ap.executor
    state = executor.state
    if executor.plan.is_empty:
        state = MissionState.NO_MISSION
    seq = 0 if executor.plan.is_empty else executor.index
    return {
        "seq": seq,
        "total": ap.behaviour.mission_total(len(executor.plan)),
        "mission_state": int(state),
        "mission_mode": 1 if executor.is_active else 2,
    }


def rc_channels(ap: "Autopilot") -> Fields:
    """RC_CHANNELS."""
    channels = ap.pilot.channels or [0] * 18
    fields: Fields = {f"chan{i + 1}_raw": value for i, value in enumerate(channels)}
    fields["time_boot_ms"] = ap.time_boot_ms
    fields["chancount"] = 0 if ap.pilot.channels is None else 16
    fields["rssi"] = 255 if ap.pilot.channels is None else 200
    return fields


def servo_output_raw(ap: "Autopilot") -> Fields:
    """SERVO_OUTPUT_RAW: the motors' common part."""
    pulse = 1000 + round(1000.0 * ap.actuation.thrust_frac) if ap.actuation.motors_on else 1000
    fields: Fields = {f"servo{i}_raw": pulse if i <= 4 else 0 for i in range(1, 9)}
    return {"time_usec": ap.time_boot_ms * 1000 % 2**32, "port": 0, **fields}


def raw_imu(ap: "Autopilot") -> Fields | None:
    """RAW_IMU in milli-g and milli-rad/s; the compass is not simulated."""
    r = ap.readings
    if r is None:
        return None
    x, y, z = (_i16(value / 9.80665 * 1000.0) for value in r.accel_frd_mps2)
    return {
        "time_usec": ap.time_boot_ms * 1000,
        "xacc": x,
        "yacc": y,
        "zacc": z,
        "xgyro": _i16(r.rollspeed_rps * 1000.0),
        "ygyro": _i16(r.pitchspeed_rps * 1000.0),
        "zgyro": _i16(r.yawspeed_rps * 1000.0),
        "xmag": 0,
        "ymag": 0,
        "zmag": 0,
    }


def highres_imu(ap: "Autopilot") -> Fields | None:
    """HIGHRES_IMU: accelerometers and gyros only."""
    r = ap.readings
    if r is None:
        return None
    x, y, z = r.accel_frd_mps2
    return {
        "time_usec": ap.time_boot_ms * 1000,
        "xacc": x,
        "yacc": y,
        "zacc": z,
        "xgyro": r.rollspeed_rps,
        "ygyro": r.pitchspeed_rps,
        "zgyro": r.yawspeed_rps,
        "xmag": math.nan,
        "ymag": math.nan,
        "zmag": math.nan,
        "abs_pressure": math.nan,
        "diff_pressure": math.nan,
        "pressure_alt": r.alt_amsl_m,
        "temperature": r.temperature_c,
        "fields_updated": 0b100000111111,
    }


def nav_controller_output(ap: "Autopilot") -> Fields:
    """NAV_CONTROLLER_OUTPUT."""
    target = ap.navigation_target()
    north, east, down = ap.pos_ned_m
    distance, bearing, climb = 0.0, 0.0, 0.0
    if target is not None:
        distance = math.hypot(target[0] - north, target[1] - east)
        bearing = math.degrees(math.atan2(target[1] - east, target[0] - north))
        climb = down - target[2]
    return {
        "nav_roll": math.degrees(ap.actuation.roll_rad),
        "nav_pitch": math.degrees(ap.actuation.pitch_rad),
        "nav_bearing": round(bearing) % 360,
        "target_bearing": round(bearing) % 360,
        "wp_dist": _u16(distance),
        "alt_error": climb,
        "aspd_error": 0.0,
        "xtrack_error": 0.0,
    }


def power_status(ap: "Autopilot") -> Fields:
    """POWER_STATUS: a board on its bench supply."""
    return {"Vcc": 5000, "Vservo": 0, "flags": 0}


def meminfo(ap: "Autopilot") -> Fields:
    """MEMINFO."""
    return {"brkval": 0, "freemem": 65535, "freemem32": 131072}


def ekf_flags(ap: "Autopilot") -> EkfFlag:
    """What the estimator provides: 831 when all is well, 167 while it waits for a position."""
    flags = EkfFlag.ATTITUDE | EkfFlag.VELOCITY_VERT | EkfFlag.POS_VERT_ABS
    if not ap.has_position:
        return flags | EkfFlag.VELOCITY_HORIZ | EkfFlag.CONST_POS_MODE
    return (
        flags
        | EkfFlag.VELOCITY_HORIZ
        | EkfFlag.POS_HORIZ_REL
        | EkfFlag.POS_HORIZ_ABS
        | EkfFlag.PRED_POS_HORIZ_REL
        | EkfFlag.PRED_POS_HORIZ_ABS
    )


def vibration(ap: "Autopilot") -> Fields:
    """VIBRATION: a well damped board."""
    return {
        "time_usec": ap.time_boot_ms * 1000,
        "vibration_x": 3.0,
        "vibration_y": 3.0,
        "vibration_z": 5.0,
        "clipping_0": 0,
        "clipping_1": 0,
        "clipping_2": 0,
    }


def high_latency2(ap: "Autopilot") -> Fields | None:
    """HIGH_LATENCY2; what the flavours put into wind, airspeed and mode differs."""
    position = global_position_int(ap)
    if position is None or ap.readings is None:
        return None
    wind_mps, wind_heading = ap.behaviour.high_latency_wind(ap)
    remaining = ap.battery_remaining_frac
    target = ap.navigation_target()
    distance = 0.0
    if target is not None:
        distance = math.hypot(target[0] - ap.pos_ned_m[0], target[1] - ap.pos_ned_m[1])
    return {
        "timestamp": ap.time_boot_ms,
        "type": ap.vehicle_type,
        "autopilot": ap.behaviour.autopilot_id,
        "custom_mode": ap.behaviour.high_latency_mode(ap.mode),
        "latitude": position["lat"],
        "longitude": position["lon"],
        "altitude": _i16(position["alt"] / 1e3),
        "target_altitude": _i16(position["alt"] / 1e3),
        "heading": round(position["hdg"] / 200.0) % 180,
        "target_heading": round(position["hdg"] / 200.0) % 180,
        "target_distance": _u16(distance / 10.0),
        "throttle": round(100.0 * ap.actuation.thrust_frac),
        "airspeed": ap.behaviour.high_latency_airspeed(ap),
        "airspeed_sp": 0,
        "groundspeed": min(255, round(5.0 * math.hypot(*ap.vel_ned_mps[:2]))),
        "windspeed": min(255, round(5.0 * wind_mps)),
        "wind_heading": wind_heading,
        "eph": 8,
        "epv": 12,
        "temperature_air": _i16(ap.readings.temperature_c),
        "climb_rate": max(-127, min(127, round(-10.0 * ap.vel_ned_mps[2]))),
        "battery": -1 if remaining is None else int(remaining * 100.0),
        "wp_num": mission_current(ap)["seq"],
        "failure_flags": 0 if ap.gnss_ok else 1,
        "custom0": 0,
        "custom1": 0,
        "custom2": 0,
    }


COMMON: dict[str, Builder] = {
    "HEARTBEAT": heartbeat,
    "SYS_STATUS": sys_status,
    "SYSTEM_TIME": system_time,
    "ATTITUDE": attitude,
    "ATTITUDE_QUATERNION": attitude_quaternion,
    "GLOBAL_POSITION_INT": global_position_int,
    "LOCAL_POSITION_NED": local_position_ned,
    "VFR_HUD": vfr_hud,
    "GPS_RAW_INT": gps_raw_int,
    "GPS_GLOBAL_ORIGIN": gps_global_origin,
    "BATTERY_STATUS": battery_status,
    "HOME_POSITION": home_position,
    "EXTENDED_SYS_STATE": extended_sys_state,
    "MISSION_CURRENT": mission_current,
    "RC_CHANNELS": rc_channels,
    "SERVO_OUTPUT_RAW": servo_output_raw,
    "NAV_CONTROLLER_OUTPUT": nav_controller_output,
    "VIBRATION": vibration,
    "HIGH_LATENCY2": high_latency2,
}
"""Messages that both autopilots send, by name."""
