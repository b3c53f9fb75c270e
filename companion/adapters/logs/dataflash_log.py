"""Read an ArduPilot dataflash log (.bin) by pymavlink's DFReader: its messages become events."""

import contextlib
import io
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from companion.adapters.autopilots.ardupilot import ArduPilot
from companion.adapters.logs.dataflash_filter import whole_messages
from companion.adapters.logs.log_time import LogClock
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
    Ground,
    GroundState,
    Home,
    MissionProgress,
    Position,
    VehicleState,
)
from companion.core.replay.recorded_flight import LogFinding, RecordedFlight
from companion.core.vehicle.airframe import MULTIROTOR

WANTED = (
    "ATT", "XKF1", "XKF2", "XKF4", "NKF1", "POS", "GPS", "BAT", "CURR", "ARSP", "MODE", "ARM",
    "EV", "MISE", "ORGN", "MSG", "VER",
)  # fmt: skip
LEAST_STEP_S = {
    "ATT": 0.045,
    "XKF1": 0.09,
    "NKF1": 0.09,
    "GPS": 0.19,
    "BAT": 0.19,
    "CURR": 0.19,
    "ARSP": 0.09,
    "XKF2": 0.4,
}
"""Least time between two of a kind: about what we ask for in flight."""

PLACE_AGE_S = 0.5
EV_ARMED, EV_DISARMED, EV_LANDED, EV_NOT_LANDED = 10, 11, 18, 28
HOME = 1
BUILDS = {1: "rover", 2: MULTIROTOR, 3: "fixed wing", 4: "antenna tracker", 7: "submarine",
          12: "blimp", 13: "helicopter"}  # fmt: skip
"""VER.BU."""

NAMES = {
    "ArduCopter": MULTIROTOR,
    "ArduPlane": "fixed wing",
    "ArduRover": "rover",
    "Rover": "rover",
    "ArduSub": "submarine",
    "Blimp": "blimp",
}


def read_dataflash_log(path: Path) -> RecordedFlight:
    """Read a .bin; LeewayError where nothing in it is a flight."""
    said = io.StringIO()
    reader = _Reader()
    try:
        with (
            contextlib.redirect_stderr(said),
            contextlib.redirect_stdout(said),
            _without_damage(path, reader.findings) as sound,
        ):
            _run(sound, reader)
    except Exception as error:
        if not reader.events:
            raise LeewayError(f"{path}: DFReader cannot read this file: {error!r}") from error
        what = f"DFReader stops: {error!r}"
        reader.findings.append(LogFinding.at(reader.now_s, what, "what came before is used"))
    for line in list(dict.fromkeys(said.getvalue().splitlines()))[:5]:
        reader.findings.append(LogFinding("file", line.strip(), "whole messages are used"))
    reader.finish()
    if not reader.events:
        raise LeewayError(f"{path}: none of ATT, XKF1, POS, BAT in this dataflash log")
    return RecordedFlight(
        source="dataflash",
        events=tuple(reader.events),
        findings=tuple(reader.findings),
        autopilot_kind=AutopilotKind.ARDUPILOT,
        vehicle=reader.vehicle,
        firmware=reader.firmware,
    )


@contextlib.contextmanager
def _without_damage(path: Path, findings: list[LogFinding]) -> Iterator[Path]:
    """The log itself, or a copy of its whole messages, for DFReader opens files only."""
    whole = whole_messages(path.read_bytes())
    if whole.data is None:
        yield path
        return
    if whole.places:
        where = f"{whole.left_out} bytes in {whole.places} places are no whole message"
        findings.append(LogFinding(f"byte {whole.first_at}", where, "left out"))
    with tempfile.NamedTemporaryFile(suffix=".bin") as copy:
        copy.write(whole.data)
        copy.flush()
        yield Path(copy.name)


def _run(path: Path, reader: "_Reader") -> None:
    from pymavlink.DFReader import DFReader_binary

    log: Any = DFReader_binary.__new__(DFReader_binary)  # so that a failed start is closed too
    try:
        log.__init__(str(path))
        reader.learn(log.params)
        wanted = reader.wanted()
        while (message := log.recv_match(type=wanted, strict=True)) is not None:
            reader.on_message(message)
    finally:
        if hasattr(log, "filehandle"):
            log.filehandle.close()  # its memory map goes with the object: views of it may be left


