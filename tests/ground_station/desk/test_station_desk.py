"""A desk whose day has wind stations: effect of their files and messages on launches."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.fleet_link import StationWindReceived
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.schema.day import DayFilesError, WindStation
from ground_station.core.schema.holds import ALL_DRONES
from tests.ground_station.desk.test_forecast_watch import DAYS, NEAR, Depot
from tests.ground_station.weather.open_meteo import START_S

HEADER = "time_utc,wind_speed_mps,wind_from_deg\n"


@pytest.fixture
def depot(tmp_path: Path, store: Store) -> Callable[[], Depot]:
    """The harbour with a constant forecast of 4 m/s from 80 degrees, and two stations."""

    def made() -> Depot:
        data = read_day(DAYS / "harbour.toml")
        lat, lon = data.day.depot.lat_deg, data.day.depot.lon_deg + 0.01
        stations = [
            WindStation(id="mast", lat_deg=lat, lon_deg=lon, height_m=40.0, file="mast.csv"),
            WindStation(id="pier", lat_deg=lat, lon_deg=lon, height_m=40.0),
        ]
        day = msgspec.structs.replace(data.day, stations=stations, wind_limit_mps=12.0)
        data = replace(data, day=day, folder=tmp_path)
        (tmp_path / "mast.csv").write_text(HEADER)
        store.add_orders_unless_conflict(data.orders)
        return Depot(store, data)

    return made


def wind(site: Depot, tmp_path: Path, for_s: float, mast: float | None, pier: float | None) -> None:
    """Both stations report every five seconds; None: the station is silent."""
    for _ in range(round(for_s / 5.0)):
        t_s = START_S + site.clock.t_s - 1000.0
        gust = 0.1 * ((t_s % 35.0) / 5.0 - 3.0)
        if mast is not None:
            with (tmp_path / "mast.csv").open("a") as log:
                log.write(f"{t_s:.1f},{mast + gust:.2f},80\n")
        if pier is not None:
            word = StationWind(
                station="pier", epoch_us=site.clock.epoch_us(), speed_mps=pier + gust, from_deg=80.0
            )
            site.wire.heard.append(StationWindReceived(word))
        site.run(5.0)


def test_two_stations_over_the_limit_stop_launches_within_ten_seconds(depot, tmp_path):
    site = depot()
    site.aboard(NEAR)
    wind(site, tmp_path, 120.0, 5.0, 5.0)
    assert site.holds() == {}
    began_s = site.clock.t_s
    for _ in range(12):
        wind(site, tmp_path, 5.0, 13.0, 13.0)
        if ALL_DRONES in site.holds():
            break
    assert site.clock.t_s - began_s <= 10.0
    assert "wind aloft 1" in site.holds()[ALL_DRONES]
    site.phase = "ready"
    wind(site, tmp_path, 30.0, 13.0, 13.0)
    assert site.wire.launches() == []


@pytest.mark.parametrize("lie", [40.0, 0.0])
def test_one_that_lies_changes_no_launch_and_is_said(depot, tmp_path, lie):
    site = depot()
    wind(site, tmp_path, 120.0, 4.0, None)
    wind(site, tmp_path, 120.0, lie, None)
    site.aboard(NEAR)
    site.phase = "ready"
    wind(site, tmp_path, 30.0, lie, None)
    assert site.holds() == {}
    assert site.wire.launches()[:1] == [f"{NEAR}.1:launch1"]
    if lie:
        assert "WARNING: station mast is not used: differs from the forecast: 4.0" in site.words()


def test_one_that_is_mute_or_writes_nonsense_is_said_and_changes_no_launch(depot, tmp_path):
    site = depot()
    wind(site, tmp_path, 60.0, 4.0, 4.0)
    with (tmp_path / "mast.csv").open("a") as log:
        log.write("now,strong,west\n" * 50)
    wind(site, tmp_path, 180.0, None, None)
    words = site.words()
    assert words.count("time_utc = 'now'") == 1
    assert "WARNING: station mast is not used: silent for 2 min" in words
    assert "WARNING: station pier is not used: silent for 2 min" in words
    site.aboard(NEAR)
    site.phase = "ready"
    site.run(30.0)
    assert site.wire.launches()[:1] == [f"{NEAR}.1:launch1"]
    wind(site, tmp_path, 30.0, 4.0, 4.0)
    assert "station pier is used again" in site.words()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"id": "d1"}, "stations.id: d1 more than once, or a drone's"),
        ({"height_m": 0.1}, "stations.mast.height_m"),
        ({"lat_deg": 91.0}, "stations.mast.lat_deg"),
        ({"id": "../mast"}, "id"),
        ({"colour": 1}, "colour"),
    ],
)
def test_mistakes_of_a_station_are_named_with_the_day(tmp_path, table, words):
    station = {"id": "mast", "lat_deg": 55.5, "lon_deg": 8.4, "height_m": 10.0} | table
    rows = "\n".join(f"{key} = {json.dumps(value)}" for key, value in station.items())
    text = (DAYS / "harbour.toml").read_text().replace('no_fly = "../sites/harbour.geojson"', "")
    day = tmp_path / "day.toml"
    day.write_text(f"{text}\n[[stations]]\n{rows}\n")
    (tmp_path / "harbour_orders.csv").write_text((DAYS / "harbour_orders.csv").read_text())
    with pytest.raises(DayFilesError) as caught:
        read_day(day)
    assert words in str(caught.value)
