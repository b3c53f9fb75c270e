"""The running desk: receives the fleet's messages, lets its dispatcher decide, sends commands."""

from dataclasses import dataclass, field

from companion.core.pilot.transitions import Phase
from companion.fleet.messages import FINAL, Answered, EventKind, Launch, State
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.dispatcher import Dispatcher, Progress
from ground_station.app.desk.exchange import Exchange
from ground_station.app.desk.wind_guard import WindGuard
from ground_station.app.desk.wind_teller import WindTeller
from ground_station.core.fleet.fleet_status import IN_THE_AIR, VehicleStatus
from ground_station.core.schema.orders import (
    IN_FORCE,
    AssignmentRow,
    AssignmentState,
    OrderRow,
    OrderState,
)

TURN_S = 0.5
"""Interval of turns when nothing new has come: a hundred vehicles send a hundred states a
second."""


@dataclass(slots=True)
class Desk:
    """One dispatcher's desk over a fleet. `wind`: watches over it; None: nobody does, and vehicles
    are told nothing of it.

    `moved_s`: when something last happened that brings the day on.
    """

    exchange: Exchange
    dispatcher: Dispatcher
    wind: WindGuard | None = None
    teller: WindTeller | None = field(init=False, default=None)
    moved_s: float = field(init=False)
    _flown: set[str] = field(default_factory=set)
    _turned_s: float | None = None
    _rests_until_s: float = 0.0

    def __post_init__(self) -> None:
        self.moved_s = self.exchange.clock.monotonic_s()
        self.exchange.on_state = self._on_state
        if self.wind is not None:
            self.exchange.on_station = self.wind.on_station
            self.teller = WindTeller(self.wind.wind, self.exchange.fleet)

    def _on_state(self, state: State) -> None:
        if self.wind is not None:
            self.wind.on_state(state)
        self.dispatcher.on_state(state)

    @property
    def store(self) -> Store:
        """Where everything is kept."""
        return self.exchange.store

    def begin(self) -> None:
        """Ask for the state of the fleet and begin to dispatch."""
        self.moved_s = self.exchange.clock.monotonic_s()
        self.dispatcher.begin()
        self.exchange.begin()

    def turn(self, wait_s: float) -> None:
        """Take what has come, then do what follows from it."""
        exchange = self.exchange
        exchange.listen(wait_s)
        now_s = exchange.clock.monotonic_s()
        if self.teller is not None:
            self.teller.turn(exchange.status, now_s)
        changed = exchange.changed
        if now_s < self._rests_until_s:
            return
        if not changed and self._turned_s is not None and now_s - self._turned_s < TURN_S:
            return
        if changed:
            self.moved_s = now_s
        exchange.changed, self._turned_s = False, now_s
        if not self._could_decide(now_s, changed):
            exchange.changed, self.moved_s = True, now_s  # the day is not idle: it waits
        ended_s = exchange.clock.monotonic_s()
        self._rests_until_s = ended_s + (ended_s - now_s)  # half of its time it listens

    def _could_decide(self, now_s: float, changed: bool) -> bool:
        """Decide; False where the store is away."""
        with self.exchange.store_may_be_away():
            if self.exchange.away is not None:  # it may be read while nothing can be written
                self.store.database.try_again()
            self._decide(now_s, changed)
            self.exchange.store_is_back()
            return True
        return False

    def _decide(self, now_s: float, changed: bool) -> None:
        """Do what is due; each decision is written before it is sent, or not taken."""
        exchange = self.exchange
        if self.wind is not None and self.wind.turn(exchange.status):  # before any launch
            changed = exchange.changed = True
        for row in self.store.assignments(in_force=True):
            self._review(row)
        match self.dispatcher.turn(exchange.status, changed=changed):
            case Progress.UNDER_WAY:
                self.moved_s = now_s
            case Progress.CHANGED:
                exchange.changed = True
            case Progress.NONE:
                pass
        exchange.send_outbox()

    def close(self) -> None:
        """Stop what runs beside the desk; store and network are the caller's."""
        self.dispatcher.close()
        if self.wind is not None:
            self.wind.close()

    # --- assignments in force --------------------------------------------------------------------

    def _review(self, row: AssignmentRow) -> None:
        """Pass on who is ready; find launches that never happened."""
        seen = self.exchange.status.of(row.vehicle)
        state, now_s = seen.state, self.exchange.clock.monotonic_s()
        if state is None or not seen.present(now_s):
            return
        self.moved_s = now_s  # it is being brought
        ready = state.phase == Phase.READY.value and state.assignment == row.id and not state.armed
        if row.state is AssignmentState.FLYING and ready and self._restarted(row, state):
            if self._flew(row):
                words = f"{row.vehicle}: {row.id} was flown: not launched again: look at it"
                self.exchange.say_once(words)
            else:
                self.store.not_flying(row.id, "its companion restarted before take-off")
        elif row.state is AssignmentState.ABOARD and _flies(state, row):
            self._note_take_off(row, state)
        elif row.state is AssignmentState.ABOARD and ready and not seen.doubts:
            self.dispatcher.on_ready(row)
        elif row.state is AssignmentState.FLYING and self._unknown_to(seen, row):
            words = f"{row.vehicle}: knows nothing of {row.id} any more: look at it"
            self.exchange.say_once(words)

    def _note_take_off(self, row: AssignmentRow, state: State) -> None:
        """A hold came behind its launch, whose answer nobody asks for any more: it flies."""
        if self.store.seen_flying(row.id, state.life):
            self.exchange.say(f"{row.vehicle}: {row.id} took off before it was held")
            self.exchange.changed = True

    def _restarted(self, row: AssignmentRow, state: State) -> bool:
        """Whether the companion that took the last launch is not the one that speaks now."""
        launches = [
            command
            for command in self.store.commands_of(row.id)
            if isinstance(command.deed, Launch) and command.answer in FINAL
        ]
        if not launches:
            return False
        last = launches[-1]  # INTERRUPTED: answered by a life that did not carry it out
        return last.life != state.life or last.answer is Answered.INTERRUPTED

    def _flew(self, row: AssignmentRow) -> bool:
        """Whether its vehicle has reported that it left a phase of flight."""
        if row.id not in self._flown:
            phases = (e for e in self.store.events(EventKind.PHASE) if e.assignment == row.id)
            if any(event.text.partition(" -> ")[0] in IN_THE_AIR for event in phases):
                self._flown.add(row.id)
        return row.id in self._flown

    def _unknown_to(self, seen: VehicleStatus, row: AssignmentRow) -> bool:
        """Whether a vehicle flies something else, and all its events are in the store."""
        state = seen.state
        if state is None:
            return False
        # Asked first: it also keeps the exchange's record of that log up to date.
        complete = self.exchange.has_all_events(state)
        return state.assignment != row.id and complete

    # --- the end of the day ----------------------------------------------------------------------

    @property
    def is_done(self) -> bool:
        """Whether nothing is open or under way that this desk can do."""
        with self.exchange.store_may_be_away():
            return not self.store.outbox() and self.dispatcher.is_done
        return False

    def is_idle(self, idle_s: float) -> bool:
        """Whether nothing has brought the day on for this long."""
        return self.exchange.clock.monotonic_s() - self.moved_s > idle_s

    def left_over(self) -> list[OrderRow]:
        """Orders that are neither delivered nor cancelled."""
        done = (OrderState.DELIVERED, OrderState.CANCELLED)
        return [row for row in self.store.orders() if row.state not in done]

    def why_left(self, row: OrderRow) -> str:
        """Why an order is not delivered, as far as the desk knows."""
        if row.why:
            return row.why
        for held in self.store.assignments(in_force=True):
            if held.order_id == row.order.id and held.state in IN_FORCE:
                return f"{held.state.value} with {held.vehicle}"
        return self.dispatcher.why_left(row.order.id) or "no drone was free for it"


def _flies(state: State, row: AssignmentRow) -> bool:
    return state.assignment == row.id and state.phase in IN_THE_AIR
