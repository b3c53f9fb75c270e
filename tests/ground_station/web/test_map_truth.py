"""The map's events match the store and the ground truth throughout a day."""

import math
import sqlite3
from contextlib import ExitStack, closing

import pytest

from companion.core.base.geo import ne_offset_m
from companion.fleet.messages import EventKind
from companion.fleet.polyline import encode_polyline
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.feasibility.reach import Feasible
from ground_station.core.fleet.certificate_ends import DAY_US, CertificateExpiry
from ground_station.core.schema.orders import OrderState
from tests.ground_station.hand_made_day import PLAN
from tests.ground_station.web.map_site import HARBOUR, MapSite
from tests.ground_station.web.sse_client import SseClient, following, merged

FLIGHT_S = 480  # the first drone is recovered; the truck has served a customer
RFC_7396 = [
    ({"a": "b"}, {"a": "c"}, {"a": "c"}),
    ({"a": "b"}, {"b": "c"}, {"a": "b", "b": "c"}),
    ({"a": "b", "b": "c"}, {"a": None}, {"b": "c"}),
    ({"a": ["b"]}, {"a": "c"}, {"a": "c"}),
    ({"a": "c"}, {"a": ["b"]}, {"a": ["b"]}),
    ({"a": {"b": "c"}}, {"a": {"b": "d", "c": None}}, {"a": {"b": "d"}}),
    ({"a": [{"b": "c"}]}, {"a": [1]}, {"a": [1]}),
    (["a", "b"], ["c", "d"], ["c", "d"]),
    ({}, {"a": {"bb": {"ccc": None}}}, {"a": {"bb": {}}}),
]
"""Of its appendix A, those whose target has no null."""


@pytest.mark.parametrize(("target", "patch", "result"), RFC_7396)
def test_the_client_of_these_tests_merges_as_the_rfc_says(target, patch, result):
    assert merged(target, patch) == result


def assert_is_true(site: MapSite, picture: dict) -> None:
    """The picture against the rows of the store, read here, and against the world."""
    orders = {row.order.id: row for row in site.store.orders()}
    assert {k: v["state"] for k, v in picture["orders"].items()} == {
        k: row.state.value for k, row in orders.items()
    }
    assert {k: v["at"] for k, v in picture["orders"].items()} == {
        k: [row.order.lat_deg, row.order.lon_deg] for k, row in orders.items()
    }
    by = {row.order_id: row.vehicle for row in site.store.assignments(in_force=True)}
    assert {k: v["vehicle"] for k, v in picture["orders"].items() if "vehicle" in v} == by
    for name, drone in site.world.drones.items():
        if drone.in_air:
            assert picture["drones"][name]["at"] == list(drone.place)
            assert picture["drones"][name]["phase"] == "outbound"
    out = {
        r.vehicle: r
        for r in site.day.sorties()
        if not (r.is_drone_on_truck or r.is_drone_lost_off_site_or_overdue)
    }
    homes = {k: v["home"] for k, v in picture["drones"].items() if "home" in v}
    assert homes == {name: row.promised_stop for name, row in out.items()}


