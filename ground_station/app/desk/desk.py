"""The running desk: receives the fleet's messages, runs its dispatcher, sends commands."""

import secrets
from dataclasses import dataclass, field

import msgspec

from companion.core.base.desk_heartbeat import HEARTBEAT_INTERVAL_S, DeskHeartbeat
from companion.core.base.errors import LeewayError
from companion.core.pilot.transitions import Phase
from companion.fleet.messages import CommandStatus, State
from companion.fleet.trust import MemberTrust
from ground_station.adapters.store.launch_store import (
    has_reported_flight,
    launches_that_may_start,
)
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.shift.days import day_and_spares, has_new_spare
from ground_station.app.desk.command_authority import CommandAuthority
from ground_station.app.desk.dispatcher import CycleResult, Dispatcher
from ground_station.app.desk.energy_use import EnergyUse
from ground_station.app.desk.exchange import FleetExchange
from ground_station.app.desk.restore_evidence import RestoreEvidence
from ground_station.app.desk.site.site_monitor import SiteMonitor
from ground_station.app.desk.site.wind_publisher import WindPublisher
from ground_station.core.fleet.fleet_status import FLIGHT_PHASE_NAMES, VehicleStatus
from ground_station.core.fleet.launch_evidence import is_launch_over, window_of
from ground_station.core.schema.order_states import CLOSED
from ground_station.core.schema.orders import (
    IN_FORCE,
    AssignmentRow,
    AssignmentState,
    OrderRow,
)

MAX_CYCLE_INTERVAL_S = 0.5
"""Maximum interval of cycles without new messages; limits the load by states of a large fleet."""


