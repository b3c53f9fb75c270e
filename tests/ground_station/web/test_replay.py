"""A past day on the map: each moment shows the same as the live map did."""

import json
import math
import shutil
import socket
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner

from companion.adapters.logs.decision_log import DecisionLog
from companion.core.base.errors import LeewayError
from companion.core.mission.event_text import DecisionEvent
from companion.fleet.messages import EventKind
from ground_station.adapters.store.past_store import PastStore
from ground_station.adapters.web.live_stream import LiveStream
from ground_station.adapters.web.map_server import MapDataSources, MapServer, PastDataSources
from ground_station.app.cli.main import app
from ground_station.app.desk.operator_commands import cancel_order
from ground_station.app.map.map_view import MapView
from ground_station.app.map.replay.past_folder import find_replay_files
from ground_station.app.map.replay.replay_feed import ReplayDataSource
from tests.ground_station.hand_made_day import PLAN
from tests.ground_station.web.browser import browsing, needs_chromium, wait_until
from tests.ground_station.web.map_site import HARBOUR, MapSite

pytestmark = [pytest.mark.sample, pytest.mark.timeout(180)]
TOOK_OFF_S = 1000.0
"""When the recorded flight began, by the autopilot's clock."""

AUTOPILOT_RATE = 0.5
"""Of the autopilot's clock: a simulator on a machine under load."""

COMPANION_OFF_US = -7_000_000_000
"""Of the companion's clock against the desk's."""


def replay(site: MapSite, folder: Path | None = None) -> ReplayDataSource:
    records = () if folder is None else find_replay_files(str(folder)).records
    return ReplayDataSource(MapView("harbour", HARBOUR), PastStore(site.reader.database), records)


def as_json(picture: dict) -> dict:
    """As a page gets it."""
    return json.loads(json.dumps(picture))


def test_a_moment_of_the_past_has_the_orders_truck_and_plan_that_were_shown_live(site: MapSite):
    """Every 20 s of the day until the first delivery, and some time after. A release counts as
    delivered before the landing.
    """
    shown, drone, before_landing = {}, site.world.drones["d1"], 0
    cancel_order(site.store, site.world.clock.epoch_us, "H-104", "anna", "customer asked")
    for _ in range(24):
        if drone.flight is not None and drone.in_air and not before_landing:
            text = DecisionEvent.create_delivery("weighed", 55.47, 8.45).text
            flight = {"assignment": drone.flight.assignment, "order": drone.flight.order}
            drone.tell(EventKind.DECISION, text, **flight)
        site.step(20)
        shown[site.world.clock.epoch_us()] = site.picture
        if drone.flight is not None and drone.in_air:
            before_landing += site.picture["orders"]["H-101"]["state"] == "delivered"
    assert before_landing > 1
    assert {"open", "assigned", "delivered"} <= {
        order["state"] for order in site.picture["orders"].values()
    }
    past = replay(site)
    for t_us, live in shown.items():
        then = as_json(past.picture_at(t_us))
        for id_, order in live["orders"].items():
            was = then["orders"][id_]
            assert (was["state"], was.get("vehicle")) == (order["state"], order.get("vehicle")), id_
        assert then["plan"]["title"] == live["plan"]["title"]
        assert then["truck"]["stop"] == live["truck"]["stop"], (then["truck"], live["truck"])
        assert then["truck"]["phase"] == live["truck"]["phase"]
        assert then["truck"].get("drive") == live["truck"].get("drive")
        homes = {name: one.get("home") for name, one in live["drones"].items()}
        assert {name: one.get("home") for name, one in then["drones"].items()} == homes


def test_before_its_first_order_there_is_nothing_and_the_span_is_the_days(site: MapSite):
    site.step(30)
    past = replay(site)
    span = past.time_line_data()
    assert 20e6 < span["to_us"] - span["from_us"] <= 30e6  # until the last row was written
    assert past.picture_at(span["from_us"] - 1)["orders"] == {}
    assert past.picture_at(span["from_us"])["orders"].keys() == site.picture["orders"].keys()


