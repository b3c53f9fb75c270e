"""A vehicle between missions: it watches its autopilot, reports to the dispatcher and waits.

The autopilot gets our heartbeats, answers to its TIMESYNC, and requests for telemetry: ArduPilot
sends no position unless asked, and a dispatcher gives no mission to a drone that is not seen on its
pad. No other command is sent here.
"""

import contextlib
import signal
from collections.abc import Callable
from types import FrameType
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, MavlinkCodec, mavlink
from companion.adapters.autopilots.link import Link
from companion.adapters.autopilots.port import AutopilotPort
from companion.adapters.clock import AutopilotClock, is_due, wall_s
from companion.adapters.files.signing_files import StampKeeper
from companion.app.flight.assignment import write_assignment
from companion.app.flight.fleet_port import STANDBY, Assigned, FleetPort
from companion.app.flight.loaded_flight import RunOptions, Settings
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import AskTelemetry
from companion.core.mission.events import ClockStepped
from companion.core.pilot.telemetry_state import TelemetryState
from companion.fleet.command_log import Verdict
from companion.fleet.messages import Answered, Assign, Command, Launch, Recall, Withdraw
from companion.fleet.service_manager import Watchdog

WAIT_S = 0.1
HEARTBEAT_S = 1.0
SILENT_S = 5.0
"""After so long nothing that was heard of the vehicle is told any more."""

TICK_S = 0.1
POSITION_SILENT_S = 5.0
ASK_AGAIN_S = 10.0
"""Of the autopilot's time: longer than a dozen requests take, each sent again twice."""


class Standby:
    """Waits on a link for an assignment; `wait` returns it, or `None` when told to stop."""

    def __init__(
        self,
        port: FleetPort,
        link: Link,
        codec: MavlinkCodec,
        options: RunOptions,
        settings: Settings,
        clock_s: Callable[[], float] = wall_s,
    ) -> None:
        self._port = port
        self._options, self._settings = options, settings
        self._link = link
        self._codec = codec
        self._clock = AutopilotClock()
        self._autopilot = AutopilotPort(self._send, self._clock, options.system_id)
        self._now = TelemetryState()
        self._beat_s: float | None = None
        self._taken: Assigned | None = None
        self._clock_s = clock_s
        self._heard_s = clock_s()
        self._ticked_s: float | None = None
        self._asked_s: float | None = None
        self._watchdog = Watchdog()
        self.stamps: StampKeeper | None = None

    def wait(self, stopped: Callable[[], bool]) -> Assigned | None:
        """Until an assignment is aboard."""
        self._port.link.be_woken(self._link.wake)
        while self._taken is None and not stopped():
            self.turn()
        return self._taken

    def turn(self) -> Assigned | None:
        """Wait a moment for bytes, handle them, talk to the desk; the assignment once it is aboard.

        No more turns after that.
        """
        now_s = self._clock_s()
        self._watchdog.turn(now_s)
        if is_due(self._beat_s, HEARTBEAT_S, now_s):
            self._beat_s = now_s
            self._send(_heartbeat())
        if now_s - self._heard_s > SILENT_S:
            self._now.forget()  # switched off: it may be carried elsewhere, and get another pack
        incoming = self._link.receive(WAIT_S)
        for message in self._codec.parse(incoming.data) if incoming is not None else []:
            self._hear(message, incoming.peer if incoming is not None else None)
        self._mind_telemetry()
        self._keep_stamps(now_s)
        self._port.turn(self._carry_out)
        self._port.publish(STANDBY, self._now)
        return self._taken

    def _keep_stamps(self, now_s: float) -> None:
        """On the ground nothing is lost by waiting for the disk, nor by one that is full."""
        write = self.stamps.due(now_s) if self.stamps is not None else None
        if write is not None:
            with contextlib.suppress(OSError):
                write()

    def _mind_telemetry(self) -> None:
        """Ask for what tells where it stands, and again while it does not come (a reboot)."""
        if self._autopilot.system_id is None or not self._clock.known:
            return
        t_s, position = self._clock.t_s, self._now.position
        if not is_due(self._ticked_s, TICK_S, t_s):
            return
        self._ticked_s = t_s
        silent = position is None or t_s - position.t_s > POSITION_SILENT_S
        if silent and is_due(self._asked_s, ASK_AGAIN_S, t_s):
            self._asked_s = t_s
            self._autopilot.order(AskTelemetry(), t_s)
        self._autopilot.tick(t_s)

    def _hear(self, message: Any, peer: Any) -> None:
        if message.get_srcComponent() == AUTOPILOT:
            self._link.answer_to(peer)
            self._heard_s = self._clock_s()
            if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                self._clock.synchronise(message.ts1 / 1e9)
                now_ns = max(1, round(self._clock.t_s * 1e9))
                self._send(mavlink.MAVLink_timesync_message(now_ns, message.ts1))
                return
        if message.get_type() == "TIMESYNC":
            self._autopilot.on_time_answer(message)
            return
        for event in self._autopilot.on_message(message):
            if isinstance(event, ClockStepped):
                self._now.forget()
            self._now.update(event)
        if self._autopilot.system_id is not None:
            self._codec.be_system(self._autopilot.system_id)

    def _send(self, message: Any) -> None:
        self._link.send(self._codec.pack(message))

    def _carry_out(self, command: Command) -> Verdict:
        deed = command.deed
        match deed:
            case Assign():
                return self._assign(deed)
            case Withdraw():
                self._port.book.close(deed.assignment)  # should it still be under way to us
                return Verdict(Answered.DONE, "not aboard")
            case Recall() if not self._now.armed:
                return Verdict(Answered.DONE, "standing by on the ground")
            case Launch():
                return Verdict(Answered.REFUSED, "no such assignment aboard")
            case _:
                return Verdict(Answered.REFUSED, "standing by: no mission of ours")

    def _assign(self, deed: Assign) -> Verdict:
        if self._taken is not None:
            return Verdict(Answered.LATER, f"taking {self._taken.assignment} aboard")
        taken = Assigned(assignment=deed.assignment, order=deed.order)
        try:
            write_assignment(deed, self._port, self._options, self._settings)
            self._port.take_aboard(taken)
        except LeewayError as error:
            return Verdict(Answered.REFUSED, str(error))
        except OSError as error:
            return Verdict(Answered.LATER, f"cannot write the mission down: {error.strerror}")
        self._taken = taken
        return Verdict(Answered.DONE, "aboard, to be planned")


def _heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        mavlink.MAV_STATE_STANDBY,
        3,
    )


class StopSignals:
    """While in use, SIGINT and SIGTERM are noted instead of killing."""

    def __init__(self) -> None:
        self.seen: list[int] = []
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "StopSignals":
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._note)
        return self

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.seen.append(number)

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
