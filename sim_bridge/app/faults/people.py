"""Other people and stations about the vehicle: a second ground station, a hand on the switch."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.flight.operator import (
    COMPANION_COMPONENT,
    MAV_CMD_DO_SET_HOME,
    command_long,
)
from sim_bridge.autopilot.kinds import LinkKind
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from sim_bridge.autopilot.mission.items import MissionItem

LINK = 2
SYSTEM, COMPONENT = 254, 190
ANSWER_S = 10.0
MAV_CMD_ARM_DISARM = 400
MAV_CMD_WAYPOINT = 16
FORCE = 21196.0
METRES_PER_DEG = 111_195.0


@dataclass(slots=True)
class Station:
    """A second ground station, or whoever else speaks to the autopilot, on a link of its own."""

    stage: Stage
    sender: tuple[int, int] = (SYSTEM, COMPONENT)
    kind: LinkKind = LinkKind.GCS
    heard: list[Message] = field(default_factory=list)
    _encoder: Encoder = field(init=False)
    _decoder: Decoder = field(default_factory=Decoder)

    def __post_init__(self) -> None:
        craft = self.stage.craft
        self._encoder = Encoder(*self.sender)
        craft.autopilot.add_link(LINK, self.kind)
        craft.others[LINK] = self._hear

    def _hear(self, t_s: float, frame: bytes) -> None:
        del t_s
        self.heard += self._decoder.feed(frame)

    def send(self, message: Message) -> None:
        """Send a message to the autopilot."""
        self.stage.craft.autopilot.receive(LINK, self._encoder.encode(message))

    def order(self, command: int, *params: float) -> None:
        """COMMAND_LONG to the autopilot."""
        self.send(command_long(self.stage.craft.number, 1, command, *params))

    def order_companion(self, command: int, *params: float) -> None:
        """COMMAND_LONG to the companion."""
        number = self.stage.craft.number
        self.send(command_long(number, COMPANION_COMPONENT, command, *params))

    def disarm(self, *, by_force: bool = False) -> None:
        """Disarm; by force also in the air."""
        self.order(MAV_CMD_ARM_DISARM, 0.0, FORCE if by_force else 0.0)

    def set_home(self, *, north_m: float = 0.0, up_m: float = 0.0) -> None:
        """DO_SET_HOME, so far from the depot."""
        depot = self.stage.craft.depot
        lat_deg = (depot.lat_deg or 0.0) + north_m / METRES_PER_DEG
        alt_m = (depot.alt_amsl_m or 0.0) + up_m
        place = (0.0, 0.0, 0.0, 0.0, lat_deg, depot.lon_deg or 0.0, alt_m)
        self.order(MAV_CMD_DO_SET_HOME, *place)

    def set_parameter(self, name: str, value: float) -> None:
        """PARAM_SET of a number."""
        ids = {"target_system": self.stage.craft.number, "target_component": 1}
        self.send(Message("PARAM_SET", **ids, param_id=name, param_value=value, param_type=9))

    def clear(self) -> None:
        """MISSION_CLEAR_ALL."""
        self.send(Message("MISSION_CLEAR_ALL", **self._target(), mission_type=0))

    def upload(
        self, items: Sequence[MissionItem], *, stop_after: int | None = None
    ) -> Iterator[None]:
        """Upload a mission as ground stations do; `stop_after` so many items it falls silent."""
        self.heard.clear()
        self.send(Message("MISSION_COUNT", **self._target(), count=len(items), mission_type=0))
        until_s, given = self.stage.t_s + ANSWER_S, 0
        while self.stage.t_s < until_s:
            yield
            asked, self.heard = self.heard, []
            for message in asked:
                if message.msg_name == "MISSION_ACK":
                    return
                if message.msg_name in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                    if stop_after is not None and given >= stop_after:
                        return
                    given += 1
                    self.send(self._item(message.seq, items[message.seq]))

    def _target(self) -> dict[str, int]:
        return {"target_system": self.stage.craft.number, "target_component": 1}

    def _item(self, seq: int, item: MissionItem) -> Message:
        p1, p2, p3, p4 = item.params
        return Message(
            "MISSION_ITEM_INT",
            **self._target(),
            seq=seq,
            frame=item.frame,
            command=item.command,
            current=0,
            autocontinue=int(item.autocontinue),
            param1=p1,
            param2=p2,
            param3=p3,
            param4=p4,
            x=item.x,
            y=item.y,
            z=item.z,
            mission_type=0,
        )


def dragged(items: Sequence[MissionItem], current: int, east_m: float) -> list[MissionItem]:
    """The same list with the next waypoint after the current item dragged sideways; behind the last
    one it is the current item, where it lands."""
    out = list(items)
    ahead = [k for k, i in enumerate(out) if k > current and i.command == MAV_CMD_WAYPOINT]
    for k in [*ahead, current][:1]:
        out[k] = _moved(out[k], east_m)
    return out


def foreign(items: Sequence[MissionItem], east_m: float) -> list[MissionItem]:
    """A mission of the same shape that somebody flies elsewhere."""
    return [_moved(i, east_m) if i.x or i.y else i for i in items]


def _moved(item: MissionItem, east_m: float) -> MissionItem:
    lat_rad = math.radians(item.x / 1e7)
    return replace(item, y=item.y + round(1e7 * east_m / METRES_PER_DEG / math.cos(lat_rad)))