@dataclass(slots=True)
class Desk:
    """Desk of one dispatcher over a fleet. `wind`: monitor of the site; None: the wind is not
    monitored, and vehicles receive no wind reports. `authority`: None in a fleet without a roster.

    `members`: drones of the day. `last_progress_s`: time of the last progress. `has_new_spare`: a
    drone has joined the day: open the desk again, with its data.
    """

    exchange: FleetExchange
    dispatcher: Dispatcher
    wind: SiteMonitor | None = None
    authority: CommandAuthority | None = None
    members: frozenset[str] = frozenset()
    wind_publisher: WindPublisher | None = field(init=False, default=None)
    last_progress_s: float = field(init=False)
    has_new_spare: bool = False
    _energy: EnergyUse = field(default_factory=EnergyUse)
    _epoch: str = field(init=False)
    _day_and_spares: tuple[str, dict[str, str]] = field(init=False)
    _evidence: RestoreEvidence = field(init=False)
    _last_cycle_s: float | None = None
    _next_cycle_s: float = 0.0
    _next_heartbeat_s: float = 0.0
    _instance_id: str = field(default_factory=lambda: secrets.token_hex(6))
    _start_s: float = field(init=False)

    def __post_init__(self) -> None:
        self.last_progress_s = self._start_s = self.exchange.clock.monotonic_s()
        self.exchange.on_state = self._on_state
        self.exchange.earliest_launch_s = lambda: self.dispatcher.earliest_launch_s
        self._epoch = self.store.epoch()
        self._day_and_spares = day_and_spares(self.store.database)
        self._evidence = RestoreEvidence(
            self.store, self.members, self.exchange.log, self.exchange.clock.epoch_us
        )
        if self.wind is not None:
            self.exchange.on_station = self.wind.on_station_report
            self.wind_publisher = WindPublisher(self.wind.wind, self.exchange.fleet)

    def check_authority_by(self, trust: MemberTrust | None) -> None:
        """Check authors and rosters by this identity; None: a fleet without a roster."""
        self.exchange.status.trust = trust
        if trust is not None:
            self.authority = CommandAuthority(
                trust, self.store, self.exchange.log, self.exchange.clock.epoch_us
            )

    def _on_state(self, state: State) -> None:
        if self.wind is not None:
            self.wind.on_state(state)
        self.dispatcher.on_state(state)
        self._energy.record_state(state)

    @property
    def store(self) -> Store:
        """The database with all data that must survive a restart."""
        return self.exchange.store

    def start_dispatching(self) -> None:
        """Request the state of the fleet and start dispatching."""
        self.last_progress_s = self.exchange.clock.monotonic_s()
        self._evidence.start()
        self.dispatcher.prepare_first_cycle()
        self.exchange.request_initial_states()

    def run_cycle(self, wait_s: float) -> None:
        """Receive messages, then run one decision cycle if it is due."""
        exchange = self.exchange
        exchange.receive_and_process_messages(wait_s)
        now_s = exchange.clock.monotonic_s()
        self._publish_heartbeat_if_due(now_s)
        if self.wind_publisher is not None:
            self.wind_publisher.send_due_wind_reports(exchange.status, now_s)
        changed = exchange.changed
        if now_s < self._next_cycle_s:
            return
        if (
            not changed
            and self._last_cycle_s is not None
            and now_s - self._last_cycle_s < MAX_CYCLE_INTERVAL_S
        ):
            return
        if changed:
            self.last_progress_s = now_s
        exchange.changed, self._last_cycle_s = False, now_s
        if not self._run_decision_cycle(now_s, changed):
            exchange.changed = True  # not idle: the desk waits for the store
            self.last_progress_s = now_s
        ended_s = exchange.clock.monotonic_s()
        self._next_cycle_s = ended_s + (ended_s - now_s)  # at least half of the time receives

    def _publish_heartbeat_if_due(self, now_s: float) -> None:
        """Publish that this desk runs; a desk that is killed or stuck falls silent."""
        if now_s < self._next_heartbeat_s:
            return
        trust = self.exchange.status.trust
        self._next_heartbeat_s = now_s + HEARTBEAT_INTERVAL_S
        heartbeat = DeskHeartbeat(
            desk="desk" if trust is None else trust.name,
            instance_id=self._instance_id,
            uptime_s=now_s - self._start_s,
            epoch_us=self.exchange.clock.epoch_us(),
            roster=msgspec.UNSET if trust is None else trust.roster_stamp,
        )
        self.exchange.fleet.publish(heartbeat)

    def _run_decision_cycle(self, now_s: float, has_new_messages: bool) -> bool:
        """Run one decision cycle; False if the store is unreachable."""
        with self.exchange.suppress_and_record_store_outage():
            if self.exchange.store_error is not None:  # reads may succeed while writes fail
                self.store.database.probe_write_after_failure()
            self._execute_decisions(now_s, has_new_messages)
            self.exchange.clear_store_outage()
            return True
        return False

    def _execute_decisions(self, now_s: float, has_new_messages: bool) -> None:
        """Execute due decisions; each is stored before it is sent, or not executed."""
        exchange = self.exchange
        if self.authority is not None:
            self.authority.exchange_roster_with_store()
            self.authority.refuse_unauthorised_launches()
        if self.store.epoch() != self._epoch:  # what this desk knows is of another store
            raise LeewayError("the store was restored while this desk ran: start the desk again")
        self.has_new_spare = has_new_spare(self.store.database, self._day_and_spares)
        if self._evidence.update(exchange):
            has_new_messages = exchange.changed = True
        if self.wind is not None and self.wind.update_and_report_hold_change(
            exchange.status
        ):  # holds precede launches
            has_new_messages = exchange.changed = True
        in_force = self.store.assignments(in_force=True)
        for row in in_force:
            self._process_assignment_in_force(row)
        self._energy.store_finished(self.store.database, exchange.clock, in_force)
        match self.dispatcher.run_decision_cycle(
            exchange.status, has_new_messages=has_new_messages
        ):
            case CycleResult.ACTIVE:
                self.last_progress_s = now_s
            case CycleResult.CHANGED:
                exchange.changed = True
            case CycleResult.IDLE:
                pass
        if self.authority is not None:
            self.authority.refuse_unauthorised_commands()
        exchange.send_due_commands()

    def close(self) -> None:
        """Stop the desk's worker processes; the caller closes store and network."""
        self.dispatcher.close()
        if self.wind is not None:
            self.wind.close()

    # --- assignments in force --------------------------------------------------------------------

    def _process_assignment_in_force(self, row: AssignmentRow) -> None:
        """Report a ready vehicle to the dispatcher; detect launches without a take-off."""
        vehicle_status = self.exchange.status.status_of(row.vehicle)
        state, now_s = vehicle_status.state, self.exchange.clock.monotonic_s()
        if state is None or not vehicle_status.is_uniquely_online_and_reporting(now_s):
            return
        self.last_progress_s = now_s  # the delivery is in progress
        ready = state.phase == Phase.READY.value and state.assignment == row.id and not state.armed
        if ready and self._end_launch_without_take_off(row, state):
            self.exchange.changed = True
        elif (
            row.state is AssignmentState.UPLOADED
            and state.assignment == row.id
            and state.phase in FLIGHT_PHASE_NAMES
        ):
            self._record_take_off(row, state)
        elif row.state is AssignmentState.UPLOADED and ready and not vehicle_status.doubts:
            self.dispatcher.on_vehicle_ready(row)
        elif row.state is AssignmentState.IN_FLIGHT and self._has_vehicle_dropped_assignment(
            vehicle_status, row
        ):
            self._log_inspection_request(row, "is not reported any more")

    def _log_inspection_request(self, row: AssignmentRow, cause: str) -> None:
        text = f"{cause}: inspect drone and parcel, then ground-station order settle {row.order_id}"
        self.exchange.log_once(f"{row.vehicle}: {row.id} {text}")

    def _record_take_off(self, row: AssignmentRow, state: State) -> None:
        """Record a take-off whose launch was sent before a hold cancelled its acknowledgement."""
        if self.store.record_unanswered_launch_as_executed(row.id, state.instance_id):
            self.exchange.log(f"{row.vehicle}: {row.id} took off before the launch hold")
            self.exchange.changed = True

    def _end_launch_without_take_off(self, row: AssignmentRow, state: State) -> bool:
        """End launches of which a ready vehicle's state shows that they started no flight; whether
        there was one.
        """
        database = self.store.database
        launches = launches_that_may_start(database, row.id)
        windows = [window_of(launch) for launch in launches]
        if not all(
            window is not None and is_launch_over(state, row.id, window) for window in windows
        ):
            return False
        reason, expired = "its validity has passed: not started", CommandStatus.EXPIRED
        is_changed = False
        for launch in launches:
            if launch.instance_id is None:
                is_changed |= self.store.record_and_apply_response(
                    launch.id, expired, reason, state.instance_id
                )
        if row.state is not AssignmentState.IN_FLIGHT:
            return is_changed
        if has_reported_flight(database, row):
            self._log_inspection_request(row, "was flown: not launched again")
            return is_changed
        return self.store.revert_launch_to_uploaded(row.id, "its launch ended before take-off")

    def _has_vehicle_dropped_assignment(
        self, vehicle_status: VehicleStatus, row: AssignmentRow
    ) -> bool:
        """Whether a vehicle reports another assignment, and all its events are in the store."""
        state = vehicle_status.state
        if state is None:
            return False
        # Evaluated first: the call also updates the exchange's record of that log.
        has_all_events = self.exchange.has_all_events_up_to(state)
        return state.assignment != row.id and has_all_events

    # --- the end of the day ----------------------------------------------------------------------

    @property
    def is_done(self) -> bool:
        """Whether no order is open or in progress that this desk can complete."""
        with self.exchange.suppress_and_record_store_outage():
            return not self.store.outbox() and self.dispatcher.is_done
        return False

    def has_been_idle_longer_than(self, idle_s: float) -> bool:
        """Whether the day has made no progress for this time."""
        return self.exchange.clock.monotonic_s() - self.last_progress_s > idle_s

    def undelivered_orders(self) -> list[OrderRow]:
        """Return the orders that are not closed."""
        return [row for row in self.store.orders() if row.state not in CLOSED]

    def undelivered_reason(self, row: OrderRow) -> str:
        """Return the reason why an order is not delivered, as far as it is recorded."""
        if row.reason:
            return row.reason
        for assignment in self.store.assignments(in_force=True):
            if assignment.order_id == row.order.id and assignment.state in IN_FORCE:
                return f"{assignment.state.value} with {assignment.vehicle}"
        return self.dispatcher.undelivered_reason(row.order.id) or "no drone was available"
