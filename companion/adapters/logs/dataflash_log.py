"""Read an ArduPilot dataflash log (.bin) with pymavlink's DFReader into events."""

import contextlib
import io
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from companion.adapters.autopilots.ardupilot import ArduPilot
from companion.adapters.logs.dataflash_filter import extract_undamaged_messages
from companion.adapters.logs.log_time import LogClock
from companion.analysis.replay.recorded_flight import LogIssue, RecordedFlight
from companion.core.base.documents import byte_location
from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from companion.core.mission.events import (
    Airspeed,
    Attitude,
    AutopilotKind,
    AutopilotWind,
    Battery,
    Event,
    GnssFix,
    GroundState,
    Home,
    MissionProgress,
    Position,
    VehicleLandedState,
    VehicleState,
)
from companion.core.vehicle.airframe import MULTIROTOR

DECODED_TYPES = (
    "ATT", "XKF1", "XKF2", "XKF4", "NKF1", "POS", "GPS", "BAT", "CURR", "ARSP", "MODE", "ARM",
    "ERR", "EV", "MISE", "ORGN", "MSG", "VER",
)  # fmt: skip
MIN_INTERVAL_S = {
    "ATT": 0.045,
    "XKF1": 0.09,
    "NKF1": 0.09,
    "GPS": 0.19,
    "BAT": 0.19,
    "CURR": 0.19,
    "ARSP": 0.09,
    "XKF2": 0.4,
}
"""Minimum interval between messages of a type: about the stream rates requested in flight."""

MAX_POSITION_AGE_S = 0.5
EV_ARMED, EV_DISARMED, EV_LANDED, EV_NOT_LANDED = 10, 11, 18, 28
HOME_ORIGIN_TYPE = 1
ERR_SUBSYSTEMS = {
    5: "radio failsafe", 6: "battery failsafe", 7: "GNSS failsafe", 8: "GCS failsafe",
    9: "fence failsafe", 12: "crash check", 16: "EKF check", 17: "EKF failsafe", 18: "barometer",
    19: "CPU failsafe", 23: "terrain failsafe", 25: "thrust loss check", 29: "vibration failsafe",
    30: "internal error", 31: "dead reckoning failsafe",
}  # fmt: skip
"""Subsystem of ERR by number (AP_Logger.h, LogErrorSubsystem); its code 0 is an end."""

VEHICLE_OF_BUILD = {1: "rover", 2: MULTIROTOR, 3: "fixed wing", 4: "antenna tracker",
    7: "submarine",
          12: "blimp", 13: "helicopter"}  # fmt: skip
"""Vehicle by VER.BU."""

VEHICLE_OF_NAME = {
    "ArduCopter": MULTIROTOR,
    "ArduPlane": "fixed wing",
    "ArduRover": "rover",
    "Rover": "rover",
    "ArduSub": "submarine",
    "Blimp": "blimp",
}


def read_dataflash_log(path: Path) -> RecordedFlight:
    """Read a .bin; LeewayError if it contains no flight."""
    captured_output = io.StringIO()
    reader = _DataflashReader()
    try:
        with (
            contextlib.redirect_stderr(captured_output),
            contextlib.redirect_stdout(captured_output),
            _undamaged_copy(path, reader.findings) as clean_path,
        ):
            _read_messages(clean_path, reader)
    except Exception as error:
        if not reader.events:
            words = "damaged from its beginning: expected FMT messages of a dataflash log"
            raise LeewayError(f"{path}: {words}") from error
        description = "damaged: DFReader stops here"
        reader.findings.append(
            LogIssue.at_time(reader.clock.t_s or 0.0, description, "data before this are used")
        )
    for line in list(dict.fromkeys(captured_output.getvalue().splitlines()))[:5]:
        reader.findings.append(LogIssue("file", line.strip(), "whole messages are used"))
    reader.append_state_events_and_sort()
    if not reader.events:
        raise LeewayError(
            f"{path}: no ATT, XKF1, POS or BAT with a time stamp (TimeUS, TimeMS) in this dataflash"
            " log"
        )
    return RecordedFlight(
        source="dataflash",
        events=tuple(reader.events),
        findings=tuple(reader.findings),
        autopilot_kind=AutopilotKind.ARDUPILOT,
        vehicle=reader.vehicle,
        firmware=reader.firmware,
        autopilot_faults=tuple(reader.faults),
    )


@contextlib.contextmanager
def _undamaged_copy(path: Path, findings: list[LogIssue]) -> Iterator[Path]:
    """Yield the log, or a copy of its whole messages, since DFReader opens only files."""
    raw = path.read_bytes()
    whole = extract_undamaged_messages(raw)
    if whole.data is None:
        yield path
        return
    if whole.damaged_sections:
        where = f"{whole.damaged_bytes} bytes in {whole.damaged_sections} sections are damaged"
        place = byte_location(whole.first_damaged_at, len(raw))
        findings.append(LogIssue(f"first {place}", where, "discarded"))
    with tempfile.NamedTemporaryFile(suffix=".bin") as copy:
        copy.write(whole.data)
        copy.flush()
        yield Path(copy.name)


