"""The desk's exchange with its fleet: messages into the store, commands out of its outbox.

A store that is away loses nothing: what could not be written is asked for again when it is back,
events by their number, answers by sending the command again. Until then only the fleet's status is
kept. It decides nothing: `watch` uses it without a dispatcher. Whatever must survive is in
the store before it is sent. What is only in memory (who is alive, which command is under way) is
received again after a restart, so the process may be killed at any moment.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import groupby

from companion.core.base.rate_limit import RateLimit
from companion.fleet.messages import (
    FINAL,
    Command,
    FleetEvent,
    Launch,
    Recall,
    Result,
    State,
)
from ground_station.adapters.clock import WallClock
from ground_station.adapters.store.database import StoreError
from ground_station.adapters.store.order_steps import deed_word
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.answer_times import AnswerTimes
from ground_station.core.fleet.desk_figures import OutboxFigures
from ground_station.core.fleet.fleet_link import (
    Clock,
    CommandAnswered,
    EventsReceived,
    FleetInput,
    FleetLink,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
    StationWindReceived,
)
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.name_counts import NameCounts
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.schema.orders import CommandRow

STATES_S = 2.0
"""All are asked for their states at most so often, however many join: each arrival asked all once,
and 500 at a time kept the desk from hearing anything else for 25 s.
"""

STATES_AGAIN_S = 60.0
"""And at least so often: who was missed when it joined is found, and a member knows by it that a
desk finds it (`companion.fleet.zenoh_link`).
"""

REJECTED_S = 60.0
"""A member's rejected messages are said at most so often, with their number."""

REPLAYS_HZ, REPLAYS_BURST = 20.0, 4000.0
"""Events that are asked for again, of one member: twice what a member keeps, at once."""

ANSWER_S = 5.0
"""Time-out of an answer. Loopback takes milliseconds, a bad radio a second or two."""

RETRY_S = 1.0
"""Wait before a command or a request for events is sent again."""