@pytest.mark.sample
def test_what_a_client_makes_of_the_events_is_the_stores_truth_until_the_first_is_home(site):
    joined_late = 60
    with Clients(site) as clients:
        for _ in range(FLIGHT_S // 4):
            site.step(4)
            truth = site.picture
            if len(clients.all) < 2 and site.world.clock.t_s > joined_late * (1 + len(clients.all)):
                clients.join()
            for client in clients.all:
                client.until(truth)
            assert_is_true(site, truth)
    assert OrderState.DELIVERED in {row.state for row in site.store.orders()}
    for client in clients.all:
        assert client.kinds.count("picture") == 1, "after the first only what changed"
        assert client.kinds.count("patch") > 10


class Clients:
    """Clients that stay until the end."""

    def __init__(self, site: MapSite) -> None:
        self.site, self._held = site, ExitStack()
        self.all: list[SseClient] = []

    def __enter__(self) -> "Clients":
        return self

    def join(self) -> None:
        self.all.append(self._held.enter_context(following(self.site.address)))

    def __exit__(self, *_: object) -> None:
        self._held.close()


def test_the_truck_says_when_it_leaves_and_for_whom_it_waits(site):
    site.until_flying("d1")
    truck = site.picture["truck"]
    depot = PLAN.stops[0]
    assert truck["stop"] == "depot"
    assert truck["leaves_us"] == site.day.day_start_us() + round(1e6 * depot.depart_s)
    binding = [why for row in site.day.sorties() if (why := row.binding_reason("depot"))]
    assert truck["waits_for"] == binding
    assert binding


def test_a_drone_is_shown_with_its_figures_its_way_and_the_gates_last_words(site):
    site.until_flying("d1")
    drone = site.world.drones["d1"]
    assert drone.flight is not None
    figures = {"margin_wh": 12.5, "p_home": 0.9987, "p_success": 0.95,
               "energy_left_wh": 61.0, "ground_speed_mps": 9.5, "text": "going"}  # fmt: skip
    site.fleet_link.more["d1"] = figures | {"lat_deg": 55.47, "lon_deg": 8.45}
    drone.tell(
        EventKind.DECISION, "go: 12.5 Wh above the reserve", assignment=drone.flight.assignment
    )
    site.step(2)
    shown = site.picture["drones"]["d1"]
    said = {name: shown["says" if name == "text" else name] for name in figures}
    assert said == figures
    assert shown["why"] == "Cleared to fly: 12.5 Wh above the reserve"
    assert shown["risk"] == "1 in 770"  # 1 / 0.0013
    assert shown["energy_needed_wh"] == pytest.approx(61.0 - 12.5)
    order = next(o for o in HARBOUR.orders if o.id == drone.flight.order)
    checked = DepotAssigner(HARBOUR.day, HARBOUR.airframes).check_delivery(order, "d1")
    assert isinstance(checked, Feasible)
    left_s = (shown["land_us"] - site.world.clock.epoch_us()) / 1e6
    assert left_s == pytest.approx(checked.time_s, rel=0.25), "by the planner's leg times"
    assert shown["drop_us"] < shown["land_us"]
    order = next(o for o in HARBOUR.orders if o.id == drone.flight.order)
    row = next(r for r in site.day.sorties() if r.vehicle == "d1")
    pad, home = row.pads[row.sortie.launch], row.pads[row.promised_stop]
    customer = [order.lat_deg, order.lon_deg]
    assert shown["way"]["out"] == [[pad.lat_deg, pad.lon_deg], customer]
    assert shown["way"]["home"] == [customer, [home.lat_deg, home.lon_deg]]
    site.fleet_link.more["d1"] = figures | {"delivered": True}
    site.step()
    assert "out" not in site.picture["drones"]["d1"]["way"]


def test_a_drone_turns_to_where_it_moves(site):
    """d1 moves 30 m east, then 30 m south; a metre of noise turns it nowhere."""
    site.until_flying("d1")
    turned = []
    for north_m, east_m in ((0, 0), (0, 30), (1, 30), (-30, 30)):
        at = {"lat_deg": 55.47 + north_m / 111_320, "lon_deg": 8.45 + east_m / 63_100}
        site.fleet_link.more["d1"] = at
        site.step()
        turned.append(site.picture["drones"]["d1"].get("course_deg"))
    assert turned[1] == pytest.approx(90.0, abs=1.0)
    assert turned[2] == turned[1]
    assert turned[3] == pytest.approx(180.0, abs=3.0)


def test_a_diversion_stays_on_the_map_while_it_is_in_force(site):
    """Later decisions without another site and the landing keep it; other decisions end it."""
    site.until_flying("d1")
    drone = site.world.drones["d1"]
    assert drone.flight is not None
    row = next(r for r in site.day.sorties() if r.vehicle == "d1")
    stop, pad = next(iter(row.pads.items()))

    def line(phase: str, words: str) -> list | None:
        drone.tell(EventKind.DECISION, words, assignment=drone.flight.assignment)
        site.fleet_link.more["d1"] = {"phase": phase, "lat_deg": 55.48, "lon_deg": 8.46}
        site.step(2)
        return site.picture["drones"]["d1"]["way"].get("now")

    there = [[55.48, 8.46], [pad.lat_deg, pad.lon_deg]]
    assert line("divert", f"divert: to {stop}: the depot is out of reach") == there
    assert "home" not in site.picture["drones"]["d1"]["way"]
    assert line("divert", "looked_again: margin moved by -4.0 Wh: 3.1 Wh above") == there
    assert line("link lost", "link_back: nothing received for 4 s") == there
    assert line("land", "looked_again: wind moved by 2.1 m/s: 3.0 Wh above") == there
    assert line("suspended", "suspended: mode not ours") is None
    assert line("divert", "position_back: after 3 s") == there
    assert line("return", "turn_back: onboard mission returned on its own") is None
    assert line("divert", "looked_again: 4.0 Wh above") is None


def test_the_words_of_an_earlier_flight_are_not_those_of_this_one(site):
    site.until_flying("d1")
    site.world.drones["d1"].tell(EventKind.DECISION, "turn_back: gone", assignment="older.1")
    site.step(2)
    assert "why" not in site.picture["drones"]["d1"]


def attention(site: MapSite) -> list[tuple[str, str]]:
    return [(one["level"], one["title"]) for one in site.picture.get("attention", [])]


def test_each_cause_is_one_item_that_is_gone_with_it(site):
    site.until_flying("d1")
    assert attention(site) == []
    site.fleet_link.more["d1"] = {"margin_wh": -3.25}
    site.step()
    assert attention(site) == [("warning", "d1 is 3.2 Wh short of coming home")]
    since_us = site.picture["attention"][0]["since_us"]
    site.step(3)
    assert site.picture["attention"][0]["since_us"] == since_us
    for wh, is_listed in ((9.0, True), (11.0, True), (12.5, False), (11.0, False)):
        site.fleet_link.more["d1"] = {"margin_wh": wh}
        site.step()
        assert bool(attention(site)) == is_listed, wh
    site.fleet_link.deaf = True
    site.step(16)
    (item,) = [one for one in site.picture["attention"] if one["who"] == "d1"]
    assert (item["level"], item["title"]) == ("warning", "No contact with d1 for 16 s")
    site.fleet_link.deaf = False
    site.step()
    assert attention(site) == []
    with closing(sqlite3.connect(site.url.removeprefix("sqlite:///"))) as db:
        db.execute("UPDATE orders SET state = 'stuck', why = 'three attempts' WHERE id = 'H-108'")
        db.commit()
    site.step(2)
    assert attention(site) == [("your_turn", "H-108 is stuck")]


def test_a_silent_desk_is_a_warning_until_it_is_received_again(site):
    site.fleet_link.heartbeats = True
    site.step(10)
    assert attention(site) == []
    site.fleet_link.heartbeats = False
    site.step(10)
    assert attention(site) == [("warning", "Desk not responding for 10 s")]
    site.fleet_link.heartbeats = True
    site.step(2)
    assert attention(site) == []


def test_a_certificate_that_ends_within_a_month_wants_a_persons_eye(site):
    now_us = site.world.clock.epoch_us()
    site.ends = CertificateExpiry(now_us + 90 * DAY_US, (("d1", now_us + 12 * DAY_US),))
    site.step()
    assert attention(site) == [("caution", "Certificates end soon")]
    assert site.picture["attention"][0]["words"].startswith("d1 ends in 12 days")
    site.ends = CertificateExpiry(now_us + 90 * DAY_US, (("d1", now_us + 90 * DAY_US),))
    site.step()
    assert attention(site) == []


def test_a_store_that_is_away_is_said_and_drones_are_still_shown(site):
    site.until_flying("d1")
    with closing(sqlite3.connect(site.url.removeprefix("sqlite:///"))) as db:
        db.execute("ALTER TABLE orders RENAME TO elsewhere")
        site.fleet_link.more["d1"] = {"lat_deg": 55.5, "lon_deg": 8.5}
        site.step(2, desk=False)
        assert attention(site)[0] == ("warning", "The desk's data is not reachable")
        assert site.picture["drones"]["d1"]["at"] == [55.5, 8.5]
        assert site.picture["orders"]
        db.execute("ALTER TABLE elsewhere RENAME TO orders")
    site.step(2, desk=False)
    assert attention(site) == []


def test_the_map_writes_nothing_and_asks_nobody_for_anything_but_states(site):
    def dump() -> list[str]:
        with closing(sqlite3.connect(site.url.removeprefix("sqlite:///"))) as db:
            return list(db.iterdump())

    site.until_flying("d1")
    site.step(10)
    before = dump()
    site.world.drones["d1"].tell(EventKind.DECISION, "go: open", assignment="H-101.1")
    site.step(20, desk=False)
    assert dump() == before
    assert (site.fleet_link.sent, site.fleet_link.events_asked) == ([], [])


def test_the_place_is_the_days_own(site):
    site.step()
    place = site.picture["site"]
    depot = HARBOUR.day.depot
    assert place["depot"] == [depot.lat_deg, depot.lon_deg]
    assert HARBOUR.no_fly is not None
    for feature, area in zip(HARBOUR.no_fly["features"], place["areas"], strict=True):
        assert area["name"] == feature["properties"]["name"]
        assert area["height_m"] == feature["properties"]["height_m"]
        corners = [(lat, lon) for lon, lat in feature["geometry"]["coordinates"][0]]
        for there, shown in zip(corners, area["ring"], strict=False):
            assert ne_offset_m(*there, *shown) == pytest.approx((0.0, 0.0), abs=0.02)


def test_the_forecast_is_shown_while_nobody_tells_a_wind(site):
    site.until_flying("d1")
    site.step()
    forecast = HARBOUR.day.forecast
    (planned,) = site.picture["winds"]
    assert planned["to_ne_mps"] == list(forecast.to_ne_mps)
    assert planned["cov_m2ps2"] == [forecast.std_mps**2, 0.0, forecast.std_mps**2]


def test_the_field_is_shown_as_it_is_believed_by_one_drone_or_more(site):
    site.world.drones["d1"].wind_ne_mps = (2.0, 7.0)
    site.until_flying("d1")
    site.step(60)  # this world's drones jump in position, which is not accepted at once
    _, field = site.picture["winds"]
    assert math.dist(field["to_ne_mps"], (2.0, 7.0)) < 1.5
    nn, _, ee = field["cov_m2ps2"]
    assert 0.1 < nn == ee < 4.0
    assert field["source"].startswith("wind ")
    assert field["source"].endswith("at 40 m, by 1 drone")


def test_a_drone_that_tells_its_route_is_shown_on_it_and_one_that_does_not_on_straight_lines(site):
    site.until_flying("d1")
    site.step()
    assert site.picture["drones"]["d1"]["way"]["straight"] is True
    out, home = [(55.47, 8.45), (55.48, 8.46), (55.49, 8.44)], [(55.49, 8.44), (55.471, 8.451)]
    site.fleet_link.more["d1"] = {
        "outbound_route": encode_polyline(out),
        "return_route": encode_polyline(home),
    }
    site.step()
    told = {"out": [list(one) for one in out], "home": [list(one) for one in home]}
    assert site.picture["drones"]["d1"]["way"] == told
    site.fleet_link.more["d1"] = {"outbound_route": "_", "return_route": encode_polyline(home)}
    site.step()
    assert site.picture["drones"]["d1"]["way"]["straight"] is True, "words that are no way"
