"""Opens the map's feed of a running fleet."""

from ground_station.adapters.clock import WallClock
from ground_station.adapters.files.day_wind import create_site_wind
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.desk.site.station_desk import StationMonitor
from ground_station.app.map.fleet_receiver import FleetListener
from ground_station.app.map.map_feed import MapPublisher
from ground_station.app.map.map_view import MapView
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.day_data import DayData


def open_map_publisher(
    view: MapView, data: DayData | None, network: ZenohFleet, order_store: Store
) -> MapPublisher:
    """Return the feed. `data`: the fleet's day; None: unknown."""
    clock, wind = WallClock(), create_site_wind(data)
    status = FleetStatus({} if data is None else data.airframes, trust=network.trust)
    stations = StationMonitor.of_day(wind, data, clock, lambda message: None)
    listener = FleetListener(network, clock, status, wind, stations)
    return MapPublisher(view, listener, order_store, clock, network.certificate_expiry_dates)