@dataclass(slots=True)
class Exchange:
    """One desk's exchange. `on_state` is told each state, `on_station` each word of a wind station;
    `changed`: something new has come.

    `away`: why the store cannot be reached, and since when; None: it can. `outbox`: as it was last
    read.
    """

    store: Store
    fleet: FleetLink
    say: Callable[[str], None]
    status: FleetStatus = field(default_factory=FleetStatus)
    clock: Clock = field(default_factory=WallClock)
    on_state: Callable[[State], None] = lambda state: None
    on_station: Callable[[StationWind], None] = lambda wind: None
    changed: bool = True
    away: str | None = None
    away_since_s: float | None = None
    answer_times: AnswerTimes = field(default_factory=AnswerTimes)
    rejected: NameCounts = field(default_factory=NameCounts)
    outbox: OutboxFigures | None = None
    _sent: set[str] = field(default_factory=set)
    _retry_s: dict[str, float] = field(default_factory=dict)
    _events_asked_s: dict[str, float] = field(default_factory=dict)
    _complete_to: dict[tuple[str, str], int] = field(default_factory=dict)
    _said: set[str] = field(default_factory=set)
    _states_wanted: bool = False
    _states_asked_s: float | None = None
    _not_said: Counter[str] = field(default_factory=Counter)
    _rejected_said_s: dict[str, float] = field(default_factory=dict)
    _replays: dict[str, RateLimit] = field(default_factory=dict)
    _maybe_behind: set[str] = field(default_factory=set)

    def begin(self) -> None:
        """Ask for the state of the whole fleet."""
        self._states_wanted = True
        self._ask_states()

    def listen(self, wait_s: float) -> None:
        """Take what has come, waiting this long for the first; ask for what was missed."""
        for _, run in groupby(self.fleet.receive(wait_s), key=type):  # in the order they came
            with self.store_may_be_away():
                self._take(list(run))
        with self.store_may_be_away():
            self._ask_for_missed_events()
        self._ask_states()

    @contextmanager
    def store_may_be_away(self) -> Iterator[None]:
        """What is inside ends where the store cannot be reached, and that is said, once."""
        try:
            yield
        except StoreError as error:
            if self.away is None:
                self.say(f"STORE AWAY: nothing new is decided, what flies goes on: {error}")
                self.away_since_s = self.clock.monotonic_s()
            self.away = str(error)

    def store_is_back(self) -> None:
        """The store has done all that it was asked for."""
        if self.away is not None:
            self.say("store back")
            self.away, self.away_since_s, self.changed = None, None, True

    def say_once(self, words: str) -> None:
        """Say it, unless it has been said before."""
        if words not in self._said:
            self._said.add(words)
            self.say(words)

    # --- in ------------------------------------------------------------------------------------

    def _take(self, run: list[FleetInput]) -> None:
        """Inputs of one kind: what the store must note of them is one transaction."""
        if events := [received for received in run if isinstance(received, EventsReceived)]:
            self._take_events(events)
        if answers := [received for received in run if isinstance(received, CommandAnswered)]:
            self._take_answers(answers)
        for received in run:
            match received:
                case LivelinessChanged():
                    self._take_liveliness(received)
                case StateReceived():
                    self._take_state(received.state)
                case StationWindReceived():
                    self.on_station(received.wind)
                case MessageRejected():
                    self._take_rejected(received)
                case _:
                    pass  # taken together

    def _take_rejected(self, received: MessageRejected) -> None:
        """Say it, and how many there were since it was said last. Where somebody sends what is not
        believed, the true states may be lost among it: they are asked for.
        """
        self._states_wanted = True
        who, now_s = received.key, self.clock.monotonic_s()
        self.rejected.add(who, received.count)
        self._not_said[who] += received.count
        said_s = self._rejected_said_s.get(who)
        if said_s is not None and now_s - said_s < REJECTED_S:
            return
        self._rejected_said_s[who] = now_s
        count = self._not_said.pop(who)
        number = "message" if count == 1 else f"{count} messages"
        self.say(f"{who}: {number} rejected: {received.reason}")

    def _take_events(self, batches: list[EventsReceived]) -> None:
        """All that came together, in one transaction."""
        new = self.store.take_event_batches([(b.events, b.replayed) for b in batches])
        for received in batches:
            self._maybe_behind.add(received.vehicle)
            for log in {event.log for event in received.events}:
                self._complete_to.pop((received.vehicle, log), None)
            if received.replayed:
                replays, now_s = self._replays_of(received.vehicle), self.clock.monotonic_s()
                replays.spend(now_s, len(received.events))
        for event in new:
            self._say_event(event)
        self.changed = self.changed or bool(new)

    def _take_state(self, state: State) -> None:
        before = self.status.of(state.vehicle).state
        now_s, now_us = self.clock.monotonic_s(), self.clock.epoch_us()
        for words in self.status.on_state(state, now_s, now_us):
            self.say(words)
        if self.status.of(state.vehicle).state is not state:
            return  # an old one
        if before is None or _decisive(before) != _decisive(state):
            self.changed = True
        self._maybe_behind.add(state.vehicle)
        self.on_state(state)

    def _take_liveliness(self, received: LivelinessChanged) -> None:
        vehicle = received.vehicle
        words = self.status.on_liveliness(vehicle, received.life, up=received.up)
        self.changed = True
        if words is not None:
            self.say(words)
        if not received.up:
            self.say(f"{vehicle}: left the network; it goes on by itself")
            return
        self.say(f"{vehicle}: joined the network")
        self._events_asked_s.pop(vehicle, None)
        self._maybe_behind.add(vehicle)
        self._states_wanted = True

    def _ask_states(self) -> None:
        """Ask all for their states, once for all who joined since the last time."""
        now_s, asked_s = self.clock.monotonic_s(), self._states_asked_s
        rest_s = STATES_S if self._states_wanted else STATES_AGAIN_S
        if asked_s is not None and now_s - asked_s < rest_s:
            return
        self._states_wanted, self._states_asked_s = False, now_s
        self.fleet.ask_states(ANSWER_S)

    def _take_answers(self, answers: list[CommandAnswered]) -> None:
        self._sent -= {received.command_id for received in answers}
        final: list[Result] = []
        for received in answers:
            if received.result is not None and received.result.answer in FINAL:
                final.append(received.result)
            else:
                self._try_again(received)
        now_s = self.clock.monotonic_s()
        new = self.store.take_answers(final) if final else set[str]()
        for result in final:
            self.answer_times.answered(result.id, now_s)  # it is in the store: not sent again
            if result.id in new:
                self.say(f"{result.vehicle}: {result.id}: {result.answer.value} {result.reason}")
                self.changed = True

    def _try_again(self, received: CommandAnswered) -> None:
        result = received.result
        why = "no answer" if result is None else f"{result.answer.value}: {result.reason}"
        if result is None:
            self.answer_times.timed_out(received.command_id)
        self._retry_s[received.command_id] = self.clock.monotonic_s() + RETRY_S
        self.store.tried(received.command_id, why)

    def _say_event(self, event: FleetEvent) -> None:
        order = f" [{event.order}]" if event.order else ""
        outcome = f"{event.outcome} " if event.outcome else ""
        self.say(f"{event.vehicle}{order}: {event.kind.value}: {outcome}{event.text}")

    def _ask_for_missed_events(self) -> None:
        """Of those whose state or events have come since the last call, or who were behind then."""
        now_s, looked_at = self.clock.monotonic_s(), self._maybe_behind
        behind = {vehicle for vehicle in looked_at if self._is_behind(vehicle, now_s)}
        self._maybe_behind -= looked_at - behind

    def _is_behind(self, vehicle: str, now_s: float) -> bool:
        """Whether events of a member that is there are missing; they are asked for when it is time.

        Who is not there is looked at again with its next state.
        """
        seen = self.status.of(vehicle)
        state = seen.state
        if state is None or not seen.present(now_s):
            return False
        asked_s = self._events_asked_s.get(vehicle)
        if asked_s is not None and now_s - asked_s < RETRY_S:
            return True
        complete_to = self._log_complete_to(vehicle, state)
        if complete_to >= state.last_seq:
            return False
        if self._replays_of(vehicle).take(now_s, 0.0):
            self._events_asked_s[vehicle] = now_s
            self.fleet.ask_events(vehicle, complete_to, ANSWER_S)
        return True

    def _replays_of(self, vehicle: str) -> RateLimit:
        """How many more events this member may be asked for."""
        return self._replays.setdefault(vehicle, RateLimit(REPLAYS_HZ, REPLAYS_BURST))

    def has_all_events(self, state: State) -> bool:
        """Whether the store holds every event up to this state."""
        return self._log_complete_to(state.vehicle, state) >= state.last_seq

    def _log_complete_to(self, vehicle: str, state: State) -> int:
        """The last event before which none is missing. Asks the store only while some are."""
        key = (vehicle, state.log)
        if self._complete_to.get(key, -1) < state.last_seq:
            self._complete_to[key] = self.store.seen_to(*key)
        return self._complete_to[key]

    # --- out -----------------------------------------------------------------------------------

    def send_outbox(self, only: set[str] | None = None) -> None:
        """Send the commands that are due; `only`: of these ids."""
        now_s, rows = self.clock.monotonic_s(), self.store.outbox()
        self.outbox = OutboxFigures(len(rows), rows[0].made_us if rows else None)
        self.answer_times.keep_only({row.id for row in rows})
        for row in rows:
            if only is not None and row.id not in only:
                continue
            retry_s = self._retry_s.get(row.id)
            if row.id in self._sent or (retry_s is not None and now_s < retry_s):
                continue
            command = self._command(row, now_s)
            if command is not None:
                self._sent.add(row.id)
                self.answer_times.sent(row.id, deed_word(row.deed), now_s)
                self.fleet.send(command, ANSWER_S)

    def _command(self, row: CommandRow, now_s: float) -> Command | None:
        """The command as of the newest state; None: not now.

        A recall is sent also where two companions share the name, or the vehicle is silent. A
        launch leaves only where no hold stands against it at that moment.
        """
        seen = self.status.of(row.vehicle)
        state = seen.state
        if state is None or not seen.lives:
            return None
        if not isinstance(row.deed, Recall) and not seen.present(now_s):
            return None
        if isinstance(row.deed, Launch) and not self.store.may_send_launch(row):
            return None
        return Command(
            id=row.id,
            vehicle=row.vehicle,
            life=state.life,
            as_of_s=state.uptime_s,
            by=row.by,
            deed=row.deed,
        )


def _decisive(state: State) -> tuple[object, ...]:
    """The fields of a state that a decision may follow from at once."""
    return (state.life, state.phase, state.assignment, state.home, state.stop, state.armed)
