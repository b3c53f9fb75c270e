"""The operator at a simulated ground station: authorises the mission, watches, may take over."""

import math
from dataclasses import dataclass, field

from sim_bridge.app.flight.joined_texts import JoinedTexts
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message

GROUND_SYSTEM, GROUND_COMPONENT = 255, 190
COMPANION_COMPONENT = 191
MAV_CMD_MISSION_START = 300
MAV_CMD_DO_SET_MODE = 176
MAV_CMD_DO_SET_HOME = 179
MAV_CMD_ARM_DISARM = 400
FORCE_DISARM = 21196.0
MAV_RESULT_TEMPORARILY_REJECTED = 1
HOME_IS_NOW = "home is now "
RTL_PARAMS = {"px4": (1.0, 4.0, 5.0), "ardupilot": (1.0, 6.0, 0.0)}
ASK_AGAIN_S = 2.0
SEVERITY_NOTICE = 5


@dataclass(slots=True)
class Operator:
    """One vehicle's ground station, by MAVLink alone; it sees what any ground station sees."""

    vehicle_system: int
    authorises: bool = True
    accepted: bool = False
    home: str = ""
    """The stop at which the vehicle last said that it ends, once that is another."""
    named: dict[str, float] = field(default_factory=dict)
    said: list[tuple[float, str]] = field(default_factory=list)
    _encoder: Encoder = field(default_factory=lambda: Encoder(GROUND_SYSTEM, GROUND_COMPONENT))
    _decoder: Decoder = field(default_factory=Decoder)
    _texts: JoinedTexts = field(default_factory=JoinedTexts)
    _next_heartbeat_s: float = 0.0
    _next_ask_s: float = 0.0
    _wanted_deg: tuple[float, float] | None = None

    def frames(self, t_s: float) -> list[bytes]:
        """What the ground station sends at `t_s`: its heartbeat, what was not yet answered."""
        out: list[bytes] = []
        if t_s >= self._next_heartbeat_s:
            self._next_heartbeat_s = t_s + 1.0
            out.append(self._encoder.encode(_heartbeat()))
        if self.authorises and not self.accepted and t_s >= self._next_ask_s:
            self._next_ask_s = t_s + ASK_AGAIN_S
            start = command_long(self.vehicle_system, COMPANION_COMPONENT, MAV_CMD_MISSION_START)
            out.append(self._encoder.encode(start))
        if self._wanted_deg is not None and t_s >= self._next_ask_s:
            self._next_ask_s = t_s + ASK_AGAIN_S
            at = (0.0, 0.0, 0.0, 0.0, *self._wanted_deg)
            move = (self.vehicle_system, COMPANION_COMPONENT, MAV_CMD_DO_SET_HOME, *at)
            out.append(self._encoder.encode(command_long(*move)))
        return out

    def receive(self, t_s: float, datagram: bytes) -> None:
        """Take in what the link brought: named values, texts, acknowledgements."""
        for message in self._decoder.feed(datagram):
            name = message.msg_name
            if name == "NAMED_VALUE_FLOAT" and math.isfinite(message.value):
                self.named[message.name] = message.value
            elif name == "STATUSTEXT" and message.severity <= SEVERITY_NOTICE:
                self._hear_text(t_s, self._texts.take(message))
            elif name == "COMMAND_ACK" and message.src_component == COMPANION_COMPONENT:
                self.accepted |= message.command == MAV_CMD_MISSION_START and message.result == 0
                later = message.result == MAV_RESULT_TEMPORARILY_REJECTED
                if message.command == MAV_CMD_DO_SET_HOME and not later:
                    self._wanted_deg = None

    def _hear_text(self, t_s: float, text: str | None) -> None:
        if text is None:
            return
        self.said.append((t_s, text))
        if text.startswith(HOME_IS_NOW):
            self.home = text.removeprefix(HOME_IS_NOW)

    def wants_home(self, lat_deg: float, lon_deg: float) -> None:
        """Ask the companion to land at another stop of the truck, by where its pad is."""
        self._wanted_deg = (lat_deg, lon_deg)

    def mode_change(self, autopilot_kind: str) -> list[bytes]:
        """Order the autopilot to return to launch, behind the companion's back."""
        order = command_long(
            self.vehicle_system, 1, MAV_CMD_DO_SET_MODE, *RTL_PARAMS[autopilot_kind]
        )
        return [self._encoder.encode(order)]

    def disarm(self) -> list[bytes]:
        """Disarm what stands there armed, by force: its landing detector says that it flies."""
        order = command_long(self.vehicle_system, 1, MAV_CMD_ARM_DISARM, 0.0, FORCE_DISARM)
        return [self._encoder.encode(order)]


def command_long(system: int, component: int, command: int, *params: float) -> Message:
    """COMMAND_LONG to one component; parameters that are not given are 0."""
    given = {f"param{i + 1}": value for i, value in enumerate(params)}
    return Message(
        "COMMAND_LONG",
        target_system=system,
        target_component=component,
        command=command,
        confirmation=0,
        **({f"param{i}": 0.0 for i in range(1, 8)} | given),
    )


def _heartbeat() -> Message:
    return Message(
        "HEARTBEAT", type=6, autopilot=8, base_mode=0, custom_mode=0, system_status=4
    )  # MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID
