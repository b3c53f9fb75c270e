"""Day tracking with a truck: combines members' states and the store's rows in a `DaySnapshot`."""

import math
from dataclasses import dataclass, field, replace

from companion.core.pilot.transitions import Phase
from companion.fleet.messages import State
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.active_plan import ActivePlan
from ground_station.app.desk.site.forecast_watch import ForecastMonitor, closing_wind_by_order
from ground_station.core.dispatch.day_snapshot import DaySnapshot, DroneStatus, TruckStatus
from ground_station.core.dispatch.dispatch_rules import ground_distance_if_known_m
from ground_station.core.dispatch.measured_wind import (
    DAY_LEAD_S,
    measured_or_previous_planning_forecast,
    wind_deviation_sigmas,
)
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import STANDBY, FleetStatus, VehicleStatus
from ground_station.core.fleet.truck_state import EN_ROUTE, TRUCK
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.holds import Hold, hold_of_vehicle_or_of_all
from ground_station.core.schema.orders import AssignmentRow, AssignmentState, OrderRow, OrderState
from ground_station.core.schema.sortie_rows import SortieRow, StopTimes
from ground_station.core.site_wind.site_wind import SiteWind

AWAY_FROM_PAD_M = 30.0
AIRBORNE_HEIGHT_M = 2.0

FORECAST_CHECK_INTERVAL_S = 60.0
"""Interval of checks of the pending plan against the forecast."""

ROWS_MAX_AGE_S = 5.0
"""Maximum age of rows of the store; they are read again even if no message has arrived."""


@dataclass(frozen=True, slots=True)
class _StoreRows:
    """Rows of the store, read at `read_s`."""

    read_s: float
    open_orders: frozenset[str]
    sorties: tuple[SortieRow, ...]
    truck_assignments: tuple[AssignmentRow, ...]
    ordered_stop: str | None
    stop_times: dict[str, StopTimes]
    plan_stored_us: int
    hold_list: tuple[Hold, ...]


