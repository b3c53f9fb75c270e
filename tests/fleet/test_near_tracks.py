"""Tracks over real zenoh: who is within 1 km is heard, who is 3 km away is not delivered."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zenoh
from pymap3d.vincenty import vreckon

from companion.core.mission.actions import TellPlace
from companion.core.separation import track_cells
from companion.core.separation.track import Track
from companion.core.separation.track_cells import cell_of
from companion.fleet import messages, signed_link
from companion.fleet.messages import encode
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_config
from companion.fleet.zenoh_link import ZenohLink
from ground_station.adapters.clock import monotonic_s
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import PATIENCE_S, Plain, plain_network, trust_of, wait_for_listener
from tests.fleet.zenoh_net import AT_HARBOUR, CELL, FLEET, HERE, Vehicle, config_file, free_port

HARBOUR = AT_HARBOUR.lat_deg, AT_HARBOUR.lon_deg
MERIDIAN = 55.47, 179.9999
GUARD = pytest.mark.parametrize("guarded", [True, False], ids=["refused", "canary: taken"])

PATIENT = {"publication": [{"key_exprs": ["leeway/**"], "config": {"congestion_control": "block"}}]}
"""zenoh's settings: nothing is dropped where this machine is busy, so what is missing was not
listened to.
"""

Place = tuple[float, float]


def moved(place: Place, by_m: float, course_deg: float) -> Place:
    lat, lon = vreckon(*place, by_m, course_deg)
    return float(lat), (float(lon) + 180.0) % 360.0 - 180.0


@contextmanager
def router_and_client(tmp_path: Path) -> Iterator[tuple[zenoh.Session, Path]]:
    """A router, and the configuration of who calls it."""
    port = free_port()
    router = config_file(tmp_path / "router.json5", listen=port, mode="router")
    client = config_file(tmp_path / "client.json5", connect=port, mode="client", qos=PATIENT)
    with zenoh.open(zenoh.Config.from_file(str(router))) as session:
        yield session, client


@dataclass
class Flyer:
    """A vehicle's link; what it tells is a number."""

    name: str
    client: Path

    def __post_init__(self) -> None:
        keys = VehicleKeys(FLEET, self.name)
        self.link = ZenohLink(read_config(self.client), keys, "a", lambda: None)

    def be_at(self, place: Place) -> None:
        """It listens about this place."""
        self.link.hear_near(*place)
        self.link.publish_state(b"{}")  # as ports do; the writer thread turns

    def tell(self, place: Place, number: int) -> None:
        """It tells this place."""
        cell = cell_of(*place)
        assert cell is not None
        self.link.publish_track(str(number).encode(), cell)

    def heard(self) -> list[tuple[str, int]]:
        """Who told which number since the last call."""
        return [(told.speaker, int(told.raw)) for told in self.link.tracks()]


@pytest.fixture
def flyers(tmp_path: Path) -> Iterator[Callable[[str], Flyer]]:
    made: list[Flyer] = []

    def make(name: str) -> Flyer:
        made.append(Flyer(name, client))
        return made[-1]

    with router_and_client(tmp_path) as (_, client):
        yield make
        for flyer in made:
            flyer.link.close()


def until(true: Callable[[], Any], wait_s: float = PATIENCE_S) -> None:
    limit_s, rest = monotonic_s() + wait_s, threading.Event()
    while not true():
        assert monotonic_s() < limit_s
        rest.wait(0.02)


def let_hear(listener: Flyer, place: Place, teller: Flyer) -> None:
    """The network knows where the listener is: what is told there arrives."""
    listener.be_at(place)

    def arrives() -> bool:
        teller.tell(place, -1)
        return bool(listener.heard())

    until(arrives)


@pytest.mark.parametrize("place", [HARBOUR, MERIDIAN], ids=["harbour", "180th meridian"])
@pytest.mark.parametrize("near_only", [True, False], ids=["near", "canary: all"])
def test_at_990_m_a_neighbour_is_heard_and_at_3_km_nothing_comes_to_the_link(
    flyers, monkeypatch, place, near_only
):
    if not near_only:
        monkeypatch.setattr(track_cells, "cells_within", lambda *_: frozenset({"*/*"}))
    d1, d2 = flyers("d1"), flyers("d2")
    let_hear(d1, place, d2)
    heard: list[int] = []
    for number in range(16):  # at all bearings, far and near in turn; what was told comes in order
        by_m = 990.0 if number % 2 else 3000.0
        d2.tell(moved(place, by_m, 22.5 * number), number)
        if number % 2:
            until(lambda n=number: heard.extend(k for _, k in d1.heard() if k >= 0) or n in heard)
    assert heard == (list(range(1, 16, 2)) if near_only else list(range(16)))


