"""Tracks over zenoh: those within 1 km are received, those at 3 km are not delivered."""

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

from companion.core.mission.actions import PublishTrack
from companion.core.separation import track_cells
from companion.core.separation.track import Track
from companion.core.separation.track_cells import cell_name_or_none
from companion.fleet import signed_link
from companion.fleet.messages import encode_message
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_link import ZenohLink
from ground_station.adapters.clock import monotonic_s
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import PATIENCE_S, Plain, plain_network, trust_of, wait_for_listener
from tests.fleet.zenoh_net import AT_HARBOUR, CELL, FLEET, HERE, Vehicle, config_file, free_port

HARBOUR = AT_HARBOUR.lat_deg, AT_HARBOUR.lon_deg
MERIDIAN = 55.47, 179.9999
GUARD = pytest.mark.parametrize("guarded", [True, False], ids=["refused", "canary: taken"])

PATIENT = {"publication": [{"key_exprs": ["leeway/**"], "config": {"congestion_control": "block"}}]}
"""zenoh settings: no message is dropped on a busy machine, so a missing message had no subscriber.
"""

Place = tuple[float, float]


def moved(place: Place, by_m: float, course_deg: float) -> Place:
    lat, lon = vreckon(*place, by_m, course_deg)
    return float(lat), (float(lon) + 180.0) % 360.0 - 180.0


@contextmanager
def router_and_client(tmp_path: Path) -> Iterator[tuple[zenoh.Session, Path]]:
    """Start a router; return it and the configuration of its clients."""
    port = free_port()
    router = config_file(tmp_path / "router.json5", listen=port, mode="router")
    client = config_file(tmp_path / "client.json5", connect=port, mode="client", qos=PATIENT)
    with zenoh.open(zenoh.Config.from_file(str(router))) as session:
        yield session, client


@dataclass
class Flyer:
    """A vehicle's link whose tracks contain a number only."""

    name: str
    client: Path

    def __post_init__(self) -> None:
        keys = VehicleKeys(FLEET, self.name)
        self.link = ZenohLink(read_and_check_zenoh_config(self.client), keys, "a", lambda: None)

    def update_position(self, place: Place) -> None:
        """Subscribe to the tracks near this position."""
        self.link.subscribe_near(*place)
        self.link.publish_state(b"{}")  # as ports do; wakes the writer thread

    def tell(self, place: Place, number: int) -> None:
        """Publish this number as a track at this position."""
        cell = cell_name_or_none(*place)
        assert cell is not None
        self.link.publish_track(str(number).encode(), cell)

    def heard(self) -> list[tuple[str, int]]:
        """Return (sender, number) of the tracks received since the last call."""
        return [(told.sender, int(told.raw)) for told in self.link.drain_tracks()]


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
    """Wait until a track published at the listener's position arrives."""
    listener.update_position(place)

    def arrives() -> bool:
        teller.tell(place, -1)
        return bool(listener.heard())

    until(arrives)


@pytest.mark.sample
@pytest.mark.parametrize("place", [HARBOUR, MERIDIAN], ids=["harbour", "180th meridian"])
@pytest.mark.parametrize("near_only", [True, False], ids=["near", "canary: all"])
def test_at_990_m_a_neighbour_is_heard_and_at_3_km_nothing_comes_to_the_link(
    flyers, monkeypatch, place, near_only
):
    if not near_only:
        monkeypatch.setattr(track_cells, "cell_names_within", lambda *_: frozenset({"*/*"}))
    d1, d2 = flyers("d1"), flyers("d2")
    let_hear(d1, place, d2)
    heard: list[int] = []
    for number in range(16):  # all bearings, far and near alternate; tracks arrive in order
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
"""Speed of the next test relative to 20 m/s; all times that depend on it are scaled too."""

STEP_M = 20.0


