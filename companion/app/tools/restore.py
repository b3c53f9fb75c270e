"""`companion restore`: give a vehicle the settings back that a flight cut off had changed."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from companion.adapters.autopilots.codec import MavlinkCodec, mavlink
from companion.adapters.autopilots.link import Link
from companion.adapters.autopilots.port import AutopilotPort
from companion.adapters.clock import AutopilotClock, is_due, wall_s
from companion.adapters.files.vehicle_settings import (
    read_settings,
    settings_file,
    write_settings,
)
from companion.core.mission.actions import AskBoard, AskParameters, Configure
from companion.core.mission.events import (
    AutopilotParameters,
    BoardKnown,
    Event,
    ParametersSet,
    VehicleState,
)

WAIT_S = 0.1
HEARTBEAT_S = 1.0
ANSWER_S = 10.0
"""Time for one question: by then a setting has been asked for eight times."""


@dataclass(slots=True)
class Caller:
    """Talks to an autopilot without a flight: says that we are there, hears, asks."""

    link: Link
    codec: MavlinkCodec
    system_id: int | None = None
    clock: AutopilotClock = field(default_factory=AutopilotClock)
    state: VehicleState | None = None
    _beat_s: float | None = None

    def __post_init__(self) -> None:
        self.port = AutopilotPort(self.send, self.clock, self.system_id)

    port: AutopilotPort = field(init=False)

    def send(self, message: Any) -> None:
        """Let one message out."""
        self.link.send(self.codec.pack(message))

    def wait_for(self, kind: type[Event], limit_s: float) -> Any | None:
        """The next event of a kind; None where none comes in time."""
        end_s = wall_s() + limit_s
        while wall_s() < end_s:
            for event in self._turn():
                if isinstance(event, kind):
                    return event
        return None

    def _turn(self) -> list[Event]:
        self._beat()
        incoming = self.link.receive(WAIT_S)
        events = self.port.tick(self.clock.t_s) if self.clock.known else []
        if incoming is None:
            return events
        for message in self.codec.parse(incoming.data):
            if self.port.may_be_ours(message) or message.get_srcSystem() == self.port.system_id:
                self.link.answer_to(incoming.peer)
            events += self._heard(message)
        for event in events:
            self.state = event if isinstance(event, VehicleState) else self.state
        return events

    def _heard(self, message: Any) -> list[Event]:
        if message.get_type() != "TIMESYNC":
            return self.port.on_message(message)
        if message.tc1 != 0:
            self.port.on_time_answer(message)
        elif message.get_srcSystem() == self.port.system_id:
            self.clock.synchronise(message.ts1 / 1e9)
            now_ns = max(1, round(self.clock.t_s * 1e9))
            self.send(mavlink.MAVLink_timesync_message(now_ns, message.ts1))
        return []

    def _beat(self) -> None:
        """We are here, and command nothing: another companion goes on as it was."""
        if not is_due(self._beat_s, HEARTBEAT_S, wall_s()):
            return
        self._beat_s = wall_s()
        kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
        self.send(mavlink.MAVLink_heartbeat_message(kind, none, 0, 0, mavlink.MAV_STATE_STANDBY, 3))


def restore(
    caller: Caller, folder: Path, silence_limit_s: float, say: Callable[[str], None]
) -> bool | None:
    """Put back what is kept in `folder` for this vehicle, and read it back.

    True: it has its own settings. False: not all, or not now; said why. None: no autopilot.
    """
    state = caller.wait_for(VehicleState, silence_limit_s)
    if state is None or caller.port.system_id is None:
        return None
    path = find_settings(caller, folder)
    own = read_settings(path)
    if not own:
        say(f"nothing to put back: no flight has left settings changed on this vehicle ({path})")
        return True
    say(f"system {caller.port.system_id}: settings that a flight changed ({path})")
    if caller.state is None or caller.state.armed:
        say("the vehicle is armed: nothing is set; disarm it, then ask again")
        return False
    return put_back(caller, path, own, say)


def find_settings(caller: Caller, folder: Path) -> Path:
    """The vehicle's file: by its board, or by its system id alone where it told none."""
    caller.port.order(AskBoard(), caller.clock.t_s)
    told = caller.wait_for(BoardKnown, ANSWER_S)
    profile, system_id = caller.port.profile, caller.port.system_id or 0
    kind = "" if profile is None else profile.autopilot_kind.value
    return settings_file(folder, kind, system_id, told.board if told is not None else "")


def put_back(caller: Caller, path: Path, own: dict[str, float], say: Callable[[str], None]) -> bool:
    """Set them, read them back; what could not be set stays in the file."""
    port, clock = caller.port, caller.clock
    port.order(AskParameters(tuple(own)), clock.t_s)
    found = caller.wait_for(AutopilotParameters, ANSWER_S)
    now = found.values if found is not None else {}
    port.order(Configure(own), clock.t_s)
    done = caller.wait_for(ParametersSet, ANSWER_S)
    failed = set(own) if done is None else set(done.failed)
    for name, value in sorted(own.items()):
        before = now.get(name)
        was = "unknown" if before is None else f"{before:g}"
        word = "NOT SET" if name in failed else "ok     "
        say(f"{word}  {name}: {was} -> {value:g}")
    write_settings(path, {name: value for name, value in own.items() if name in failed})
    return not failed
