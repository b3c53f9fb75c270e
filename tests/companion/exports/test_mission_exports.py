"""Exported missions, opened by the readers of the target tools."""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import gpxpy
import pytest
import shapely
from fastkml import KML
from typer.testing import CliRunner

from companion.adapters.files.params import (
    flight_file_path,
    read_airframe,
    read_flight,
    read_obstacle_document,
)
from companion.app.cli.main import app
from companion.app.tools.export import ExportRequest, export_mission_or_track
from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import MissionExport, build_mission_export
from companion.core.exports.formats import auxiliary_document_by_suffix
from companion.core.exports.geojson import mission_geojson
from companion.core.exports.ground_plan import plan_flight_without_vehicle
from companion.core.exports.qgc_plan import mission_plan_document
from companion.core.mission.mission_items import ItemKind
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3

DEPOT = (55.47, 8.45, 12.0)
NAV_TAKEOFF, DO_JUMP = 22, 177
MISSION_FRAME, RELATIVE_FRAME = 2, 3


def planned(name: str = "default"):
    path = flight_file_path(name)
    flight = read_flight(path)
    energy = RouteEnergy(read_airframe(flight.vehicle.airframe), REFERENCE_DENSITY_KGPM3)
    return plan_flight_without_vehicle(flight, energy, read_obstacle_document(flight, path))


@pytest.fixture(scope="module")
def flown():
    return planned()


@pytest.fixture(scope="module")
def mission(flown) -> MissionExport:
    return build_mission_export(flown, "harbour")


def text_of(file_format: ExportFormat) -> str:
    return export_mission_or_track(
        ExportRequest(Path("default"), file_format, autopilot="ardupilot")
    ).text


READ_WPL = """
import json, sys
from pymavlink import mavwp
loader = mavwp.MAVWPLoader()
loader.load(sys.argv[1])
items = [loader.wp(k) for k in range(loader.count())]
print(json.dumps([[i.command, i.frame, i.param1, i.x, i.y, i.z] for i in items]))
"""


