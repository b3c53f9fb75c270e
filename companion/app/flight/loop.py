"""The flight loop: bytes to events, the pilot, actions to bytes; one thread, the autopilot's clock.

Where the autopilot sends TIMESYNC requests (the simulator's lockstep, and real PX4), each request
is a tick: everything before it has been received, the outputs leave, and it is answered last.
Without them, telemetry ticks about ten times a second.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from companion.adapters.autopilots.codec import AUTOPILOT, COMPONENT, MavlinkCodec, mavlink
from companion.adapters.autopilots.link import Link
from companion.adapters.autopilots.operator_port import OperatorPort, OperatorTrust
from companion.adapters.autopilots.port import AutopilotPort
from companion.adapters.autopilots.status_text import StatusTexts
from companion.adapters.clock import AutopilotClock, is_due, utc_words, wall_s
from companion.adapters.files.signing_files import STAMPS, StampKeeper
from companion.app.flight.hearing import STALL_S, Hearing
from companion.app.flight.monitor_keeper import MonitorKeeper
from companion.app.flight.planning import PlanBeside, Planning
from companion.app.flight.recorder import Recorder
from companion.app.flight.settings_keeper import SettingsKeeper
from companion.core.mission.actions import (
    Action,
    Answer,
    DropOrders,
    Finished,
    Order,
    PhaseChanged,
    Publish,
    Reply,
    SaveCheckpoint,
    Say,
    Severity,
)
from companion.core.mission.events import (
    BoardKnown,
    Event,
    LinkBack,
    LinkSilent,
    OperatorReached,
    SettingsLeft,
    Tick,
)
from companion.core.mission.find_plan import FindPlan, PlanFound
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase
from companion.fleet.service_manager import Watchdog

if TYPE_CHECKING:
    from companion.app.flight.fleet_port import FleetPort  # zenoh's: loaded for a fleet only

WAIT_S = 0.1
TICK_S = 0.1
LOCKSTEP_LAPSE_S = 0.25
"""Without a TIMESYNC request for this long (autopilot time) telemetry ticks instead."""

SILENT_S = 3.0
"""Wall-clock silence that counts as a lost link."""

HEARTBEAT_S = 1.0
BUNDLE_BYTES = 1400
"""An Ethernet frame carries 1472 bytes under IPv4 and UDP, a tunnel some less."""

CLOCKS_APART_S = 3.0
"""All signed frames are refused for so long (three heartbeats): no late one among good ones."""

ECHO_FRAMES = 200
"""Frames of ours that are known again when they come back: some seconds of them."""


@dataclass(frozen=True, slots=True)
class _Outgoing:
    """A frame that was packed at core time `t_s`; an order must leave while it is fresh."""

    frame: bytes
    is_order: bool
    t_s: float


@dataclass(slots=True)
class Loop:
    """Everything wired; `step` handles what one wait brings."""

    link: Link
    codec: MavlinkCodec
    recorder: Recorder
    pilot: Pilot
    clock: AutopilotClock
    silence_limit_s: float
    autopilot: AutopilotPort
    operator: OperatorPort
    hearing: Hearing
    settings: SettingsKeeper
    planning: Planning = field(default_factory=PlanBeside)
    finished: Finished | None = None
    lost: bool = False
    on_action: Callable[[Action], None] | None = None
    port: "FleetPort | None" = None
    """None: no dispatcher's desk; operators still speak MAVLink."""
    monitor: MonitorKeeper | None = None
    """Of the vehicle's service; None: nothing is kept."""
    stamps: StampKeeper | None = None
    """Of signed frames; None: nothing is signed."""
    wall_clock_s: Callable[[], float] = wall_s
    """For silences; a world that simulates many companions at once brings its own."""
    _system_known: bool = False
    _ticked_s: float | None = None
    _synced_s: float | None = None
    _synced_ns: int | None = None
    _beat_s: float | None = None
    _beat_wall_s: float | None = None
    _to_publish: dict[str, float] = field(default_factory=dict)
    _heard_wall_s: float = 0.0
    _heard_s: float = 0.0
    _silent: bool = False
    _record_lost: bool = False
    _strangers_told: bool = False
    _texts: StatusTexts = field(default_factory=StatusTexts)
    _refused_wall_s: float | None = None
    _clocks_told: bool = False
    _answer: Answer = field(default_factory=lambda: Answer(Reply.DENIED))
    _said: deque[bytes] = field(default_factory=lambda: deque(maxlen=ECHO_FRAMES))
    _outgoing: list[_Outgoing] = field(default_factory=list)
    _outgoing_bytes: int = 0
    _watchdog: Watchdog = field(default_factory=Watchdog)

    @classmethod
    def wire(
        cls,
        link: Link,
        codec: MavlinkCodec,
        recorder: Recorder,
        pilot: Pilot,
        *,
        system_id: int | None,
        silence_limit_s: float,
        wall_clock_s: Callable[[], float] = wall_s,
        settings_folder: Path | None = None,
        trust: OperatorTrust | None = None,
    ) -> "Loop":
        """Connect the parts."""
        clock = AutopilotClock()
        clock.resume(pilot.telemetry.t_s)
        made: list[Loop] = []

        def send(message: Any) -> None:
            made[0].send(message)

        def order(message: Any) -> None:
            made[0].send_order(message)

        def ask(event: Event) -> Reply:
            return made[0].ask(event)

        def say(text: str) -> None:
            made[0].carry_out([Say(Severity.WARNING, text)])

        loop = cls(
            link=link,
            codec=codec,
            recorder=recorder,
            pilot=pilot,
            clock=clock,
            silence_limit_s=silence_limit_s,
            autopilot=AutopilotPort(order, clock, system_id),
            operator=OperatorPort(send, ask, lambda: pilot.estimates.limits, say, trust),
            hearing=Hearing(link, lambda: made[0].wall_clock_s()),
            settings=SettingsKeeper(
                settings_folder,
                recorder.keep_settings,
                lambda words: recorder.note(made[0].clock.t_s, words),
            ),
            wall_clock_s=wall_clock_s,
        )
        made.append(loop)
        loop._heard_wall_s = wall_clock_s()
        loop._heard_s = clock.t_s
        return loop

    # --- in ------------------------------------------------------------------------------------

    def step(self) -> None:
        """Wait a moment for bytes and handle them."""
        self._watchdog.turn(self.wall_clock_s())
        alone = self._silent or not self._system_known
        if alone and is_due(self._beat_wall_s, HEARTBEAT_S, self.wall_clock_s()):
            self._heartbeat()  # a caller must speak first, or nobody knows that it is there
        incoming = self.link.receive(WAIT_S)
        if incoming is not None:
            self.hearing.heard_one()
        self._mind_stall()
        self._mind_silence()
        self._mind_signing()
        self._mind_strangers()
        if incoming is not None:
            for message in self.codec.parse(incoming.data):
                self._message(message, incoming.peer)
                if self.finished is not None:
                    break
        if self.port is not None:
            self._talk_to_desk(self.port)
        self.flush()
        self.recorder.hand_over()

    def _talk_to_desk(self, port: "FleetPort") -> None:
        if self.finished is None:
            port.turn(port.in_mission(self.pilot, self.clock.t_s, self.ask_why))
            if port.link.wind_cov_is_read():  # a desk asked for states lately
                self._give([OperatorReached(self.clock.t_s)])
        port.publish(self.pilot.phase.value, self.pilot.telemetry, self.pilot)

    def _message(self, message: Any, peer: Any) -> None:
        system = self.autopilot.system_id
        known = system is not None
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source[1] == COMPONENT and bytes(message.get_msgbuf()) in self._said:
            return  # the wiring echoes: it is nobody else
        if not known or source[0] == system:
            self.recorder.stream(bytes(message.get_msgbuf()), self.clock.t_s)
        if known and self.operator.is_station(message, system, peer, signed=self.codec.signed):
            self._give([OperatorReached(self.clock.t_s)])
        if known and self._to_operator_port(message, system, peer):
            self.recorder.stream(bytes(message.get_msgbuf()), self.clock.t_s)
            return
        from_autopilot = source == (system, AUTOPILOT)
        if from_autopilot:
            self._heard(peer)
            if message.get_type() == "HEARTBEAT" and self.hearing.heartbeat():
                text = f"companion stood still for {self.hearing.stood_s:.1f} s"
                self.carry_out([Say(Severity.WARNING, text)])
        if message.get_type() == "TIMESYNC":
            if from_autopilot and message.tc1 == 0:
                self._timesync(message)
            elif not known and source[1] == AUTOPILOT and message.tc1 == 0:
                self.link.answer_to(peer)
                self._answer_timesync(message.ts1)
            elif message.tc1 != 0:
                self.autopilot.on_time_answer(message)
                self._tick_between()
            return
        if not known and self.autopilot.may_be_ours(message):
            self.link.answer_to(peer)  # a listener can ask it nothing (the time) otherwise
        events = self.autopilot.on_message(message)
        if not self._system_known and self.autopilot.system_id is not None:
            self._system_known = True
            self.operator.trust.found(peer)
            self.codec.be_system(self.autopilot.system_id)
            self._heard(peer)
        self._give(events)
        self._tick_between()

    def _to_operator_port(self, message: Any, system: int, peer: Any) -> bool:
        signed, t_s = self.codec.signed, self.clock.t_s
        return self.operator.on_message(message, system, t_s, peer, signed=signed)

    def _timesync(self, message: Any) -> None:
        """Tick, let everything out, answer last. A repeated request is only answered."""
        if message.ts1 != self._synced_ns:
            self._synced_ns = message.ts1
            self.clock.synchronise(message.ts1 / 1e9)
            self._synced_s = self.clock.t_s
            if not self.clock.doubtful:
                self._tick()
        self._answer_timesync(message.ts1)

    def _answer_timesync(self, asked_ns: int) -> None:
        now_ns = max(1, round(self.clock.t_s * 1e9))
        self.send(mavlink.MAVLink_timesync_message(now_ns, asked_ns))

    def _tick_between(self) -> None:
        """Tick about ten times a second where no TIMESYNC request does."""
        if self._synced_s is not None and self.clock.t_s - self._synced_s <= LOCKSTEP_LAPSE_S:
            return
        if self.clock.doubtful or not self.clock.known:
            return
        if is_due(self._ticked_s, TICK_S - 0.005, self.clock.t_s):
            self._tick()

    def _tick(self) -> None:
        t_s = self.clock.t_s
        self._ticked_s = t_s
        self.recorder.heard(self.pilot.telemetry, self.pilot.autopilot, self.autopilot.system_id)
        if self.pilot.flight_plan is not None and self.pilot.autopilot is not None:
            self.recorder.planned(t_s, self.pilot.flight_plan, self.pilot.autopilot)
        self._mind_records()
        if not self.hearing.may_decide():
            self._give([Tick(t_s, late=True)])
        else:
            self._publish_next()
            self._give(self.autopilot.tick(t_s))
            if self.port is not None:
                self._give(self.port.neighbours(t_s))
                self._give(self.port.winds(t_s))
            self._give([Tick(t_s)])
        if is_due(self._beat_s, HEARTBEAT_S - 1e-6, t_s):
            self._beat_s = t_s
            self._heartbeat()

    def _give(self, events: list[Event]) -> None:
        for event in events:
            if self.finished is None:
                self.carry_out(self.pilot.handle(event))
                if isinstance(event, BoardKnown):
                    self._meet(event)
        found = self.planning.found()
        if found is not None and self.finished is None:
            self.carry_out(self.pilot.handle(PlanFound(self.clock.t_s, *found)))

    @property
    def _vehicle(self) -> tuple[str, int]:
        """Which autopilot it is, and its system id."""
        kind = self.pilot.autopilot
        return "" if kind is None else kind.value, self.autopilot.system_id or 0

    def _meet(self, board: BoardKnown) -> None:
        left = self.settings.meet(*self._vehicle, board.board)
        if left:
            self._give([SettingsLeft(board.t_s, left)])

    def ask(self, event: Event) -> Reply:
        """Give the mission an operator's order and return its reply."""
        return self.ask_why(event).reply

    def ask_why(self, event: Event) -> Answer:
        """The reply with its reason."""
        self._answer = Answer(Reply.ACCEPTED)
        self._give([event])
        return self._answer

    # --- silence -------------------------------------------------------------------------------

    def _heard(self, peer: Any) -> None:
        self.link.answer_to(peer)
        self._heard_wall_s = self.wall_clock_s()
        if self._silent:
            self._silent = False
            self.recorder.note(self.clock.t_s, "heard again")
            # The gap is known once the clock has been stamped; a lull shows none.
            self._give([LinkBack(self.clock.t_s, 0.0)])

    def _mind_stall(self) -> None:
        """What we could not hear while we stood still is no silence of the link."""
        self._heard_wall_s += self.hearing.turned()

    def _mind_records(self) -> None:
        """The operator hears once that the flight goes on without its record."""
        words = self.recorder.new_trouble()
        if words is not None and not self._record_lost:
            self._record_lost = True
            self.carry_out([Say(Severity.WARNING, f"record given up, {words}")])

    def _mind_silence(self) -> None:
        silent_s = self.wall_clock_s() - self._heard_wall_s
        if silent_s > SILENT_S and not self._silent and self._system_known:
            self._silent = True
            self._give([LinkSilent(self.clock.t_s)])
        if silent_s > self.silence_limit_s:
            self.lost = True

    def _mind_strangers(self) -> None:
        """The operator hears once that somebody floods our port; the vehicle is heard as before."""
        if self.link.strangers and not self._strangers_told:
            self._strangers_told = True
            self.carry_out([Say(Severity.WARNING, "strangers flood the link: not heard")])

    def _mind_signing(self) -> None:
        """Nothing that is rightly signed is accepted: the operator hears which clock says what."""
        apart_us = self.codec.clocks_apart_us
        write = self.stamps.due(self.wall_clock_s()) if self.stamps is not None else None
        if write is not None:
            self.recorder.keep(STAMPS, write)
        if apart_us is None:
            self._refused_wall_s = None
            return
        now_s = self.wall_clock_s()
        self._refused_wall_s = now_s if self._refused_wall_s is None else self._refused_wall_s
        if self._clocks_told or now_s - self._refused_wall_s < CLOCKS_APART_S:
            return
        self._clocks_told = True
        behind_s = (apart_us[1] - apart_us[0]) / 1e6
        words = (
            f"signing: autopilot's clock {behind_s:.0f} s behind ours",
            f"autopilot: {utc_words(apart_us[0])}",
            f"this computer: {utc_words(apart_us[1])}",
            "set the clock that is wrong, then start again",
        )
        self.carry_out([Say(Severity.CRITICAL, text) for text in words])

    # --- out -----------------------------------------------------------------------------------

    def carry_out(self, actions: list[Action]) -> None:
        """Do what the mission asks."""
        t_s = self.clock.t_s
        for action in actions:
            if isinstance(action, Finished):
                action = self._counted(action)
            self.recorder.take(action, t_s)
            if self.port is not None:
                self.port.take(action)
            match action:
                case Order():
                    self.autopilot.order(action, t_s)
                case DropOrders():
                    self.autopilot.drop_orders()
                    self._outgoing = [kept for kept in self._outgoing if not kept.is_order]
                    self._outgoing_bytes = sum(len(kept.frame) for kept in self._outgoing)
                case Say():
                    for message in self._texts.messages(action.severity, action.text):
                        self.send(message)
                case Publish():
                    self._to_publish.update(action.values)
                case Answer():
                    self._answer = action
                case PhaseChanged():
                    self._heartbeat()
                case SaveCheckpoint():
                    self.settings.take(*self._vehicle, self.pilot.settings_before)
                case FindPlan():
                    self.planning.begin(action)
                case Finished():
                    self.finished = action
                case _:
                    pass
            if self.on_action is not None:
                self.recorder.show(self.on_action, action)

    def _counted(self, finished: Finished) -> Finished:
        """The flight joins the vehicle's service; the operator hears what came into doubt by it."""
        if self.monitor is None:
            return finished
        finished, new = self.monitor.take(finished, self.recorder.keep_monitor)
        self.recorder.note(self.clock.t_s, self.monitor.line(finished))
        self.carry_out([Say(Severity.WARNING, words) for words in new])
        if self.port is not None:
            self.port.doubt = "; ".join(self.monitor.doubts.words)
        return finished

    def _publish_next(self) -> None:
        """One named value a tick: of several at once PX4's log keeps the last (flown)."""
        if not self._to_publish:
            return
        name = next(iter(self._to_publish))
        value = self._to_publish.pop(name)
        self.send(
            mavlink.MAVLink_named_value_float_message(self.clock.boot_ms, name.encode()[:10], value)
        )

    def _heartbeat(self) -> None:
        self._beat_wall_s = self.wall_clock_s()
        phase = self.pilot.phase
        if phase is Phase.IDENTIFY:
            state = mavlink.MAV_STATE_BOOT
        elif phase is Phase.PASSIVE:
            state = mavlink.MAV_STATE_STANDBY
        else:
            state = mavlink.MAV_STATE_ACTIVE
        flags = mavlink.MAV_MODE_FLAG_AUTO_ENABLED if phase in FLIGHT_PHASES else 0
        self.send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                mavlink.MAV_AUTOPILOT_INVALID,
                flags,
                (self.pilot.flies_since_ms or 0) & 0xFFFFFFFF,
                state,
                3,
            )
        )

    def send(self, message: Any) -> None:
        """Pack and keep one message; it leaves at the next `flush`."""
        self._pack(message, is_order=False)

    def send_order(self, message: Any) -> None:
        """The same for what the autopilot shall do or tell; while we are late it is lost, as on a
        link, and sent again when that is due and still wanted."""
        if not self.hearing.is_late:
            self._pack(message, is_order=True)

    def _pack(self, message: Any, *, is_order: bool) -> None:
        frame = self.codec.pack(message)
        self._said.append(frame)
        if self._outgoing_bytes + len(frame) > BUNDLE_BYTES:
            self.flush()
        self._outgoing.append(_Outgoing(frame, is_order, self.clock.t_s))
        self._outgoing_bytes += len(frame)

    def flush(self) -> None:
        """Let out what was said since the last time, whole frames together: a datagram costs its
        sender and its reader more than its bytes do. Orders stay until it is known that they are
        fresh, and those that are not are lost."""
        if not self._outgoing:
            return
        self._mind_stall()
        going = [kept for kept in self._outgoing if not kept.is_order or self._is_fresh(kept)]
        staying = [kept for kept in self._outgoing if kept.is_order and self._must_wait]
        if going:
            for kept in going:
                self.recorder.stream(kept.frame, kept.t_s)
            self.link.send(b"".join(kept.frame for kept in going))
        self._outgoing = staying
        self._outgoing_bytes = sum(len(kept.frame) for kept in staying)

    @property
    def _must_wait(self) -> bool:
        """Orders neither leave nor are lost yet: the next tick shows whether they are stale."""
        return not self.hearing.may_order and not self.hearing.is_late

    def _is_fresh(self, kept: _Outgoing) -> bool:
        return self.hearing.may_order and self.clock.t_s - kept.t_s <= STALL_S
