"""The MAVLink messages that the simulated autopilots send or understand.

Source: the published message definitions (mavlink.io: minimal, standard, common, ardupilotmega and
development sets). A message is its id, its name and its fields in the order of definition, those
after `|` being MAVLink 2 extensions; `f32[4] q` is an array, `=3` a constant that the sender need
not state. Everything else (order on the wire, lengths, the CRC's extra byte) follows from that by
the rules of the protocol (mavlink.io/en/guide/serialization.html) and is derived here.
"""

import re
import struct
from binascii import crc_hqx
from dataclasses import dataclass, field

_DEFINITIONS = """
0 HEARTBEAT
    u8 type, u8 autopilot, u8 base_mode, u32 custom_mode, u8 system_status, u8 mavlink_version=3
1 SYS_STATUS
    u32 onboard_control_sensors_present, u32 onboard_control_sensors_enabled,
    u32 onboard_control_sensors_health, u16 load, u16 voltage_battery, i16 current_battery,
    i8 battery_remaining, u16 drop_rate_comm, u16 errors_comm, u16 errors_count1,
    u16 errors_count2, u16 errors_count3, u16 errors_count4 |
    u32 onboard_control_sensors_present_extended, u32 onboard_control_sensors_enabled_extended,
    u32 onboard_control_sensors_health_extended
2 SYSTEM_TIME
    u64 time_unix_usec, u32 time_boot_ms
4 PING
    u64 time_usec, u32 seq, u8 target_system, u8 target_component
11 SET_MODE
    u8 target_system, u8 base_mode, u32 custom_mode
20 PARAM_REQUEST_READ
    u8 target_system, u8 target_component, char[16] param_id, i16 param_index
21 PARAM_REQUEST_LIST
    u8 target_system, u8 target_component
22 PARAM_VALUE
    char[16] param_id, f32 param_value, u8 param_type, u16 param_count, u16 param_index
23 PARAM_SET
    u8 target_system, u8 target_component, char[16] param_id, f32 param_value, u8 param_type
24 GPS_RAW_INT
    u64 time_usec, u8 fix_type, i32 lat, i32 lon, i32 alt, u16 eph, u16 epv, u16 vel, u16 cog,
    u8 satellites_visible | i32 alt_ellipsoid, u32 h_acc, u32 v_acc, u32 vel_acc, u32 hdg_acc,
    u16 yaw
29 SCALED_PRESSURE
    u32 time_boot_ms, f32 press_abs, f32 press_diff, i16 temperature |
    i16 temperature_press_diff
30 ATTITUDE
    u32 time_boot_ms, f32 roll, f32 pitch, f32 yaw, f32 rollspeed, f32 pitchspeed, f32 yawspeed
31 ATTITUDE_QUATERNION
    u32 time_boot_ms, f32 q1, f32 q2, f32 q3, f32 q4, f32 rollspeed, f32 pitchspeed,
    f32 yawspeed | f32[4] repr_offset_q
32 LOCAL_POSITION_NED
    u32 time_boot_ms, f32 x, f32 y, f32 z, f32 vx, f32 vy, f32 vz
33 GLOBAL_POSITION_INT
    u32 time_boot_ms, i32 lat, i32 lon, i32 alt, i32 relative_alt, i16 vx, i16 vy, i16 vz,
    u16 hdg
36 SERVO_OUTPUT_RAW
    u32 time_usec, u8 port, u16 servo1_raw, u16 servo2_raw, u16 servo3_raw, u16 servo4_raw,
    u16 servo5_raw, u16 servo6_raw, u16 servo7_raw, u16 servo8_raw | u16 servo9_raw,
    u16 servo10_raw, u16 servo11_raw, u16 servo12_raw, u16 servo13_raw, u16 servo14_raw,
    u16 servo15_raw, u16 servo16_raw
38 MISSION_WRITE_PARTIAL_LIST
    u8 target_system, u8 target_component, i16 start_index, i16 end_index | u8 mission_type
39 MISSION_ITEM
    u8 target_system, u8 target_component, u16 seq, u8 frame, u16 command, u8 current,
    u8 autocontinue, f32 param1, f32 param2, f32 param3, f32 param4, f32 x, f32 y, f32 z |
    u8 mission_type
40 MISSION_REQUEST
    u8 target_system, u8 target_component, u16 seq | u8 mission_type
41 MISSION_SET_CURRENT
    u8 target_system, u8 target_component, u16 seq
42 MISSION_CURRENT
    u16 seq | u16 total, u8 mission_state, u8 mission_mode, u32 mission_id, u32 fence_id,
    u32 rally_points_id
43 MISSION_REQUEST_LIST
    u8 target_system, u8 target_component | u8 mission_type
44 MISSION_COUNT
    u8 target_system, u8 target_component, u16 count | u8 mission_type
45 MISSION_CLEAR_ALL
    u8 target_system, u8 target_component | u8 mission_type
46 MISSION_ITEM_REACHED
    u16 seq
47 MISSION_ACK
    u8 target_system, u8 target_component, u8 type | u8 mission_type
49 GPS_GLOBAL_ORIGIN
    i32 latitude, i32 longitude, i32 altitude | u64 time_usec
51 MISSION_REQUEST_INT
    u8 target_system, u8 target_component, u16 seq | u8 mission_type
62 NAV_CONTROLLER_OUTPUT
    f32 nav_roll, f32 nav_pitch, i16 nav_bearing, i16 target_bearing, u16 wp_dist,
    f32 alt_error, f32 aspd_error, f32 xtrack_error
65 RC_CHANNELS
    u32 time_boot_ms, u8 chancount, u16 chan1_raw, u16 chan2_raw, u16 chan3_raw, u16 chan4_raw,
    u16 chan5_raw, u16 chan6_raw, u16 chan7_raw, u16 chan8_raw, u16 chan9_raw, u16 chan10_raw,
    u16 chan11_raw, u16 chan12_raw, u16 chan13_raw, u16 chan14_raw, u16 chan15_raw,
    u16 chan16_raw, u16 chan17_raw, u16 chan18_raw, u8 rssi
66 REQUEST_DATA_STREAM
    u8 target_system, u8 target_component, u8 req_stream_id, u16 req_message_rate, u8 start_stop
69 MANUAL_CONTROL
    u8 target, i16 x, i16 y, i16 z, i16 r, u16 buttons | u16 buttons2, u8 enabled_extensions,
    i16 s, i16 t, i16 aux1, i16 aux2, i16 aux3, i16 aux4, i16 aux5, i16 aux6
70 RC_CHANNELS_OVERRIDE
    u8 target_system, u8 target_component, u16 chan1_raw, u16 chan2_raw, u16 chan3_raw,
    u16 chan4_raw, u16 chan5_raw, u16 chan6_raw, u16 chan7_raw, u16 chan8_raw | u16 chan9_raw,
    u16 chan10_raw, u16 chan11_raw, u16 chan12_raw, u16 chan13_raw, u16 chan14_raw,
    u16 chan15_raw, u16 chan16_raw, u16 chan17_raw, u16 chan18_raw
73 MISSION_ITEM_INT
    u8 target_system, u8 target_component, u16 seq, u8 frame, u16 command, u8 current,
    u8 autocontinue, f32 param1, f32 param2, f32 param3, f32 param4, i32 x, i32 y, f32 z |
    u8 mission_type
74 VFR_HUD
    f32 airspeed, f32 groundspeed, i16 heading, u16 throttle, f32 alt, f32 climb
75 COMMAND_INT
    u8 target_system, u8 target_component, u8 frame, u16 command, u8 current, u8 autocontinue,
    f32 param1, f32 param2, f32 param3, f32 param4, i32 x, i32 y, f32 z
76 COMMAND_LONG
    u8 target_system, u8 target_component, u16 command, u8 confirmation, f32 param1, f32 param2,
    f32 param3, f32 param4, f32 param5, f32 param6, f32 param7
77 COMMAND_ACK
    u16 command, u8 result | u8 progress, i32 result_param2, u8 target_system,
    u8 target_component
82 SET_ATTITUDE_TARGET
    u32 time_boot_ms, u8 target_system, u8 target_component, u8 type_mask, f32[4] q,
    f32 body_roll_rate, f32 body_pitch_rate, f32 body_yaw_rate, f32 thrust
84 SET_POSITION_TARGET_LOCAL_NED
    u32 time_boot_ms, u8 target_system, u8 target_component, u8 coordinate_frame, u16 type_mask,
    f32 x, f32 y, f32 z, f32 vx, f32 vy, f32 vz, f32 afx, f32 afy, f32 afz, f32 yaw,
    f32 yaw_rate
86 SET_POSITION_TARGET_GLOBAL_INT
    u32 time_boot_ms, u8 target_system, u8 target_component, u8 coordinate_frame, u16 type_mask,
    i32 lat_int, i32 lon_int, f32 alt, f32 vx, f32 vy, f32 vz, f32 afx, f32 afy, f32 afz,
    f32 yaw, f32 yaw_rate
109 RADIO_STATUS
    u8 rssi, u8 remrssi, u8 txbuf, u8 noise, u8 remnoise, u16 rxerrors, u16 fixed
110 FILE_TRANSFER_PROTOCOL
    u8 target_network, u8 target_system, u8 target_component, u8[251] payload
111 TIMESYNC
    i64 tc1, i64 ts1
141 ALTITUDE
    u64 time_usec, f32 altitude_monotonic, f32 altitude_amsl, f32 altitude_local,
    f32 altitude_relative, f32 altitude_terrain, f32 bottom_clearance
147 BATTERY_STATUS
    u8 id, u8 battery_function, u8 type, i16 temperature, u16[10] voltages, i16 current_battery,
    i32 current_consumed, i32 energy_consumed, i8 battery_remaining | i32 time_remaining,
    u8 charge_state, u16[4] voltages_ext, u8 mode, u32 fault_bitmask
148 AUTOPILOT_VERSION
    u64 capabilities, u32 flight_sw_version, u32 middleware_sw_version, u32 os_sw_version,
    u32 board_version, u8[8] flight_custom_version, u8[8] middleware_custom_version,
    u8[8] os_custom_version, u16 vendor_id, u16 product_id, u64 uid | u8[18] uid2
163 AHRS
    f32 omegaIx, f32 omegaIy, f32 omegaIz, f32 accel_weight, f32 renorm_val, f32 error_rp,
    f32 error_yaw
166 RADIO
    u8 rssi, u8 remrssi, u8 txbuf, u8 noise, u8 remnoise, u16 rxerrors, u16 fixed
168 WIND
    f32 direction, f32 speed, f32 speed_z
193 EKF_STATUS_REPORT
    u16 flags, f32 velocity_variance, f32 pos_horiz_variance, f32 pos_vert_variance,
    f32 compass_variance, f32 terrain_alt_variance | f32 airspeed_variance
230 ESTIMATOR_STATUS
    u64 time_usec, u16 flags, f32 vel_ratio, f32 pos_horiz_ratio, f32 pos_vert_ratio,
    f32 mag_ratio, f32 hagl_ratio, f32 tas_ratio, f32 pos_horiz_accuracy, f32 pos_vert_accuracy
231 WIND_COV
    u64 time_usec, f32 wind_x, f32 wind_y, f32 wind_z, f32 var_horiz, f32 var_vert,
    f32 wind_alt, f32 horiz_accuracy, f32 vert_accuracy
235 HIGH_LATENCY2
    u32 timestamp, u8 type, u8 autopilot, u16 custom_mode, i32 latitude, i32 longitude,
    i16 altitude, i16 target_altitude, u8 heading, u8 target_heading, u16 target_distance,
    u8 throttle, u8 airspeed, u8 airspeed_sp, u8 groundspeed, u8 windspeed, u8 wind_heading,
    u8 eph, u8 epv, i8 temperature_air, i8 climb_rate, i8 battery, u16 wp_num,
    u16 failure_flags, i8 custom0, i8 custom1, i8 custom2
242 HOME_POSITION
    i32 latitude, i32 longitude, i32 altitude, f32 x, f32 y, f32 z, f32[4] q, f32 approach_x,
    f32 approach_y, f32 approach_z | u64 time_usec
244 MESSAGE_INTERVAL
    u16 message_id, i32 interval_us
245 EXTENDED_SYS_STATE
    u8 vtol_state, u8 landed_state
251 NAMED_VALUE_FLOAT
    u32 time_boot_ms, char[10] name, f32 value
253 STATUSTEXT
    u8 severity, char[50] text | u16 id, u8 chunk_seq
256 SETUP_SIGNING
    u8 target_system, u8 target_component, u8[32] secret_key, u64 initial_timestamp
295 AIRSPEED
    u8 id, f32 airspeed, i16 temperature, f32 raw_press, u8 flags
300 PROTOCOL_VERSION
    u16 version, u16 min_version, u16 max_version, u8[8] spec_version_hash,
    u8[8] library_version_hash
345 PARAM_ERROR
    u8 target_system, u8 target_component, char[16] param_id, i16 param_index, u8 error
436 CURRENT_MODE
    u8 standard_mode, u32 custom_mode, u32 intended_custom_mode
"""

