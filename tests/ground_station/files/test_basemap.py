"""A base map in both schemas, for pictures: written by pmtiles and mapbox-vector-tile, and by
Debian's tools as the how-to says.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import mapbox_vector_tile
import msgspec
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.pyplot import imread
from pmtiles.tile import Compression, TileType, zxy_to_tileid
from pmtiles.writer import Writer

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.basemap import Ground, read_ground
from ground_station.adapters.files.day_files import read_day
from ground_station.app.pictures.day_picture import GROUND, draw_day_plan
from tests.ground_station.views.test_plan_view import plan_with

HARBOUR = Path(__file__).parents[3] / "params" / "days" / "harbour.toml"
HOW_TO = Path(__file__).parents[3] / "docs" / "how-to" / "watch-on-a-map.md"
SIDE = 4096
TOP_DEG = 85.0511287798066
"""The northern edge of Web Mercator's square, where it is as high as it is wide: atan(sinh(pi))."""

PROTOMAPS = {"landuse": {"kind": "park"}, "buildings": {}, "roads": {"kind": "minor_road"}}
OPENMAPTILES = {"landcover": {"class": "grass"}, "building": {}, "transportation": {}}


def feature(geometry: str, properties: dict) -> dict:
    return {"geometry": geometry, "properties": properties}


def write(path: Path, layers: list[dict], zoom: int = 1, column: int = 1, row: int = 0) -> Path:
    """One tile: by default the north-eastern quarter of the world."""
    raw = mapbox_vector_tile.encode(layers, default_options={"y_coord_down": True})
    with path.open("wb") as file:
        writer = Writer(file)
        writer.write_tile(zxy_to_tileid(zoom, column, row), raw)
        header = {
            "tile_type": TileType.MVT,
            "tile_compression": Compression.NONE,
            "min_zoom": zoom,
            "max_zoom": zoom,
            "min_lon_e7": -1_800_000_000,
            "min_lat_e7": -850_000_000,
            "max_lon_e7": 1_800_000_000,
            "max_lat_e7": 850_000_000,
            "center_zoom": zoom,
            "center_lon_e7": 0,
            "center_lat_e7": 0,
        }
        writer.finalize(header, {"attribution": "&copy; <b>somebody</b>"})
    return path


def shapes(ground: Ground) -> dict[str, list]:
    return {
        kind: [shape for shape in ground.shapes if shape.kind == kind]
        for kind in dict.fromkeys(shape.kind for shape in ground.shapes)
    }


@pytest.mark.parametrize("schema", [PROTOMAPS, OPENMAPTILES], ids=["protomaps", "openmaptiles"])
def test_what_lies_there_is_read_in_degrees_in_the_order_it_is_drawn(tmp_path: Path, schema: dict):
    green, house, road = schema
    square = f"POLYGON ((0 0, {SIDE} 0, {SIDE} {SIDE}, 0 {SIDE}, 0 0))"
    layers = [
        {"name": road, "features": [feature(f"LINESTRING (0 {SIDE}, {SIDE} 0)", schema[road])]},
        {"name": house, "features": [feature(square, schema[house])]},
        {"name": green, "features": [feature(square, schema[green])]},
        {"name": "places", "features": [feature("POINT (1 1)", {"name": "x"})]},
    ]
    found = read_ground(write(tmp_path / "town.pmtiles", layers), (10.0, 10.0), (20.0, 20.0))
    by_kind = shapes(found)
    assert list(by_kind) == ["green", "house", "road"]
    assert found.attribution == "© somebody"
    (line,) = by_kind["road"]
    assert not line.is_area
    np.testing.assert_allclose(line.lat_lon_deg, [[0.0, 0.0], [TOP_DEG, 180.0]], atol=1e-9)
    (area,) = by_kind["green"]
    assert area.is_area
    assert {tuple(corner.round(6)) for corner in area.lat_lon_deg} == {
        (0.0, 0.0),
        (0.0, 180.0),
        (round(TOP_DEG, 6), 0.0),
        (round(TOP_DEG, 6), 180.0),
    }


def test_where_people_live_is_no_green_in_openmaptiles(tmp_path: Path):
    square = f"POLYGON ((0 0, {SIDE} 0, {SIDE} {SIDE}, 0 {SIDE}, 0 0))"
    layers = [{"name": "landuse", "features": [feature(square, {"class": "residential"})]}]
    town = write(tmp_path / "town.pmtiles", layers)
    assert read_ground(town, (10.0, 10.0), (20.0, 20.0)).shapes == ()