@dataclass(slots=True)
class DayTracker:
    """Keeps data that only members report: take-offs, waiting times on the pad. `wind`:
    wind field measured by the fleet. `forecast`: monitor of the followed forecast.
    """

    store: Store
    day: DayStore
    active: ActivePlan
    clock: Clock
    wind: SiteWind | None = None
    forecast: ForecastMonitor | None = None
    snapshot: DaySnapshot | None = None
    _airborne: set[str] = field(default_factory=set)
    _truck_stop: tuple[str, bool] | None = None
    _wait_start_s: dict[str, float] = field(default_factory=dict)
    _start_us: int | None = None
    _rows: _StoreRows | None = None
    _desk_start_us: int = 0
    _plan_stored_us: int = 0
    _closing_checked_s: float = -math.inf
    _closing_text: str = ""
    _previously_closed: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        self._desk_start_us = self.clock.epoch_us()

    def discard_store_rows(self) -> None:
        """Read the store again for the next snapshot because its content may have changed."""
        self._rows = None

    def discard_expired_store_rows(self) -> None:
        """Read the store again when the rows are older than `ROWS_MAX_AGE_S`: other programs write
        too.
        """
        rows = self._rows
        if rows is not None and self.clock.monotonic_s() - rows.read_s > ROWS_MAX_AGE_S:
            self._rows = None

    def record_state(self, state: State) -> None:
        """Process a state that a member has published."""
        if state.vehicle == TRUCK:
            self._record_truck_arrival_or_departure(state)
            return
        is_up = (state.height_rel_m or 0.0) > AIRBORNE_HEIGHT_M
        if state.armed and state.assignment and is_up:
            self._airborne.add(state.assignment)

    def _record_truck_arrival_or_departure(self, state: State) -> None:
        """Record the truck's arrivals and departures in the store."""
        if state.stop is None:
            return
        now = (state.stop, state.phase == EN_ROUTE)
        if now != self._truck_stop:
            self.day.record_truck_stop(None if now[1] else state.stop)
            self._rows = None
            self._truck_stop = now

    def update_snapshot(self, status: FleetStatus) -> DaySnapshot:
        """Return the snapshot of the present moment."""
        now_s = self.clock.monotonic_s()
        truck = status.vehicles.get(TRUCK)
        start_us = self._start_or_read_day_us(
            truck is not None and truck.is_uniquely_online_and_reporting(now_s)
        )
        rows = self._rows = self._rows or self._read_store_rows(now_s)
        drones = {
            d.id: self._drone_status(
                status.status_of(d.id), status.charge_frac_at_rest(d.id), now_s
            )
            for d in self.active.data.day.drones
        }
        self.snapshot = DaySnapshot(
            now_s=max(0.0, (self.clock.epoch_us() - start_us) / 1e6),
            start_us=start_us,
            plan=self.active.plan,
            truck=_truck_status(truck, rows.ordered_stop, now_s),
            drones=drones,
            open_orders=rows.open_orders,
            sorties=rows.sorties,
            truck_assignments=rows.truck_assignments,
            changed_orders=self.active.changed_order_ids,
            opens_s={
                order.id: (order.earliest_us - start_us) / 1e6
                for order in self.active.data.orders
                if order.earliest_us is not None
            },
            stop_times=rows.stop_times,
            replanning=self.active.is_replanning,
            plan_created_s=max(0.0, (rows.plan_stored_us - start_us) / 1e6),
            last_replan_s=self.active.last_attempt.ended_s,
            last_replan_key=self.active.last_attempt.replan_key,
            pad_wait_s=self._update_pad_waiting_times_s(rows.sorties, drones, now_s),
            wind_deviation_sigmas=wind_deviation_sigmas(
                self.wind, now_s, self.active.data.day.forecast
            ),
            desk_start_s=(self._desk_start_us - start_us) / 1e6,
            drones_on_hold=frozenset(
                vehicle for vehicle in drones if hold_of_vehicle_or_of_all(rows.hold_list, vehicle)
            ),
            drones_out_of_service=frozenset(
                hold.scope for hold in rows.hold_list if hold.is_out_of_service
            ),
        )
        if self.forecast is not None:
            closed = self.forecast.reason_by_withdrawable_assignment(rows.hold_list)
            closing = self._forecast_closure_text(self.snapshot, self.forecast, now_s)
            self.snapshot = replace(
                self.snapshot, closed_assignments=closed, plan_closing_text=closing
            )
        return self.snapshot

    def _forecast_closure_text(
        self, snapshot: DaySnapshot, forecast: ForecastMonitor, now_s: float
    ) -> str:
        """Return the planned orders that the forecast closes in two consecutive checks, as text."""
        if now_s - self._closing_checked_s < FORECAST_CHECK_INTERVAL_S:
            return self._closing_text
        self._closing_checked_s = now_s
        delay_s = max(0.0, snapshot.truck_delay_s(), snapshot.departure_delay_for_landings_s())
        pending = [
            (s, now_s + max(0.0, s.launch_s + delay_s - snapshot.now_s))
            for s in snapshot.unassigned_sorties_by_launch_time()
        ]
        orders = {order.id: order for order in self.active.data.orders}
        found = closing_wind_by_order(forecast, pending, self.active.all_stops, orders)
        closed_twice = sorted(found.keys() & self._previously_closed)
        self._previously_closed = frozenset(found)
        self._closing_text = (
            f"the forecast closes {', '.join(closed_twice)}" if closed_twice else ""
        )
        return self._closing_text

    def _start_or_read_day_us(self, truck_is_present: bool) -> int:
        """Return the start of the day: the first message received from its truck."""
        if self._start_us is None:
            self._start_us = (
                self.day.start_day_once() if truck_is_present else self.day.day_start_us()
            )
        return self.clock.epoch_us() if self._start_us is None else self._start_us

    def _read_store_rows(self, now_s: float) -> _StoreRows:
        orders = self.store.orders()
        self.active.replace_orders_if_changed(orders)
        plan_stored_us = self.day.active_plan_stored_at_us()
        if plan_stored_us != self._plan_stored_us:
            self.active.adopt_later_plan(self.day.active_plan())
            self._plan_stored_us = plan_stored_us
        return _StoreRows(
            read_s=now_s,
            open_orders=_open_order_ids(orders),
            sorties=tuple(self.day.sorties()),
            truck_assignments=tuple(r for r in self.store.assignments() if r.vehicle == TRUCK),
            ordered_stop=self.day.last_ordered_truck_stop(),
            stop_times={times.stop: times for times in self.day.truck_stop_visits()},
            plan_stored_us=plan_stored_us,
            hold_list=tuple(self.store.holds_in_force()),
        )

    def _update_pad_waiting_times_s(
        self, sorties: tuple[SortieRow, ...], drones: dict[str, DroneStatus], now_s: float
    ) -> dict[str, float]:
        """By assignment: time that a drone on its pad has not been ready, since this desk began."""
        waiting = (AssignmentState.ORDERED, AssignmentState.UPLOADED)
        on_pads = [r for r in sorties if r.put_on_pad and r.assignment.state in waiting]
        waiting_ids = [r.id for r in on_pads if r.vehicle in drones and not drones[r.vehicle].ready]
        self._wait_start_s = {id_: self._wait_start_s.get(id_, now_s) for id_ in waiting_ids}
        return {id_: now_s - since_s for id_, since_s in self._wait_start_s.items()}

    def _drone_status(
        self, vehicle_status: VehicleStatus, charge_frac: float | None, now_s: float
    ) -> DroneStatus:
        state = vehicle_status.state
        if state is None:
            return DroneStatus(vehicle_status.vehicle)
        return DroneStatus(
            vehicle=vehicle_status.vehicle,
            present=vehicle_status.is_uniquely_online_and_reporting(now_s),
            doubtful=bool(vehicle_status.doubts),
            idle=state.phase == STANDBY and not state.armed,
            ready=state.phase == Phase.READY.value and not state.armed,
            off_ground=state.assignment in self._airborne or self._is_away_from_launch_pad(state),
            assignment=state.assignment,
            home=state.home,
            lat_deg=state.lat_deg,
            lon_deg=state.lon_deg,
            charge_frac=charge_frac,
            silent_s=vehicle_status.seconds_since_last_state(now_s),
        )

    def _is_away_from_launch_pad(self, state: State) -> bool:
        """Whether it is away from its launch pad; also determined after a restart of the desk."""
        rows = self.snapshot.sorties if self.snapshot is not None else ()
        row = next((row for row in rows if row.id == state.assignment), None)
        if row is None:
            return False
        away_m = ground_distance_if_known_m(
            state.lat_deg, state.lon_deg, row.pads[row.sortie.launch]
        )
        return away_m is not None and away_m > AWAY_FROM_PAD_M

    def read_open_order_ids(self) -> frozenset[str]:
        """Return the orders that have no assignment in the store."""
        return _open_order_ids(self.store.orders(OrderState.OPEN))

    def planning_forecast(self, fallback_forecast: Forecast) -> Forecast:
        """Return the forecast based on wind reports of drones in flight; if there are too few, the
        followed forecast or `fallback_forecast`.
        """
        if self.forecast is not None:
            fallback_forecast = self.forecast.expected_wind(DAY_LEAD_S)
        return measured_or_previous_planning_forecast(
            self.wind, self.clock.monotonic_s(), fallback_forecast
        )

    @property
    def followed_forecast_in_day_time(self) -> DayForecast | None:
        """The followed forecast in the day's time."""
        if self.forecast is None or self.snapshot is None:
            return None
        return self.forecast.tracker.forecast_in_day_time(self.snapshot.start_us)


def _open_order_ids(orders: list[OrderRow]) -> frozenset[str]:
    return frozenset(row.order.id for row in orders if row.state is OrderState.OPEN)


def _truck_status(
    vehicle_status: VehicleStatus | None, ordered_stop: str | None, now_s: float
) -> TruckStatus | None:
    state = vehicle_status.state if vehicle_status is not None else None
    if vehicle_status is None or state is None or state.stop is None:
        return None
    stop = ordered_stop or state.stop
    return TruckStatus(
        vehicle_status.is_uniquely_online_and_reporting(now_s),
        state.phase == EN_ROUTE or stop != state.stop,
        stop,
    )
