"""The day's data: read completely, or rejected with all errors at once."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from companion.core.vehicle.airframe import Airframe
from ground_station.adapters.files.day_files import DayData, read_day
from ground_station.adapters.files.order_files import read_orders
from ground_station.app.cli.main import app
from ground_station.core.schema.day import DayFilesError
from ground_station.core.schema.orders import Service

HARBOUR = Path(__file__).parents[3] / "params" / "days" / "harbour.toml"


@pytest.fixture(scope="module")
def harbour() -> DayData:
    return read_day(HARBOUR)


@pytest.fixture(scope="module")
def m100(harbour: DayData) -> Airframe:
    return harbour.airframes["m100"]


def problems_of(path: Path) -> list[str]:
    with pytest.raises(DayFilesError) as caught:
        read_orders(path, None) if path.suffix != ".toml" else read_day(path)
    return [str(p).removeprefix(f"{path.parent}/") for p in caught.value.problems]


def test_the_shipped_day_is_read_and_its_empty_heights_follow_the_terrain(harbour):
    assert [order.id for order in harbour.orders] == [f"H-{n}" for n in range(101, 109)]
    first, second = harbour.orders[0], harbour.orders[1]
    # 0.01 degrees of longitude at 55.468 N on the WGS84 ellipsoid are 632 m: 3.16 m at 0.5 %.
    assert first.alt_amsl_m == pytest.approx(12.0 + 0.005 * 632.0, abs=0.02)
    assert (second.alt_amsl_m, second.service) == (11.0, Service.DRONE)
    assert harbour.no_fly is not None
    assert harbour.road_times_s is None


def test_everything_wrong_in_a_table_is_listed_with_row_and_column(tmp_path):
    path = tmp_path / "orders.csv"
    path.write_text(
        "id,lat_deg,lon_deg,alt_amsl_m,mass_kg,service,note\n"
        "a,95,8.0,3,0.5,any,\n"
        "b,55.0,eight,3,0.5,ship,\n"
        "\n"
        'c,55.0,8.0,3,nan,any,"two\nlines"\n'
        "d,55.0,8.0,,0.5,any,\n"
        "e,55.0,8.0\n"
        "f g,55.0,8.0,3,-1,any,\n"
    )
    assert problems_of(path) == [
        "orders.csv, row 8: 3 cells, expected 7 as in the header",
        "orders.csv, row 2, column lat_deg: '95': expected a number from -85 to 85",
        "orders.csv, row 3, column lon_deg: 'eight': expected a number from -180 to 180",
        "orders.csv, row 3, column service: 'ship': expected any, drone or truck",
        "orders.csv, row 5, column mass_kg: 'nan': expected a number from 0 to 500",
        "orders.csv, row 7, column alt_amsl_m: empty, expected the ground's height above sea level,"
        " m (or --day DAY)",
        "orders.csv, row 9, column mass_kg: '-1': expected a number from 0 to 500",
        "orders.csv, row 9, column id: 'f g': expected 1 to 40 letters, digits, '.', '_' or '-'",
    ]


@pytest.mark.parametrize(("apart_m", "named"), [(1.0, 60), (3.0, 0)])
def test_the_same_parcel_within_two_metres_is_named_wherever_it_lies(tmp_path, apart_m, named):
    rng, lines = np.random.default_rng(5), ["id,lat_deg,lon_deg,alt_amsl_m,mass_kg"]
    for n in range(60):
        lat, lon, turn = rng.uniform(-80, 80), rng.uniform(-180, 180), rng.uniform(0, 6.28)
        # WGS84 at any latitude is within 0.7 % of a sphere of 6371 km
        north, east = np.cos(turn) / 111_195.0, np.sin(turn) / 111_195.0 / np.cos(np.radians(lat))
        for id_, along_m in ((f"a{n}", 0.0), (f"b{n}", apart_m)):
            place = f"{lat + along_m * north:.9f},{lon + along_m * east:.9f}"
            lines.append(f"{id_},{place},0,0.5")
    path = tmp_path / "orders.csv"
    path.write_text("\n".join(lines))
    if named == 0:
        assert len(read_orders(path)[0]) == 120
    else:
        said = problems_of(path)
        assert len(said) == named
        assert all("the same parcel to the same place" in words for words in said)


def test_orders_that_no_depot_here_would_have_are_refused_with_the_likely_cause(tmp_path):
    day = [line for line in HARBOUR.read_text().splitlines() if not line.startswith("no_fly")]
    (tmp_path / "harbour.toml").write_text("\n".join(day))
    (tmp_path / "harbour_orders.csv").write_text(
        "id,lat_deg,lon_deg,alt_amsl_m,mass_kg,service,note\n"
        "near,55.4680,8.4400,12,0.4,any,\n"
        "swapped,8.4450,55.4700,12,0.4,any,\n"
        "nowhere,0,0,12,0.4,any,\n"
        "antipode,-55.469,-171.556,12,0.4,drone,\n"
        "grams,55.4690,8.4420,12,400,any,\n"
        "letter,55.4691,8.4421,12,40,drone,\n"
    )
    found = problems_of(tmp_path / "harbour.toml")
    assert [line.split(": ")[0] for line in found] == [
        "harbour_orders.csv, row 3, column lat_deg",
        "harbour_orders.csv, row 4, column lat_deg",
        "harbour_orders.csv, row 5, column lat_deg",
        "harbour_orders.csv, row 6, column mass_kg",
        "harbour_orders.csv, row 7, column mass_kg",
    ]
    endings = ("swapped?", "no position stated?", "at most 100 km", "grams?", "grams?")
    assert all(line.endswith(end) for line, end in zip(found, endings, strict=True))


def test_a_day_names_the_problems_of_all_its_files(tmp_path):
    (tmp_path / "orders.csv").write_text("id,lat_deg,lon_deg,alt_amsl_m,mass_kg\na,x,8,3,1\n")
    (tmp_path / "roads.csv").write_text("from,depot,a\ndepot,0,-5\n")
    text = HARBOUR.read_text().replace("harbour_orders.csv", "orders.csv")
    text = text.replace("../sites/harbour.geojson", "nowhere.geojson")
    text = text.replace('fleet = "harbour"', 'fleet = "harbour"\nroads = "roads.csv"')
    (tmp_path / "day.toml").write_text(text.replace('"m100"', '"m999"', 1))
    said = "\n".join(problems_of(tmp_path / "day.toml"))
    for words in (
        "orders.csv, row 2, column lat_deg: 'x'",
        "nowhere.geojson: No such file",
        "m999: no such airframe; names: ",
        "roads.csv, row 2, column a: '-5'",
    ):
        assert words in said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('id = "d2"', 'id = "d1"'), "d1 more than once"),
        (('id = "d2"', 'id = "D 2"'), "drones.id"),
        (("max_loss = 0.01", "max_loss = 2.0"), "mission.max_loss"),
        (('format = "day/1"', 'format = "day/2"'), "format"),
    ],
)
def test_a_day_that_breaks_the_format_names_the_key(tmp_path, change, words):
    (tmp_path / "day.toml").write_text(HARBOUR.read_text().replace(*change, 1))
    assert words in "\n".join(problems_of(tmp_path / "day.toml"))


def test_everything_wrong_in_a_day_itself_is_listed_at_once(tmp_path):
    (tmp_path / "day.toml").write_text(
        'format = "day/1"\nlorry = 1\norders = "o.csv"\n'
        "[depot]\nlat_deg = 95.0\nlon_deg = 200.0\nalt_amsl_m = 1.0\n"
        "[truck]\nspeed_mps = 0.0\ncapacity_kg = -1.0\n"
        '[mission]\nmax_loss = "small"\nreserve_frac = 0.2\n'
        '[[drones]]\nid = "d1"\n'
        '[[drones]]\nid = "D 2"\nairframe = "m100"\ncharge_frac = 7.0\n'
    )
    said = "\n".join(problems_of(tmp_path / "day.toml"))
    for words in (
        "lorry: unknown key",
        "orders: Expected `array`, got `str`",
        "depot.lat_deg = 95.0: expected a number from -85 to 85",
        "depot.lon_deg = 200.0: expected a number from -180 to 180",
        "truck.speed_mps = 0.0",
        "truck.capacity_kg = -1.0",
        "mission.max_loss: Expected `float`, got `str`",
        "drones[0].airframe: missing",
        "drones.id",
        "drones.D 2.charge_frac = 7.0",
    ):
        assert words in said
    assert len(said.splitlines()) == 10


def test_a_road_matrix_names_what_stands_in_it_twice_and_what_is_missing(tmp_path):
    (tmp_path / "orders.csv").write_text(
        "id,lat_deg,lon_deg,alt_amsl_m,mass_kg\na,55,8,3,1\nb,55.1,8,3,1\n"
    )
    (tmp_path / "roads.csv").write_text(
        "from,depot,a,a\ndepot,0,60,61\na,75,0,x\na,75,0,0\nz,1,1,1\n"
    )
    text = HARBOUR.read_text().replace("harbour_orders.csv", "orders.csv")
    text = text.replace("no_fly =", "roads = 'roads.csv' #")
    (tmp_path / "day.toml").write_text(text)
    assert sorted(problems_of(tmp_path / "day.toml")) == [
        "roads.csv, row 1, column a: column more than once",
        "roads.csv, row 1, column b: column missing",
        "roads.csv, row 3, column a: 'x': expected seconds, 0 or more",
        "roads.csv, row 4: row a more than once",
        "roads.csv, row 5: expected a name of the header and 3 numbers",
        "roads.csv: row b missing",
    ]


def test_a_file_nested_without_end_is_refused_in_a_line(tmp_path):
    path = tmp_path / "orders.geojson"
    path.write_text("[" * 200_000)
    (words,) = problems_of(path)
    assert "nested too deeply" in words


def test_taking_a_days_orders_lists_what_no_drone_can_bring_and_what_would_help(tmp_path):
    orders = (HARBOUR.parent / "harbour_orders.csv").read_text()
    (tmp_path / "orders.csv").write_text(orders + "H-900,55.60,8.45,12,0.5,drone,\n")
    text = HARBOUR.read_text().replace("harbour_orders.csv", "orders.csv")
    (tmp_path / "day.toml").write_text(text.replace("no_fly =", "# no_fly ="))
    taking = [
        "order",
        "import",
        str(tmp_path / "day.toml"),
        "--store",
        f"sqlite:///{tmp_path}/d.db",
    ]
    runner = CliRunner(env={"COLUMNS": "160"})
    done = runner.invoke(app, taking)
    assert done.exit_code == 0, done.output
    assert "9 orders imported" in done.output
    far, heavy = (next(x for x in done.output.splitlines() if n in x) for n in ("H-900", "H-105"))
    assert "Wh short" in far
    assert "within" in far
    assert "the truck" in heavy
    assert "H-101" not in done.output
    again = runner.invoke(app, taking)
    assert "0 orders imported, 9 imported before" in again.output


def test_a_road_matrix_gives_seconds_each_way(tmp_path):
    (tmp_path / "orders.csv").write_text("id,lat_deg,lon_deg,alt_amsl_m,mass_kg\na,55,8,3,1\n")
    (tmp_path / "roads.csv").write_text("from,depot,a\ndepot,0,60\na,75,0\n")
    text = HARBOUR.read_text().replace("harbour_orders.csv", "orders.csv")
    text = text.replace("no_fly =", "roads = 'roads.csv' #")
    (tmp_path / "day.toml").write_text(text)
    roads = read_day(tmp_path / "day.toml").road_times_s
    assert roads is not None
    assert (roads["depot", "a"], roads["a", "depot"]) == (60.0, 75.0)
