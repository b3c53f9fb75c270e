"""The desk's exchange with its fleet: messages into the store, commands out of its outbox.

An unreachable store loses no data: after it recovers, missing events are requested by number and
responses by sending the command again. Until then only the fleet's status is kept. The exchange
makes no decisions: `watch` uses it without a dispatcher. All data that must survive is in the store
before it is sent. Data in memory (vehicles alive, commands in transit) is received again after a
restart, so the process may be killed at any moment.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import groupby

import msgspec

from companion.core.base.rate_limit import RateLimit
from companion.fleet.messages import (
    FINAL_STATUSES,
    Command,
    Launch,
    LaunchWindow,
    Recall,
    Result,
    State,
)
from ground_station.adapters.clock import WallClock
from ground_station.adapters.store.database import StoreError
from ground_station.adapters.store.launch_store import stamp_and_mark_launch_sent
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.fleet_link import (
    Clock,
    CommandResponse,
    DeskHeartbeatReceived,
    EventsReceived,
    FleetInput,
    FleetLink,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
    StationWindReceived,
)
from ground_station.core.fleet.fleet_status import FLIGHT_PHASE_NAMES, FleetStatus
from ground_station.core.fleet.launch_evidence import launch_window_on_vehicle_clock
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.schema.orders import CommandRow

STATE_REQUEST_MIN_INTERVAL_S = 2.0
"""Minimum interval of state requests to all members. One request for each arrival blocked the desk
for 25 s when 500 vehicles joined together.
"""

STATE_REQUEST_INTERVAL_S = 60.0
"""Maximum interval of state requests. It detects members that were missed when they joined, and
confirms to each member that a desk receives it (`companion.fleet.zenoh_link`).
"""

REJECTED_LOG_INTERVAL_S = 60.0
"""Minimum interval of log entries on rejected messages of one member, with their number."""

EVENT_REPLAY_RATE_HZ, EVENT_REPLAY_BURST = 20.0, 4000.0
"""Events requested again from one member: rate, and a burst of twice what a member keeps."""

RESPONSE_TIMEOUT_S = 5.0
"""Response timeout. Loopback takes milliseconds, a bad radio a second or two."""

RETRY_DELAY_S = 1.0
"""Wait before a command or a request for events is sent again."""


@dataclass(slots=True)
class FleetExchange:
    """Exchange of one desk. `on_state` receives each state, `on_station` each report of a wind
    station; `changed`: new messages have arrived. `earliest_launch_s`: end of the launch gap.

    `store_error`: error of the unreachable store; None: it is reachable.
    """

    store: Store
    fleet: FleetLink
    log: Callable[[str], None]
    status: FleetStatus = field(default_factory=FleetStatus)
    clock: Clock = field(default_factory=WallClock)
    on_state: Callable[[State], None] = lambda state: None
    on_station: Callable[[StationWind], None] = lambda wind: None
    changed: bool = True
    store_error: str | None = None
    earliest_launch_s: Callable[[], float] = lambda: -math.inf
    _commands_in_transit: set[str] = field(default_factory=set)
    _next_attempt_s: dict[str, float] = field(default_factory=dict)
    _events_requested_s: dict[str, float] = field(default_factory=dict)
    _complete_to: dict[tuple[str, str], int] = field(default_factory=dict)
    _logged_messages: set[str] = field(default_factory=set)
    _states_required: bool = False
    _states_requested_s: float | None = None
    _unlogged_rejections: Counter[str] = field(default_factory=Counter)
    _rejection_logged_s: dict[str, float] = field(default_factory=dict)
    _replay_limits: dict[str, RateLimit] = field(default_factory=dict)
    _unchecked_members: set[str] = field(default_factory=set)

    def request_initial_states(self) -> None:
        """Request the state of the whole fleet."""
        self._states_required = True
        self._request_states_if_due()

    def receive_and_process_messages(self, wait_s: float) -> None:
        """Process received messages, waiting this long for the first; request missed ones."""
        for _, batch in groupby(self.fleet.receive(wait_s), key=type):  # in the order they came
            with self.suppress_and_record_store_outage():
                self._process_batch(list(batch))
        with self.suppress_and_record_store_outage():
            self._request_missing_events()
        self._request_states_if_due()

    @contextmanager
    def suppress_and_record_store_outage(self) -> Iterator[None]:
        """Suppress a StoreError of the body: log it once per outage and set `store_error`."""
        try:
            yield
        except StoreError as error:
            if self.store_error is None:
                self.log(f"store unreachable: no new decisions, flights continue: {error}")
            self.store_error = str(error)

    def clear_store_outage(self) -> None:
        """Clear `store_error` after a cycle without a StoreError."""
        if self.store_error is not None:
            self.log("store reachable again")
            self.store_error, self.changed = None, True

    def log_once(self, message: str) -> None:
        """Log a message unless it has been logged before."""
        if message not in self._logged_messages:
            self._logged_messages.add(message)
            self.log(message)

    # --- in ------------------------------------------------------------------------------------

    def _process_batch(self, batch: list[FleetInput]) -> None:
        """Process inputs of one type; all that is stored of them is one transaction."""
        if events := [received for received in batch if isinstance(received, EventsReceived)]:
            self._store_and_log_events(events)
        if responses := [received for received in batch if isinstance(received, CommandResponse)]:
            self._store_responses_or_schedule_retry(responses)
        for received in batch:
            match received:
                case LivelinessChanged():
                    self._process_liveliness(received)
                case StateReceived():
                    self._process_state(received.state)
                case StationWindReceived():
                    self.on_station(received.wind)
                case DeskHeartbeatReceived():
                    self.status.record_desk_heartbeat(received.heartbeat, self.clock)
                case MessageRejected():
                    self._count_and_log_rejected(received)

    def _count_and_log_rejected(self, received: MessageRejected) -> None:
        """Log the number of rejected messages of a sender at most every `REJECTED_LOG_INTERVAL_S`.
        Valid states may have been discarded between them, so all states are requested.
        """
        self._states_required = True
        sender, now_s = received.key, self.clock.monotonic_s()
        self._unlogged_rejections[sender] += received.count
        logged_s = self._rejection_logged_s.get(sender)
        if logged_s is not None and now_s - logged_s < REJECTED_LOG_INTERVAL_S:
            return
        self._rejection_logged_s[sender] = now_s
        count = self._unlogged_rejections.pop(sender)
        number = "message" if count == 1 else f"{count} messages"
        self.log(f"{sender}: {number} rejected: {received.reason}")

    def _store_and_log_events(self, batches: list[EventsReceived]) -> None:
        """Store all batches that arrived together in one transaction."""
        new = self.store.record_event_batches([(b.events, b.replayed) for b in batches])
        for received in batches:
            self._unchecked_members.add(received.vehicle)
            for log in {event.log for event in received.events}:
                self._complete_to.pop((received.vehicle, log), None)
            if received.replayed:
                replays = self._event_replay_limit_of(received.vehicle)
                now_s = self.clock.monotonic_s()
                replays.consume_tokens_beyond_limit(now_s, len(received.events))
        for event in new:
            order = f" [{event.order}]" if event.order else ""
            outcome = f"{event.outcome} " if event.outcome else ""
            self.log(f"{event.vehicle}{order}: {event.kind.value}: {outcome}{event.text}")
        self.changed = self.changed or bool(new)

    def _process_state(self, state: State) -> None:
        before = self.status.status_of(state.vehicle).state
        now_s, epoch_us = self.clock.monotonic_s(), self.clock.epoch_us()
        for message in self.status.record_state_and_new_doubts(state, now_s, epoch_us):
            self.log(message)
        if self.status.status_of(state.vehicle).state is not state:
            return  # an outdated state
        if before is None or _decision_trigger_fields(before) != _decision_trigger_fields(state):
            self.changed = True
        self._unchecked_members.add(state.vehicle)
        self.on_state(state)

    def _process_liveliness(self, received: LivelinessChanged) -> None:
        vehicle = received.vehicle
        message = self.status.record_liveliness_change(
            vehicle, received.instance_id, has_joined=received.has_joined
        )
        self.changed = True
        if message is not None:
            self.log(message)
        if not received.has_joined:
            state = self.status.status_of(vehicle).state
            is_flying = state is not None and state.phase in FLIGHT_PHASE_NAMES
            self.log(f"{vehicle}: left the network{'; its flight continues' if is_flying else ''}")
            return
        self.log(f"{vehicle}: joined the network")
        self._events_requested_s.pop(vehicle, None)
        self._unchecked_members.add(vehicle)
        self._states_required = True

    def _request_states_if_due(self) -> None:
        """Request all states, once for all members that joined since the last request."""
        now_s, requested_s = self.clock.monotonic_s(), self._states_requested_s
        interval_s = (
            STATE_REQUEST_MIN_INTERVAL_S if self._states_required else STATE_REQUEST_INTERVAL_S
        )
        if requested_s is not None and now_s - requested_s < interval_s:
            return
        self._states_required, self._states_requested_s = False, now_s
        self.fleet.request_states(RESPONSE_TIMEOUT_S)

    def _store_responses_or_schedule_retry(self, responses: list[CommandResponse]) -> None:
        self._commands_in_transit -= {received.command_id for received in responses}
        final: list[Result] = []
        for received in responses:
            if received.result is not None and received.result.status in FINAL_STATUSES:
                final.append(received.result)
            else:
                id_, result = received.command_id, received.result
                answer = f"{result.status.value}: {result.reason}" if result else "no answer"
                self._next_attempt_s[id_] = self.clock.monotonic_s() + RETRY_DELAY_S
                self.store.record_send_attempt(id_, answer)
        new = self.store.record_and_apply_responses(final) if final else set[str]()
        for result in final:
            if result.id in new:
                self.log(f"{result.vehicle}: {result.id}: {result.status.value} {result.reason}")
                self.changed = True

    def _request_missing_events(self) -> None:
        """Check members with new states or events, and those that were incomplete before."""
        now_s, members = self.clock.monotonic_s(), self._unchecked_members
        incomplete = {
            vehicle for vehicle in members if self._request_events_if_missing(vehicle, now_s)
        }
        self._unchecked_members -= members - incomplete

    def _request_events_if_missing(self, vehicle: str, now_s: float) -> bool:
        """Whether events of a present member are missing; request them when the interval is over.

        A member that is not present is checked again with its next state.
        """
        vehicle_status = self.status.status_of(vehicle)
        state = vehicle_status.state
        if state is None or not vehicle_status.is_uniquely_online_and_reporting(now_s):
            return False
        requested_s = self._events_requested_s.get(vehicle)
        if requested_s is not None and now_s - requested_s < RETRY_DELAY_S:
            return True
        complete_to = self._last_gapless_event_number(vehicle, state)
        if complete_to >= state.last_seq:
            return False
        if self._event_replay_limit_of(vehicle).try_consume_tokens(now_s, 0.0):
            self._events_requested_s[vehicle] = now_s
            self.fleet.request_events(vehicle, complete_to, RESPONSE_TIMEOUT_S)
        return True

    def _event_replay_limit_of(self, vehicle: str) -> RateLimit:
        """Return the limit of further events that may be requested from this member."""
        return self._replay_limits.setdefault(
            vehicle, RateLimit(EVENT_REPLAY_RATE_HZ, EVENT_REPLAY_BURST)
        )

    def has_all_events_up_to(self, state: State) -> bool:
        """Whether the store holds every event up to this state."""
        return self._last_gapless_event_number(state.vehicle, state) >= state.last_seq

    def _last_gapless_event_number(self, vehicle: str, state: State) -> int:
        """Return the last event number without a gap before it; query the store only if needed."""
        key = (vehicle, state.log)
        if self._complete_to.get(key, -1) < state.last_seq:
            self._complete_to[key] = self.store.last_gapless_event_number(*key)
        return self._complete_to[key]

    # --- out -----------------------------------------------------------------------------------

    def send_due_commands(self, command_ids: set[str] | None = None) -> None:
        """Send the commands that are due; `command_ids`: restrict to these ids."""
        now_s = self.clock.monotonic_s()
        for row in self.store.outbox():
            if command_ids is not None and row.id not in command_ids:
                continue
            retry_s = self._next_attempt_s.get(row.id)
            if row.id in self._commands_in_transit or (retry_s is not None and now_s < retry_s):
                continue
            command = self._build_command_and_mark_launch_sent(row, now_s)
            if command is not None:
                self._commands_in_transit.add(row.id)
                self.fleet.send(command, RESPONSE_TIMEOUT_S)

    def _build_command_and_mark_launch_sent(self, row: CommandRow, now_s: float) -> Command | None:
        """Return the command based on the latest state; None: it cannot be sent now.

        A recall is sent even if two companions share the name or the vehicle is silent. A launch is
        sent only if no hold applies to it at that moment.
        """
        vehicle_status = self.status.status_of(row.vehicle)
        state = vehicle_status.state
        if state is None or not vehicle_status.instance_ids:
            return None
        if not isinstance(
            row.command, Recall
        ) and not vehicle_status.is_uniquely_online_and_reporting(now_s):
            return None
        window = None
        if isinstance(row.command, Launch):
            window = launch_window_on_vehicle_clock(vehicle_status, self.earliest_launch_s(), now_s)
            window = window and stamp_and_mark_launch_sent(self.store.database, row, window)
            if window is None:
                return None
        return _command_of_row(row, state, window)


def _command_of_row(row: CommandRow, state: State, window: LaunchWindow | None) -> Command:
    """Return the command, based on this state; a launch on the state of its validity."""
    action, instance_id, as_of_s = row.command, state.instance_id, state.uptime_s
    if isinstance(action, Launch) and window is not None:
        action = msgspec.structs.replace(action, window=window)
        instance_id, as_of_s = window.instance_id, window.not_before_s
    return Command(
        id=row.id,
        vehicle=row.vehicle,
        instance_id=instance_id,
        as_of_s=as_of_s,
        by=row.issuer,
        action=action,
    )


def _decision_trigger_fields(state: State) -> tuple[object, ...]:
    """Return the fields of a state that may require an immediate decision."""
    return (state.instance_id, state.phase, state.assignment, state.home, state.stop, state.armed)
