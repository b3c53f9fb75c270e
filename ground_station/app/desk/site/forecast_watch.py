"""Forecast monitoring of the desk: its file, its comparison with wind measured by the fleet, and
the launches that it closes.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, location_to_ground_ned_m
from companion.core.mission.flight_plan import depot_frame
from ground_station.adapters.files.watched_file import ForecastFileMonitor
from ground_station.adapters.store.order_store import Store
from ground_station.core.dispatch.hold_source import HoldSource
from ground_station.core.dispatch.launch_promise import (
    ForecastSorties,
    LaunchClosing,
    find_launch_closing,
    format_closing_of_orders,
    format_reopening_suffix,
    format_utc_time_of_day,
)
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.planning.launch_windows import SortieInForecast
from ground_station.core.schema.day import Drone, Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop
from ground_station.core.schema.holds import Hold
from ground_station.core.schema.orders import (
    AssignmentRow,
    Order,
    OrderState,
    Service,
    order_location,
)
from ground_station.core.schema.sortie_rows import SortieRow
from ground_station.core.site_wind.corrected_forecast import ForecastTracker
from ground_station.core.site_wind.site_wind import SiteWind

PRIOR_UPDATE_INTERVAL_S = 60.0
"""Update interval of the expected wind before any member reports."""

SCORE_LOG_INTERVAL_S = 1800.0
"""Interval of log entries on forecast accuracy; a change of its validity is logged immediately."""

EVALUATION_INTERVAL_S = 30.0
"""Evaluation interval of a waiting launch; a new forecast causes an immediate evaluation."""

MIN_CLOSURE_S, MAX_REOPENING_WAIT_S = 300.0, 1800.0
"""Minimum duration of a launch closure, and the waiting time for its end. An assignment that does
not open again within half an hour is withdrawn after the minimum duration, so that its drone and
order are available to others; until then an operator may release it.
"""

ORDERS_PER_CYCLE = 2
"""Closings of open orders computed per cycle: each takes some 20 ms."""

ORDER_CHECK_INTERVAL_S = 120.0
"""Minimum interval between evaluations of all open orders."""

PRIORITY_HORIZON_S = 3600.0
"""Orders that close within this time have priority."""

MIN_LOGGED_CHANGE_S = 600.0
"""A closing that has moved by less is not logged again."""


@dataclass(frozen=True, slots=True)
class _LaunchEvaluation:
    """Evaluation of a waiting launch: its time, and reason and start of a closure."""

    vehicle: str
    evaluated_s: float
    version: int
    reason: str = ""
    closed_since_s: float = math.inf
    reopens_s: float | None = None


@dataclass(slots=True)
class ForecastMonitor:
    """Forecast monitor of one desk. `file_monitor`: None if no later forecast is available.
    `at_depot`: evaluate open orders, too; with a truck the plan covers them.
    """

    tracker: ForecastTracker
    file_monitor: ForecastFileMonitor | None
    data: DayData
    wind: SiteWind
    store: Store
    clock: Clock
    log: Callable[[str], None]
    at_depot: bool
    closings: dict[str, LaunchClosing] = field(default_factory=dict)
    """Closings of open orders as of their last evaluation."""
    sorties: ForecastSorties = field(init=False)
    _evaluations: dict[str, _LaunchEvaluation] = field(default_factory=dict)
    _logged_closings_s: dict[str, float | None] = field(default_factory=dict)
    _orders_to_check: list[Order] = field(default_factory=list)
    _new_closings: dict[str, LaunchClosing] = field(default_factory=dict)
    _order_check_s: float = -math.inf
    _prior_updated_s: float = -math.inf
    _score_logged_s: float | None = None
    _was_biased: bool = False
    _end_is_logged: bool = False
    _order_positions: dict[Order, Ned] = field(default_factory=dict)
    _drone_types: list[Drone] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.sorties = ForecastSorties(self.data)
        drone_types = {
            (d.airframe, d.charge_frac, d.temperature_c, d.battery_health_frac): d
            for d in self.data.day.drones
        }
        self._drone_types = list(drone_types.values())
        self._score_logged_s = self.clock.monotonic_s()

    def update_forecast_and_check_orders(self, now_s: float) -> None:
        """Check the file, the measured wind, and some open orders. Raises StoreError."""
        self._adopt_new_forecast_file(now_s)
        self.tracker.record_comparison_if_due(self.wind)
        if now_s - self._prior_updated_s >= PRIOR_UPDATE_INTERVAL_S:
            self._prior_updated_s = now_s
            self.wind.set_prior(self.tracker.unbiased_cruise_wind(now_s))
        self._log_score_if_due(now_s)
        self._log_forecast_end_once()
        if self.at_depot:
            self._evaluate_next_open_orders(now_s)

    def expected_wind(self, horizon_s: float = 0.0) -> Forecast:
        """Return the forecast at cruise height after `horizon_s`, corrected by measured wind."""
        return self.tracker.expected_cruise_wind(self.clock.monotonic_s() + horizon_s)

    # --- the file ------------------------------------------------------------------------------

    def _adopt_new_forecast_file(self, now_s: float) -> None:
        found = (
            None
            if self.file_monitor is None
            else self.file_monitor.start_read_if_changed_and_take_result(now_s)
        )
        if found is None:
            return
        try:
            if isinstance(found, LeewayError):
                raise found
            self.tracker.replace_forecast_and_clear_record(found)
        except LeewayError as error:
            self.log(f"WARNING: forecast rejected, keeping the current one: {error}")
            return
        self._prior_updated_s = self._order_check_s = -math.inf
        self._end_is_logged = False
        height_m = self.tracker.height_m
        wind = self.tracker.current_forecast_with_bias.wind_at_day_time(now_s, height_m)
        self.log(f"a newer forecast: {wind} at {height_m:.0f} m now")

    def _log_score_if_due(self, now_s: float) -> None:
        score = self.tracker.current_score
        is_biased = score is not None and score.is_bias_above_stated_error
        due = self._score_logged_s is None or now_s - self._score_logged_s >= SCORE_LOG_INTERVAL_S
        if score is None or not (due or is_biased != self._was_biased):
            return
        self._score_logged_s, self._was_biased = now_s, is_biased
        self.log(score.score_text)

    def _log_forecast_end_once(self) -> None:
        if self._end_is_logged or not self.tracker.has_forecast_ended:
            return
        self._end_is_logged = True
        self.log(
            "WARNING: the forecast does not cover the present: its last wind remains in use"
            " and blocks no launches: supply a newer forecast file"
        )

    # --- launches that wait --------------------------------------------------------------------

    def evaluate_hold_reason_by_vehicle(
        self,
        rows: Iterable[AssignmentRow],
        orders: Mapping[str, Order],
        sorties: Mapping[str, SortieRow],
        now_s: float,
    ) -> dict[str, str]:
        """Return the reason for a hold by vehicle: assignments whose launch is not promised now."""
        found: dict[str, str] = {}
        forecast = self.tracker.current_forecast_with_bias
        evaluations: dict[str, _LaunchEvaluation] = {}
        for row in rows:
            order = orders.get(row.order_id)
            if order is None:
                continue
            verdict = self._evaluate_launch(row, order, sorties.get(row.id), forecast, now_s)
            evaluations[row.id] = verdict
            if verdict.reason:
                found[row.vehicle] = verdict.reason
        self._evaluations = evaluations
        return found

    def reason_by_withdrawable_assignment(self, hold_list: Iterable[Hold]) -> dict[str, str]:
        """Return assignments that stay closed for long, with the reason. Excludes those whose hold
        an operator has released.
        """
        now_s = self.clock.monotonic_s()
        vehicles_on_hold = {hold.scope for hold in hold_list if hold.by == HoldSource.FORECAST}
        return {
            id_: one.reason
            for id_, one in self._evaluations.items()
            if one.reason
            and now_s - one.closed_since_s >= MIN_CLOSURE_S
            and (one.reopens_s is None or one.reopens_s - now_s > MAX_REOPENING_WAIT_S)
            and one.vehicle in vehicles_on_hold
        }

    def _evaluate_launch(
        self,
        row: AssignmentRow,
        order: Order,
        sortie: SortieRow | None,
        forecast: DayForecast,
        now_s: float,
    ) -> _LaunchEvaluation:
        previous = self._evaluations.get(row.id)
        version = self.tracker.version
        if previous is not None:
            is_recent = (
                now_s - previous.evaluated_s < EVALUATION_INTERVAL_S and previous.version == version
            )
            if is_recent or (previous.reason and now_s - previous.closed_since_s < MIN_CLOSURE_S):
                return previous
        sortie_in_forecast = self._sortie_in_forecast(row, order, sortie, forecast, now_s)
        wind_text = (
            "" if sortie_in_forecast is None else sortie_in_forecast.launch_restriction_text(now_s)
        )
        if sortie_in_forecast is None or not wind_text:
            return _LaunchEvaluation(row.vehicle, now_s, version)
        again_s = find_launch_closing(sortie_in_forecast, now_s).reopens_s
        reopening = format_reopening_suffix(forecast, again_s)
        reason = (
            f"order {order.id} is not launched: at {format_utc_time_of_day(forecast, now_s)} the"
            f" forecast has {wind_text}{reopening}"
        )
        since_s = previous.closed_since_s if previous is not None and previous.reason else now_s
        return _LaunchEvaluation(row.vehicle, now_s, version, reason, since_s, again_s)

    def _sortie_in_forecast(
        self,
        row: AssignmentRow,
        order: Order,
        sortie: SortieRow | None,
        forecast: DayForecast,
        now_s: float,
    ) -> SortieInForecast | None:
        if sortie is not None:
            if sortie.promised_stop not in sortie.pads or sortie.sortie.launch not in sortie.pads:
                return None
            pads = sortie.pads[sortie.sortie.launch], sortie.pads[sortie.promised_stop]
            return self.sorties.planned_sortie_in_forecast(order, sortie.sortie, pads, forecast)
        drone = self.data.day.find_drone(row.vehicle)
        if drone is None:
            return None
        wind, layer = self.tracker.expected_cruise_wind(now_s), row.layer or 0
        return self.sorties.depot_sortie_in_forecast(
            order, self._customer_position_ned_m(order), drone, layer, forecast, wind
        )

    def _customer_position_ned_m(self, order: Order) -> Ned:
        if order not in self._order_positions:
            frame = depot_frame(self.data.day.depot.location)
            self._order_positions[order] = location_to_ground_ned_m(frame, order_location(order))
        return self._order_positions[order]

    # --- open orders of a depot ----------------------------------------------------------------

    def closed_order_ids(self) -> frozenset[str]:
        """Return the open orders that are not promised now: they are not assigned."""
        now_s = self.clock.monotonic_s()
        return frozenset(id_ for id_, one in self.closings.items() if one.is_closed_at(now_s))

    def priority_order_ids(self) -> list[str]:
        """Return the open orders that are promised now but not in an hour, in the order of their
        closing.
        """
        now_s = self.clock.monotonic_s()
        closing_orders = [
            (one.until_s, id_)
            for id_, one in self.closings.items()
            if one.until_s is not None and 0.0 <= one.until_s - now_s <= PRIORITY_HORIZON_S
        ]
        return [id_ for _, id_ in sorted(closing_orders)]

    def has_reopening_orders(self) -> bool:
        """Whether a closed order is promised again within the evaluated period."""
        now_s = self.clock.monotonic_s()
        return any(
            one.reopens_s is not None and one.is_closed_at(now_s) for one in self.closings.values()
        )

    def closure_reason(self, order: str) -> str | None:
        """Return the reason why an open order is not assigned; None: the forecast permits it."""
        closing = self.closings.get(order)
        if closing is None or not closing.is_closed_at(self.clock.monotonic_s()):
            return None
        forecast = self.tracker.current_forecast_with_bias
        return (
            f"the forecast has {closing.wind}{format_reopening_suffix(forecast, closing.reopens_s)}"
        )

    def _evaluate_next_open_orders(self, now_s: float) -> None:
        if not self._orders_to_check:
            if now_s - self._order_check_s < ORDER_CHECK_INTERVAL_S:
                return
            self._order_check_s = now_s
            rows = self.store.orders(OrderState.OPEN)
            self._orders_to_check = [r.order for r in rows if r.order.service is not Service.TRUCK]
            self._new_closings = {}
        forecast = self.tracker.current_forecast_with_bias
        wind = self.tracker.expected_cruise_wind(now_s)
        for order in self._orders_to_check[:ORDERS_PER_CYCLE]:
            self._new_closings[order.id] = self._latest_order_closing(order, forecast, wind, now_s)
        del self._orders_to_check[:ORDERS_PER_CYCLE]
        if not self._orders_to_check:
            self.closings = self._new_closings
            self._log_changed_closings(forecast)

    def _latest_order_closing(
        self, order: Order, forecast: DayForecast, wind: Forecast, now_s: float
    ) -> LaunchClosing:
        """Return the closing for the drone type that can deliver the order for the longest time."""
        found: list[LaunchClosing] = []
        for drone in self._drone_types:
            if order.mass_kg > self.data.airframes[drone.airframe].mass.max_payload_kg:
                continue
            ground = self._customer_position_ned_m(order)
            sortie_in_forecast = self.sorties.depot_sortie_in_forecast(
                order, ground, drone, 0, forecast, wind
            )
            closing = find_launch_closing(sortie_in_forecast, now_s)
            if closing.until_s is None:
                return closing
            found.append(closing)
        if not found:
            return LaunchClosing(order.id, None)
        return max(found, key=lambda one: (one.until_s or 0.0, -(one.reopens_s or math.inf)))

    def _log_changed_closings(self, forecast: DayForecast) -> None:
        """Log closings that are new or have moved; those with equal times share one line."""
        groups: dict[tuple[float, float | None], list[LaunchClosing]] = {}
        for one in self.closings.values():
            logged_s = self._logged_closings_s.get(one.order)
            has_moved = (
                logged_s is None
                or one.until_s is None
                or abs(one.until_s - logged_s) >= MIN_LOGGED_CHANGE_S
            )
            if one.until_s is None:
                if logged_s is not None:
                    self.log(f"order {one.order} may be launched again")
                self._logged_closings_s.pop(one.order, None)
            elif has_moved and not (
                logged_s is not None and one.until_s < self.clock.monotonic_s()
            ):
                self._logged_closings_s[one.order] = one.until_s
                groups.setdefault((one.until_s, one.reopens_s), []).append(one)
        for (until_s, again_s), group in sorted(groups.items(), key=lambda item: item[0][0]):
            self.log(
                format_closing_of_orders(
                    forecast, until_s, again_s, group, self.clock.monotonic_s()
                )
            )


def closing_wind_by_order(
    monitor: ForecastMonitor,
    sorties_with_launch_s: Iterable[tuple[PlannedSortie, float]],
    stops: Mapping[str, PlannedStop],
    orders: Mapping[str, Order],
) -> dict[str, str]:
    """Return planned sorties that the forecast closes at their launch time, each with the wind.

    `sorties_with_launch_s`: each with its expected launch time on the desk's monotonic clock.
    """
    forecast = monitor.tracker.current_forecast_with_bias
    found: dict[str, str] = {}
    for sortie, launch_s in sorties_with_launch_s:
        order = orders.get(sortie.order)
        launch, home = stops.get(sortie.launch), stops.get(sortie.home)
        if order is None or launch is None or home is None:
            continue
        start, end = launch.pads.get(sortie.vehicle), home.pads.get(sortie.vehicle)
        if start is None or end is None:
            continue
        sortie_in_forecast = monitor.sorties.planned_sortie_in_forecast(
            order, sortie, (start, end), forecast
        )
        wind_text = (
            ""
            if sortie_in_forecast is None
            else sortie_in_forecast.launch_restriction_text(launch_s)
        )
        if wind_text:
            found[sortie.order] = wind_text
    return found
