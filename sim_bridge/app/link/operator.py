"""Operator at a simulated ground station: authorises, monitors and may override the mission."""

import math
from dataclasses import dataclass, field

from companion.core.mission.alerts import Alert, parse_alert_text
from sim_bridge.app.link.client_messages import (
    COMPANION_COMPONENT,
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    MODE_PARAMS,
    command_long,
    ground_heartbeat,
)
from sim_bridge.app.link.joined_texts import JoinedTexts
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder
from sim_bridge.autopilot.mavlink.commands import FORCE_DISARM
from sim_bridge.autopilot.mavlink.enums import Cmd

MAV_RESULT_TEMPORARILY_REJECTED = 1
REQUEST_INTERVAL_S = 2.0
MAX_SHOWN_SEVERITY = 5


@dataclass(slots=True)
class Operator:
    """Ground station of one vehicle. It uses MAVLink only."""

    vehicle_system: int
    authorises: bool = True
    authorises_from_s: float = 0.0
    accepted: bool = False
    landing_stop: str = ""
    """Last landing stop reported by the vehicle, once it has changed."""
    named_values: dict[str, float] = field(default_factory=dict)
    received_texts: list[tuple[float, str]] = field(default_factory=list)
    _encoder: Encoder = field(default_factory=lambda: Encoder(GROUND_SYSTEM, GROUND_COMPONENT))
    _decoder: Decoder = field(default_factory=Decoder)
    _texts: JoinedTexts = field(default_factory=JoinedTexts)
    _next_heartbeat_s: float = 0.0
    _next_request_s: float = 0.0
    _requested_home_deg: tuple[float, float] | None = None

    def collect_due_frames(self, t_s: float) -> list[bytes]:
        """Return the frames due at `t_s`: heartbeat and unacknowledged requests."""
        out: list[bytes] = []
        if t_s >= self._next_heartbeat_s:
            self._next_heartbeat_s = t_s + 1.0
            out.append(self._encoder.encode_next_frame(ground_heartbeat()))
        may_authorise = self.authorises and t_s >= self.authorises_from_s
        if may_authorise and not self.accepted and t_s >= self._next_request_s:
            self._next_request_s = t_s + REQUEST_INTERVAL_S
            start = command_long(self.vehicle_system, COMPANION_COMPONENT, Cmd.MISSION_START)
            out.append(self._encoder.encode_next_frame(start))
        if self._requested_home_deg is not None and t_s >= self._next_request_s:
            self._next_request_s = t_s + REQUEST_INTERVAL_S
            at = (0.0, 0.0, 0.0, 0.0, *self._requested_home_deg)
            move = (self.vehicle_system, COMPANION_COMPONENT, Cmd.DO_SET_HOME, *at)
            out.append(self._encoder.encode_next_frame(command_long(*move)))
        return out

    def process_received_datagram(self, t_s: float, datagram: bytes) -> None:
        """Process received named values, texts and acknowledgements."""
        for message in self._decoder.decode_bytes(datagram):
            name = message.msg_name
            if name == "NAMED_VALUE_FLOAT" and math.isfinite(message.value):
                self.named_values[message.name] = message.value
            elif name == "STATUSTEXT" and message.severity <= MAX_SHOWN_SEVERITY:
                self._store_text_and_landing_stop(
                    t_s, self._texts.add_chunk_and_take_complete_text(message)
                )
            elif name == "COMMAND_ACK" and message.src_component == COMPANION_COMPONENT:
                self.accepted |= message.command == Cmd.MISSION_START and message.result == 0
                later = message.result == MAV_RESULT_TEMPORARILY_REJECTED
                if message.command == Cmd.DO_SET_HOME and not later:
                    self._requested_home_deg = None

    def _store_text_and_landing_stop(self, t_s: float, text: str | None) -> None:
        if text is None:
            return
        self.received_texts.append((t_s, text))
        alert = parse_alert_text(text)
        if alert is not None and alert[0] is Alert.LANDING_STOP_MOVED:
            self.landing_stop = alert[1]["site"]

    def start_requesting_landing_stop(self, lat_deg: float, lon_deg: float) -> None:
        """Request a landing at another stop of the truck, by the position of its pad."""
        self._requested_home_deg = (lat_deg, lon_deg)

    def rtl_command_frames(self, autopilot_kind: str) -> list[bytes]:
        """Return frames that command return to launch, sent to the autopilot only."""
        order = command_long(
            self.vehicle_system, 1, Cmd.DO_SET_MODE, *MODE_PARAMS[autopilot_kind]["rtl"]
        )
        return [self._encoder.encode_next_frame(order)]

    def forced_disarm_command_frames(self) -> list[bytes]:
        """Return frames that force disarming: the landing detector does not report a landing."""
        order = command_long(self.vehicle_system, 1, Cmd.COMPONENT_ARM_DISARM, 0.0, FORCE_DISARM)
        return [self._encoder.encode_next_frame(order)]
