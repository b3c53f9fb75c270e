"""Dispatch of a day with a truck: drones ride on it, start from its stops and return to it.

Each cycle takes a snapshot of the day, applies `DispatchRules`, and executes the actions as
transactions. Plan, promises and the truck's orders are in the store; no state here must survive.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from companion.fleet.messages import State
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.active_plan import ActivePlan
from ground_station.app.desk.day_tracker import DayTracker
from ground_station.app.desk.dispatcher import CycleResult
from ground_station.app.desk.idle_reasons import ReasonLog
from ground_station.app.desk.site.forecast_watch import ForecastMonitor
from ground_station.core.dispatch.day_snapshot import DaySnapshot
from ground_station.core.dispatch.dispatch_actions import (
    AuthoriseLaunch,
    CancelHomeChange,
    ConfirmHomeChange,
    DeclareOffSite,
    DeclareOverdue,
    DeployDrone,
    DispatchAction,
    DriveToStop,
    RecoverDrone,
    RequestHomeChange,
    SendMission,
    ServeOrder,
    WithdrawAssignment,
)
from ground_station.core.dispatch.dispatch_rules import DispatchRules
from ground_station.core.dispatch.flight_tables import (
    NeighbourKeys,
    no_neighbour_keys,
    sortie_flight_table,
    with_neighbour_keys,
)
from ground_station.core.dispatch.replanning import candidate_landing_pads_by_stop
from ground_station.core.feasibility.reach import DayFeasibility
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.planning.airspace import Airspace
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.orders import AssignmentRow
from ground_station.core.site_wind.site_wind import SiteWind

CHARGE_ERROR_FRAC = 0.05
"""Error of a charge read from the resting voltage; the companion checks it before the flight."""


@dataclass(slots=True)
class TruckDispatcher:
    """`Dispatcher` for a day with a truck. `wind`: wind field measured by the fleet; None: the
    forecast applies. `forecast`: monitor of the followed forecast. `departure_blockers`: reasons
    that keep the truck at its stop.
    """

    store: Store
    day: DayStore
    active: ActivePlan
    clock: Clock
    log: Callable[[str], None]
    issuer: str = "desk"
    wind: SiteWind | None = None
    forecast: ForecastMonitor | None = None
    neighbour_keys: NeighbourKeys = no_neighbour_keys
    departure_blockers: list[str] = field(default_factory=list)
    _tracker: DayTracker = field(init=False)
    _late_orders: ReasonLog = field(init=False)
    _cached_version: int | None = None
    _airspace: Airspace | None = None
    _feasibility: DayFeasibility | None = None

    def __post_init__(self) -> None:
        self._late_orders = ReasonLog.of_late_orders(self.store, self.log)
        self._tracker = DayTracker(
            self.store, self.day, self.active, self.clock, self.wind, self.forecast
        )

    @property
    def snapshot(self) -> DaySnapshot | None:
        """The last snapshot of the day."""
        return self._tracker.snapshot

    def prepare_first_cycle(self) -> None:
        """Do nothing: all data is in the store."""

    def on_state(self, state: State) -> None:
        """Process a state that a drone or the truck has published."""
        self._tracker.record_state(state)

    def on_vehicle_ready(self, assignment: AssignmentRow) -> None:
        """Do nothing: `run_decision_cycle` launches by the plan."""

    @property
    def earliest_launch_s(self) -> float:
        """No gap: the plan separates launches."""
        return -math.inf

    def run_decision_cycle(self, status: FleetStatus, *, has_new_messages: bool) -> CycleResult:
        """Run one cycle: execute all actions that are due."""
        tracker = self._tracker
        if has_new_messages:
            tracker.discard_store_rows()
        tracker.discard_expired_store_rows()
        snapshot = tracker.update_snapshot(status)
        truck = snapshot.truck
        self._late_orders.publish(snapshot.late_texts(self.active.data.orders))
        if truck is None:
            return CycleResult.IDLE
        self.active.request_or_adopt_plan(
            snapshot, tracker.planning_forecast, tracker.followed_forecast_in_day_time
        )
        self._discard_values_of_earlier_plan()
        if self.active.is_replanning and not snapshot.replanning:
            # The request was made in this cycle: the truck waits from now on.
            snapshot = tracker.snapshot = replace(snapshot, replanning=True)
        rules = DispatchRules(
            self.active.params, self._launch_conflict, self._has_sufficient_charge
        )
        actions = rules.due_actions(snapshot)
        for action in actions:
            if message := self._store_action_and_format_result(action):
                self.log(message)
        if actions:
            tracker.discard_store_rows()
        self.departure_blockers = rules.departure_blockers(snapshot)
        truck_is_waiting = truck.present and (
            snapshot.current_stop is None or bool(self.departure_blockers)
        )
        is_active = bool(actions) or snapshot.replanning or truck_is_waiting
        return CycleResult.ACTIVE if is_active else CycleResult.IDLE

    def _discard_values_of_earlier_plan(self) -> None:
        """Discard values that were computed for an earlier plan."""
        if self._cached_version != self.active.version:
            self._cached_version, self._airspace = self.active.version, None
            self._feasibility = None
            self._tracker.discard_store_rows()

    def _store_action_and_format_result(self, action: DispatchAction) -> str | None:
        day, by = self.day, self.issuer
        match action:
            case DeployDrone():
                return self._assign_sortie_and_format_result(action.sortie)
            case SendMission():
                done = day.release_mission(action.assignment)
                return f"{action.assignment}: drone on its pad, mission released" if done else None
            case AuthoriseLaunch():
                done = self.store.launch(action.assignment, by)
                return f"{action.assignment}: launch ordered" if done else None
            case WithdrawAssignment():
                done = day.withdraw(action.assignment, by, action.reason)
                return f"{action.assignment}: withdrawn: {action.reason}" if done else None
            case RecoverDrone():
                done = day.order_recovery(action.assignment, action.pad, by)
                return f"{action.assignment}: recovery ordered" if done else None
            case RequestHomeChange():
                id_, stop = action.assignment, action.stop
                done = day.request_home(id_, stop, by)
                return f"{id_}: landing at {stop} requested: {action.reason}" if done else None
            case ConfirmHomeChange():
                done = day.confirm_home(action.assignment, action.stop)
                return f"{action.assignment}: landing at {action.stop} confirmed" if done else None
            case CancelHomeChange():
                done = day.cancel_home_request(action.assignment, action.stop)
                return f"{action.assignment}: landed, but not at {action.stop}" if done else None
            case DeclareOverdue():
                day.mark_sortie_lapsed_and_void_commands(action.assignment)
                return f"{action.assignment}: overdue, no contact: search at its last position"
            case DeclareOffSite():
                day.update_sortie_columns(action.assignment, away=True)
                return f"{action.assignment}: landed away from all of the truck's stops: collect it"
            case ServeOrder():
                id_ = self.day.order_delivery(action.order, by)
                return f"truck: delivery of {action.order} ordered ({id_})" if id_ else None
            case DriveToStop():
                done = day.order_drive(action.from_stop, action.stop, by)
                return f"truck: sent from {action.from_stop} to {action.stop.id}" if done else None

    def _assign_sortie_and_format_result(self, sortie: PlannedSortie) -> str | None:
        data = self.active.data
        order = next((o for o in data.orders if o.id == sortie.order), None)
        drone = data.day.find_drone(sortie.vehicle)
        if order is None or drone is None:
            return None
        pads = candidate_landing_pads_by_stop(self.active.plan, sortie, self.active.all_stops)
        table = sortie_flight_table(data.day, drone, order, sortie, pads, data.elevation)
        table = with_neighbour_keys(table, self.neighbour_keys)
        id_ = self.day.assign(
            sortie, pads, lambda assignment: table | {"name": assignment}, data.no_fly, self.issuer
        )
        return f"{drone.id}: assigned {order.id} ({id_}), lands at {sortie.home}" if id_ else None

    def _launch_conflict(
        self, sortie: PlannedSortie, airborne_sorties: Sequence[PlannedSortie]
    ) -> str | None:
        if self._airspace is None:
            self._airspace = Airspace(self.active.data)
        try:
            return self._airspace.launch_conflict(sortie, airborne_sorties, self.active.all_stops)
        except KeyError as pad_name:  # a pad of no plan: separation cannot be checked
            return f"unknown pad {pad_name}"

    def _has_sufficient_charge(self, sortie: PlannedSortie, charge_frac: float) -> bool:
        data = self.active.data
        drone = data.day.find_drone(sortie.vehicle)
        assert drone is not None
        if self._feasibility is None:
            self._feasibility = DayFeasibility(data.day, data.airframes)
        feasibility = self._feasibility.of_drone(drone)
        order = next((o for o in data.orders if o.id == sortie.order), None)
        if order is None:
            return False
        read_frac = min(1.0, charge_frac + CHARGE_ERROR_FRAC)
        return (
            feasibility.usable_above_reserve_wh_and_std(order.mass_kg, read_frac)[0]
            >= sortie.required_wh
        )

    @property
    def is_done(self) -> bool:
        """Whether the truck is at its last stop and the plan is complete."""
        snapshot = self.snapshot
        if (
            snapshot is None
            or snapshot.current_stop is None
            or snapshot.replanning
            or self.departure_blockers
        ):
            return False
        if self._tracker.read_open_order_ids() != snapshot.open_orders:  # new orders have come
            return False
        is_at_last_stop = snapshot.plan.stops[-1].id == snapshot.current_stop.id
        is_active = any(
            not (row.is_drone_on_truck or row.is_drone_lost_off_site_or_overdue)
            for row in snapshot.sorties
        )
        return is_at_last_stop and not is_active and not self.active.has_replan_reason(snapshot)

    def undelivered_reason(self, order_id: str) -> str | None:
        """Return the plan's reason for an order that is not planned."""
        for line in self.active.plan.unplanned:
            if line.order == order_id:
                return f"{line.reason}; possible with {line.remedy}"
        return None

    def close(self) -> None:
        """Cancel the plan that is being computed."""
        self.active.close()
