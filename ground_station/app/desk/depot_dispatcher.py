"""Dispatch from the depot, without a truck: the nearest order that a free drone can deliver."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.fleet.messages import State
from ground_station.adapters.store.launch_store import count_refused_launches
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.tables import CONFIRM_KEY
from ground_station.app.desk.dispatcher import CycleResult
from ground_station.app.desk.idle_reasons import IdleReasons, ReasonLog
from ground_station.app.desk.launch_pacing import LaunchPacing
from ground_station.app.desk.site.forecast_watch import ForecastMonitor
from ground_station.core.dispatch.depot_assignment import DepotAssigner, FreeDrone
from ground_station.core.dispatch.flight_tables import (
    NeighbourKeys,
    no_neighbour_keys,
    with_neighbour_keys,
)
from ground_station.core.dispatch.measured_wind import (
    LAUNCH_LEAD_S,
    measured_or_previous_launch_forecast,
    winds_differ_enough_to_replan,
)
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.holds import hold_of_vehicle_or_of_all
from ground_station.core.schema.orders import AssignmentRow, AssignmentState, OrderState, Service
from ground_station.core.site_wind.site_wind import SiteWind

WIND_CHECK_INTERVAL_S = 30.0
"""Interval of wind checks: each change of the planning wind recomputes all order costs."""

WINDOW_CHECK_INTERVAL_S = 1.0

MAX_REFUSED_LAUNCHES = 3
"""Refused launches after which an assignment is withdrawn for inspection by the operator."""


@dataclass(frozen=True, slots=True)
class DepotParams:
    """Operating mode. `assigns_orders`, `orders_launches` False: the operator assigns or launches.

    `launch_gap_s`: minimum time from a take-off to the next launch, by any desk.
    `requires_confirmation`: each launch requires confirmation by a named person.
    """

    issuer: str = "desk"
    assigns_orders: bool = True
    orders_launches: bool = True
    launch_gap_s: float = 20.0
    requires_confirmation: bool = False


@dataclass(slots=True)
class DepotDispatcher:
    """`Dispatcher` for drones that start at the depot and return to it. No drop is before the
    order's window.

    `wind`: wind field measured by the fleet; None: the day's forecast applies. `forecast`: monitor
    of the followed forecast. `infeasible_orders`: orders that no drone of the day can deliver; they
    do not keep the day open.
    """

    store: Store
    data: DayData
    assigner: DepotAssigner
    clock: Clock
    log: Callable[[str], None]
    params: DepotParams = field(default_factory=DepotParams)
    infeasible_orders: frozenset[str] = frozenset()
    wind: SiteWind | None = None
    forecast: ForecastMonitor | None = None
    neighbour_keys: NeighbourKeys = no_neighbour_keys
    _planning_wind: Forecast | None = None
    _wind_checked_s: float = -math.inf
    _pacing: LaunchPacing = field(init=False)
    _confirmation_requested: set[str] = field(default_factory=set)
    _layers_are_full: bool = False
    _idle_reasons: IdleReasons = field(init=False)
    _late_orders: ReasonLog = field(init=False)
    _next_window_check_s: float = -math.inf
    _has_later_windows: bool = False

    def __post_init__(self) -> None:
        gap_s = self.params.launch_gap_s
        self._pacing = LaunchPacing(self.store, self.clock, self.log, gap_s)
        self._idle_reasons = IdleReasons(
            self.store, self.data, self.assigner, self.log, self.clock.epoch_us
        )
        self._late_orders = ReasonLog.of_late_orders(self.store, self.log)

    def prepare_first_cycle(self) -> None:
        """Keep the gap between a launch just before a restart and the next one."""
        self._pacing.start_gap_after_restart()

    def on_state(self, state: State) -> None:
        """Count a take-off; `run_decision_cycle` reads all other data from the fleet's status."""
        self._pacing.start_gap_at_take_off(state)

    def on_vehicle_ready(self, assignment: AssignmentRow) -> None:
        """Launch the assignment in its slot; withdraw it after too many refusals."""
        id_, vehicle, params = assignment.id, assignment.vehicle, self.params
        if count_refused_launches(self.store.database, id_) >= MAX_REFUSED_LAUNCHES:
            if self.store.withdraw_assignment(id_, params.issuer):
                text = f"launch refused {MAX_REFUSED_LAUNCHES} times: {id_} withdrawn"
                self.log(f"{vehicle}: {text}: inspect {vehicle}")
            return
        if not params.orders_launches:
            return
        (row,) = self.store.orders_by_id([assignment.order_id])
        if self.assigner.is_before_window(row.order, self.clock.epoch_us()):
            return
        if params.requires_confirmation and assignment.confirmed_by is None:
            self._log_confirmation_request_once(assignment)
            return
        if id_ in self._confirmation_requested:  # a hold voids it: it is requested again
            self._confirmation_requested.discard(id_)
            self._store_confirmation_requests()
        if not self._pacing.can_order_next_launch():
            return
        after = self._pacing.newest_launch
        if self.store.launch(
            id_,
            params.issuer,
            newest_known_launch=after,
            requires_confirmation=params.requires_confirmation,
        ):
            self._pacing.record_newest_launch()
            confirmation = (
                f", confirmed by {assignment.confirmed_by}" if params.requires_confirmation else ""
            )
            self.log(f"{vehicle}: launch of {id_} ordered{confirmation}")

    def _log_confirmation_request_once(self, assignment: AssignmentRow) -> None:
        """Log once for each launch which command confirms it."""
        if assignment.id not in self._confirmation_requested:
            self._confirmation_requested.add(assignment.id)
            self._store_confirmation_requests()
            order = assignment.order_id
            self.log(
                f"{assignment.vehicle}: ready: `ground-station order launch {order}` confirms the"
                " launch"
            )

    @property
    def earliest_launch_s(self) -> float:
        """End of the launch gap."""
        return self._pacing.earliest_launch_s

    def _store_confirmation_requests(self) -> None:
        """Store the requests for the map."""
        requests = sorted(self._confirmation_requested)
        self.store.database.replace_about_value(CONFIRM_KEY, requests)

    def run_decision_cycle(self, status: FleetStatus, *, has_new_messages: bool) -> CycleResult:
        """Assign open orders to free drones. `has_new_messages`: since the last cycle."""
        del has_new_messages
        self._pacing.store_fleet_status(status)
        withdrawn = self._withdraw_forecast_closed_assignments()
        if not self.params.assigns_orders:
            return CycleResult.CHANGED if withdrawn else CycleResult.IDLE
        free = self._idle_drones_at_depot(status)
        if free:
            self._update_planning_wind_if_due()
        has_changed = bool(free) and self._assign_orders(free)
        self._idle_reasons.update_if_due(status, self.clock.monotonic_s())
        self._check_windows_if_due()
        if has_changed or withdrawn:
            return CycleResult.CHANGED
        if self._has_later_windows:
            return CycleResult.ACTIVE
        has_later_launches = self.forecast is not None and self.forecast.has_reopening_orders()
        return CycleResult.ACTIVE if has_later_launches else CycleResult.IDLE

    def _check_windows_if_due(self) -> None:
        """Report orders on the ground that cannot keep their window."""
        now_s, now_us = self.clock.monotonic_s(), self.clock.epoch_us()
        if now_s < self._next_window_check_s:
            return
        self._next_window_check_s = now_s + WINDOW_CHECK_INTERVAL_S
        orders = [row.order for row in self.store.orders(OrderState.OPEN)]
        late = {order.id: self.assigner.late_text(order, now_us) for order in orders}
        on_ground = [
            row.order_id
            for row in self.store.assignments(in_force=True)
            if row.state is AssignmentState.UPLOADED
        ]
        for row in self.store.orders_by_id(on_ground):
            late[row.order.id] = self.assigner.late_text(row.order, now_us, is_loaded=True)
        self._late_orders.publish({id_: text for id_, text in late.items() if text})
        self._has_later_windows = any((order.earliest_us or 0) > now_us for order in orders)

    def _withdraw_forecast_closed_assignments(self) -> bool:
        """Withdraw assignments whose launch the forecast has closed for a long time."""
        if self.forecast is None:
            return False
        has_changed = False
        for id_, reason in self.forecast.reason_by_withdrawable_assignment(
            self.store.holds_in_force()
        ).items():
            if self.params.orders_launches and self.store.withdraw_assignment(
                id_, self.params.issuer
            ):
                self.log(f"{id_}: withdrawn: {reason}")
                has_changed = True
        return has_changed

    def _update_planning_wind_if_due(self) -> None:
        """Compute order costs in the wind that the fleet measures, if it has changed."""
        now_s, before = self.clock.monotonic_s(), self._planning_wind or self.data.day.forecast
        if now_s - self._wind_checked_s < WIND_CHECK_INTERVAL_S:
            return
        self._wind_checked_s = now_s
        expected = self.data.day.forecast
        if self.forecast is not None:
            expected = self.forecast.expected_wind(LAUNCH_LEAD_S)
        wind = measured_or_previous_launch_forecast(self.wind, now_s, expected)
        if winds_differ_enough_to_replan(wind, before):
            self._planning_wind = wind
            self.assigner.set_wind_and_clear_caches(wind)
            wind_text = f"{wind.speed_mps:.1f} +- {wind.std_mps:.1f} m/s from {wind.from_deg:.0f}"
            self.log(f"orders are planned in wind {wind_text}")

    def _idle_drones_at_depot(self, status: FleetStatus) -> list[FreeDrone]:
        """Return idle drones at the depot; the operator collects drones that are elsewhere."""
        assigned_vehicles = {row.vehicle for row in self.store.assignments(in_force=True)}
        hold_list, now_s = self.store.holds_in_force(), self.clock.monotonic_s()
        free_drones: list[FreeDrone] = []
        for vehicle_status in sorted(
            status.vehicles.values(), key=lambda vehicle_status: vehicle_status.vehicle
        ):
            vehicle, state = vehicle_status.vehicle, vehicle_status.state
            if (
                not vehicle_status.can_take_assignment(now_s)
                or vehicle in assigned_vehicles
                or hold_of_vehicle_or_of_all(hold_list, vehicle)
            ):
                continue
            depot_position = state and self.assigner.position_if_at_depot(
                state.lat_deg, state.lon_deg
            )
            if depot_position is not None:
                charge_frac = status.charge_frac_at_rest(vehicle)
                free_drones.append(FreeDrone(vehicle, charge_frac, depot_position))
        return free_drones

    def _assign_orders(self, free_drones: list[FreeDrone]) -> bool:
        has_changed, rows = False, self.store.assignments()
        is_full = self.assigner.are_all_depot_layers_occupied(rows)
        if is_full and not self._layers_are_full:
            self.log("all altitude layers over the depot are in use: drones wait")
        self._layers_are_full = is_full
        if self._layers_are_full:  # skip reading the orders: there may be thousands
            return False
        waiting, priority_orders = self.store.orders(OrderState.OPEN), list[str]()
        if self.forecast is not None:
            closed_orders = self.forecast.closed_order_ids()
            priority_orders = self.forecast.priority_order_ids()
            waiting = [row for row in waiting if row.order.id not in closed_orders]
        assignments = self.assigner.assign_orders_to_free_drones(
            waiting, rows, free_drones, priority_orders, self.clock.epoch_us()
        )
        for choice in assignments:
            order, vehicle, layer = choice.order.id, choice.vehicle, choice.layer
            flight = self.assigner.flight_table(
                choice.order, vehicle, layer, choice.launch_position
            )
            flight = with_neighbour_keys(flight, self.neighbour_keys)
            no_fly, by = self.data.no_fly, self.params.issuer
            id_ = self.store.assign_order(order, vehicle, flight, no_fly, by, layer)
            if id_ is not None:
                has_changed = True
                height_m = self.assigner.layers.mission_in_layer(layer).cruise_height_m
                height_text = f"{height_m:.0f} m above the depot"
                self.log(f"{vehicle}: assigned {order} ({id_}), outbound at {height_text}")
        return has_changed

    @property
    def is_done(self) -> bool:
        """Whether every order is settled, assigned to the truck, or impossible for the drones."""
        assigned, open_rows = (self.store.orders(s) for s in (OrderState.ASSIGNED, OrderState.OPEN))
        feasible_rows = [row for row in open_rows if row.order.id not in self.infeasible_orders]
        return all(row.order.service is Service.TRUCK for row in (*assigned, *feasible_rows))

    def undelivered_reason(self, order_id: str) -> str | None:
        """Return the forecast's reason for an undelivered order; None: the forecast closes none."""
        return None if self.forecast is None else self.forecast.closure_reason(order_id)

    def close(self) -> None:
        """Do nothing: this dispatcher starts no other process."""
