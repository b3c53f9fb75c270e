"""`companion check --init`: files that the check accepts, from either autopilot, over UDP."""

import json
import math
import tomllib

import pytest
from pymavlink.dialects.v20 import common as mavlink
from typer.testing import CliRunner

from companion.adapters.files.params import read_airframe, read_flight, read_obstacles
from companion.app.cli.main import app
from companion.app.tools.init_flight import cells_and_source, find_customer
from companion.app.tools.vehicle_facts import SiteFacts, SiteItem, VehicleFacts
from companion.core.base.location import Location
from sim_bridge.autopilot.mission.items import MissionItem
from tests.sitl.served import companion_done, free_udp_port, on_the_ground
from tests.sitl.test_sitl_check import AS_PROMISED

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(120)]

HOME_DEG, CUSTOMER_DEG, RALLY_DEG = (55.47, 8.45), (55.4695, 8.4440), (55.4703, 8.4470)
CORNERS_DEG = ((55.4720, 8.4400), (55.4720, 8.4410), (55.4730, 8.4410))
PORT = free_udp_port()
CENTRE_DEG, RADIUS_M = (55.4780, 8.4500), 50.0
SETTINGS = {
    "px4": AS_PROMISED["px4"]
    | {"BAT1_N_CELLS": 6.0, "BAT1_CAPACITY": 5700.0, "MPC_TKO_SPEED": 3.0, "MPC_XY_CRUISE": 8.0},
    "ardupilot": AS_PROMISED["ardupilot"] | {"BATT_CAPACITY": 5700.0, "WPNAV_SPEED": 800.0},
}
SOURCES = {
    "px4": ("MPC_XY_CRUISE = 8", "BAT1_CAPACITY = 5700 mAh", "BAT1_N_CELLS = 6", "RTL_RETURN_ALT"),
    "ardupilot": ("WPNAV_SPEED = 800", "BATT_CAPACITY = 5700 mAh", "V a cell: verify", "RTL_ALT"),
}


def plan_text(fence: bool = True) -> str:
    lat_lons = (HOME_DEG, CUSTOMER_DEG, CUSTOMER_DEG)
    items = [
        {"type": "SimpleItem", "command": command, "frame": 3, "params": [0, 0, 0, None, *at, 35.0]}
        for command, at in zip((22, 16, 211), lat_lons, strict=True)
    ]
    circle = {"inclusion": False, "circle": {"center": CENTRE_DEG, "radius": RADIUS_M}}
    polygon = {"inclusion": False, "polygon": CORNERS_DEG}
    return json.dumps(
        {
            "fileType": "Plan",
            "version": 1,
            "mission": {"version": 2, "plannedHomePosition": [*HOME_DEG, 12.0], "items": items},
            "geoFence": {"polygons": [polygon], "circles": [circle]} if fence else {},
            "rallyPoints": {"points": [[*RALLY_DEG, 30.0]]},
        }
    )


def store_site(served, autopilot_kind):
    """Store the site of `plan_text` in the autopilot, as a ground station's upload does."""

    def item(command, at_deg, height_m=35.0, param1=0.0):
        x, y = (round(each * 1e7) for each in at_deg)
        return MissionItem(frame=3, command=command, param1=param1, x=x, y=y, z=height_m)

    store = served.autopilot.store
    home = [item(16, HOME_DEG)] if autopilot_kind == "ardupilot" else []
    store.mission += [*home, item(22, HOME_DEG), item(16, CUSTOMER_DEG), item(211, (0.0, 0.0))]
    store.fence += [item(5002, at, 0.0, 3.0) for at in CORNERS_DEG]
    store.fence += [item(5004, CENTRE_DEG, 0.0, RADIUS_M)]
    store.rally += [item(5100, RALLY_DEG)]