_STRUCT_CODE = {
    "i8": "b", "u8": "B", "char": "s", "i16": "h", "u16": "H", "i32": "i", "u32": "I",
    "i64": "q", "u64": "Q", "f32": "f", "f64": "d",
}  # fmt: skip
_C_NAME = {
    "i8": "int8_t", "u8": "uint8_t", "char": "char", "i16": "int16_t", "u16": "uint16_t",
    "i32": "int32_t", "u32": "uint32_t", "i64": "int64_t", "u64": "uint64_t",
    "f32": "float", "f64": "double",
}  # fmt: skip
_FIELD = re.compile(r"(?P<type>\w+)(?:\[(?P<count>\d+)\])? (?P<name>\w+)(?:=(?P<constant>\d+))?")

MIRRORED_BITS = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc16_mcrf4xx_bytes(data: bytes) -> bytes:
    """Compute CRC-16/MCRF4XX of `data` as two bytes, low byte first (wire order).

    The standard library has only the bit-reversed form of this CRC (same polynomial, most
    significant bit first), in C: this function reverses the bits of its input and result.
    """
    mirrored = crc_hqx(data.translate(MIRRORED_BITS), 0xFFFF)
    return mirrored.to_bytes(2, "big").translate(MIRRORED_BITS)


@dataclass(frozen=True, slots=True)
class Field:
    """One field: `type` as in the table; `count` is 0 for a scalar, else the array's length."""

    name: str
    type: str
    count: int
    extension: bool
    constant: int | None

    @property
    def item_size_bytes(self) -> int:
        """Bytes of one item on the wire; it decides the order of the fields."""
        return struct.calcsize("<" + _STRUCT_CODE[self.type])

    @property
    def struct_code(self) -> str:
        """The field in `struct` notation; char and u8 arrays are one bytes object."""
        if self.count and self.type in ("char", "u8"):
            return f"{self.count}s"
        return f"{self.count or ''}{_STRUCT_CODE[self.type]}"


