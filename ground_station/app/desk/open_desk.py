"""Opens a desk over a store, with the dispatcher that the day needs."""

from collections.abc import Callable
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import WallClock
from ground_station.adapters.files.day_wind import site_wind_of, station_files
from ground_station.adapters.files.followed_file import FollowedFile
from ground_station.adapters.files.forecast_readers import (
    ForecastPlace,
    ForecastReader,
    ProcessReader,
)
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.active_plan import ActivePlan, check_plan
from ground_station.app.desk.depot_dispatcher import DepotDispatcher, DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.exchange import Exchange
from ground_station.app.desk.forecast_watch import ForecastWatch
from ground_station.app.desk.replanner import ProcessReplanner, Replanner
from ground_station.app.desk.station_desk import StationDesk
from ground_station.app.desk.truck_dispatcher import TruckDispatcher
from ground_station.app.desk.wind_guard import WindGuard
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.dispatch.wind_holds import WindHolds
from ground_station.core.feasibility.wind_limit import limit_of
from ground_station.core.fleet.fleet_link import Clock, FleetLink, OffsetClock
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.site_wind.followed_forecast import FollowedForecast
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_stations import StationBook

Say = Callable[[str], None]


def open_depot_desk(
    data: DayData,
    store: Store,
    fleet: FleetLink,
    say: Say,
    params: DepotParams,
    impossible: frozenset[str] = frozenset(),
    clock: Clock | None = None,
    assigner: DepotAssigner | None = None,
    forecasts: ForecastReader | None = None,
) -> Desk:
    """A desk of drones that start from the depot. `impossible`: orders that none of them can bring.
    `assigner`: one that knows the day already. `forecasts`: who reads a newer forecast file; None:
    a process beside the desk.

    Raises LeewayError where the store holds a day with a truck.
    """
    clock = clock or WallClock()
    if DayStore(store.database, clock.epoch_us).plan() is not None:
        raise LeewayError("this store holds a day with a truck: expected --plan")
    assigner = assigner or DepotAssigner(data.day, data.airframes)
    wind = site_wind_of(data, say)
    reader = forecasts or ProcessReader(clock)
    watch = _forecast_watch(data, wind, store, clock, say, reader, at_depot=True)
    dispatcher = DepotDispatcher(store, data, assigner, clock, say, params, impossible, wind, watch)
    dispatcher.neighbour_keys = fleet.neighbour_keys
    limits, stations = WindHolds(wind, limit_of(data)), _stations(data, wind, clock, say)
    guard = WindGuard(store, data, limits, clock, say, forecast=watch, stations=stations)
    exchange = Exchange(store, fleet, say, FleetStatus(data.airframes), clock)
    return Desk(exchange, dispatcher, guard)


def open_truck_desk(
    data: DayData,
    plan: DayPlan,
    store: Store,
    fleet: FleetLink,
    say: Say,
    clock: Clock | None = None,
    replanner: Replanner | None = None,
    by: str = "desk",
    forecasts: ForecastReader | None = None,
) -> Desk:
    """A desk of drones that ride on a truck, by a plan. `forecasts` as above.

    Where the store holds a plan of this day already (after a restart), the newest one goes on.
    Raises LeewayError where `plan` does not fit the day, or the store began with another one.
    """
    clock = clock or WallClock()
    check_plan(data, plan)
    day_clock = _not_behind(clock, store, say)
    day = DayStore(store.database, day_clock.epoch_us)
    if not day.take_plan(plan, "as given"):
        kept = day.plans()
        if all(before != plan for before, _ in kept):
            raise LeewayError("this store holds another plan: expected that, or an empty store")
        say(f"plan {kept[-1][0].revision} goes on ({kept[-1][1]})")
    in_force = day.plan()
    assert in_force is not None
    active = ActivePlan(day, data, in_force, replanner or ProcessReplanner(clock), say)
    wind = site_wind_of(data, say)
    reader = forecasts or ProcessReader(clock)
    watch = _forecast_watch(data, wind, store, day_clock, say, reader, at_depot=False)
    dispatcher = TruckDispatcher(store, day, active, day_clock, say, by, wind, watch)
    dispatcher.neighbour_keys = fleet.neighbour_keys
    limits = WindHolds(wind, limit_of(data))
    stations = _stations(data, wind, day_clock, say)
    guard = WindGuard(store, data, limits, day_clock, say, day.sorties, watch, stations)
    exchange = Exchange(store, fleet, say, FleetStatus(data.airframes), clock)
    return Desk(exchange, dispatcher, guard)


def _forecast_watch(
    data: DayData,
    wind: SiteWind,
    store: Store,
    clock: Clock,
    say: Say,
    reader: ForecastReader,
    *,
    at_depot: bool,
) -> ForecastWatch | None:
    """None: the day names no forecast to follow."""
    forecast = data.forecast
    if forecast is None:
        return None
    follows = FollowedForecast(forecast, clock, data.day.mission.cruise_height_m)
    file = None
    if forecast.file:
        place = ForecastPlace(Path(forecast.file), forecast.lat_deg, forecast.lon_deg)
        file = FollowedFile(place, reader)
    return ForecastWatch(follows, file, data, wind, store, clock, say, at_depot)


def _stations(data: DayData, wind: SiteWind, clock: Clock, say: Say) -> StationDesk | None:
    """None: the day names no wind station, so none is heard."""
    if not data.day.stations:
        return None
    return StationDesk(StationBook.of_day(wind, data.day.stations), station_files(data), clock, say)


def _not_behind(clock: Clock, store: Store, say: Say) -> Clock:
    """A clock whose time stamps are not before the store's last entry."""
    newest_us = DayStore(store.database, clock.epoch_us).newest_us()
    behind_us = 0 if newest_us is None else newest_us - clock.epoch_us()
    if behind_us <= 0:
        return clock
    say(f"the clock is {behind_us / 1e6:.0f} s behind the store's last entry: goes on from that")
    return OffsetClock(clock, behind_us)