def test_holds_and_confirmations_are_shown_while_they_were_in_force(site: MapSite):
    from ground_station.adapters.store.hold_store import HoldStore

    clock = site.world.clock
    holds = HoldStore(site.store.database, clock.epoch_us)
    site.step(5)
    before_us = clock.epoch_us()
    site.step(5)
    holds.place_holds(["d2"], "propeller", "anna")
    held_us = clock.epoch_us()
    site.step(5)
    holds.clear_holds(["d2"], "anna")
    after_us = clock.epoch_us()
    past = replay(site)
    assert "notes" not in past.picture_at(before_us)
    assert past.picture_at(held_us)["notes"] == ["d2 is held by anna: propeller"]
    assert "notes" not in past.picture_at(after_us)


ROUND_IT = [[8.45, 55.47, 52.0], [8.46, 55.475, 52.0], [8.455, 55.48, 52.0]]
HOME = [[8.455, 55.48, 52.0], [8.45, 55.47, 52.0]]
MOVED_HOME = [[8.455, 55.48, 52.0], [8.459, 55.472, 52.0]]
"""Out around something, home straight, and home to another place: longitude, latitude, metres."""

ANEW_S = 25
FIELD = [8.447, 55.476, 12.0]


def mission(out: list, home: list) -> dict:
    """A mission as GeoJSON (RFC 7946), by hand."""
    lines = [("outbound", out), ("homeward", home)]
    found = [
        {"type": "Feature", "geometry": {"type": "LineString", "coordinates": line},
         "properties": {"name": name, "kind": "route"}}
        for name, line in lines
    ]  # fmt: skip
    field = {"type": "Point", "coordinates": FIELD}
    about = {"name": "field", "kind": "rally point"}
    found.append({"type": "Feature", "geometry": field, "properties": about})
    return {"type": "FeatureCollection", "name": "m", "features": found}


def lat_lon(line: list) -> list:
    return [(lat, lon) for lon, lat, _ in line]


def write_record(path: Path, decisions: dict[float, str], began_us: int) -> None:
    """Write 50 s of flight north at 10 m/s, with decisions and a falling margin."""
    path.parent.mkdir(parents=True)
    now_us = [began_us]
    log = DecisionLog(path, lambda: now_us[0])
    log.write("phase", {"t_s": TOOK_OFF_S, "before": "arm", "now": "outbound", "why": "go"})
    state = {"mode": "", "mode_name": "", "failsafe": False, "ready_state": True}
    log.write("heard_state", {"t_s": TOOK_OFF_S, "armed": True, **state})
    log.write_route_geojson(TOOK_OFF_S, mission(ROUND_IT, HOME))
    for k in range(50):
        t_s, now_us[0] = TOOK_OFF_S + AUTOPILOT_RATE * k, began_us + 1_000_000 * k
        log.write("heard_position", {
            "t_s": t_s, "lat_deg": 55.47 + k * 10.0 / 111_320.0, "lon_deg": 8.45,
            "alt_amsl_m": 50.0, "height_rel_m": 40.0,
            "vel_n_mps": 10.0, "vel_e_mps": 0.0, "vel_d_mps": 0.0,
        })  # fmt: skip
        log.write("assessment", {
            "t_s": t_s, "p_home": 0.999, "p_home_now": 0.999, "p_success": 0.99,
            "margin_wh": 30.0 - k, "energy_left_wh": 90.0, "energy_need_wh": 40.0,
            "p_home_unattended": None,
        })  # fmt: skip
        log.write(
            "energy", {"t_s": t_s, "left_wh": 90.0, "std_wh": 1.0, "source": "", "used_wh": 0}
        )
        cov = {"nn_m2ps2": 1.0, "ne_m2ps2": 0.25, "ee_m2ps2": 2.0}
        log.write("wind", {"t_s": t_s, "to_n_mps": -2.0, "to_e_mps": 3.0, **cov})
        for kind, _, reason in (
            words.partition(": ") for at, words in decisions.items() if at == k
        ):
            none = dict.fromkeys(("p_home", "p_home_now", "p_success", "margin_wh"))
            log.write("decision", {"t_s": t_s, "kind": kind, "reason": reason, **none})
        if k == ANEW_S:
            log.write_route_geojson(t_s, mission(ROUND_IT, MOVED_HOME))
    log.close()