@dataclass(frozen=True, slots=True)
class MessageSpec:
    """One message type: its fields in wire order and derived data."""

    id: int
    name: str
    fields: tuple[Field, ...]
    crc_extra: bytes
    base_size: int
    full: struct.Struct = field(repr=False)


def _crc_extra(message_name: str, base_fields: list[Field]) -> bytes:
    """The byte that makes two definitions of one message id incompatible, if they differ."""
    text = f"{message_name} ".encode()
    for item in base_fields:
        text += f"{_C_NAME[item.type]} {item.name} ".encode()
        if item.count:
            text += bytes([item.count])
    low, high = crc16_mcrf4xx_bytes(text)
    return bytes([low ^ high])


def _parse_message_spec(id_text: str, name: str, definition: str) -> MessageSpec:
    base_text, _, extension_text = definition.partition("|")
    parsed = [
        Field(
            match["name"],
            match["type"],
            int(match["count"] or 0),
            extension,
            None if match["constant"] is None else int(match["constant"]),
        )
        for text, extension in ((base_text, False), (extension_text, True))
        for match in _FIELD.finditer(text)
    ]
    base = sorted(
        (f for f in parsed if not f.extension), key=lambda f: -f.item_size_bytes
    )  # is stable
    fields = base + [f for f in parsed if f.extension]
    return MessageSpec(
        id=int(id_text),
        name=name,
        fields=tuple(fields),
        crc_extra=_crc_extra(name, base),
        base_size=struct.calcsize("<" + "".join(f.struct_code for f in base)),
        full=struct.Struct("<" + "".join(f.struct_code for f in fields)),
    )


def _parse_message_definitions(definitions: str) -> dict[str, MessageSpec]:
    blocks = re.findall(r"^(\d+) (\w+)\n((?:    .*\n)+)", definitions, re.MULTILINE)
    return {name: _parse_message_spec(id_text, name, body) for id_text, name, body in blocks}


SPECS: dict[str, MessageSpec] = _parse_message_definitions(_DEFINITIONS)
SPECS_BY_ID: dict[int, MessageSpec] = {spec.id: spec for spec in SPECS.values()}
