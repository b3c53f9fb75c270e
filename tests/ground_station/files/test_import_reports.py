"""Import reports of a day: on the terminal, in the plan's file, on the map, and with --strict."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.day_files import read_day
from ground_station.app.cli.main import app
from ground_station.app.map.flight_decisions import FlightDecisions
from ground_station.app.map.map_snapshot import MapSnapshot, StoreSnapshot
from ground_station.app.map.map_view import MapView
from ground_station.app.planning.region_days import divide_days_among_trucks
from ground_station.app.planning.region_days import write_region_day_and_orders as write_region
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.day import DayFilesError
from tests.ground_station.files.small_files import collection, square, zone

DAY = (Path(__file__).parents[3] / "params" / "days" / "harbour.toml").read_text()
ORDERS = "Auftrag;Breite;Länge;Paket\nA-1;55,468;8,44;400\nA-2;55,4725;8,453;200\n"
FAR = square(0.1, 12.0, 57.0)


def write_day(folder: Path, *zones: object) -> Path:
    (folder / "orders.csv").write_text(ORDERS)
    (folder / "zones.json").write_text(json.dumps(collection(*zones)))
    text = DAY.replace("harbour_orders.csv", "orders.csv")
    text = text.replace("../sites/harbour.geojson", "zones.json")
    path = folder / "day.toml"
    path.write_text(text.replace("[depot]", 'columns = { mass_g = "Paket" }\n[depot]', 1))
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_day(tmp_path, zone(FAR), zone(square(0.001, 8.46, 55.475)))


def test_a_plan_prints_and_holds_what_was_used_of_each_file(path: Path) -> None:
    out = path.parent / "plan.json"
    words = ["plan", str(path), "--policy", "dynamic", "--out", str(out), "--strict"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "zones.json: 1 of 2 zones and obstacles used" in done.stderr
    assert "skipped: beyond 100 km of the depot: zone Z1" in done.stderr
    orders, zones = json.loads(out.read_text())["imports"]
    assert (orders["file"], orders["used"], orders["skipped"]) == ("orders.csv", 2, [])
    assert orders["notes"][0] == "read as separated by semicolons"
    assert "Paket as mass_g" in orders["notes"][1]
    assert [one["place"] for one in zones["skipped"]] == ["zone Z1"]


def test_strict_refuses_a_file_of_another_area_and_the_map_shows_it(tmp_path: Path) -> None:
    path = write_day(tmp_path, zone(FAR))
    store = f"sqlite:///{tmp_path}/desk.db"
    taking = ["order", "import", str(path), "--store", store, "--strict"]
    refused = CliRunner().invoke(app, taking)
    assert isinstance(refused.exception, LeewayError | SystemExit)
    assert "0 of 1 zones and obstacles lie within 100 km" in refused.output + str(refused.exception)
    assert not (tmp_path / "desk.db").exists()
    snapshot = MapSnapshot(0.0, FleetStatus({}), {}, FlightDecisions(), StoreSnapshot())
    notes = MapView("harbour", read_day(path)).build_picture(snapshot)["notes"]
    assert any("suspicious: 0 of 1 zones" in note for note in notes)


def test_a_region_of_a_day_with_other_headings_is_read_again(path: Path) -> None:
    day = read_day(path)
    (region,) = divide_days_among_trucks([day], [1])
    again = read_day(write_region(path.parent, region, path))
    assert sorted(order.mass_kg for order in again.orders) == [0.2, 0.4]


def test_a_wind_station_beyond_reach_is_refused(path: Path) -> None:
    station = "\n[[stations]]\nid = 'mast'\nlat_deg = 8.45\nlon_deg = 55.47\nheight_m = 10.0\n"
    path.write_text(path.read_text() + station)
    with pytest.raises(DayFilesError, match=r"stations\.mast: .* latitude and longitude swapped"):
        read_day(path)