class _Reader:
    """Takes messages in the order of the file."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.findings: list[LogFinding] = []
        self.vehicle: str | None = None
        self.firmware: str | None = None
        self._values: dict[str, float] = {}
        self._profile = ArduPilot()
        self._clock = LogClock()
        self._heard_s: dict[str, float] = {}
        self._core = 0
        self._place: tuple[float, float, float, float, float] | None = None
        self._fused = False
        self._home_m: float | None = None
        self._states: list[tuple[float, bool | None, int | None]] = []
        self._grounds: list[tuple[float, bool]] = []

    @property
    def now_s(self) -> float:
        """Where we are in the log, on its clock."""
        return self._clock.t_s or 0.0

    def on_message(self, message: Any) -> None:
        """Take one message."""
        kind = message.get_type()
        if kind in ("MSG", "VER"):
            self._identify(kind, message)
            return
        stamp_us = getattr(message, "TimeUS", None)
        t_s = None if stamp_us is None else self._clock.stamp(kind, stamp_us / 1e6)
        if t_s is None or not self._due(kind, message, t_s):
            return
        match kind:
            case "ATT":
                angles = (message.Roll, message.Pitch, message.Yaw)
                if all(map(math.isfinite, angles)):
                    self.events.append(Attitude(t_s, *map(math.radians, angles)))
            case "XKF1" | "NKF1":
                self._fused = True
                self._position(t_s, (message.VN, message.VE, message.VD))
            case "XKF2":
                self._wind(t_s, message)
            case "XKF4":
                self._core = getattr(message, "PI", 0)
            case "POS" | "GPS":
                self._hear_place(kind, message, t_s)
            case "BAT" | "CURR":
                self._battery(t_s, message)
            case "ARSP":
                self._airspeed(t_s, message)
            case _:
                self._hear_state(kind, message, t_s)

    def _due(self, kind: str, message: Any, t_s: float) -> bool:
        """Leave out other instances and cores, and what comes faster than it is looked at."""
        if kind in ("XKF1", "XKF2", "NKF1") and getattr(message, "C", 0) != self._core:
            return False
        if kind == "BAT":
            kind = f"BAT {_instance(message)}"
        elif kind in ("GPS", "ARSP") and _instance(message) != 0:
            return False
        last_s = self._heard_s.get(kind)
        if last_s is not None and t_s - last_s < LEAST_STEP_S.get(kind.split()[0], 0.0):
            return False
        self._heard_s[kind] = t_s
        return True

    def learn(self, parameters: dict[str, float]) -> None:
        """Take the parameters, which DFReader has read when it opened the log."""
        self._values = {name: float(value) for name, value in parameters.items()}

    def wanted(self) -> list[str]:
        """Messages worth decoding: without those whose values are known to be no facts."""
        idle = set() if self._fuses_drag() else {"XKF2"}
        if not self._profile.has_pitot(self._values):
            idle.add("ARSP")
        return [kind for kind in WANTED if kind not in idle]

    def _fuses_drag(self) -> bool:
        return bool(self._values.get("EK3_DRAG_BCOEF_X") or self._values.get("EK3_DRAG_BCOEF_Y"))

    def _identify(self, kind: str, message: Any) -> None:
        if kind == "VER":
            self.vehicle = BUILDS.get(getattr(message, "BU", -1), self.vehicle)
        else:
            text = safe_text(str(message.Message))
            for name, vehicle in NAMES.items():
                if text.startswith(name):
                    self.vehicle, self.firmware = self.vehicle or vehicle, text

    def _hear_place(self, kind: str, message: Any, t_s: float) -> None:
        if kind == "GPS":
            count = getattr(message, "NSats", None)
            self.events.append(GnssFix(t_s, message.Status >= 3, count))
            if self._fused:
                return
        if message.Lat == 0.0 and message.Lng == 0.0:
            return
        alt = float(message.Alt)
        rel = float(getattr(message, "RelHomeAlt", alt - (self._home_m or alt)))
        self._place = (t_s, float(message.Lat), float(message.Lng), alt, rel)
        if kind == "GPS" and message.Status >= 3:
            course = math.radians(message.GCrs)
            north, east = message.Spd * math.cos(course), message.Spd * math.sin(course)
            self._position(t_s, (north, east, getattr(message, "VZ", 0.0)))

    def _position(self, t_s: float, velocity: tuple[float, float, float]) -> None:
        if self._place is None or t_s - self._place[0] > PLACE_AGE_S:
            return
        if all(map(math.isfinite, (*self._place, *velocity))):
            self.events.append(Position(t_s, *self._place[1:], *map(float, velocity)))

    def _wind(self, t_s: float, message: Any) -> None:
        """EKF3's wind states are real only with drag fusion; they say where the air moves to."""
        north, east = float(message.VWN), float(message.VWE)
        if math.isfinite(north + east) and (north, east) != (0.0, 0.0):
            self.events.append(AutopilotWind(t_s, north, east))

    def _battery(self, t_s: float, message: Any) -> None:
        voltage, current = float(message.Volt), float(message.Curr)
        used_mah, used_wh = float(message.CurrTot), float(getattr(message, "EnrgTot", math.nan))
        measured = math.isfinite(current) and current >= 0.0
        left, warm = getattr(message, "RemPct", None), float(getattr(message, "Temp", 0.0))
        self.events.append(
            Battery(
                t_s,
                voltage_v=voltage if math.isfinite(voltage) and voltage > 0.0 else None,
                current_a=current if measured else None,
                consumed_ah=used_mah / 1000.0 if measured and math.isfinite(used_mah) else None,
                consumed_j=used_wh * 3600.0 if measured and math.isfinite(used_wh) else None,
                remaining_frac=left / 100.0 if left is not None and 0 <= left <= 100 else None,
                temperature_c=warm if math.isfinite(warm) and warm != 0.0 else None,
                pack=_instance(message),
            )
        )

    def _airspeed(self, t_s: float, message: Any) -> None:
        speed = float(message.Airspeed)
        healthy = bool(getattr(message, "H", 1))
        if healthy and math.isfinite(speed):
            self.events.append(Airspeed(t_s, max(speed, 0.0)))

    def _hear_state(self, kind: str, message: Any, t_s: float) -> None:
        if kind == "ORGN":
            if message.Type == HOME:
                self._home_m = float(message.Alt)
                home = (float(message.Lat), float(message.Lng), self._home_m)
                self.events.append(Home(t_s, *home))
            return
        if kind == "MISE":  # items counted with home, as in CMD
            index, total = int(message.CNum) - 1, int(message.CTot) - 1
            self.events.append(MissionProgress(t_s, index if index >= 0 else None, total))
        elif kind == "EV" and message.Id in (EV_LANDED, EV_NOT_LANDED):
            self._grounds.append((t_s, message.Id == EV_LANDED))
        elif kind == "EV" and message.Id in (EV_ARMED, EV_DISARMED):
            self._states.append((t_s, message.Id == EV_ARMED, None))
        elif kind == "ARM":
            self._states.append((t_s, bool(message.ArmState), None))
        elif kind == "MODE":
            self._states.append((t_s, None, int(message.ModeNum)))

    def finish(self) -> None:
        """Tell armed and landed from the start: the log says only when they change.

        With LOG_DISARMED 0 it begins when the vehicle is armed already, and does not say so.
        """
        self.findings += self._clock.findings()
        if not self.events:
            return
        start_s = min(event.t_s for event in self.events)
        first = next((armed for _, armed, _ in self._states if armed is not None), None)
        armed = self._values.get("LOG_DISARMED") == 0.0 if first is None else not first
        mode = 0
        for t_s, now_armed, now_mode in [(start_s, None, None), *self._states]:
            armed = armed if now_armed is None else now_armed
            mode = mode if now_mode is None else now_mode
            self.events.append(VehicleState(t_s, *self._profile.mode(mode, 0), armed=armed))
        if self._grounds:
            before = (start_s, not self._grounds[0][1])
            for t_s, landed in (before, *self._grounds):
                ground = Ground.ON_GROUND if landed else Ground.IN_AIR
                self.events.append(GroundState(t_s, ground))
        self.events.sort(key=lambda event: event.t_s)


def _instance(message: Any) -> int:
    for name in ("I", "Inst", "Instance"):
        value = getattr(message, name, None)
        if value is not None:
            return int(value)
    return 0
