"""Active plan of a day with a truck, the data it is based on, and its replacement."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.adapters.store.day_store import DayStore
from ground_station.app.desk.replanner import NoPlan, Replanner
from ground_station.core.dispatch.day_snapshot import DaySnapshot
from ground_station.core.dispatch.dispatch_rules import DispatchParams
from ground_station.core.dispatch.replanning import (
    ReplanReason,
    broken_promise_reason,
    data_with_returned_orders_by_truck,
    delay_plan_by_computation_time,
    replan_reason,
    replanning_start_state,
)
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import DayPlan, PlannedStop
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.order_changes import needs_new_plan
from ground_station.core.schema.orders import Order, OrderRow


@dataclass(frozen=True, slots=True)
class ReplanAttempt:
    """Most recent completed re-planning: time, day situation and reason.

    `refused`: it produced no new plan, so the same reason is not tried again. `failure_count`:
    number of consecutive planner runs that ended without a result.
    """

    ended_s: float | None = None
    replan_key: object = None
    reason: ReplanReason | None = None
    refused: bool = False
    failure_count: int = 0


@dataclass(frozen=True, slots=True)
class _Request:
    snapshot: DaySnapshot
    reason: ReplanReason
    previous_forecast: Forecast
    """Forecast in force before the request."""
    orders: list[Order]
    """Orders of the request."""


@dataclass(slots=True)
class ActivePlan:
    """Current `plan` and `data`. `request_or_adopt_plan` replaces both,
    `replace_orders_if_changed` replaces the data; `version` counts the replacements.
    """

    day: DayStore
    data: DayData
    plan: DayPlan
    replanner: Replanner
    log: Callable[[str], None]
    params: DispatchParams = field(default_factory=DispatchParams)
    all_stops: dict[str, PlannedStop] = field(default_factory=dict)
    """All stops of all plans of the day, each with every pad that any plan assigned to it."""
    last_attempt: ReplanAttempt = field(default_factory=ReplanAttempt)
    version: int = 0
    _planned_orders: list[Order] = field(init=False)
    """Orders on which the active plan is based."""
    _request: _Request | None = None

    def __post_init__(self) -> None:
        self._planned_orders = self.data.orders
        wind = self.day.measured_wind_of_last_plan()
        if wind is not None:
            self.data = self._data_with_forecast(wind)
        for plan, _ in self.day.plans_with_reasons():
            self._add_stops_and_pads(plan)

    def _add_stops_and_pads(self, plan: DayPlan) -> None:
        for stop in plan.stops:
            known_stop = self.all_stops.get(stop.id)
            pads = {**stop.pads, **(known_stop.pads if known_stop else {})}
            self.all_stops[stop.id] = msgspec.structs.replace(stop, pads=pads)

    def _data_with_forecast(self, wind: Forecast) -> DayData:
        day = msgspec.structs.replace(self.data.day, forecast=wind)
        return replace(self.data, day=day)

    def replace_orders_if_changed(self, rows: list[OrderRow]) -> None:
        """Update the day's data to the orders of the store: people add and change orders."""
        orders = [row.order for row in rows]
        if orders != self.data.orders:
            self.data = replace(self.data, orders=orders)
            self.version += 1

    @property
    def changed_order_ids(self) -> frozenset[str]:
        """Orders that a person has changed since the active plan, in a way that plans depend on."""
        if self.data.orders is self._planned_orders:
            return frozenset()
        before = {order.id: order for order in self._planned_orders}
        return frozenset(
            order.id
            for order in self.data.orders
            if before.get(order.id, order) != order and needs_new_plan(before[order.id], order)
        )

    def adopt_later_plan(self, stored_plan: DayPlan | None) -> None:
        """Adopt the store's latest plan if another desk of this day has published a later one."""
        if stored_plan is None or stored_plan.revision <= self.plan.revision:
            return
        wind = self.day.measured_wind_of_last_plan()
        if wind is not None:
            self.data = self._data_with_forecast(wind)
        self.plan, self._planned_orders = stored_plan, self.data.orders
        self.version += 1
        self._add_stops_and_pads(stored_plan)
        self.log(f"plan {stored_plan.revision} in force, made by another desk")

    @property
    def is_replanning(self) -> bool:
        """Whether a new plan is being computed."""
        return self._request is not None

    def request_or_adopt_plan(
        self,
        snapshot: DaySnapshot,
        forecast_from_measured_wind: Callable[[Forecast], Forecast],
        followed_forecast: DayForecast | None = None,
    ) -> None:
        """Request a new plan when the day deviates from the active one; adopt it when finished.

        `forecast_from_measured_wind` returns a forecast based on the wind that the fleet measures
        now. `followed_forecast`: the followed forecast in the day's time; it gives each sortie of a
        new plan its own wind.
        """
        if self._request is None:
            self._request_plan_if_due(snapshot, forecast_from_measured_wind, followed_forecast)
            return
        result = self.replanner.take_finished_plan()
        if result is None:
            return
        request, self._request = self._request, None
        if not self._schedule_retry_if_failed(result, request.reason, snapshot):
            self._store_and_adopt_result(result, request, snapshot)
        elif self.data.day.forecast != request.previous_forecast:
            self._set_forecast(
                request.previous_forecast
            )  # keeps the wind deviation as a reason to re-plan

    def has_replan_reason(self, snapshot: DaySnapshot) -> bool:
        """Whether there is a re-planning reason that has not been refused, due now or later."""
        return self._unrefused_replan_reason(replace(snapshot, last_replan_s=None)) is not None

    def _unrefused_replan_reason(self, snapshot: DaySnapshot) -> ReplanReason | None:
        reason = replan_reason(snapshot, self.params)
        return None if self.last_attempt.refused and reason == self.last_attempt.reason else reason

    def _request_plan_if_due(
        self,
        snapshot: DaySnapshot,
        forecast_from_measured_wind: Callable[[Forecast], Forecast],
        followed_forecast: DayForecast | None,
    ) -> None:
        reason = self._unrefused_replan_reason(snapshot)
        if reason is None:
            return
        wind = self.data.day.forecast
        if reason.cause.is_wind_related:
            self._set_forecast(forecast_from_measured_wind(wind))
        self.log(f"replanning: {reason.text}")
        self._request = _Request(snapshot, reason, wind, self.data.orders)
        data = replace(
            data_with_returned_orders_by_truck(self.data, snapshot),
            forecast=followed_forecast,
            start_us=snapshot.start_us,
        )
        self.replanner.start_planning(data, self._state_fixed_by_promises(snapshot))

    def _state_fixed_by_promises(self, snapshot: DaySnapshot) -> DayState:
        drones = [drone.id for drone in self.data.day.drones]
        return replanning_start_state(snapshot, drones, self.data.day.truck.recover_s)

    def _set_forecast(self, wind: Forecast) -> None:
        self.data = self._data_with_forecast(wind)
        self.version += 1

    def _schedule_retry_if_failed(
        self, result: DayPlan | NoPlan, reason: ReplanReason, snapshot: DaySnapshot
    ) -> bool:
        """Whether the planner ended without a result and will be started again."""
        if not isinstance(result, NoPlan) or not result.can_retry:
            return False
        failure_count = (
            self.last_attempt.failure_count + 1 if self.last_attempt.reason == reason else 1
        )
        can_retry = failure_count < self.params.max_replan_attempts
        if can_retry:
            self.last_attempt = replace(
                self.last_attempt,
                ended_s=snapshot.now_s,
                reason=reason,
                refused=False,
                failure_count=failure_count,
            )
            wait_s = self.params.replan_interval_s
            self.log(f"no new plan ({result.reason}): next attempt in {wait_s:.0f} s")
        return can_retry

    def _store_and_adopt_result(
        self, result: DayPlan | NoPlan, request: _Request, snapshot: DaySnapshot
    ) -> None:
        start = self._state_fixed_by_promises(request.snapshot)
        rejection = (
            result.reason if isinstance(result, NoPlan) else broken_promise_reason(result, start)
        )
        refused = rejection is not None or isinstance(result, NoPlan)
        attempt = ReplanAttempt(
            snapshot.now_s, request.snapshot.plan_inputs_comparison_key, request.reason, refused
        )
        if refused or isinstance(result, NoPlan):
            self.last_attempt = attempt
            self.log(f"no new plan ({rejection}): continuing with plan {self.plan.revision}")
            return
        wind = self.data.day.forecast if request.reason.cause.is_wind_related else None
        duration_s = max(0.0, snapshot.now_s - request.snapshot.now_s)
        delayed_plan = delay_plan_by_computation_time(
            result, start, request.snapshot.now_s, duration_s
        )
        self.day.try_store_active_plan(delayed_plan, request.reason.text, wind)
        in_force = self.day.active_plan()
        self.last_attempt = attempt  # set last: a plan that the store rejects is requested again
        assert in_force is not None
        if in_force.revision < delayed_plan.revision:
            self.log("new plan discarded: it lacks a stop where another desk assigned a landing")
            return
        self.plan, self._planned_orders = in_force, request.orders
        self.version += 1
        self._add_stops_and_pads(in_force)
        unplanned_text = f", {len(result.unplanned)} orders unplanned" if result.unplanned else ""
        self.log(f"plan {result.revision} in force: {len(result.stops)} stops{unplanned_text}")

    def close(self) -> None:
        """Cancel the plan that is being computed."""
        self.replanner.close()


def require_plan_fits_day(data: DayData, plan: DayPlan) -> None:
    """Raise LeewayError with all inconsistencies if a plan does not fit the day."""
    orders = {order.id for order in data.orders}
    stops = {stop.id: stop for stop in plan.stops}
    rejection: list[str] = []
    if plan.day != data.day.name:
        rejection.append(f"of day {plan.day!r}, expected {data.day.name!r}")
    for sortie in plan.sorties:
        where = f"sortie {sortie.order} by {sortie.vehicle}"
        if data.day.find_drone(sortie.vehicle) is None:
            rejection.append(f"{where}: no such drone in the day")
        if sortie.order not in orders:
            rejection.append(f"{where}: no such order in the day")
        for stop in (sortie.launch, sortie.home):
            if stop not in stops or sortie.vehicle not in stops[stop].pads:
                rejection.append(f"{where}: expected a stop {stop} with a pad for it")
    rejection += [
        f"stop {stop.id}: no such order {order} in the day"
        for stop in plan.stops
        for order in stop.serves
        if order not in orders
    ]
    if rejection:
        raise LeewayError("\n".join(f"the plan: {detail}" for detail in rejection))
