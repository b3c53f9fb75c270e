"""Opens a desk over a store, with the dispatcher for the type of day."""

from collections.abc import Callable, Sequence
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import WallClock
from ground_station.adapters.files.day_wind import create_site_wind
from ground_station.adapters.files.watched_file import (
    READ_TIMEOUT_S,
    ForecastFileMonitor,
    ForecastLocation,
    ForecastReader,
    read_forecast_at,
)
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.workers.beside import ProcessWorker
from ground_station.app.desk.active_plan import ActivePlan, require_plan_fits_day
from ground_station.app.desk.depot_dispatcher import DepotDispatcher, DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.exchange import FleetExchange
from ground_station.app.desk.replanner import Replanner, create_process_planner
from ground_station.app.desk.site.forecast_watch import ForecastMonitor
from ground_station.app.desk.site.site_monitor import SiteMonitor
from ground_station.app.desk.site.station_desk import StationMonitor
from ground_station.app.desk.truck_dispatcher import TruckDispatcher
from ground_station.core.dispatch.depot_assignment import DepotAssigner, assigner_of_day
from ground_station.core.dispatch.wind_holds import WindHoldRules
from ground_station.core.feasibility.wind_limit import launch_wind_limit_mps
from ground_station.core.fleet.fleet_link import Clock, FleetLink, OffsetClock
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.sortie_rows import SortieRow
from ground_station.core.site_wind.corrected_forecast import ForecastTracker
from ground_station.core.site_wind.site_wind import SiteWind

LogMessage = Callable[[str], None]


def open_depot_desk(
    data: DayData,
    store: Store,
    fleet: FleetLink,
    log: LogMessage,
    params: DepotParams,
    infeasible_orders: frozenset[str] = frozenset(),
    clock: Clock | None = None,
    assigner: DepotAssigner | None = None,
    forecast_reader: ForecastReader | None = None,
) -> Desk:
    """Open a desk of drones that start from the depot. `infeasible_orders`: orders that none of
    them can deliver. `assigner`: instance prepared for the day. `forecast_reader`: reader of later
    forecast files; None: a separate process.

    Raises LeewayError if the store holds a day with a truck.
    """
    clock = clock or WallClock()
    if DayStore(store.database, clock.epoch_us).active_plan() is not None:
        raise LeewayError("this store holds a day with a truck: give its plan with --plan")
    assigner = assigner or assigner_of_day(data, None)
    wind = create_site_wind(data, log)
    watch = _open_forecast_monitor(data, wind, store, clock, log, forecast_reader, at_depot=True)
    dispatcher = DepotDispatcher(
        store, data, assigner, clock, log, params, infeasible_orders, wind, watch
    )
    dispatcher.neighbour_keys = fleet.neighbour_keys
    monitor = _open_site_monitor(data, store, wind, watch, clock, log)
    exchange = FleetExchange(store, fleet, log, FleetStatus(data.airframes), clock)
    drones = frozenset(drone.id for drone in data.day.drones)
    return Desk(exchange, dispatcher, monitor, members=drones)


def open_truck_desk(
    data: DayData,
    plan: DayPlan,
    store: Store,
    fleet: FleetLink,
    log: LogMessage,
    clock: Clock | None = None,
    replanner: Replanner | None = None,
    issuer: str = "desk",
    forecast_reader: ForecastReader | None = None,
) -> Desk:
    """Open a desk of drones that ride on a truck, following a plan. `forecast_reader` as above.

    If the store holds a plan of this day already (after a restart), its latest one applies. Raises
    LeewayError if `plan` does not fit the day, or the store began with another one.
    """
    clock = clock or WallClock()
    require_plan_fits_day(data, plan)
    day_clock = _clock_not_before_store_entries(clock, store, log)
    day = DayStore(store.database, day_clock.epoch_us)
    if not day.try_store_active_plan(plan, "as given"):
        stored_plans = day.plans_with_reasons()
        if all(before != plan for before, _ in stored_plans):
            raise LeewayError("the store has another plan: give that with --plan, or a new --store")
        log(f"plan {stored_plans[-1][0].revision} continues ({stored_plans[-1][1]})")
    in_force = day.active_plan()
    assert in_force is not None
    active = ActivePlan(
        day, data, in_force, replanner or Replanner(create_process_planner(clock)), log
    )
    wind = create_site_wind(data, log)
    watch = _open_forecast_monitor(
        data, wind, store, day_clock, log, forecast_reader, at_depot=False
    )
    dispatcher = TruckDispatcher(store, day, active, day_clock, log, issuer, wind, watch)
    dispatcher.neighbour_keys = fleet.neighbour_keys
    monitor = _open_site_monitor(data, store, wind, watch, day_clock, log, day.sorties)
    exchange = FleetExchange(store, fleet, log, FleetStatus(data.airframes), clock)
    members = frozenset(drone.id for drone in data.day.drones)
    return Desk(exchange, dispatcher, monitor, members=members)


def _open_forecast_monitor(
    data: DayData,
    wind: SiteWind,
    store: Store,
    clock: Clock,
    log: LogMessage,
    forecast_reader: ForecastReader | None,
    *,
    at_depot: bool,
) -> ForecastMonitor | None:
    """Return the monitor of the followed forecast; None: the day names no forecast."""
    forecast = data.forecast
    if forecast is None:
        return None
    tracker = ForecastTracker(forecast, clock, data.day.mission.cruise_height_m)
    file = None
    if forecast.file:
        location = ForecastLocation(Path(forecast.file), forecast.lat_deg, forecast.lon_deg)
        reader = forecast_reader or ProcessWorker(read_forecast_at, clock, READ_TIMEOUT_S)
        file = ForecastFileMonitor(location, reader)
    return ForecastMonitor(tracker, file, data, wind, store, clock, log, at_depot)


def _open_site_monitor(
    data: DayData,
    store: Store,
    wind: SiteWind,
    forecast_monitor: ForecastMonitor | None,
    clock: Clock,
    log: LogMessage,
    find_sorties: Callable[[], Sequence[SortieRow]] = lambda: (),
) -> SiteMonitor:
    """Return the monitor of the site. Reports of wind stations are ignored if the day has none."""
    stations = StationMonitor.of_day(wind, data, clock, log) if data.day.stations else None
    limits = WindHoldRules(wind, launch_wind_limit_mps(data))
    return SiteMonitor(store, data, limits, clock, log, find_sorties, forecast_monitor, stations)


def _clock_not_before_store_entries(clock: Clock, store: Store, log: LogMessage) -> Clock:
    """Return a clock whose time stamps are never before the store's last entry."""
    newest_us = DayStore(store.database, clock.epoch_us).newest_time_stamp_us()
    lag_us = 0 if newest_us is None else newest_us - clock.epoch_us()
    if lag_us <= 0:
        return clock
    lag_text = f"{lag_us / 1e6:.0f} s"
    log(f"WARNING: clock {lag_text} behind the store: the desk adds {lag_text}; correct the clock")
    return OffsetClock(clock, lag_us)
