"""A simulated vehicle flies a ground station's plan, and the ground station records it (.tlog).

No companion: what flies here is what an operator flies to calibrate an airframe. The ground
station knows the vehicle by MAVLink alone.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError
from sim_bridge.app.serve.server import PHYSICS_STEP_S, ServedVehicle
from sim_bridge.autopilot.kinds import AutopilotKind, LinkKind
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message

LINK = 0
GROUND_SYSTEM, GROUND_COMPONENT = 255, 190
STEP_S = 0.1
STANDS_S = 20.0  # at rest before arming: the log then holds what avionics alone draw
DOWN_S = 8.0
ASK_AGAIN_S = 3.0
READY_WITHIN_S = 120.0
_STEPS = round(STEP_S / PHYSICS_STEP_S)
_ARMED = 128
_MODE = {AutopilotKind.PX4: (1.0, 4.0, 4.0), AutopilotKind.ARDUPILOT: (1.0, 3.0, 0.0)}
_MAV_CMD_DO_SET_MODE, _MAV_CMD_ARM, _MAV_CMD_INTERVAL = 176, 400, 511
_WANTED_HZ = {30: 10.0, 33: 10.0, 1: 2.0, 147: 2.0}  # ATTITUDE, GLOBAL_POSITION_INT, battery
_EPOCH_US = 1_700_000_000_000_000


@dataclass(frozen=True, slots=True)
class PlanFlight:
    """How a flight went, by truth."""

    duration_s: float
    energy_wh: float
    wind_mean_mps: float


@dataclass(slots=True)
class GroundStation:
    """Uploads a mission, starts it, and writes what it hears."""

    items: list[dict[str, Any]]
    autopilot_kind: AutopilotKind
    log: Any
    armed: bool = False
    started: bool = False
    uploaded: bool = False
    _encoder: Encoder = field(default_factory=lambda: Encoder(GROUND_SYSTEM, GROUND_COMPONENT))
    _decoder: Decoder = field(default_factory=Decoder)
    _next_beat_s: float = 0.0
    _next_ask_s: float = STANDS_S
    _streams_asked: bool = False

    def speak(self, t_s: float) -> list[bytes]:
        """What it sends now."""
        out: list[Message] = []
        if t_s >= self._next_beat_s:
            self._next_beat_s = t_s + 1.0
            beat = {"type": 6, "autopilot": 8, "base_mode": 0, "custom_mode": 0}
            out.append(Message("HEARTBEAT", **beat, system_status=4))
        if not self._streams_asked:
            self._streams_asked = True
            out += [
                self._command(_MAV_CMD_INTERVAL, float(number), 1e6 / rate_hz)
                for number, rate_hz in _WANTED_HZ.items()
            ]
        if not self.started and t_s >= self._next_ask_s:
            self._next_ask_s = t_s + ASK_AGAIN_S
            if self.uploaded:
                out += [
                    self._command(_MAV_CMD_DO_SET_MODE, *_MODE[self.autopilot_kind]),
                    self._command(_MAV_CMD_ARM, 1.0),
                ]
            else:
                out.append(self._to("MISSION_COUNT", count=len(self._listed), mission_type=0))
        return [self._encoder.encode(message) for message in out]

    def hear(self, t_s: float, datagram: bytes) -> list[bytes]:
        """Log what came; answers, for an upload."""
        self.log.write(struct.pack(">Q", _EPOCH_US + round(t_s * 1e6)) + datagram)
        out: list[Message] = []
        for message in self._decoder.feed(datagram):
            name = message.msg_name
            if name == "HEARTBEAT" and message.src_component == 1:
                self.armed = bool(message.base_mode & _ARMED)
                self.started |= self.armed
            elif name in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                self._next_ask_s = t_s + ASK_AGAIN_S
                out.append(self._item(message.seq))
            elif name == "MISSION_ACK":
                if message.type != 0:
                    raise LeewayError(f"the simulated autopilot refused the plan: {message.type}")
                self.uploaded = True
        return [self._encoder.encode(message) for message in out]

    @property
    def _listed(self) -> list[dict[str, Any]]:
        """ArduPilot's item 0 is home."""
        home = {"command": 16, "frame": 0, "params": [0.0] * 7}
        return [home, *self.items] if self.autopilot_kind is AutopilotKind.ARDUPILOT else self.items

    def _item(self, seq: int) -> Message:
        item = self._listed[seq]
        params = [math.nan if p is None else float(p) for p in item["params"]]
        if self.autopilot_kind is AutopilotKind.ARDUPILOT:
            params = [0.0 if math.isnan(p) else p for p in params]
        names = ("param1", "param2", "param3", "param4")
        return self._to(
            "MISSION_ITEM_INT",
            seq=seq,
            frame={3: 6}.get(item["frame"], item["frame"]),
            command=item["command"],
            current=0,
            autocontinue=1,
            **dict(zip(names, params[:4], strict=True)),
            x=round(params[4] * 1e7),
            y=round(params[5] * 1e7),
            z=params[6],
            mission_type=0,
        )

    def _command(self, number: int, *params: float) -> Message:
        given = (*params, *(0.0,) * (7 - len(params)))
        fields = {f"param{i + 1}": value for i, value in enumerate(given)}
        return self._to("COMMAND_LONG", command=number, confirmation=0, **fields)

    def _to(self, name: str, **fields: Any) -> Message:
        return Message(name, target_system=1, target_component=1, **fields)


def fly_plan(
    served: ServedVehicle,
    autopilot_kind: AutopilotKind,
    items: list[dict[str, Any]],
    tlog: Path,
    *,
    limit_s: float = 3600.0,
    progress: Callable[[float], None] = lambda t_s: None,
) -> PlanFlight:
    """Fly a plan's items to the landing; the .tlog is what a ground station would have."""
    autopilot = served.autopilot
    autopilot.add_link(LINK, LinkKind.GCS)
    winds: list[float] = []
    with tlog.open("wb") as log:
        station = GroundStation(items, autopilot_kind, log)
        flew, down_s, t_s = False, 0.0, 0.0
        for step in range(round(limit_s / STEP_S)):
            t_s = (step + 1) * STEP_S
            served.advance(_STEPS)
            waiting = [d for link, d in autopilot.take_outbox() if link == LINK]
            answers = station.speak(t_s)
            for datagram in waiting:
                answers += station.hear(t_s, datagram)
            for datagram in answers:
                autopilot.receive(LINK, datagram)
            truth = served.truth
            if truth.crashed or truth.motors_failed:
                raise LeewayError(f"the simulated vehicle was lost at {t_s:.0f} s")
            if truth.airborne:
                flew = True
                winds.append(math.hypot(*truth.wind_to_ned_mps[:2]))
            if step % 10 == 0:
                progress(t_s)
            if not flew and t_s > READY_WITHIN_S:
                raise LeewayError(f"{tlog.name}: never took off within {READY_WITHIN_S:.0f} s")
            down_s = down_s + STEP_S if flew and not station.armed else 0.0
            if down_s > DOWN_S:
                break
        else:
            raise LeewayError(f"{tlog.name}: not down after {limit_s:.0f} s")
    truth = served.truth
    mean_wind = sum(winds) / len(winds)
    return PlanFlight(t_s, truth.energy_used_wh, mean_wind)