@pytest.fixture
def flown(site: MapSite, tmp_path: Path) -> tuple[MapSite, Path, int]:
    """A day in which d1 flies, its record, and the desk's time at which the record begins."""
    drone = site.world.drones["d1"]
    drone.clock_off_us = COMPANION_OFF_US
    site.until_flying("d1")
    assert drone.flight is not None
    assignment = drone.flight.assignment
    began_us = site.world.clock.epoch_us()
    row = next(r for r in site.day.sorties() if r.vehicle == "d1")
    again = "go: 12 Wh above"
    told = {10.0: again, 30.0: f"divert: to {row.promised_stop}: the wind has turned", 44.0: again}
    for k in range(45):
        if k in told:
            drone.tell(EventKind.DECISION, told[k], assignment=assignment)
        site.step()
    folder = tmp_path / "run"
    write_record(
        folder / "d1" / f"assignment-{assignment}" / "decisions.mcap",
        told,
        began_us + COMPANION_OFF_US,
    )
    return site, folder, began_us


def test_a_flights_record_is_on_the_desks_clock_within_a_second(flown):
    site, folder, began_us = flown
    past = replay(site, folder)
    for k in range(2, 42):
        drone = past.picture_at(began_us + k * 1_000_000)["drones"]["d1"]
        assert drone["at"][0] == pytest.approx(
            55.47 + k * 10.0 / 111_320.0, abs=1.01 * 10 / 111_320
        )
        assert drone["margin_wh"] == pytest.approx(30.0 - k, abs=1.01)
        assert math.cos(math.radians(drone["course_deg"])) > 0.999
        assert drone["armed"]
        assert list(drone["wind_to_ne_mps"]) == [-2.0, 3.0]
    assert drone["phase"] == "outbound"
    assert drone["why"].startswith("Diverts to ")
    assert past.record_fault_texts == ()
    (mark,) = past.time_line_data()["marks"]
    assert mark["words"].startswith("d1: divert: to ")
    assert mark["t_us"] == pytest.approx(began_us + 30e6, abs=1e6)
    history = past.margin_history_until("d1", began_us + 20_000_000)
    assert history is not None
    assert [one["margin_wh"] for one in history] == [30.0 - k for k in range(len(history))]
    assert 18 <= len(history) <= 22
    reach = past.reachable_area_boundary_at("d1", began_us + 20_000_000)
    assert reach is not None
    assert len(reach) > 10


def test_the_route_is_the_one_that_was_aboard_at_that_time(flown):
    site, folder, began_us = flown
    past = replay(site, folder)

    def way(k: int) -> dict:
        return past.picture_at(began_us + k * 1_000_000)["drones"]["d1"]["way"]

    for k, home in ((10, HOME), (20, HOME), (28, MOVED_HOME)):
        assert way(k) == {"out": lat_lon(ROUND_IT), "home": lat_lon(home)}
    row = next(r for r in site.day.sorties() if r.vehicle == "d1")
    straight = replay(site).picture_at(began_us + 10_000_000)["drones"]["d1"]["way"]
    pad = row.pads[row.sortie.launch]
    assert straight["straight"]
    assert straight["out"][0] == (pad.lat_deg, pad.lon_deg)
    assert len(straight["out"]) == 2


