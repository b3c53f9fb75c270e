"""Elevation tiles in the formats of Copernicus and SRTM, written with rasterio."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.core.base.geo import offset_position_deg
from companion.core.base.location import Location
from companion.core.ground.ground_strip import GroundStrip
from companion.core.mission.flight_file import Flight
from companion.fleet.messages import MAX_MESSAGE_BYTES, Assign
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.elevation import read_elevation
from ground_station.adapters.files.params import read_flight_with_terrain_heights
from ground_station.app.cli.main import app
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.dispatch.flight_tables import depot_delivery_flight_table
from ground_station.core.schema.day import DayFilesError
from ground_station.core.schema.elevation import SiteElevation

rasterio = pytest.importorskip("rasterio")
# Deprecation in rasterio 1.4 with affine 3.
pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

LAT_DEG, LON_DEG = 55.999, 8.4  # near the edge of two tiles of one degree
SECONDS = 1.0 / 3600.0
ROOT = Path(__file__).parents[3]


def plane_m(lat_deg: np.ndarray, lon_deg: np.ndarray) -> np.ndarray:
    """Return a plane, which bilinear interpolation reproduces exactly."""
    return 50.0 + 4000.0 * (lat_deg - 56.0) + 2000.0 * (lon_deg - 8.4)


def write_tile(
    path: Path,
    south_deg: float,
    *,
    rows: int = 180,
    lon_step: float = 1.5 * SECONDS,
    crs: str | None = "EPSG:4326",
    nodata: float | None = None,
    hole: tuple[int, int] | None = None,
    driver: str = "GTiff",
    height: float | None = None,
) -> Path:
    """Write part of a GLO-30 tile: points on whole seconds of latitude, the southern edge in the
    tile below, and 1.5 seconds of longitude beyond 50 degrees north.
    """
    columns = 400
    top, left = south_deg + rows * SECONDS, 8.3
    lat = top - SECONDS * np.arange(rows)
    lon = left + lon_step * np.arange(columns)
    heights = plane_m(lat[:, None], lon[None, :])
    if height is not None:
        heights = np.full_like(heights, height)
    if hole is not None:
        heights[hole] = nodata
    transform = rasterio.transform.from_origin(
        left - 0.5 * lon_step, top + 0.5 * SECONDS, lon_step, SECONDS
    )
    with rasterio.open(
        path, "w", driver=driver, height=rows, width=columns, count=1, dtype="float32",
        crs=crs, transform=transform, nodata=nodata, compress="deflate",
    ) as file:  # fmt: skip
        file.write(heights.astype("float32"), 1)
    return path


@pytest.fixture
def tiles(tmp_path: Path) -> list[Path]:
    name = "Copernicus_DSM_COG_10_N{}_00_E008_00_DEM.tif"
    return [
        write_tile(tmp_path / name.format(55), 56.0 - 180 * SECONDS),
        write_tile(tmp_path / name.format(56), 56.0),
    ]


def near(elevation: SiteElevation, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return LAT_DEG + rng.uniform(-0.02, 0.02, count), LON_DEG + rng.uniform(-0.02, 0.02, count)


def test_heights_are_the_planes_on_both_sides_of_a_tiles_edge_and_on_it(tiles):
    elevation = read_elevation(tiles, LAT_DEG, LON_DEG, 3000.0)
    lat, lon = near(elevation)
    assert (lat > 56.0).sum() > 50 < (lat < 56.0).sum()
    np.testing.assert_allclose(elevation.heights_amsl_at(lat, lon), plane_m(lat, lon), atol=0.01)
    edge = np.full(5, 56.0) + SECONDS * np.linspace(0.0, 1.0, 5)
    there = np.full(5, LON_DEG)
    np.testing.assert_allclose(
        elevation.heights_amsl_at(edge, there), plane_m(edge, there), atol=0.01
    )
    assert elevation.datum == "EGM2008, documented by Copernicus GLO-30, not in the tile"


def test_a_strip_is_the_same_ground_about_the_depot_and_fits_a_command(tiles):
    elevation = read_elevation(tiles, LAT_DEG, LON_DEG, 6000.0)
    depot = Location(lat_deg=LAT_DEG, lon_deg=LON_DEG, alt_amsl_m=46.0)
    customer = Location(name="c", north_m=900.0, east_m=1300.0)
    table = elevation.ground_table_along_route(depot, [customer])
    strip = GroundStrip(table)
    rng = np.random.default_rng(2)
    places = rng.uniform(0.0, 1.0, (100, 1)) * (900.0, 1300.0) + rng.uniform(-200, 200, (100, 2))
    lat, lon = offset_position_deg(LAT_DEG, LON_DEG, places[:, 0], places[:, 1])
    np.testing.assert_allclose(strip.ground_heights_m(places), plane_m(lat, lon) - 46.0, atol=0.06)
    assert len(msgspec.json.encode(table)) < 20_000 < MAX_MESSAGE_BYTES["command"]
    far = [customer, Location(name="far", north_m=-40000.0, east_m=9000.0)]
    with pytest.raises(LeewayError, match="at most 60000 in all"):
        elevation.ground_table_along_route(depot, far)


def test_srtms_own_format_is_read_and_its_voids_are_unknown(tmp_path):
    heights = np.full((1201, 1201), 300, ">i2")
    heights[600, 600] = -32768
    path = tmp_path / "N55E008.hgt"
    path.write_bytes(heights.tobytes())
    elevation = read_elevation([path], 55.5, 8.5, 3000.0)
    assert elevation.datum == "EGM96, documented by SRTM, not in the tile"
    assert elevation.height_amsl_at(55.5, 8.5) is None
    assert elevation.height_amsl_at(55.51, 8.5) == pytest.approx(300.0)


def test_nodata_is_unknown_and_a_sea_of_zero_is_ground(tmp_path):
    hole = write_tile(tmp_path / "h.tif", 55.98, nodata=-9999.0, hole=(90, 240))
    elevation = read_elevation([hole], LAT_DEG, LON_DEG, 3000.0)
    known = np.isfinite(elevation.amsl_m).sum(), np.isnan(elevation.amsl_m).sum()
    assert known[1] > 0 < known[0]
    at = (55.98 + 90 * SECONDS, 8.3 + 240 * 1.5 * SECONDS)
    assert elevation.height_amsl_at(*at) is None
    sea = write_tile(tmp_path / "s.tif", 55.98, height=0.0)
    assert read_elevation([sea], LAT_DEG, LON_DEG, 500.0).height_amsl_at(LAT_DEG, LON_DEG) == 0.0


DAY = """
format = "day/1"
elevation = ["tile.tif"]
orders = ["orders.csv"]
depot = { lat_deg = 55.999, lon_deg = 8.4, alt_amsl_m = 46.0 }
drones = [{ id = "d1", airframe = "m100" }]
"""


def write_day(folder: Path, orders: str) -> Path:
    write_tile(folder / "tile.tif", 55.98)
    (folder / "orders.csv").write_text("id,lat_deg,lon_deg,alt_amsl_m,mass_kg\n" + orders)
    path = folder / "day.toml"
    path.write_text(DAY)
    return path


def test_an_order_without_a_height_gets_the_tiles_and_each_flight_its_strip(tmp_path):
    data = read_day(write_day(tmp_path, "o1,56.005,8.41,,0.4\no2,56.005,8.41,61,0.5\n"))
    heights = [order.alt_amsl_m for order in data.orders]
    assert heights == [pytest.approx(50.0 + 20.0 + 20.0, abs=0.06), 61.0]
    assigner = DepotAssigner(data.day, data.airframes, data.elevation)
    table = assigner.flight_table(data.orders[0], "d1", layer=2)
    command = msgspec.json.encode(Assign(assignment="a", order="o1", flight=table))
    assert len(command) < MAX_MESSAGE_BYTES["command"]
    flight = msgspec.convert(msgspec.json.decode(command)["flight"], Flight)
    assert flight.site.terrain.heights is not None
    customer = GroundStrip(flight.site.terrain.heights)
    lat, lon = math.radians(56.005 - 55.999), math.radians(0.01)
    north, east = 6_367_000.0 * lat, 6_390_000.0 * lon * math.cos(math.radians(56.0))
    assert customer.ground_height_below_m((north, east, 0.0)) == pytest.approx(
        heights[0] - 46.0, abs=0.3
    )
    # A higher layer adds its height to the ground clearance.
    assert flight.mission.clearance_m == 20.0 + 2 * 12.0
    level = depot_delivery_flight_table(data.day, data.day.drones[0], data.orders[0])
    assert "terrain" not in level["site"]
    assert "clearance_m" not in level["mission"]


@pytest.mark.parametrize(
    ("alt_amsl_m", "words"),
    [("86.0", "46.0 m there .* above the ellipsoid"), ("14.1", r"tiles in feet\?")],
)
def test_tiles_far_from_the_depots_height_are_refused(tmp_path, alt_amsl_m, words):
    path = write_day(tmp_path, "o1,56.005,8.41,,0.4\n")
    path.write_text(path.read_text().replace("46.0", alt_amsl_m))
    with pytest.raises(DayFilesError, match=words):
        read_day(path)


def test_an_order_that_the_tiles_do_not_have_is_named_by_its_row(tmp_path):
    with pytest.raises(DayFilesError) as told:
        read_day(write_day(tmp_path, "o1,57.5,8.41,,0.4\n"))
    assert "row 2" in str(told.value)
    assert "the elevation has no height there" in str(told.value)


def test_the_file_of_a_flights_ground_is_written_from_tiles_and_planned_over(tmp_path, tiles):
    flight = tmp_path / "f.toml"
    site = """
format = "flight/1"
vehicle = { airframe = "m100" }
[site]
depot = { lat_deg = 55.999, lon_deg = 8.4, alt_amsl_m = 46.0 }
customer = { name = "c", north_m = 300.0, east_m = 300.0, up_m = 20.0 }
"""
    flight.write_text(site)
    out = tmp_path / "g.csv"
    done = CliRunner().invoke(app, ["ground", str(flight), *map(str, tiles), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "EGM2008" in done.output
    # 300 m north and 300 m east of the plane: 10.8 m and 9.6 m higher.
    assert "c: above the depot's ground: tiles 20.4 m, flight file 20 m" in done.output
    flight.write_text(site + 'terrain = { kind = "grid", grid = "g.csv" }\n')
    heights = read_flight_with_terrain_heights(flight).site.terrain.heights
    assert heights is not None
    assert GroundStrip(heights).ground_height_below_m((300.0, 300.0, 0.0)) == pytest.approx(
        20.4, abs=0.1
    )