def test_outside_the_extract_there_is_nothing(tmp_path: Path):
    line = {"name": "roads", "features": [feature("LINESTRING (0 0, 9 9)", {})]}
    town = write(tmp_path / "town.pmtiles", [line])
    assert read_ground(town, (-20.0, -20.0), (-10.0, -10.0)).shapes == ()


def test_a_damaged_file_is_said(tmp_path: Path):
    line = {"name": "roads", "features": [feature("LINESTRING (0 0, 9 9)", {})]}
    town = write(tmp_path / "town.pmtiles", [line])
    raw = town.read_bytes()
    for wrong in (raw[:200], raw[:-30] + b"\xff" * 30):
        town.write_bytes(wrong)
        with pytest.raises(LeewayError, match=r"--basemap .*town.pmtiles: damaged"):
            read_ground(town, (10.0, 10.0), (20.0, 20.0))


OSM = """<osm version="0.6">
<node id="1" version="1" lat="55.465" lon="8.435"/>
<node id="2" version="1" lat="55.475" lon="8.465"/>
<node id="3" version="1" lat="55.470" lon="8.450"/>
<node id="4" version="1" lat="55.470" lon="8.451"/>
<node id="5" version="1" lat="55.471" lon="8.451"/>
<node id="6" version="1" lat="55.471" lon="8.450"/>
<way id="7" version="1"><nd ref="1"/><nd ref="2"/><tag k="highway" v="primary"/></way>
<way id="8" version="1"><nd ref="3"/><nd ref="4"/><nd ref="5"/><nd ref="6"/><nd ref="3"/>
<tag k="natural" v="water"/></way></osm>
"""


def test_a_plans_picture_has_the_base_map_beneath_and_its_attribution(tmp_path: Path):
    """A park over all of it, in the tile of zoom 6 that has the harbour."""
    park = f"POLYGON ((0 0, {SIDE} 0, {SIDE} {SIDE}, 0 {SIDE}, 0 0))"
    layer = {"name": "landuse", "features": [feature(park, {"kind": "park"})]}
    town = write(tmp_path / "town.pmtiles", [layer], 6, 33, 20)
    data = read_day(HARBOUR)
    plan = msgspec.structs.replace(plan_with(["depot", "depot-end"]), sorties=[])
    pictures = []
    for name, basemap in (("bare.png", None), ("streets.png", town)):
        draw_day_plan(data, plan, tmp_path / name, basemap)
        pictures.append(imread(tmp_path / name)[..., :3])
    bare, streets = pictures
    assert bare.shape == streets.shape, "the base map moves no limits"
    green = np.isclose(streets, to_rgb(GROUND["green"]), atol=0.02).all(axis=-1)
    assert not np.isclose(bare, to_rgb(GROUND["green"]), atol=0.02).all(axis=-1).any()
    assert green.mean() > 0.3


TOOLS = ("osmium", "tilemaker", "jq", "sqlite3")


@pytest.mark.night
def test_what_the_how_to_makes_of_an_osm_extract_is_read(tmp_path: Path):
    """Half a pixel of a tile at zoom 14 is 0.2 m here."""
    if missing := [tool for tool in TOOLS if shutil.which(tool) is None]:
        pytest.skip(f"not installed: {', '.join(missing)}: no base map was made")
    (tmp_path / "region.osm").write_text(OSM)
    block = next(text for text in re.findall(r"```\n(.*?)```", HOW_TO.read_text(), re.S)
                 if "tilemaker" in text)  # fmt: skip
    script = "osmium cat region.osm -o region.osm.pbf\n" + block.split("\n", 1)[1]
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-ec", script],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-500:] + done.stderr[-500:]
    found = read_ground(tmp_path / "town.pmtiles", (55.46, 8.43), (55.48, 8.47))
    by_kind = shapes(found)
    assert found.attribution == "© OpenStreetMap contributors"
    water = np.vstack([shape.lat_lon_deg for shape in by_kind["water"]])
    np.testing.assert_allclose(water.min(axis=0), [55.470, 8.450], atol=4e-6)
    np.testing.assert_allclose(water.max(axis=0), [55.471, 8.451], atol=4e-6)
    assert by_kind["road"]