def _read_messages(path: Path, reader: "_DataflashReader") -> None:
    from pymavlink.DFReader import DFReader_binary

    log: Any = DFReader_binary.__new__(DFReader_binary)  # a failed constructor must also be closed
    try:
        log.__init__(str(path))
        reader.store_parameters(log.params)
        types = reader.types_to_decode()
        while (message := log.recv_match(type=types, strict=True)) is not None:
            reader.on_message(message)
    finally:
        if hasattr(log, "filehandle"):
            log.filehandle.close()  # the object frees its memory map: views of it may remain


def _boot_time_s(kind: str, message: Any) -> float | None:
    """Return the time since boot; before 2015 logs have milliseconds, in GPS as `T`."""
    stamp_us = getattr(message, "TimeUS", None)
    if stamp_us is not None:
        return float(stamp_us) / 1e6
    stamp_ms = getattr(message, "T" if kind == "GPS" else "TimeMS", None)
    return None if stamp_ms is None else float(stamp_ms) / 1e3


class _DataflashReader:
    """Processes messages in file order."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.findings: list[LogIssue] = []
        self.faults: list[tuple[float, str]] = []
        self.vehicle: str | None = None
        self.firmware: str | None = None
        self._values: dict[str, float] = {}
        self._profile = ArduPilot()
        self.clock = LogClock()
        self._last_used_s: dict[str, float] = {}
        self._ekf_core = 0
        self._last_position: tuple[float, float, float, float, float] | None = None
        self._has_ekf_velocity = False
        self._home_m: float | None = None
        self._state_changes: list[tuple[float, bool | None, int | None]] = []
        self._landed_states: list[tuple[float, bool]] = []

    def on_message(self, message: Any) -> None:
        """Process one message."""
        kind = message.get_type()
        if kind in ("MSG", "VER"):
            self._store_vehicle_and_firmware(kind, message)
            return
        stamp_s = _boot_time_s(kind, message)
        if stamp_s is not None:
            t_s = self.clock.update_from_stamp(kind, stamp_s)
        else:  # MODE and EV have none before 2015
            t_s = self.clock.t_s if kind in ("MODE", "EV") else None
        if t_s is None or not self._record_if_used(kind, message, t_s):
            return
        match kind:
            case "ATT":
                angles = (message.Roll, message.Pitch, message.Yaw)
                if all(map(math.isfinite, angles)):
                    self.events.append(Attitude(t_s, *map(math.radians, angles)))
            case "XKF1" | "NKF1":
                self._has_ekf_velocity = True
                self._append_position_event(t_s, (message.VN, message.VE, message.VD))
            case "XKF2":
                # EKF3's wind states (direction TO) are valid only with drag fusion
                north, east = float(message.VWN), float(message.VWE)
                if math.isfinite(north + east) and (north, east) != (0.0, 0.0):
                    self.events.append(AutopilotWind(t_s, north, east))
            case "XKF4":
                self._ekf_core = getattr(message, "PI", 0)
            case "POS" | "GPS":
                self._store_position_and_append_events(kind, message, t_s)
            case "BAT" | "CURR":
                self._append_battery_event(t_s, message)
            case "ARSP":
                speed = float(message.Airspeed)
                if getattr(message, "H", 1) and math.isfinite(speed):
                    self.events.append(Airspeed(t_s, max(speed, 0.0)))
            case _:
                self._store_state_change(kind, message, t_s)

    def _record_if_used(self, kind: str, message: Any, t_s: float) -> bool:
        """Skip other instances and EKF cores, and messages above the required rate."""
        if kind in ("XKF1", "XKF2", "NKF1") and getattr(message, "C", 0) != self._ekf_core:
            return False
        if kind == "BAT":
            kind = f"BAT {_instance_number(message)}"
        elif kind in ("GPS", "ARSP") and _instance_number(message) != 0:
            return False
        last_s = self._last_used_s.get(kind)
        if last_s is not None and t_s - last_s < MIN_INTERVAL_S.get(kind.split()[0], 0.0):
            return False
        self._last_used_s[kind] = t_s
        return True

    def store_parameters(self, parameters: dict[str, float]) -> None:
        """Store the parameters that DFReader read when it opened the log."""
        self._values = {name: float(value) for name, value in parameters.items()}

    def types_to_decode(self) -> list[str]:
        """Return the message types to decode, without those known to hold invalid values."""
        drag = self._values.get("EK3_DRAG_BCOEF_X") or self._values.get("EK3_DRAG_BCOEF_Y")
        idle = set() if drag else {"XKF2"}
        if not self._profile.has_pitot(self._values):
            idle.add("ARSP")
        return [kind for kind in DECODED_TYPES if kind not in idle]

    def _store_vehicle_and_firmware(self, kind: str, message: Any) -> None:
        if kind == "VER":
            self.vehicle = VEHICLE_OF_BUILD.get(getattr(message, "BU", -1), self.vehicle)
        else:
            text = safe_text(str(message.Message))
            for name, vehicle in VEHICLE_OF_NAME.items():
                if text.startswith(name):
                    self.vehicle, self.firmware = self.vehicle or vehicle, text

    def _store_position_and_append_events(self, kind: str, message: Any, t_s: float) -> None:
        if kind == "GPS":
            count = getattr(message, "NSats", None)
            self.events.append(GnssFix(t_s, message.Status >= 3, count))
            if self._has_ekf_velocity:
                return
        if message.Lat == 0.0 and message.Lng == 0.0:
            return
        alt = float(message.Alt)
        height_above_home_m = getattr(message, "RelAlt", alt - (self._home_m or alt))  # to 2015
        rel = float(getattr(message, "RelHomeAlt", height_above_home_m))
        self._last_position = (t_s, float(message.Lat), float(message.Lng), alt, rel)
        if kind == "GPS" and message.Status >= 3:
            course = math.radians(message.GCrs)
            north, east = message.Spd * math.cos(course), message.Spd * math.sin(course)
            self._append_position_event(t_s, (north, east, getattr(message, "VZ", 0.0)))

    def _append_position_event(self, t_s: float, velocity: tuple[float, float, float]) -> None:
        if self._last_position is None or t_s - self._last_position[0] > MAX_POSITION_AGE_S:
            return
        if all(map(math.isfinite, (*self._last_position, *velocity))):
            self.events.append(Position(t_s, *self._last_position[1:], *map(float, velocity)))

    def _append_battery_event(self, t_s: float, message: Any) -> None:
        voltage, current = float(message.Volt), float(message.Curr)
        if hasattr(message, "TimeMS"):  # before 2015: hundredths
            voltage, current = 0.01 * voltage, 0.01 * current
        used_mah, used_wh = float(message.CurrTot), float(getattr(message, "EnrgTot", math.nan))
        measured = math.isfinite(current) and current >= 0.0
        left, temperature_c = getattr(message, "RemPct", None), float(getattr(message, "Temp", 0.0))
        self.events.append(
            Battery(
                t_s,
                voltage_v=voltage if math.isfinite(voltage) and voltage > 0.0 else None,
                current_a=current if measured else None,
                consumed_ah=used_mah / 1000.0 if measured and math.isfinite(used_mah) else None,
                consumed_j=used_wh * 3600.0 if measured and math.isfinite(used_wh) else None,
                remaining_frac=left / 100.0 if left is not None and 0 <= left <= 100 else None,
                temperature_c=temperature_c
                if math.isfinite(temperature_c) and temperature_c != 0.0
                else None,
                pack=_instance_number(message),
            )
        )

    def _store_state_change(self, kind: str, message: Any, t_s: float) -> None:
        if kind == "ORGN":
            if message.Type == HOME_ORIGIN_TYPE:
                self._home_m = float(message.Alt)
                home = (float(message.Lat), float(message.Lng), self._home_m)
                self.events.append(Home(t_s, *home))
            return
        if kind == "MISE":  # items counted with home, as in CMD
            index, total = int(message.CNum) - 1, int(message.CTot) - 1
            self.events.append(MissionProgress(t_s, index if index >= 0 else None, total))
        elif kind == "EV" and message.Id in (EV_LANDED, EV_NOT_LANDED):
            self._landed_states.append((t_s, message.Id == EV_LANDED))
        elif kind == "EV" and message.Id in (EV_ARMED, EV_DISARMED):
            self._state_changes.append((t_s, message.Id == EV_ARMED, None))
        elif kind == "ERR" and message.ECode != 0 and message.Subsys in ERR_SUBSYSTEMS:
            self.faults.append((t_s, f"{ERR_SUBSYSTEMS[message.Subsys]}, code {message.ECode}"))
        elif kind == "ARM":
            self._state_changes.append((t_s, bool(message.ArmState), None))
        elif kind == "MODE":
            self._state_changes.append((t_s, None, int(message.ModeNum)))

    def append_state_events_and_sort(self) -> None:
        """Add armed and landed states from the start: the log records only changes.

        With LOG_DISARMED 0 it starts with the vehicle already armed and does not record this.
        """
        self.findings += self.clock.clock_issues()
        if not self.events:
            return
        start_s = min(event.t_s for event in self.events)
        first = next((armed for _, armed, _ in self._state_changes if armed is not None), None)
        armed = self._values.get("LOG_DISARMED") == 0.0 if first is None else not first
        mode = 0
        for t_s, now_armed, now_mode in [(start_s, None, None), *self._state_changes]:
            armed = armed if now_armed is None else now_armed
            mode = mode if now_mode is None else now_mode
            self.events.append(VehicleState(t_s, *self._profile.decode_mode(mode, 0), armed=armed))
        if self._landed_states:
            before = (start_s, not self._landed_states[0][1])
            for t_s, landed in (before, *self._landed_states):
                ground = VehicleLandedState.ON_GROUND if landed else VehicleLandedState.IN_AIR
                self.events.append(GroundState(t_s, ground))
        self.events.sort(key=lambda event: event.t_s)


def _instance_number(message: Any) -> int:
    for name in ("I", "Inst", "Instance"):
        value = getattr(message, name, None)
        if value is not None:
            return int(value)
    return 0