def test_before_it_knows_where_it_is_a_vehicle_hears_nobody(flyers):
    d1, d2 = flyers("d1"), flyers("d2")
    let_hear(d2, HARBOUR, d1)
    for number in range(5):
        d2.tell(HARBOUR, number)
    d1.tell(HARBOUR, 9)
    until(lambda: ("d1", 9) in d2.heard())
    assert d1.heard() == []
    let_hear(d1, HARBOUR, d2)


SPED_UP = 10.0
"""The flight of the next test is so much faster than 20 m/s, and so is all that depends on it."""

STEP_M = 20.0


@pytest.mark.parametrize("ahead", [True, False], ids=["all heard", "canary: own cell only"])
def test_two_that_fly_apart_by_900_m_hear_one_another_in_every_cell(flyers, monkeypatch, ahead):
    """2 km, over several edges of cells: every track is heard, once and in order."""
    monkeypatch.setattr(track_cells, "LOOK_S", track_cells.LOOK_S / SPED_UP)
    monkeypatch.setattr(track_cells, "KEPT_S", track_cells.KEPT_S / SPED_UP)
    if not ahead:
        own = lambda lat, lon, _: frozenset({cell_of(lat, lon)})  # noqa: E731
        monkeypatch.setattr(track_cells, "cells_within", own)
    d1, d2 = flyers("d1"), flyers("d2")
    let_hear(d1, HARBOUR, d2)
    let_hear(d2, moved(HARBOUR, 900.0, 120.0), d1)
    heard: dict[str, list[int]] = {"d1": [], "d2": []}

    def listen() -> None:
        for flyer in (d1, d2):
            heard[flyer.name] += [number for _, number in flyer.heard() if number >= 0]

    rest, steps, cells = threading.Event(), list(range(100)), set()
    for number in steps:
        here = moved(HARBOUR, STEP_M * number, 37.0)
        there = moved(here, 900.0, 120.0)
        cells |= {cell_of(*here), cell_of(*there)}
        for flyer, place in ((d1, here), (d2, there)):
            flyer.be_at(place)
            flyer.tell(place, number)
        rest.wait(STEP_M / (20.0 * SPED_UP))
        listen()
        if ahead:  # on a busy machine it takes its time
            until(lambda n=number: listen() or all(n in numbers for numbers in heard.values()))
    assert len(cells) >= 6
    if ahead:
        assert heard == {"d1": steps, "d2": steps}
    else:
        assert not any(numbers == steps for numbers in heard.values())


def test_cells_that_were_left_long_ago_are_no_longer_delivered(tmp_path, monkeypatch):
    monkeypatch.setattr(track_cells, "KEPT_S", 3.0)
    with router_and_client(tmp_path) as (router, client):
        d1 = Flyer("d1", client)
        here = router.declare_publisher(VehicleKeys(FLEET, "d2").track(CELL))
        far = moved(HARBOUR, 20_000.0, 90.0)
        there = router.declare_publisher(VehicleKeys(FLEET, "d2").track(cell_of(*far) or ""))
        d1.be_at(HARBOUR)
        until(lambda: here.matching_status.matching)
        assert not there.matching_status.matching
        until(lambda: d1.be_at(far) or there.matching_status.matching)
        assert here.matching_status.matching, "the new ones first"
        until(lambda: d1.be_at(far) or not here.matching_status.matching)
        assert there.matching_status.matching
        d1.link.close()


# --- who may tell what ----------------------------------------------------------------------------


def track(vehicle: str, place: dict[str, float] = HERE, north_mps: float = 0.0) -> bytes:
    still = dict.fromkeys(("vel_e_mps", "vel_d_mps"), 0.0)
    errors = dict.fromkeys(("pos_std_m", "alt_std_m", "vel_std_mps"), 1.0)
    told = {**place, "alt_amsl_m": 50.0, "gnss_s": 1.8e9, "vel_n_mps": north_mps}
    return encode(Track(vehicle=vehicle, **told, **still, **errors))


@pytest.mark.parametrize("guarded", [True, False], ids=["kept", "canary: rules of no use"])
def test_by_the_desks_rules_a_member_tells_in_any_cell_by_its_own_key_only(tmp_path, guarded):
    """With TLS. Vehicles hear one another by way of the desk, a viewer hears no track."""
    site = SecureSite(tmp_path / "pki")
    if not guarded:
        path = site.home("desk") / "zenoh.json5"
        table = json.loads(path.read_text())
        table["access_control"]["enabled"] = False
        path.write_text(json.dumps(table))
    desk, d1 = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    d1.phase = "outbound"
    seen: list[str] = []
    try:
        with (
            zenoh.open(read_config(site.home("d2") / "zenoh.json5")) as d2,
            zenoh.open(read_config(site.home("otto") / "zenoh.json5")) as otto,
        ):
            every = otto.declare_subscriber(
                f"leeway/{FLEET}/vehicle/*/track/**", lambda s: seen.append(str(s.key_expr))
            )
            raw_link, heard = d1.port.link.link, set()
            author = trust_of(site, "d2")

            def all_arrive() -> bool:
                desk.receive(0.02)
                d2.put(VehicleKeys(FLEET, "truck").track(CELL), author.seal("track", b"forged"))
                d2.put(VehicleKeys(FLEET, "d2").track(CELL), author.seal("track", track("d2")))
                heard.update(told.speaker for told in raw_link.tracks())
                return "d2" in heard and (guarded or "truck" in heard)

            until(all_arrive)
            assert ("truck" in heard) is not guarded
            assert bool(seen) is not guarded
            every.undeclare()
    finally:
        d1.close()
        desk.close()