def read_by_mavproxys_loader(path: Path) -> list[list[float]]:
    """Return command, frame, parameter 1 and position of each item, read in a MAVLink 2 process."""
    words = [sys.executable, "-c", READ_WPL, str(path)]
    done = subprocess.run(words, env=os.environ | {"MAVLINK20": "1"}, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    return json.loads(done.stdout)


@pytest.mark.sample
def test_mavproxy_reads_the_waypoints_and_finds_every_item_where_it_is(flown, tmp_path):
    path = tmp_path / "harbour.waypoints"
    path.write_text(text_of(ExportFormat.WPL))
    (_, _, _, *home), *read = read_by_mavproxys_loader(path)
    assert home == pytest.approx(DEPOT, abs=1e-6)
    for item, (command, frame, first, *place) in zip(flown.mission.items, read, strict=True):
        if item.spot is None:
            assert frame == MISSION_FRAME
        else:
            spot = item.spot
            assert frame == RELATIVE_FRAME
            assert place[:2] == pytest.approx((spot.lat_deg, spot.lon_deg), abs=1e-7)
            assert place[2] == pytest.approx(spot.height_rel_m, abs=0.01)
        if item.kind is ItemKind.JUMP:
            assert command == DO_JUMP
            assert int(first) == int(item.value) + 1, "home is item 0"


READ_BESIDE = """
import json, sys
from pymavlink import mavwp
fence, rally = mavwp.MissionItemProtocol_Fence(), mavwp.MissionItemProtocol_Rally()
fence.load(sys.argv[1])
rally.load(sys.argv[2])
print(json.dumps([[[i.command, i.param1, i.x, i.y] for i in fence.wpoints],
    [[i.command, i.frame, i.x, i.y, i.z] for i in rally.wpoints]]))
"""
FENCE_RETURN, FENCE_EXCLUSION, RALLY_POINT = 5000, 5002, 5100


@pytest.mark.sample
def test_mavproxys_loaders_read_fence_and_rally_points_beside_the_mission(mission, tmp_path):
    done = CliRunner().invoke(
        app, ["export", "default", "--format", "wpl", "--out", str(tmp_path / "h.waypoints")]
    )
    assert done.exit_code == 0, done.output
    names = [str(tmp_path / name) for name in ("h.fence.waypoints", "h.rally.waypoints")]
    words = [sys.executable, "-c", READ_BESIDE, *names]
    read = subprocess.run(words, env=os.environ | {"MAVLINK20": "1"}, capture_output=True)
    assert read.returncode == 0, read.stderr.decode()
    (first, *corners), rally = json.loads(read.stdout)
    assert first == [FENCE_RETURN, 0.0, pytest.approx(DEPOT[0]), pytest.approx(DEPOT[1])]
    high = [area for area in mission.areas if area.name in ("silo", "wind turbine works")]
    for area in high:
        ring, corners = corners[: len(area.ring_deg)], corners[len(area.ring_deg) :]
        for (command, count, *at), expected in zip(ring, area.ring_deg, strict=True):
            assert (command, count) == (FENCE_EXCLUSION, len(area.ring_deg))
            assert at == pytest.approx(expected, abs=1e-7)
    assert corners == []
    (place,) = [place.point for place in mission.locations if place.name == "quay"]
    lat_lon = [pytest.approx(at, abs=1e-7) for at in (place.lat_deg, place.lon_deg)]
    assert rally == [[RALLY_POINT, RELATIVE_FRAME, *lat_lon, 40.0]] * 2, "Mission Planner drops one"


def test_a_mission_without_areas_and_sites_has_its_own_file_only(mission):
    bare = replace(mission, areas=(), rally=())
    assert auxiliary_document_by_suffix(bare, ExportFormat.WPL) == {}
    assert auxiliary_document_by_suffix(mission, ExportFormat.PLAN) == {}


def test_gpxpy_reads_places_and_both_ways(mission):
    document = gpxpy.parse(text_of(ExportFormat.GPX))
    assert [(w.name, w.type) for w in document.waypoints] == [
        ("launch", "launch and home"),
        ("customer", "customer"),
        ("quay", "rally point"),
    ]
    assert [route.name for route in document.routes] == ["outbound", "homeward"]
    out, back = (
        [(p.latitude, p.longitude, p.elevation) for p in route.points] for route in document.routes
    )
    assert out == [pytest.approx(p, abs=1e-6) for p in mission.outbound]
    assert back[-1] == pytest.approx(DEPOT, abs=1e-6), "lands at the depot's ground"
    # 40 m above the depot, which is 12 m above sea level
    assert max(elevation for *_, elevation in out) == pytest.approx(52.0)


def test_fastkml_reads_places_ways_and_obstacles_as_they_stand(mission):
    (document,) = KML.parse(BytesIO(text_of(ExportFormat.KML).encode())).features
    shapes = {mark.name: mark.geometry for mark in document.features}
    assert {"launch", "customer", "quay", "outbound", "homeward"} <= shapes.keys()
    assert shapes["outbound"].coords == tuple(
        pytest.approx((lon, lat, alt), abs=1e-6) for lat, lon, alt in mission.outbound
    )
    tops = {name: shape.exterior.coords[0][2] for name, shape in shapes.items()
            if shape.geom_type == "Polygon"}  # fmt: skip
    assert tops["silo"] == pytest.approx(12.0 + 75.0), "absolute: above the sea"


def wrong_handed(document) -> list[str]:
    """Return the names of polygons whose ring is not counterclockwise, by shapely."""
    shapes = [(f["properties"]["name"], shapely.geometry.shape(f["geometry"]))
              for f in document["features"] if f["geometry"]["type"] == "Polygon"]  # fmt: skip
    assert shapes
    return [name for name, shape in shapes if not shape.exterior.is_ccw]


def test_outlines_in_geojson_are_closed_and_right_handed_however_they_were_drawn(mission):
    drawn = json.loads(text_of(ExportFormat.GEOJSON))
    assert wrong_handed(drawn) == []
    assert wrong_handed(mission_geojson(backwards(mission))) == []
    for feature in drawn["features"]:
        if feature["geometry"]["type"] == "Polygon":
            (ring,) = feature["geometry"]["coordinates"]
            assert ring[0] == ring[-1]


def backwards(mission: MissionExport) -> MissionExport:
    turned = [replace(area, ring_deg=area.ring_deg[::-1]) for area in mission.areas]
    return replace(mission, areas=tuple(turned))


def test_the_fence_of_a_plan_has_what_stands_as_high_as_the_mission_flies(mission):
    """The first two of 75, 62, 22 and 30 m: the mission flies at 40 m, with 8 m of clearance over
    obstacles.
    """
    document = mission_plan_document(mission, "px4")
    polygons = document["geoFence"]["polygons"]
    corners = {tuple(corner) for polygon in polygons for corner in polygon["polygon"]}
    high = {"silo", "wind turbine works"}
    assert {area.name for area in mission.areas} - high == {"warehouse", "school"}
    assert corners == {at for area in mission.areas if area.name in high for at in area.ring_deg}
    assert not any(polygon["inclusion"] for polygon in polygons)


def test_the_rally_points_of_a_plan_are_the_sites(mission):
    (quay,) = mission_plan_document(mission, "px4")["rallyPoints"]["points"]
    (place,) = [place for place in mission.locations if place.name == "quay"]
    assert quay == pytest.approx([place.point.lat_deg, place.point.lon_deg, 40.0], abs=1e-6)


def test_jumps_of_a_plan_lead_to_the_items_own_numbers(mission, flown):
    items = mission_plan_document(mission, "px4")["mission"]["items"]
    numbered = {item["doJumpId"]: item for item in items}
    for item, ours in zip(items, flown.mission.items, strict=True):
        if ours.kind is ItemKind.JUMP:
            target = numbered[item["params"][0]]
            assert target is items[int(ours.value)]
    assert items[0]["command"] == NAV_TAKEOFF
    assert json.loads(json.dumps(items, allow_nan=False)) == items


def test_a_yaw_that_is_free_is_null_in_a_plan_and_zero_for_ardupilot(flown):
    for free, expected in ((math.nan, None), (0.0, 0.0)):
        mission = build_mission_export(flown, "harbour", free_yaw_value=free)
        takeoff = mission_plan_document(mission, "px4")["mission"]["items"][0]
        assert takeoff["params"][3] == expected


def test_a_flight_that_lands_elsewhere_shows_launch_and_home_apart():
    kinds = {place.kind for place in build_mission_export(planned("truck_stop"), "t").locations}
    assert {"launch", "home"} <= kinds
    assert "launch and home" not in kinds


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["nowhere"], "no such flight"),
        (["default", "--autopilot", "betaflight"], "expected px4 or ardupilot"),
        (["{empty}"], "decisions.mcap"),
    ],
)
def test_mistakes_are_said_in_a_line_and_nothing_is_written(words, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    asked = [word.format(empty="empty") for word in words]
    done = CliRunner().invoke(app, ["export", *asked])
    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1
    assert expected in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_the_command_names_the_file_by_flight_and_format(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, ending in (("plan", "plan"), ("wpl", "waypoints"), ("gpx", "gpx")):
        done = CliRunner().invoke(app, ["export", "default", "--format", name])
        assert done.exit_code == 0, done.output
        assert (tmp_path / f"default.{ending}").is_file()
    printed = CliRunner().invoke(app, ["export", "default", "--format", "gpx", "--out", "-"])
    assert printed.stdout == (tmp_path / "default.gpx").read_text()


def test_a_flight_without_a_depot_is_refused_with_its_key(tmp_path):
    path = tmp_path / "flight.toml"
    path.write_text(
        'format = "flight/1"\n[site]\ncustomer = { east_m = 500.0, north_m = 0.0 }\n'
        '[vehicle]\nairframe = "m100"\n[mission]\n'
    )
    with pytest.raises(LeewayError, match=r"flight\.toml: site\.depot: expected"):
        export_mission_or_track(ExportRequest(path, ExportFormat.KML))
