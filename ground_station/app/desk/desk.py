"""The running desk: hears the fleet, keeps the store, sends what is in the outbox, assigns.

Everything that must survive is in the store before it is sent; what is in memory here (who lives,
which command is under way) is heard again after a restart. So it may be killed at any moment.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from companion.core.pilot.transitions import FLIGHT_PHASES, Phase
from companion.fleet.messages import (
    FINAL,
    Answered,
    Command,
    EventKind,
    FleetEvent,
    Launch,
    Recall,
    State,
)
from ground_station.adapters.files.day_files import DayData
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import WallClock
from ground_station.app.desk.truck_dispatcher import DayDesk
from ground_station.core.dispatch.depot_assignment import Chooser, Free
from ground_station.core.fleet.fleet_link import (
    Alive,
    Clock,
    CommandAnswered,
    EventsHeard,
    Fleet,
    Heard,
    Nonsense,
    StateHeard,
)
from ground_station.core.fleet.fleet_status import Picture, VehicleSeen
from ground_station.core.schema.orders import AssignmentRow, AssignmentState, CommandRow

ANSWER_S = 5.0
"""How long an answer is waited for; loopback takes milliseconds, a bad radio a second or two."""

AGAIN_S = 1.0
LAUNCHES = 3
"""Refused so often, an assignment is withdrawn: something on that vehicle wants a person."""

IN_THE_AIR = frozenset(phase.value for phase in FLIGHT_PHASES)
LOOK_S = 0.5
"""So often the day is looked at, where nothing new is heard."""


@dataclass(frozen=True, slots=True)
class DeskOptions:
    """How the desk dispatches. `assigns` False: it only carries on what was ordered."""

    by: str = "desk"
    assigns: bool = True
    launches: bool = True
    launch_gap_s: float = 20.0


@dataclass(slots=True)
class Desk:
    """One dispatcher's desk over a fleet; with `day`, of drones that ride on a truck.

    `moved_s`: when something last happened that brings the day on.
    """

    store: Store
    fleet: Fleet
    say: Callable[[str], None]
    options: DeskOptions = field(default_factory=DeskOptions)
    data: DayData | None = None
    chooser: Chooser | None = None
    picture: Picture = field(default_factory=Picture)
    clock: Clock = field(default_factory=WallClock)
    day: DayDesk | None = None
    moved_s: float = -1e9
    _sent: dict[str, float] = field(default_factory=dict)
    _again_s: dict[str, float] = field(default_factory=dict)
    _asked_log_s: dict[str, float] = field(default_factory=dict)
    _seen_to: dict[tuple[str, str], int] = field(default_factory=dict)
    _said: set[str] = field(default_factory=set)
    _flown: set[str] = field(default_factory=set)
    _launched_s: float = -1e9
    _looked_s: float = -1e9
    _stirred: bool = True

    def begin(self) -> None:
        """Ask for the picture at once; a launch just before a restart keeps its gap."""
        self.moved_s = self.clock.monotonic_s()
        if any(r.state is AssignmentState.FLYING for r in self.store.assignments(in_force=True)):
            self._launched_s = self.moved_s
        self.fleet.ask_states(ANSWER_S)

    def turn(self, wait_s: float) -> None:
        """Hear what came, then do what follows: at once where something new was heard, else now
        and then (a hundred vehicles tell a hundred states a second).
        """
        self.listen(wait_s)
        now_s = self.clock.monotonic_s()
        if not self._stirred and now_s - self._looked_s < LOOK_S:
            return
        stirred = self._stirred
        if stirred:
            self.moved_s = now_s
        self._stirred, self._looked_s = False, now_s
        for row in self.store.assignments(in_force=True):
            self._mind(row)
        if self.day is not None and self.day.turn(self.picture, stirred=stirred):
            self.moved_s = now_s
        if self.options.assigns and self.chooser is not None and self.day is None:
            self._assign(self.chooser)
        self.send_outbox()

    def listen(self, wait_s: float) -> None:
        """Only hear, and ask for what was missed."""
        for heard in self.fleet.heard(wait_s):
            self._hear(heard)
        self._mind_logs()

    # --- hearing -------------------------------------------------------------------------------

    def _hear(self, heard: Heard) -> None:
        match heard:
            case Alive():
                self._hear_alive(heard)
            case StateHeard():
                self._hear_state(heard.state)
            case EventsHeard():
                new = self.store.take_events(heard.events, replayed=heard.replayed)
                for log in {event.log for event in heard.events}:
                    self._seen_to.pop((heard.vehicle, log), None)
                for event in new:
                    self._tell(event)
                self._stirred = self._stirred or bool(new)
            case CommandAnswered():
                self._hear_answer(heard)
            case Nonsense():
                self._say_once(f"{heard.key}: not understood: {heard.reason}")

    def _hear_state(self, state: State) -> None:
        before = self.picture.of(state.vehicle).state
        for words in self.picture.hear(state, self.clock.monotonic_s(), self.clock.epoch_us()):
            self.say(words)
        if before is None or _gist(before) != _gist(state):
            self._stirred = True
        if self.day is not None:
            self.day.hear(state)

    def _hear_alive(self, heard: Alive) -> None:
        words = self.picture.alive(heard.vehicle, heard.life, up=heard.up)
        self._stirred = True
        if words is not None:
            self.say(words)
        if not heard.up:
            self.say(f"{heard.vehicle}: gone from the network; it flies on by itself")
            return
        self.say(f"{heard.vehicle}: here")
        self._asked_log_s.pop(heard.vehicle, None)
        self.fleet.ask_states(ANSWER_S)

    def _hear_answer(self, heard: CommandAnswered) -> None:
        self._sent.pop(heard.command_id, None)
        result = heard.result
        if result is None or result.answer not in FINAL:
            why = "no answer" if result is None else f"{result.answer.value}: {result.reason}"
            self._again_s[heard.command_id] = self.clock.monotonic_s() + AGAIN_S
            self.store.tried(heard.command_id, why)
            return
        if self.store.answered(heard.command_id, result.answer, result.reason, result.life):
            self.say(f"{result.vehicle}: {heard.command_id}: {result.answer.value} {result.reason}")
            self._stirred = True

    def _tell(self, event: FleetEvent) -> None:
        order = f" [{event.order}]" if event.order else ""
        outcome = f"{event.outcome} " if event.outcome else ""
        self.say(f"{event.vehicle}{order}: {event.kind.value}: {outcome}{event.text}")

    def _say_once(self, words: str) -> None:
        if words not in self._said:
            self._said.add(words)
            self.say(words)

    def _mind_logs(self) -> None:
        """Ask for the events that were missed."""
        now_s = self.clock.monotonic_s()
        for seen in self.picture.vehicles.values():
            state = seen.state
            if state is None or not seen.present(now_s):
                continue
            if now_s - self._asked_log_s.get(seen.vehicle, -1e9) < AGAIN_S:
                continue
            seen_to = self._known_to(seen.vehicle, state)
            if seen_to < state.last_seq:
                self._asked_log_s[seen.vehicle] = now_s
                self.fleet.ask_events(seen.vehicle, seen_to, ANSWER_S)

    def _known_to(self, vehicle: str, state: State) -> int:
        """The event up to which nothing is missing; the store is asked only while some are."""
        key = (vehicle, state.log)
        if self._seen_to.get(key, -1) < state.last_seq:
            self._seen_to[key] = self.store.seen_to(*key)
        return self._seen_to[key]

    # --- assignments ---------------------------------------------------------------------------

    def _mind(self, row: AssignmentRow) -> None:
        """Launch what is ready; see when a launch came to nothing."""
        seen = self.picture.of(row.vehicle)
        state, now_s = seen.state, self.clock.monotonic_s()
        if state is None or not seen.present(now_s):
            return
        self.moved_s = now_s  # it is being brought
        ready = state.phase == Phase.READY.value and state.assignment == row.id and not state.armed
        if row.state is AssignmentState.FLYING and ready and self._restarted(row, state):
            if self._flew(row):
                self._say_once(f"{row.vehicle}: {row.id} was flown: not launched again: look at it")
            else:
                self.store.not_flying(row.id, "its companion restarted before take-off")
        elif row.state is AssignmentState.ABOARD and ready and not seen.doubts:
            if self.day is None:
                self._launch(row, now_s)
        elif row.state is AssignmentState.FLYING and self._forgotten(row, seen, state):
            self._say_once(f"{row.vehicle}: knows nothing of {row.id} any more: look at it")

    def _restarted(self, row: AssignmentRow, state: State) -> bool:
        launches = [
            command
            for command in self.store.commands_of(row.id)
            if isinstance(command.deed, Launch) and command.answer in FINAL
        ]
        if not launches:
            return False
        last = launches[-1]  # interrupted: answered by the life that did not do it
        return last.life != state.life or last.answer is Answered.INTERRUPTED

    def _flew(self, row: AssignmentRow) -> bool:
        """Its vehicle told that it left a phase which it is in only in the air."""
        if row.id not in self._flown:
            phases = (e for e in self.store.events(EventKind.PHASE) if e.assignment == row.id)
            if any(event.text.partition(" -> ")[0] in IN_THE_AIR for event in phases):
                self._flown.add(row.id)
        return row.id in self._flown

    def _forgotten(self, row: AssignmentRow, seen: VehicleSeen, state: State) -> bool:
        told_all = self._known_to(seen.vehicle, state) >= state.last_seq
        return state.assignment != row.id and told_all

    def _launch(self, row: AssignmentRow, now_s: float) -> None:
        if self.store.refused_launches(row.id) >= LAUNCHES:
            if self.store.withdraw(row.id, self.options.by):
                self.say(f"{row.vehicle}: launch refused {LAUNCHES} times: {row.id} withdrawn")
            return
        if not self.options.launches or now_s - self._launched_s < self.options.launch_gap_s:
            return
        if self.store.launch(row.id, self.options.by):
            self._launched_s = now_s
            self.say(f"{row.vehicle}: launch of {row.id} ordered")

    def _assign(self, chooser: Chooser) -> None:
        held = {row.vehicle for row in self.store.assignments(in_force=True)}
        now_s = self.clock.monotonic_s()
        free = [
            Free(seen.vehicle, self._charge(seen))
            for seen in sorted(self.picture.vehicles.values(), key=lambda s: s.vehicle)
            if seen.free(now_s) and seen.vehicle not in held
        ]
        if not free:
            return
        no_fly = self.data.no_fly if self.data is not None else None
        for choice in chooser.choose(self.store.orders(), self.store.assignments(), free):
            flight = chooser.flight_of(choice.order, choice.vehicle)
            id_ = self.store.assign(
                choice.order.id, choice.vehicle, flight, no_fly, self.options.by
            )
            if id_ is not None:
                self._stirred = True
                self.say(f"{choice.vehicle}: assigned {choice.order.id} ({id_})")

    def _charge(self, seen: VehicleSeen) -> float | None:
        """From the resting voltage, where it is told."""
        state = seen.state
        airframe = self.picture.airframes.get(state.airframe) if state is not None else None
        if state is None or airframe is None or not state.voltage_v or state.armed is not False:
            return None
        return airframe.battery.charge_frac_at_rest(state.voltage_v)

    # --- the outbox ----------------------------------------------------------------------------

    def send_outbox(self, only: set[str] | None = None) -> None:
        """Send what waits and is due; `only`: of these ids."""
        now_s = self.clock.monotonic_s()
        for row in self.store.outbox():
            if only is not None and row.id not in only:
                continue
            if row.id in self._sent or now_s < self._again_s.get(row.id, -1e9):
                continue
            command = self._command(row, now_s)
            if command is not None:
                self._sent[row.id] = now_s
                self.fleet.send(command, ANSWER_S)

    def _command(self, row: CommandRow, now_s: float) -> Command | None:
        """What to send, as of the newest state; `None`: not now. A recall goes to all of a name."""
        seen = self.picture.of(row.vehicle)
        state = seen.state
        if state is None or not seen.lives:
            return None
        if not isinstance(row.deed, Recall) and not seen.present(now_s):
            return None
        return Command(
            id=row.id,
            vehicle=row.vehicle,
            life=state.life,
            as_of_s=state.uptime_s,
            by=row.by,
            deed=row.deed,
        )


def _gist(state: State) -> tuple[object, ...]:
    """What of a state something may follow from at once."""
    return (state.life, state.phase, state.assignment, state.home, state.stop, state.armed)
