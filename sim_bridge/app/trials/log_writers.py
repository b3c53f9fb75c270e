"""Writers of every log format that `companion replay` reads; they share no code with the readers.

By the published descriptions of ULog, dataflash, MAVLink and CSV, not by the libraries that read
them.
"""

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np

from sim_bridge.app.trials.made_flight import (
    ALT_M,
    CHARGE_FRAC,
    CURRENT_A,
    LAT_DEG,
    LON_DEG,
    VOLTAGE_V,
    MadeFlight,
)
from sim_bridge.autopilot.mavlink.codec import Encoder, Message

# --- CSV ----------------------------------------------------------------------------------------

CONTRACT = ("t_s", "vel_n_mps", "vel_e_mps", "vel_d_mps", "roll_deg", "pitch_deg", "yaw_deg",
            "airspeed_mps")  # fmt: skip


def csv_columns(world: MadeFlight) -> dict[str, np.ndarray]:
    """The columns of CSV telemetry (docs/reference/replay-json.md)."""
    angles = [np.degrees(a) for a in (world.roll_rad, world.pitch_rad, world.yaw_rad)]
    values = (world.t_s, *world.vel_ned_mps.T, *angles, world.airspeed_mps)
    return dict(zip(CONTRACT, values, strict=True))


def battery_columns(world: MadeFlight) -> dict[str, np.ndarray]:
    ones = np.ones(world.t_s.size)
    current = np.where(world.flying, CURRENT_A, 0.0)
    return {
        "voltage_v": np.where(world.flying, VOLTAGE_V - 0.9, VOLTAGE_V) * ones,
        "current_a": current,
        "consumed_mah": 1000.0 * world.used_ah,
        "armed": world.flying.astype(float),
        "lat_deg": world.lat_deg,
        "lon_deg": world.lon_deg,
        "alt_m": ALT_M - world.pos_ned_m[:, 2],
    }


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> Path:
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns)]
    lines += [",".join("" if x != x else f"{x:.9g}" for x in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


# --- ULog (docs.px4.io: ULog File Format) --------------------------------------------------------

ULOG_MAGIC = b"ULog\x01\x12\x35\x01"
ULOG_TYPES = {"uint64_t": "Q", "float": "f", "double": "d", "uint8_t": "B", "int8_t": "b",
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
    """Collects messages; `save` writes the file."""

    def __init__(self, parameters: dict[str, int]) -> None:
        self._head = [ULOG_MAGIC + struct.pack("<Q", 1000), self._message("B", bytes(40))]
        for name, fields in ULOG_TOPICS.items():
            self._head.append(self._message("F", f"{name}:{fields}".encode()))
        self._head.append(self._message("I", _keyed("char[4] sys_name", b"PX4 ")))
        for name, value in parameters.items():
            self._head.append(
                self._message("P", _keyed(f"int32_t {name}", struct.pack("<i", value)))
            )
        self._ids = {name: number for number, name in enumerate(ULOG_TOPICS)}
        for name, number in self._ids.items():
            self._head.append(self._message("A", struct.pack("<BH", 0, number) + name.encode()))
        self._data: list[tuple[int, bytes]] = []

    @staticmethod
    def _message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    def add(self, topic: str, t_s: float, *values: Any) -> None:
        stamp_us = round(t_s * 1e6)
        code = "<Q"
        for item in ULOG_TOPICS[topic].split(";")[1:-1]:
            kind = item.split()[0]
            name, _, count = kind.partition("[")
            code += (count.rstrip("]") or "") + ULOG_TYPES[name]
        body = struct.pack("<H", self._ids[topic]) + struct.pack(code, stamp_us, *values)
        self._data.append((stamp_us, self._message("D", body)))

    def save(self, path: Path) -> Path:
        data = [body for _, body in sorted(self._data, key=lambda item: item[0])]
        path.write_bytes(b"".join((*self._head, *data)))
        return path


def _keyed(key: str, value: bytes) -> bytes:
    return bytes([len(key)]) + key.encode() + value


def write_ulog(
    path: Path,
    world: MadeFlight,
    parameters: dict[str, int] | None = None,
    *,
    airspeed_source: int = -1,
    current_a: float = CURRENT_A,
    wind: bool = False,
) -> Path:
    log = UlogWriter({"MAV_TYPE": 2, **(parameters or {})})
    flew: bool | None = None
    for i, t_s in enumerate(world.t_s.tolist()):
        log.add("vehicle_attitude", t_s, *quaternion(world, i))
        n, e, d = world.pos_ned_m[i]
        valid = (True, True, LAT_DEG, LON_DEG, ALT_M)
        log.add("vehicle_local_position", t_s + 1e-4, n, e, d, *world.vel_ned_mps[i], *valid)
        height = ALT_M - d
        log.add("vehicle_global_position", t_s, world.lat_deg[i], world.lon_deg[i], height)
        speed = world.airspeed_mps[i]
        log.add("airspeed_validated", t_s, speed, airspeed_source)
        if wind and i % 5 == 0:
            log.add("wind", t_s, *world.wind_to_ne_mps, 0.25, 0.25)
        flying = bool(world.flying[i])
        if i % 2 == 0 and world.powered:
            used = 1000.0 * world.used_ah[i] if current_a >= 0.0 else 0.0
            amps = current_a if flying or current_a < 0.0 else 0.0
            volts = VOLTAGE_V - 0.9 * flying
            log.add("battery_status", t_s, volts, amps, used, CHARGE_FRAC, math.nan)
        if flying != flew or i % 10 == 0:
            flew = flying
            log.add("vehicle_status", t_s, 2 if flying else 1, 3 if flying else 4, False)
            log.add("vehicle_land_detected", t_s, not flying)
    return log.save(path)


def quaternion(world: MadeFlight, i: int) -> tuple[float, float, float, float]:
    """Body to NED, scalar first (yaw, pitch, roll in that order)."""
    halves = [0.5 * float(a[i]) for a in (world.roll_rad, world.pitch_rad, world.yaw_rad)]
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(h), math.sin(h)) for h in halves)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


# --- dataflash (ardupilot.org: Logs, and the FMT messages that every log begins with) -------------

DATAFLASH = {
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
DF_CODES = {"Q": "Q", "B": "B", "M": "B", "f": "f", "c": "h", "C": "H", "L": "i", "N": "16s",
            "Z": "64s", "n": "4s"}  # fmt: skip
DF_SCALE = {"c": 100.0, "C": 100.0, "L": 1e7}


class DataflashWriter:
    """Messages in the order of `add`, each with its format before the first."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._format("FMT", 128, 89, "BBnNZ", "Type,Length,Name,Format,Columns")
        for name, (number, code, columns) in DATAFLASH.items():
            size = 3 + struct.calcsize("<" + "".join(DF_CODES[c] for c in code))
            self._format(name, number, size, code, columns)

    def _format(self, name: str, number: int, size: int, code: str, columns: str) -> None:
        body = struct.pack(
            "<BB4s16s64s", number, size, name.encode(), code.encode(), columns.encode()
        )
        self._bytes += b"\xa3\x95\x80" + body

    def add(self, name: str, t_s: float, *values: Any) -> None:
        number, code, _ = DATAFLASH[name]
        wire: list[Any] = [round(t_s * 1e6)]
        for letter, value in zip(code[1:], values, strict=True):
            scaled = round(value * DF_SCALE[letter]) if letter in DF_SCALE else value
            wire.append(scaled.encode() if isinstance(scaled, str) else scaled)
        body = struct.pack("<" + "".join(DF_CODES[c] for c in code), *wire)
        self._bytes += b"\xa3\x95" + bytes([number]) + body

    def save(self, path: Path) -> Path:
        path.write_bytes(bytes(self._bytes))
        return path


def write_dataflash(
    path: Path,
    world: MadeFlight,
    parameters: dict[str, float] | None = None,
    *,
    says: str = "ArduCopter V4.5.7 (abcdef01)",
    wind: bool = True,
) -> Path:
    """As ArduCopter logs by default: from arming on, arming itself not said."""
    log = DataflashWriter()
    log.add("MSG", 0.0, says)
    for name, value in {"LOG_DISARMED": 0.0, **(parameters or {})}.items():
        log.add("PARM", 0.0, name, value)
    log.add("MODE", 0.0, 3, 3, 1)
    flew = False
    for i, t_s in enumerate(world.t_s.tolist()):
        roll, pitch, yaw = (
            math.degrees(a[i]) for a in (world.roll_rad, world.pitch_rad, world.yaw_rad)
        )
        log.add("ATT", t_s, 0.0, roll, 0.0, pitch, 0.0, yaw % 360.0)
        down = world.pos_ned_m[i, 2]
        log.add("POS", t_s, world.lat_deg[i], world.lon_deg[i], ALT_M - down, -down, -down)
        for core in (0, 1):  # the other core is off: it must not be taken
            n, e, d = world.vel_ned_mps[i] + 30.0 * core
            log.add("XKF1", t_s, core, roll, pitch, yaw % 360.0, n, e, d)
            estimate = world.wind_to_ne_mps if wind else (0.0, 0.0)
            log.add("XKF2", t_s, core, *estimate)
        log.add("ARSP", t_s, 0, world.airspeed_mps[i], 1, 1)
        flying = bool(world.flying[i])
        if flying != flew:
            flew = flying
            log.add("EV", t_s, 28 if flying else 18)
        if i % 2 == 0 and world.powered:
            amps = CURRENT_A if flying else 0.0
            used = 1000.0 * float(world.used_ah[i])
            log.add("BAT", t_s, 0, VOLTAGE_V - 0.9 * flying, amps, used, used * 0.0232)
    log.add("EV", world.t_s[-1], 11)
    return log.save(path)


# --- .tlog (microseconds since 1970, big-endian, before each frame) -------------------------------


class TlogWriter:
    """Frames by the simulated autopilots' own codec, which shares nothing with pymavlink."""

    EPOCH_US = 1_700_000_000_000_000

    def __init__(self, system: int = 1) -> None:
        self._encoder = Encoder(system=system, component=1)
        self.parts: list[bytes] = []

    def add(self, t_s: float, name: str, **fields: Any) -> None:
        frame = self._encoder.encode(Message(name, **fields))
        self.parts.append(struct.pack(">Q", self.EPOCH_US + round(t_s * 1e6)) + frame)

    def save(self, path: Path) -> Path:
        path.write_bytes(b"".join(self.parts))
        return path


def write_tlog(
    path: Path,
    world: MadeFlight,
    *,
    px4: bool = True,
    vehicle: int = 2,
    wind: bool = False,
    system: int = 1,
) -> Path:
    log = TlogWriter(system)
    for i, t_s in enumerate(world.t_s.tolist()):
        boot_ms = round(1000.0 * t_s)
        flying = bool(world.flying[i])
        if i % 5 == 0:
            mode = (4 << 16 | 4 << 24) if px4 else 3
            log.add(
                t_s,
                "HEARTBEAT",
                type=vehicle,
                autopilot=12 if px4 else 3,
                base_mode=0x81 if flying else 0x01,
                custom_mode=mode,
                system_status=4,
            )
            log.add(t_s, "EXTENDED_SYS_STATE", vtol_state=0, landed_state=2 if flying else 1)
            if wind and not px4:
                n, e = world.wind_to_ne_mps
                from_deg = math.degrees(math.atan2(-e, -n))
                log.add(t_s, "WIND", direction=from_deg, speed=math.hypot(n, e), speed_z=0.0)
        log.add(t_s, "ATTITUDE", time_boot_ms=boot_ms, roll=float(world.roll_rad[i]),
                pitch=float(world.pitch_rad[i]), yaw=float(world.yaw_rad[i]),
                rollspeed=0.0, pitchspeed=0.0, yawspeed=0.0)  # fmt: skip
        n, e, d = (round(100.0 * v) for v in world.vel_ned_mps[i].tolist())
        up_mm = round(-1000.0 * world.pos_ned_m[i, 2])
        log.add(t_s, "GLOBAL_POSITION_INT", time_boot_ms=boot_ms,
                lat=round(1e7 * world.lat_deg[i]), lon=round(1e7 * world.lon_deg[i]),
                alt=round(1000.0 * ALT_M) + up_mm, relative_alt=up_mm, vx=n, vy=e, vz=d,
                hdg=0)  # fmt: skip
        if i % 2 == 0 and world.powered:
            log.add(t_s, "BATTERY_STATUS", id=0, battery_function=0, type=1, temperature=32767,
                    voltages=(round(1000.0 * (VOLTAGE_V - 0.9 * flying)), *([65535] * 9)),
                    current_battery=round(100.0 * CURRENT_A) if flying else 0,
                    current_consumed=round(1000.0 * float(world.used_ah[i])),
                    energy_consumed=-1, battery_remaining=-1)  # fmt: skip
    return log.save(path)