@pytest.mark.sample
@pytest.mark.parametrize("source", ["autopilot", "plan"])
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_the_files_hold_what_the_autopilot_states_and_the_check_follows(
    autopilot_kind, source, tmp_path
):
    served = on_the_ground(autopilot_kind, SETTINGS[autopilot_kind], charge_frac=0.9)
    (tmp_path / "site.plan").write_text(plan_text())
    mission = tmp_path / "mine.toml"
    init = "autopilot" if source == "autopilot" else str(tmp_path / "site.plan")
    if source == "autopilot":
        store_site(served, autopilot_kind)
    before = served.autopilot.params.checksum()
    words = ("check", f"--init={init}", f"--mission={mission}", f"--run-dir={tmp_path / 'run'}")
    done = companion_done(served, *words)
    assert served.autopilot.params.checksum() == before
    assert done.stdout.splitlines()[-1] == "READY", done.stdout
    assert done.returncode == 0
    flight = read_flight(mission)
    depot = flight.site.depot
    assert depot is not None
    assert (depot.lat_deg, depot.lon_deg) == pytest.approx(HOME_DEG, abs=2e-5)  # GNSS: 2 m
    assert depot.alt_amsl_m == pytest.approx(12.0, abs=2.0)
    at = flight.site.customer
    assert (at.lat_deg, at.lon_deg) == pytest.approx(CUSTOMER_DEG, abs=1e-6)
    (rally,) = flight.site.rally
    assert (rally.lat_deg, rally.lon_deg) == pytest.approx(RALLY_DEG, abs=1e-6)
    assert flight.mission.cruise_height_m == 35.0
    areas = read_obstacles(flight, mission, Location(lat_deg=55.47, lon_deg=8.45, alt_amsl_m=12.0))
    assert [len(area.ring_ne_m) for area in areas] == [4, 25]  # closed rings
    assert all(math.isinf(area.height_m) for area in areas)
    airframe = read_airframe(flight.vehicle.airframe)
    assert airframe.speeds.cruise_airspeed_mps == 8.0
    assert airframe.battery.cells == 6
    text = mission.read_text() + (tmp_path / "mine-airframe.toml").read_text()
    for each in SOURCES[autopilot_kind]:
        assert each in text


def test_a_plan_alone_gives_the_site_and_nothing_is_overwritten(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "site.plan").write_text(plan_text(fence=False))
    words = ["check", "--init", "site.plan", "--mission", "mine.toml"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 3
    assert done.stdout.splitlines()[-1] == "NOT CHECKED: no --link"
    written = {path.name: path.read_bytes() for path in tmp_path.glob("mine*")}
    assert set(written) == {"mine.toml", "mine-airframe.toml"}
    assert tomllib.loads(written["mine.toml"].decode())["site"]["customer"]["name"] == "customer"
    for removed in ("", "mine.toml"):
        if removed:
            (tmp_path / removed).unlink()
        again = CliRunner().invoke(app, words)
        assert again.exit_code == 2
        assert "exists already, and --init overwrites no file" in again.stderr
    assert (tmp_path / "mine-airframe.toml").read_bytes() == written["mine-airframe.toml"]


@pytest.mark.parametrize(
    ("words", "code", "reason"),
    [
        (["--init", "autopilot"], 2, "--init autopilot: expected --link"),
        ([], 2, "--link: expected, except with --init and a plan"),
        (["--init", "none.plan"], 2, "none.plan: No such file"),
        (["--init", "bad.plan"], 2, "bad.plan: geoFence or rallyPoints"),
        (
            ["--init", "autopilot", "--link", f"udpin:127.0.0.1:{PORT}", "--silence-limit", "0.3"],
            4,
            f"no answer from an autopilot on udpin:127.0.0.1:{PORT}",
        ),
    ],
    ids=["no link", "nothing", "no plan", "bad plan", "no answer"],  # the port is drawn
)
def test_without_an_answer_no_file_is_written(words, code, reason, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bad = json.loads(plan_text()) | {"rallyPoints": {"points": [7]}}
    (tmp_path / "bad.plan").write_text(json.dumps(bad))
    done = CliRunner().invoke(app, ["check", "--mission", "mine.toml", *words])
    assert done.exit_code == code
    assert reason in done.stdout + done.stderr
    assert not list(tmp_path.glob("mine*"))


@pytest.mark.parametrize(
    ("volts", "cells"), [(25.7, 6), (22.2, 6), (15.2, 4), (16.8, 4), (12.6, 3), (46.0, 12)]
)
def test_the_number_of_cells_is_estimated_from_the_resting_voltage(volts, cells):
    found = cells_and_source(VehicleFacts(voltage_v=volts))
    assert found is not None
    assert found[0] == cells
    assert "verify" in found[1]


def test_without_a_release_the_farthest_waypoint_is_the_customer_and_without_any_none():
    points = [(55.47, 8.45), (55.48, 8.45), (55.475, 8.45)]
    items = [SiteItem(mavlink.MAV_CMD_NAV_WAYPOINT, 3, at, 30.0) for at in points]
    site = SiteFacts("the onboard mission", (55.47, 8.45, 0.0), items, [], [])
    found = find_customer(site)
    assert found is not None
    assert found[0] == (55.48, 8.45)
    assert "item 2" in found[1]
    assert find_customer(SiteFacts("x", (55.47, 8.45, 0.0), items[:0], [], [])) is None
