"""Writers of every log format that `companion replay` reads; they share no code with the readers.

They follow the published descriptions of ULog, dataflash, MAVLink and CSV and use none of the
libraries that read them.
"""

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np

from sim_bridge.app.trials.synthetic_flight import (
    ALT_M,
    CHARGE_FRAC,
    LAT_DEG,
    LON_DEG,
    SyntheticFlight,
)
from sim_bridge.autopilot.mavlink.codec import Encoder, Message

# --- CSV ----------------------------------------------------------------------------------------

CSV_COLUMNS = ("t_s", "vel_n_mps", "vel_e_mps", "vel_d_mps", "roll_deg", "pitch_deg", "yaw_deg",
            "airspeed_mps")  # fmt: skip


def telemetry_csv_columns(synthetic_flight: SyntheticFlight) -> dict[str, np.ndarray]:
    """Return the columns of CSV telemetry (docs/reference/replay-json.md)."""
    values = (
        synthetic_flight.t_s,
        *synthetic_flight.vel_ned_mps.T,
        *np.degrees(synthetic_flight.attitude_rad).T,
        synthetic_flight.airspeed_mps,
    )
    return dict(zip(CSV_COLUMNS, values, strict=True))


def battery_csv_columns(synthetic_flight: SyntheticFlight) -> dict[str, np.ndarray]:
    return {
        "voltage_v": synthetic_flight.voltage_v,
        "current_a": synthetic_flight.current_a,
        "consumed_mah": 1000.0 * synthetic_flight.consumed_charge_ah,
        "armed": synthetic_flight.flying.astype(float),
        "lat_deg": synthetic_flight.lat_deg,
        "lon_deg": synthetic_flight.lon_deg,
        "alt_m": ALT_M - synthetic_flight.pos_ned_m[:, 2],
    }


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> Path:
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns)]
    lines += [",".join("" if x != x else f"{x:.9g}" for x in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


# --- ULog (docs.px4.io: ULog File Format) --------------------------------------------------------

ULOG_MAGIC = b"ULog\x01\x12\x35\x01"
ULOG_TYPE_CODES = {"uint64_t": "Q", "float": "f", "double": "d", "uint8_t": "B", "int8_t": "b",
              "bool": "?", "int32_t": "i", "uint16_t": "H"}  # fmt: skip
ULOG_TOPICS = {
    "vehicle_attitude": "uint64_t timestamp;float[4] q;",
    "vehicle_local_position": "uint64_t timestamp;float x;float y;float z;float vx;float vy;"
    "float vz;bool v_xy_valid;bool v_z_valid;double ref_lat;double ref_lon;float ref_alt;",
    "vehicle_global_position": "uint64_t timestamp;double lat;double lon;float alt;",
    "vehicle_status": "uint64_t timestamp;uint8_t arming_state;uint8_t nav_state;bool failsafe;",
    "vehicle_land_detected": "uint64_t timestamp;bool landed;",
    "battery_status": "uint64_t timestamp;float voltage_v;float current_a;float discharged_mah;"
    "float remaining;float temperature;",
    "airspeed_validated": "uint64_t timestamp;float true_airspeed_m_s;int8_t airspeed_source;",
    "wind": "uint64_t timestamp;float windspeed_north;float windspeed_east;float variance_north;"
    "float variance_east;",
}


class UlogWriter:
    """Collects messages; `write_sorted_by_time` writes the file."""

    def __init__(self, parameters: dict[str, int]) -> None:
        self._head = [ULOG_MAGIC + struct.pack("<Q", 1000), self._encode_message("B", bytes(40))]
        for name, fields in ULOG_TOPICS.items():
            self._head.append(self._encode_message("F", f"{name}:{fields}".encode()))
        self._head.append(self._encode_message("I", _key_value_bytes("char[4] sys_name", b"PX4 ")))
        for name, value in parameters.items():
            self._head.append(
                self._encode_message(
                    "P", _key_value_bytes(f"int32_t {name}", struct.pack("<i", value))
                )
            )
        self._ids = {name: number for number, name in enumerate(ULOG_TOPICS)}
        for name, number in self._ids.items():
            self._head.append(
                self._encode_message("A", struct.pack("<BH", 0, number) + name.encode())
            )
        self._data: list[tuple[int, bytes]] = []

    @staticmethod
    def _encode_message(message_type: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(message_type)) + body

    def append_message(self, topic: str, t_s: float, *values: Any) -> None:
        stamp_us = round(t_s * 1e6)
        code = "<Q"
        for item in ULOG_TOPICS[topic].split(";")[1:-1]:
            kind = item.split()[0]
            name, _, count = kind.partition("[")
            code += (count.rstrip("]") or "") + ULOG_TYPE_CODES[name]
        body = struct.pack("<H", self._ids[topic]) + struct.pack(code, stamp_us, *values)
        self._data.append((stamp_us, self._encode_message("D", body)))

    def write_sorted_by_time(self, path: Path) -> Path:
        data = [body for _, body in sorted(self._data, key=lambda item: item[0])]
        path.write_bytes(b"".join((*self._head, *data)))
        return path


def _key_value_bytes(key: str, value: bytes) -> bytes:
    return bytes([len(key)]) + key.encode() + value


def write_ulog(
    path: Path,
    synthetic_flight: SyntheticFlight,
    parameters: dict[str, int] | None = None,
    *,
    airspeed_source: int = -1,
    with_current: bool = True,
    with_wind_estimate: bool = False,
) -> Path:
    log = UlogWriter({"MAV_TYPE": 2, **(parameters or {})})
    attitude = synthetic_flight.attitude_rad.tolist()
    was_airborne: bool | None = None
    for i, t_s in enumerate(synthetic_flight.t_s.tolist()):
        log.append_message("vehicle_attitude", t_s, *body_to_ned_quaternion(attitude[i]))
        n, e, d = synthetic_flight.pos_ned_m[i]
        valid = (True, True, LAT_DEG, LON_DEG, ALT_M)
        log.append_message(
            "vehicle_local_position", t_s + 1e-4, n, e, d, *synthetic_flight.vel_ned_mps[i], *valid
        )
        height = ALT_M - d
        log.append_message(
            "vehicle_global_position",
            t_s,
            synthetic_flight.lat_deg[i],
            synthetic_flight.lon_deg[i],
            height,
        )
        speed = synthetic_flight.airspeed_mps[i]
        log.append_message("airspeed_validated", t_s, speed, airspeed_source)
        if with_wind_estimate and i % 5 == 0:
            log.append_message("wind", t_s, *synthetic_flight.wind_to_ne_mps, 0.25, 0.25)
        is_airborne = bool(synthetic_flight.flying[i])
        if i % 2 == 0 and synthetic_flight.powered:
            used = 1000.0 * synthetic_flight.consumed_charge_ah[i] if with_current else 0.0
            amps = synthetic_flight.current_a[i] if with_current else -1.0
            volts = synthetic_flight.voltage_v[i]
            log.append_message("battery_status", t_s, volts, amps, used, CHARGE_FRAC, math.nan)
        if is_airborne != was_airborne or i % 10 == 0:
            was_airborne = is_airborne
            log.append_message(
                "vehicle_status", t_s, 2 if is_airborne else 1, 3 if is_airborne else 4, False
            )
            log.append_message("vehicle_land_detected", t_s, not is_airborne)
    return log.write_sorted_by_time(path)


def body_to_ned_quaternion(attitude_rad: list[float]) -> tuple[float, float, float, float]:
    """Return the quaternion from body to NED, scalar first (order yaw, pitch, roll)."""
    halves = [0.5 * angle for angle in attitude_rad]
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(h), math.sin(h)) for h in halves)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