@pytest.mark.sample
@pytest.mark.parametrize("ahead", [True, False], ids=["all heard", "canary: own cell only"])
def test_two_that_fly_apart_by_900_m_hear_one_another_in_every_cell(flyers, monkeypatch, ahead):
    """Over 2 km and several cell boundaries, every track is received once and in order."""
    monkeypatch.setattr(track_cells, "SEARCH_INTERVAL_S", track_cells.SEARCH_INTERVAL_S / SPED_UP)
    monkeypatch.setattr(track_cells, "CELL_LIFETIME_S", track_cells.CELL_LIFETIME_S / SPED_UP)
    if not ahead:
        own = lambda lat, lon, _: frozenset({cell_name_or_none(lat, lon)})  # noqa: E731
        monkeypatch.setattr(track_cells, "cell_names_within", own)
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
        cells |= {cell_name_or_none(*here), cell_name_or_none(*there)}
        for flyer, place in ((d1, here), (d2, there)):
            flyer.update_position(place)
            flyer.tell(place, number)
        rest.wait(STEP_M / (20.0 * SPED_UP))
        listen()
        if ahead:  # a busy machine may need longer
            until(lambda n=number: listen() or all(n in numbers for numbers in heard.values()))
    assert len(cells) >= 6
    if ahead:
        assert heard == {"d1": steps, "d2": steps}
    else:
        assert not any(numbers == steps for numbers in heard.values())


@pytest.mark.sample
def test_cells_that_were_left_long_ago_are_no_longer_delivered(tmp_path, monkeypatch):
    monkeypatch.setattr(track_cells, "CELL_LIFETIME_S", 3.0)
    with router_and_client(tmp_path) as (router, client):
        d1 = Flyer("d1", client)
        here = router.declare_publisher(VehicleKeys(FLEET, "d2").track_key(CELL))
        far = moved(HARBOUR, 20_000.0, 90.0)
        there = router.declare_publisher(
            VehicleKeys(FLEET, "d2").track_key(cell_name_or_none(*far) or "")
        )
        d1.update_position(HARBOUR)
        until(lambda: here.matching_status.matching)
        assert not there.matching_status.matching
        until(lambda: d1.update_position(far) or there.matching_status.matching)
        assert here.matching_status.matching, "the new ones first"
        until(lambda: d1.update_position(far) or not here.matching_status.matching)
        assert there.matching_status.matching
        d1.link.close()


# --- access rules for tracks ----------------------------------------------------------------------


def track(vehicle: str, place: dict[str, float] = HERE, north_mps: float = 0.0) -> bytes:
    still = dict.fromkeys(("vel_e_mps", "vel_d_mps"), 0.0)
    errors = dict.fromkeys(("pos_std_m", "alt_std_m", "vel_std_mps"), 1.0)
    told = {**place, "alt_amsl_m": 50.0, "gnss_s": 1.8e9, "vel_n_mps": north_mps}
    return encode_message(Track(vehicle=vehicle, **told, **still, **errors))