def test_of_a_flight_without_a_desk_route_and_diversion_are_the_records_own(tmp_path: Path):
    folder = tmp_path / "default-seed1"
    write_record(folder / "decisions.mcap", {30.0: "divert: to field: the wind has turned"}, 1)
    past = ReplayDataSource(MapView("past"), None, find_replay_files(str(folder)).records)
    began_us = past.time_line_data()["from_us"]
    out = past.picture_at(began_us + 10_000_000)["drones"][folder.name]
    assert out["way"] == {"out": lat_lon(ROUND_IT), "home": lat_lon(HOME)}
    (feed,) = past.flights
    feed.combined_record.rows["phase"].append(
        {"unix_s": 31.0, "before": "outbound", "now": "divert", "why": "wind"}
    )
    diverted = past.picture_at(began_us + 40_000_000)["drones"][folder.name]
    assert diverted["way"]["now"] == [diverted["at"], (FIELD[1], FIELD[0])]
    assert "home" not in diverted["way"]


def test_between_stops_the_truck_is_where_the_plans_drive_puts_it(site: MapSite):
    """The plan of the test: depot to stop-1 in 90 s, 300 m to the east."""
    while not site.world.driver.truck.is_en_route:
        site.step()
    left_us = site.world.clock.epoch_us()
    site.step(15)
    depot, stop = PLAN.stops[:2]
    live = site.picture["truck"]
    assert "at" not in live
    drive = live["drive"]
    assert drive["left_us"] == pytest.approx(left_us, abs=2e6)
    assert drive["arrive_us"] - drive["left_us"] == 90_000_000
    for end, place in (("start", depot.location), ("end", stop.location)):
        assert drive[end] == [place.lat_deg, place.lon_deg]
    past = as_json(replay(site).picture_at(site.world.clock.epoch_us()))
    assert past["truck"]["drive"] == drive
    while site.world.driver.truck.is_en_route:
        site.step()
    site.step(2)
    assert "drive" not in site.picture["truck"]


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def overwrite(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    middle = len(raw) // 2
    raw[middle : middle + 400] = bytes(range(200)) * 2
    path.write_bytes(raw)


@pytest.mark.parametrize("damage", [cut, overwrite, lambda p: p.write_bytes(b"nothing")])
def test_a_damaged_record_is_a_note_and_the_rest_is_shown(flown, damage):
    site, folder, began_us = flown
    (record,) = folder.rglob("*.mcap")
    damage(record)
    with served(replay(site, folder)) as address:
        found = httpx.get(f"{address}/moment.json?t_us={began_us + 10_000_000}")
        assert found.status_code == 200
        assert [words for words in found.json()["notes"] if words.startswith("d1 (H-")]
        assert found.json()["orders"].keys() == site.picture["orders"].keys()
        for question in ("history", "reach"):
            where = f"{address}/{question}.json?vehicle=d1&t_us={began_us + 10_000_000}"
            assert httpx.get(where).status_code in (200, 204)


def test_a_record_whose_rows_lack_what_is_shown_is_a_note(flown):
    site, folder, began_us = flown
    (record,) = folder.rglob("*.mcap")
    record.write_bytes(record.read_bytes().replace(b'"lat_deg"', b'"lat_dog"'))
    notes = replay(site, folder).picture_at(began_us + 10_000_000)["notes"]
    assert any("a row of heard_position without lat_deg, lon_deg" in words for words in notes)


def test_a_record_that_is_missing_is_a_note_and_the_desks_words_stand_in(flown):
    site, folder, began_us = flown
    shutil.rmtree(folder / "d1")
    with pytest.raises(LeewayError, match="no store"):
        find_replay_files(str(folder))
    then = replay(site).picture_at(began_us + 40_000_000)
    assert any("no records of flights" in words for words in then["notes"])
    assert "at" not in then["drones"]["d1"]
    assert then["drones"]["d1"]["why"].startswith("Diverts to ")


class served:
    """A server that shows this past."""

    def __init__(self, feed: ReplayDataSource) -> None:
        past = PastDataSources(
            feed.time_line_data,
            feed.picture_at,
            feed.margin_history_until,
            feed.reachable_area_boundary_at,
        )
        self.server = MapServer("127.0.0.1", 0)
        none = LiveStream()
        self.server.start_serving(MapDataSources(none, lambda _: None, lambda _: None, None, past))

    def __enter__(self) -> str:
        return f"http://127.0.0.1:{self.server.port}"

    def __exit__(self, *_: object) -> None:
        self.server.close()


@pytest.mark.parametrize("t_us", ["", "-1", "x", "1e9", "1" * 18])
def test_a_time_that_is_none_is_refused(site: MapSite, t_us: str):
    site.step()
    with served(replay(site)) as address:
        for path in ("moment", "history", "reach"):
            assert httpx.get(f"{address}/{path}.json?t_us={t_us}").status_code == 400
        far = httpx.get(f"{address}/moment.json?t_us={'9' * 17}")
        assert far.status_code == 200


def test_the_live_map_has_no_past(site: MapSite):
    site.step()
    assert httpx.get(f"{site.address}/span.json").status_code == 204
    assert httpx.get(f"{site.address}/moment.json?t_us=1").status_code == 404


def test_the_page_goes_to_any_time_by_bar_and_keys_and_plays(flown):
    program = needs_chromium()
    site, folder, began_us = flown
    feed = replay(site, folder)
    with (
        served(feed) as address,
        browsing(program, viewport={"width": 1280, "height": 800}) as page,
    ):
        page.goto(address)
        page.wait_for_selector("#link.past")
        page.locator("#map .order").first.wait_for(state="attached")
        page.keyboard.press("m")  # to the diversion
        at = "Number(document.querySelector('#time').value)"
        assert page.evaluate(at) == pytest.approx(began_us + 30e6, abs=2e6)
        page.locator('#map .drone[data-key="d1"]').wait_for(state="attached")
        page.keyboard.press(",")
        assert page.evaluate(at) == pytest.approx(began_us + 20e6, abs=2e6)
        page.keyboard.press("j")
        page.locator("#card .decision", has_text="Cleared to fly: 12 Wh above").wait_for()
        page.keyboard.press(".")
        page.locator("#card .decision", has_text="Diverts to").wait_for()
        page.evaluate("document.activeElement.blur()")
        for key in (",", ",", "<", " "):
            page.keyboard.press(key)
        wait_until(page, f"{at} >= {began_us + 14e6}")
        clocks = "['#clock', '#time-words'].map((id) => document.querySelector(id).innerText)"
        for _ in range(10):
            header, bar = page.evaluate(clocks)
            assert bar.endswith(header), "both are the time of what is shown"
            page.wait_for_timeout(70.0)
        page.keyboard.press(" ")
        assert page.locator("#play").inner_text() == "Play"
        page.locator("#time").focus()
        page.keyboard.press("Home")
        page.locator("#map .drone").first.wait_for(state="detached")


def test_the_command_shows_a_run_or_says_what_it_expected(flown, tmp_path: Path):
    site, folder, _ = flown
    shutil.copy(site.url.removeprefix("sqlite:///"), folder / "desk.db")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = CliRunner().invoke(app, ["map", "--replay", str(folder), "--port", str(port)])
        assert "Address already in use" in str(done.exception)
    assert find_replay_files(str(folder)).store == f"sqlite:///{folder}/desk.db"
    assert find_replay_files(str(folder / "desk.db")).records == ()
    assert len(find_replay_files(str(folder / "desk.db"), folder).records) == 1
    shutil.copy(folder / "desk.db", folder / "other.db")
    for options, words in (
        (["--replay", str(folder)], "expected one store"),
        (["--replay", str(tmp_path / "none")], "expected a store's URL or file, or a run's folder"),
        (
            ["--replay", str(folder / "desk.db"), "--records", "/none"],
            "expected a folder of flights",
        ),
        (["--records", str(folder), "--fleet", "x"], "expected --replay"),
    ):
        done = CliRunner().invoke(app, ["map", "--port", "0", *options])
        assert isinstance(done.exception, LeewayError)
        assert words in str(done.exception)