# --- dataflash (ardupilot.org: Logs, and the FMT messages that every log begins with) -------------

DATAFLASH_FORMATS = {
    "ATT": (130, "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    "XKF1": (131, "QBccCfff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD"),
    "XKF2": (132, "QBff", "TimeUS,C,VWN,VWE"),
    "POS": (133, "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
    "BAT": (134, "QBffff", "TimeUS,Inst,Volt,Curr,CurrTot,EnrgTot"),
    "ARSP": (135, "QBfBB", "TimeUS,I,Airspeed,U,H"),
    "MODE": (136, "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    "EV": (137, "QB", "TimeUS,Id"),
    "PARM": (138, "QNf", "TimeUS,Name,Value"),
    "MSG": (139, "QZ", "TimeUS,Message"),
}
DATAFLASH_TYPE_CODES = {"Q": "Q", "B": "B", "M": "B", "f": "f", "c": "h", "C": "H", "L": "i",
    "N": "16s",
            "Z": "64s", "n": "4s"}  # fmt: skip
DATAFLASH_SCALES = {"c": 100.0, "C": 100.0, "L": 1e7}


class DataflashWriter:
    """Collects messages in the order of `append_message`, after the format messages."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._append_format_message("FMT", 128, 89, "BBnNZ", "Type,Length,Name,Format,Columns")
        for name, (number, code, columns) in DATAFLASH_FORMATS.items():
            size = 3 + struct.calcsize("<" + "".join(DATAFLASH_TYPE_CODES[c] for c in code))
            self._append_format_message(name, number, size, code, columns)

    def _append_format_message(
        self, name: str, number: int, size: int, code: str, columns: str
    ) -> None:
        body = struct.pack(
            "<BB4s16s64s", number, size, name.encode(), code.encode(), columns.encode()
        )
        self._bytes += b"\xa3\x95\x80" + body

    def append_message(self, name: str, t_s: float, *values: Any) -> None:
        number, code, _ = DATAFLASH_FORMATS[name]
        wire: list[Any] = [round(t_s * 1e6)]
        for letter, value in zip(code[1:], values, strict=True):
            scaled = (
                round(value * DATAFLASH_SCALES[letter]) if letter in DATAFLASH_SCALES else value
            )
            wire.append(scaled.encode() if isinstance(scaled, str) else scaled)
        body = struct.pack("<" + "".join(DATAFLASH_TYPE_CODES[c] for c in code), *wire)
        self._bytes += b"\xa3\x95" + bytes([number]) + body

    def save(self, path: Path) -> Path:
        path.write_bytes(bytes(self._bytes))
        return path


def write_dataflash(
    path: Path,
    synthetic_flight: SyntheticFlight,
    parameters: dict[str, float] | None = None,
    *,
    firmware_text: str = "ArduCopter V4.5.7 (abcdef01)",
    with_wind_estimate: bool = True,
) -> Path:
    """Write a log as ArduCopter does by default: from arming on, without an arming event."""
    log = DataflashWriter()
    log.append_message("MSG", 0.0, firmware_text)
    for name, value in {"LOG_DISARMED": 0.0, **(parameters or {})}.items():
        log.append_message("PARM", 0.0, name, value)
    log.append_message("MODE", 0.0, 3, 3, 1)
    attitude_deg = np.degrees(synthetic_flight.attitude_rad).tolist()
    was_airborne = False
    for i, t_s in enumerate(synthetic_flight.t_s.tolist()):
        roll, pitch, yaw = attitude_deg[i]
        log.append_message("ATT", t_s, 0.0, roll, 0.0, pitch, 0.0, yaw % 360.0)
        down = synthetic_flight.pos_ned_m[i, 2]
        log.append_message(
            "POS",
            t_s,
            synthetic_flight.lat_deg[i],
            synthetic_flight.lon_deg[i],
            ALT_M - down,
            -down,
            -down,
        )
        for core in (0, 1):  # the other core has an offset: readers must not use it
            n, e, d = synthetic_flight.vel_ned_mps[i] + 30.0 * core
            log.append_message("XKF1", t_s, core, roll, pitch, yaw % 360.0, n, e, d)
            estimate = synthetic_flight.wind_to_ne_mps if with_wind_estimate else (0.0, 0.0)
            log.append_message("XKF2", t_s, core, *estimate)
        log.append_message("ARSP", t_s, 0, synthetic_flight.airspeed_mps[i], 1, 1)
        is_airborne = bool(synthetic_flight.flying[i])
        if is_airborne != was_airborne:
            was_airborne = is_airborne
            log.append_message("EV", t_s, 28 if is_airborne else 18)
        if i % 2 == 0 and synthetic_flight.powered:
            amps, volts = synthetic_flight.current_a[i], synthetic_flight.voltage_v[i]
            used = 1000.0 * float(synthetic_flight.consumed_charge_ah[i])
            log.append_message("BAT", t_s, 0, volts, amps, used, used * 0.0232)
    log.append_message("EV", synthetic_flight.t_s[-1], 11)
    return log.save(path)


# --- .tlog (microseconds since 1970, big-endian, before each frame) -------------------------------


class TlogWriter:
    """Writes frames with the codec of the simulated autopilots, independent of pymavlink."""

    EPOCH_US = 1_700_000_000_000_000

    def __init__(self, system: int = 1) -> None:
        self._encoder = Encoder(system=system, component=1)
        self.parts: list[bytes] = []

    def append_frame(self, t_s: float, message_name: str, **fields: Any) -> None:
        frame = self._encoder.encode_next_frame(Message(message_name, **fields))
        self.parts.append(struct.pack(">Q", self.EPOCH_US + round(t_s * 1e6)) + frame)

    def save(self, path: Path) -> Path:
        path.write_bytes(b"".join(self.parts))
        return path


def write_tlog(
    path: Path,
    synthetic_flight: SyntheticFlight,
    *,
    px4: bool = True,
    mav_type: int = 2,
    with_wind_estimate: bool = False,
    system_id: int = 1,
) -> Path:
    log = TlogWriter(system_id)
    attitude = synthetic_flight.attitude_rad.tolist()
    for i, t_s in enumerate(synthetic_flight.t_s.tolist()):
        boot_ms = round(1000.0 * t_s)
        is_airborne = bool(synthetic_flight.flying[i])
        if i % 5 == 0:
            mode = (4 << 16 | 4 << 24) if px4 else 3
            log.append_frame(
                t_s,
                "HEARTBEAT",
                type=mav_type,
                autopilot=12 if px4 else 3,
                base_mode=0x81 if is_airborne else 0x01,
                custom_mode=mode,
                system_status=4,
            )
            log.append_frame(
                t_s, "EXTENDED_SYS_STATE", vtol_state=0, landed_state=2 if is_airborne else 1
            )
            if with_wind_estimate and not px4:
                n, e = synthetic_flight.wind_to_ne_mps
                from_deg = math.degrees(math.atan2(-e, -n))
                log.append_frame(
                    t_s, "WIND", direction=from_deg, speed=math.hypot(n, e), speed_z=0.0
                )
        roll, pitch, yaw = attitude[i]
        rates = dict.fromkeys(("rollspeed", "pitchspeed", "yawspeed"), 0.0)
        log.append_frame(
            t_s, "ATTITUDE", time_boot_ms=boot_ms, roll=roll, pitch=pitch, yaw=yaw, **rates
        )
        n, e, d = (round(100.0 * v) for v in synthetic_flight.vel_ned_mps[i].tolist())
        up_mm = round(-1000.0 * synthetic_flight.pos_ned_m[i, 2])
        log.append_frame(t_s, "GLOBAL_POSITION_INT", time_boot_ms=boot_ms,
                lat=round(1e7 * synthetic_flight.lat_deg[i]),
                lon=round(1e7 * synthetic_flight.lon_deg[i]),
                alt=round(1000.0 * ALT_M) + up_mm, relative_alt=up_mm, vx=n, vy=e, vz=d,
                hdg=0)  # fmt: skip
        if i % 2 == 0 and synthetic_flight.powered:
            log.append_frame(t_s, "BATTERY_STATUS", id=0, battery_function=0, type=1,
            temperature=32767,
                    voltages=(round(1000.0 * synthetic_flight.voltage_v[i]), *([65535] * 9)),
                    current_battery=round(100.0 * synthetic_flight.current_a[i]),
                    current_consumed=round(1000.0 * float(synthetic_flight.consumed_charge_ah[i])),
                    energy_consumed=-1, battery_remaining=-1)  # fmt: skip
    return log.save(path)