@pytest.mark.parametrize("guarded", [True, False], ids=["kept", "canary: rules of no use"])
def test_by_the_desks_rules_a_member_tells_in_any_cell_by_its_own_key_only(tmp_path, guarded):
    """With TLS. Vehicles receive each other through the desk; a viewer receives no track."""
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
            zenoh.open(read_and_check_zenoh_config(site.home("d2") / "zenoh.json5")) as d2,
            zenoh.open(read_and_check_zenoh_config(site.home("otto") / "zenoh.json5")) as otto,
        ):
            every = otto.declare_subscriber(
                f"leeway/{FLEET}/vehicle/*/track/**", lambda s: seen.append(str(s.key_expr))
            )
            raw_link, heard = d1.port.member.link.link, set()
            author = trust_of(site, "d2")

            def all_arrive() -> bool:
                desk.receive(0.02)
                d2.put(
                    VehicleKeys(FLEET, "truck").track_key(CELL),
                    author.sign_in_envelope("track", b"forged"),
                )
                d2.put(
                    VehicleKeys(FLEET, "d2").track_key(CELL),
                    author.sign_in_envelope("track", track("d2")),
                )
                heard.update(told.sender for told in raw_link.drain_tracks())
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
    rest = {"alt_amsl_m": 50.0, "vel_ned_mps": (1.0, 2.0, 0.0), "on_setpoints": True}
    try:
        for teller, listener in ((d1, d2), (d2, d1)):
            found: list[Any] = []

            def hears(teller=teller, listener=listener, found=found) -> bool:
                desk.receive(0.02)
                teller.port.report_action_to_desk(PublishTrack(1.8e9, **HERE, **rest))
                found += listener.port.take_received_tracks(1.0)
                return bool(found)

            until(hears)
            assert found[0].track.vehicle == teller.port.member.vehicle
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
    """Return the senders that d1 accepts until the truck's track, published last, arrives."""
    author, found = trust_of(plain.site, "truck"), []

    def last_arrives() -> bool:
        plain.put("track", author.sign_in_envelope("track", track("truck")), "truck")
        found.extend(event.track.vehicle for event in plain.d1.port.take_received_tracks(1.0))
        return "truck" in found

    until(last_arrives)
    return [name for name in found if name != "truck"]


NEXT_CELL = cell_name_or_none(*moved(HARBOUR, 1000.0, 90.0)) or ""


@pytest.mark.sample
@GUARD
@pytest.mark.parametrize("cell", [NEXT_CELL, "*/*"], ids=["the next", "all"])
def test_who_tells_its_place_in_a_cell_where_it_is_not_is_refused_and_counted(
    plain, monkeypatch, guarded, cell
):
    if not guarded:
        any_cell = type("Any", (), {"__ne__": lambda self, other: False})
        monkeypatch.setattr(signed_link, "cell_name_or_none", lambda lat, lon: any_cell())
    plain.put(
        f"track/{cell}", trust_of(plain.site, "d2").sign_in_envelope("track", track("d2")), "d2"
    )
    assert set(heard_until_last(plain)) == (set() if guarded else {"d2"})
    said = plain.d1.port.member.link.rejections.pop_report_if_due(0.0) or ""
    assert ("d2 sent its position in another cell" in said) is guarded


@GUARD
def test_a_true_track_played_to_another_cell_does_not_hide_the_one_before_it(
    plain, monkeypatch, guarded
):
    if not guarded:
        monkeypatch.setattr(signed_link, "decode_and_match_received_track", lambda told: None)
    author = trust_of(plain.site, "d2")
    true = author.sign_in_envelope("track", track("d2", north_mps=3.0))

    def heard() -> list[str]:
        plain.put("track", true, "d2")
        plain.put(f"track/{NEXT_CELL}", true, "d2")
        return heard_until_last(plain)

    if guarded:
        assert heard() == ["d2"]
    else:
        until(lambda: heard() == [])  # repeat until both have arrived before d1 polls


def test_without_identities_too_a_place_told_in_a_cell_where_it_is_not_is_refused_and_said(
    tmp_path,
):
    with router_and_client(tmp_path) as (router, client):
        d1, heard = Vehicle("d1", tmp_path / "d1", client), set()
        try:

            def arrives() -> bool:
                router.put(VehicleKeys(FLEET, "d2").track_key(NEXT_CELL), track("d2"))
                router.put(VehicleKeys(FLEET, "d3").track_key(CELL), track("d2"))
                router.put(VehicleKeys(FLEET, "d4").track_key(CELL), track("d4"))
                heard.update(event.track.vehicle for event in d1.port.take_received_tracks(1.0))
                return "d4" in heard and d1.port.refusals.total >= 2

            until(arrives)
            assert heard == {"d4"}
            until(
                lambda: any(
                    "rejected: d" in e.text for e in d1.port.member.log.next_stored_events_after(0)
                )
            )
        finally:
            d1.close()