def test_vehicles_with_identities_hear_each_other_by_way_of_the_desk(tmp_path):
    site = SecureSite(tmp_path / "pki")
    desk, d1 = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    d2 = site.vehicle("d2", tmp_path / "d2")
    rest = {"alt_amsl_m": 50.0, "vel_ned_mps": (1.0, 2.0, 0.0), "aside": True}
    try:
        for teller, listener in ((d1, d2), (d2, d1)):
            found: list[Any] = []

            def hears(teller=teller, listener=listener, found=found) -> bool:
                desk.receive(0.02)
                teller.port.take(TellPlace(1.8e9, **HERE, **rest))
                found += listener.port.neighbours(1.0)
                return bool(found)

            until(hears)
            assert found[0].track.vehicle == teller.port.vehicle
    finally:
        for one in (d1, d2, desk):
            one.close()


@pytest.fixture
def plain(tmp_path: Path) -> Iterator[Plain]:
    with plain_network(SecureSite(tmp_path / "pki"), tmp_path) as made:
        made.d1.stop()
        wait_for_listener(made.rogue, NEXT_CELL)
        yield made


def heard_until_last(plain: Plain) -> list[str]:
    """Speakers that d1 believes, once all that was put has arrived; the last is the truck's."""
    author, found = trust_of(plain.site, "truck"), []

    def last_arrives() -> bool:
        plain.put("track", author.seal("track", track("truck")), "truck")
        found.extend(event.track.vehicle for event in plain.d1.port.neighbours(1.0))
        return "truck" in found

    until(last_arrives)
    return [name for name in found if name != "truck"]


NEXT_CELL = cell_of(*moved(HARBOUR, 1000.0, 90.0)) or ""


@GUARD
@pytest.mark.parametrize("cell", [NEXT_CELL, "*/*"], ids=["the next", "all"])
def test_who_tells_its_place_in_a_cell_where_it_is_not_is_refused_and_counted(
    plain, monkeypatch, guarded, cell
):
    if not guarded:
        any_cell = type("Any", (), {"__ne__": lambda self, other: False})
        monkeypatch.setattr(messages, "cell_of", lambda lat, lon: any_cell())
    plain.put(f"track/{cell}", trust_of(plain.site, "d2").seal("track", track("d2")), "d2")
    assert set(heard_until_last(plain)) == (set() if guarded else {"d2"})
    said = plain.d1.port.link.refusals.due(0.0) or ""
    assert ("d2 tells its place in a cell where it is not" in said) is guarded


@GUARD
def test_a_true_track_played_to_another_cell_does_not_hide_the_one_before_it(
    plain, monkeypatch, guarded
):
    if not guarded:
        monkeypatch.setattr(signed_link, "decode_told_track", lambda told: None)
    author = trust_of(plain.site, "d2")
    true = author.seal("track", track("d2", north_mps=3.0))

    def heard() -> list[str]:
        plain.put("track", true, "d2")
        plain.put(f"track/{NEXT_CELL}", true, "d2")
        return heard_until_last(plain)

    if guarded:
        assert heard() == ["d2"]
    else:
        until(lambda: heard() == [])  # once both have come before d1 looks: it looks at any time


def test_without_identities_too_a_place_told_in_a_cell_where_it_is_not_is_refused_and_said(
    tmp_path,
):
    with router_and_client(tmp_path) as (router, client):
        d1, heard = Vehicle("d1", tmp_path / "d1", client), set()
        try:

            def arrives() -> bool:
                router.put(VehicleKeys(FLEET, "d2").track(NEXT_CELL), track("d2"))
                router.put(VehicleKeys(FLEET, "d3").track(CELL), track("d2"))
                router.put(VehicleKeys(FLEET, "d4").track(CELL), track("d4"))
                heard.update(event.track.vehicle for event in d1.port.neighbours(1.0))
                return "d4" in heard and d1.port.refusals.total >= 2

            until(arrives)
            assert heard == {"d4"}
            until(lambda: any("not believed: d" in e.text for e in d1.port.log.after(0)))
        finally:
            d1.close()
