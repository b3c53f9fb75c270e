"""Recovery after a restore: the desk decides nothing until each member has reported what it did."""

from collections.abc import Callable
from dataclasses import dataclass, field

from companion.fleet.command_log import MAX_LAUNCH_VALIDITY_S
from companion.fleet.messages import State
from ground_station.adapters.store import restored
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.exchange import FleetExchange
from ground_station.core.fleet.fleet_status import FLIGHT_PHASE_NAMES
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.orders import AssignmentState


@dataclass(slots=True)
class RestoreEvidence:
    """Ends the hold of a restore member by member: those of the day (`members`), of the store and
    of the network.

    A member's evidence is complete when it is on the ground with an assignment that the store
    knows, or none, all its events are in the store, and no earlier launch can be in transit to it.
    """

    store: Store
    members: frozenset[str]
    log: Callable[[str], None]
    epoch_us: Callable[[], int]
    _first_states: dict[str, State] = field(default_factory=dict)
    _logged: dict[str, str] = field(default_factory=dict)

    def start(self) -> None:
        """Apply the outcomes in the store, and require the evidence of the day's members."""
        restored.apply_stored_outcomes(self.store.database, self.epoch_us)
        restored.require_evidence_of_members(self.store.database, self.members)

    def update(self, exchange: FleetExchange) -> bool:
        """Record new evidence; whether the restore is settled now."""
        database = self.store.database
        record = restored.open_restore(database)
        if record is None:
            return False
        waiting = record.missing
        reporting = {name for name, one in exchange.status.vehicles.items() if one.state}
        new = reporting - waiting.keys() - set(record.settled)
        if new:
            restored.require_evidence_of_members(database, new)
            return False
        missing = {name: self._missing_evidence(name, exchange) for name in waiting}
        for name, reason in missing.items():
            if self._logged.get(name) != reason:
                self._logged[name] = reason
                self.log(f"restored: {name} {reason}" if reason else f"restored: {name} settled")
        if {name: reason for name, reason in missing.items() if reason} == waiting and waiting:
            return False
        settled = [name for name, reason in missing.items() if not reason]
        if not restored.record_evidence(database, missing, settled):
            return False
        self._log_unsettled_orders(exchange)
        return True

    def _missing_evidence(self, name: str, exchange: FleetExchange) -> str:
        """Return what is missing of a member; empty: its evidence is complete."""
        status, now_s = exchange.status.status_of(name), exchange.clock.monotonic_s()
        state = status.state
        if state is None or not status.is_uniquely_online_and_reporting(now_s):
            return restored.NOT_REPORTED
        first = self._first_states.get(name)
        if first is None or first.instance_id != state.instance_id:
            self._first_states[name] = first = state
        if state.armed or state.phase in FLIGHT_PHASE_NAMES:
            return f"is in flight with {state.assignment}"
        if not exchange.has_all_events_up_to(state):
            return "has further events"
        if state.assignment is not None:
            rows = self.store.assignments(in_force=True)
            if all((row.id, row.vehicle) != (state.assignment, name) for row in rows):
                now_us = self.epoch_us()
                restored.withdraw_unknown_assignment(
                    self.store.database, now_us, state.assignment, name
                )
                return f"carries {state.assignment}, unknown here: it is withdrawn"
        wait_s = MAX_LAUNCH_VALIDITY_S - (state.uptime_s - first.uptime_s)
        if wait_s > 0.0:
            return "may receive an earlier launch"
        if name == TRUCK:
            restored.record_reported_truck_stop(self.store.database, self.epoch_us(), state)
        return ""

    def _log_unsettled_orders(self, exchange: FleetExchange) -> None:
        """Log the assignments that no member reports, with the command that settles each."""
        self.log("restored: the evidence of each member is in the store")
        for row in self.store.assignments(in_force=True):
            state = exchange.status.status_of(row.vehicle).state
            is_loaded = state is not None and state.assignment == row.id
            if not is_loaded and row.state is not AssignmentState.ORDERED:
                self.log(
                    f"restored: {row.id}: {row.vehicle} reports neither it nor its outcome: inspect"
                    f" drone and parcel, then ground-station order settle {row.order_id}"
                )
