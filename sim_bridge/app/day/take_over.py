"""A person takes a vehicle over at a second ground station: what its companion sends from then on.

The person orders the return to the autopilot's own home (its launch place), and the autopilot
brings the vehicle down there. The companion can know of it from the first heartbeat that reaches
it with another mode.
"""

from dataclasses import dataclass, field

from sim_bridge.app.faults.authority import TOLD_PILOT_S
from sim_bridge.app.flight.vehicle_process import ASKING, COMMANDING, MISSION_CUSTOM_MODE
from sim_bridge.autopilot.mavlink.codec import Decoder


@dataclass(slots=True)
class TakeOver:
    """One take-over. Times are the day's. `commands`: what left after `knows_s`, in words."""

    autopilot_kind: str
    taken_s: float
    knows_s: float | None = None
    commands: list[str] = field(default_factory=list)
    _decoder: Decoder = field(default_factory=Decoder, repr=False)

    def reaches_companion(self, t_s: float, datagrams: list[bytes]) -> None:
        """What the companion hears: another mode in a heartbeat tells of the person."""
        if self.knows_s is not None:
            return
        mission = MISSION_CUSTOM_MODE[self.autopilot_kind]
        messages = [m for raw in datagrams for m in self._decoder.feed(raw)]
        if any(m.msg_name == "HEARTBEAT" and m.custom_mode != mission for m in messages):
            self.knows_s = t_s + TOLD_PILOT_S

    def leaves_companion(self, t_s: float, datagram: bytes) -> None:
        """What the companion sends: a command after it could know is one too many."""
        if self.knows_s is None or t_s <= self.knows_s:
            return
        for message in self._decoder.feed(datagram):
            number = message.__dict__.get("command", 0)
            if message.msg_name in COMMANDING and number not in ASKING:
                self.commands.append(f"{message.msg_name} {number or ''} at {t_s:.1f} s")
