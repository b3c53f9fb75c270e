"""Two neighbouring fleets: signed tracks are exchanged, and nothing else."""

import json
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh

from companion.core.base.errors import LeewayError
from companion.core.mission.actions import PublishTrack
from companion.core.mission.events import NeighbourTrackReceived
from companion.core.mission.flight_file import NeighbourFleet
from companion.fleet import neighbour_tracks, signed_link
from companion.fleet.neighbour_tracks import MAX_TRACKED_NEIGHBOURS
from companion.fleet.roles import Role
from companion.fleet.topics import VehicleKeys, roster_key, vehicle_and_cell_from_key
from companion.fleet.trust import MemberTrust
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_link import ZenohLink
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.neighbour_line import (
    MAX_TRACK_BYTES,
    VEHICLE_BURST,
    VEHICLE_RATE_HZ,
    NeighbourConnection,
    neighbour_identity_folder,
)
from ground_station.adapters.pki.neighbours import add_mutual_neighbour_identities
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.adapters.zenoh_router import ZenohRouter
from tests.fleet.secure_site import YEAR_DAYS, SecureSite
from tests.fleet.strangers import PATIENCE_S, Plain, plain_network, trust_of
from tests.fleet.test_near_tracks import router_and_client, track, until
from tests.fleet.zenoh_net import CELL, FLEET, HERE, Vehicle
from tests.ground_station.desk_parts import a_state

pytestmark = pytest.mark.sample

PIER = "pier"
KEPT_OUT_S = 2.0
REST = {"alt_amsl_m": 50.0, "vel_ned_mps": (1.0, 2.0, 0.0), "on_setpoints": True}


def tell(vehicle: Vehicle) -> None:
    vehicle.port.report_action_to_desk(PublishTrack(1.8e9, **HERE, **REST))


def names(vehicle: Vehicle) -> list[str]:
    """Return the names of the neighbours received since the last call."""
    events = vehicle.port.take_received_tracks(1.0)
    return [
        event.full_vehicle_name for event in events if isinstance(event, NeighbourTrackReceived)
    ]


# --- one network, no identities -------------------------------------------------------------------


def test_a_neighbouring_fleets_vehicle_of_our_own_name_is_heard_while_it_is_wished(tmp_path):
    with router_and_client(tmp_path) as (_, client), ExitStack() as ends:
        ours = Vehicle("d1", tmp_path / "ours", client)
        theirs = Vehicle.on(
            "d1",
            tmp_path / "theirs",
            lambda life: ZenohLink(
                read_and_check_zenoh_config(client), VehicleKeys(PIER, "d1"), life, lambda: None
            ),
        )
        d2 = Vehicle("d2", tmp_path / "d2", client)
        for one in (ours, theirs, d2):
            ends.callback(one.close)
        heard: list[str] = []

        def hears(*whom: str) -> Callable[[], bool]:
            def look() -> bool:
                for one in (theirs, d2, ours):
                    tell(one)
                heard.extend(names(ours))
                return set(whom) <= set(heard)

            return look

        until(hears("d2"))
        ours.port.member.link.subscribe_fleets(
            [NeighbourFleet(fleet=PIER), NeighbourFleet(fleet=FLEET)]
        )
        assert "pier/d1" not in heard
        until(hears("pier/d1"))
        assert set(heard) == {"d2", "pier/d1"}, "nobody is a neighbour of its own fleet"
        ours.port.member.link.subscribe_fleets(())
        threading.Event().wait(1.5)  # the network updates its subscriptions
        names(ours)
        heard.clear()
        until(hears("d2"))
        assert "pier/d1" not in heard


# --- two networks with identities -----------------------------------------------------------------


@dataclass
class Town:
    """Two fleets, each with a desk as its router; the desks are neighbours."""

    harbour: SecureSite
    pier: SecureSite

    @classmethod
    def made(cls, folder: Path, *, introduced: bool = True) -> "Town":
        town = cls(SecureSite(folder / "harbour"), SecureSite(folder / "pier", fleet=PIER))
        if introduced:
            add_mutual_neighbour_identities([town.harbour.pki, town.pier.pki], YEAR_DAYS)
        return town

    def neighbour(self, site: SecureSite, name: str = "d1") -> NeighbourFleet:
        """Return the entry that a desk sends for a vehicle of this fleet."""
        key = site.pki.roster.member_by_name[name].key
        return NeighbourFleet(fleet=site.fleet, keys={name: key})


@pytest.fixture
def town(tmp_path: Path) -> Town:
    return Town.made(tmp_path)


@dataclass
class Met:
    """Both desks, and a d1 of each fleet at the same position."""

    town: Town
    desk: ZenohFleet
    other: ZenohFleet
    ours: Vehicle
    theirs: Vehicle

    def turn(self) -> None:
        """Run one cycle of both desks and publish both tracks."""
        self.desk.receive(0.02)
        self.other.receive(0.02)
        for one in (self.ours, self.theirs):
            tell(one)


@pytest.fixture
def meet(tmp_path: Path) -> Iterator[Callable[..., Met]]:
    with ExitStack() as ends:

        def make(town: Town, *, lines: bool = True) -> Met:
            def desk(site: SecureSite, other: str) -> ZenohFleet:
                return ends.enter_context(
                    closing(site.person("desk", neighbours=[other] if lines else []))
                )

            def d1(site: SecureSite) -> Vehicle:
                return ends.enter_context(closing(site.vehicle("d1", tmp_path / site.fleet / "d1")))

            return Met(
                town,
                desk(town.harbour, PIER),
                desk(town.pier, FLEET),
                d1(town.harbour),
                d1(town.pier),
            )

        yield make


@pytest.mark.parametrize("lines", [True, False], ids=["heard", "canary: no lines"])
def test_with_identities_both_hear_one_another_by_way_of_their_desks(town, meet, lines):
    met = meet(town, lines=lines)
    if lines:
        keys = met.desk.neighbour_keys(PIER)
        assert keys == {n: town.pier.pki.roster.member_by_name[n].key for n in ("d1", "d2")}, (
            "no truck"
        )
        assert met.desk.neighbour_keys("elsewhere") == {}
    else:
        keys = {"d1": town.pier.pki.roster.member_by_name["d1"].key}
    met.ours.port.member.link.subscribe_fleets([NeighbourFleet(fleet=PIER, keys=dict(keys))])
    met.theirs.port.member.link.subscribe_fleets([town.neighbour(town.harbour)])
    ours, theirs = set[str](), set[str]()

    def both_hear() -> bool:
        met.turn()
        ours.update(names(met.ours))
        theirs.update(names(met.theirs))
        return ours == {"pier/d1"} and theirs == {"harbour/d1"}

    if lines:
        until(both_hear)
        return
    limit_s = monotonic_s() + KEPT_OUT_S
    while monotonic_s() < limit_s:
        both_hear()
    assert not ours | theirs


def test_by_way_of_a_router_too_they_hear_a_neighbour(tmp_path):
    """Harbour's desk accepts no connections: it forwards the neighbour's tracks to its router."""
    town = Town(
        SecureSite(tmp_path / "harbour", routers=("r1",)), SecureSite(tmp_path / "pier", fleet=PIER)
    )
    add_mutual_neighbour_identities([town.harbour.pki, town.pier.pki], YEAR_DAYS)
    with (
        closing(ZenohRouter.open_router(town.harbour.home("r1"), print)) as router,
        closing(town.pier.person("desk")) as other,
        closing(town.harbour.person("desk", neighbours=[PIER])) as desk,
        closing(town.harbour.vehicle("d1", tmp_path / "h" / "d1")) as ours,
        closing(town.pier.vehicle("d1", tmp_path / "p" / "d1")) as theirs,
    ):
        ours.port.member.link.subscribe_fleets([town.neighbour(town.pier)])

        def hears() -> bool:
            router.accept_roster_and_reopen_if_stale(monotonic_s())
            other.receive(0.02)
            desk.receive(0.02)
            tell(theirs)
            return "pier/d1" in names(ours)

        until(hears)


def test_whose_keys_the_desk_has_not_told_is_not_heard_and_that_is_said(town, meet):
    met = meet(town)
    met.ours.port.member.link.subscribe_fleets([NeighbourFleet(fleet=PIER)])
    met.theirs.port.member.link.subscribe_fleets([town.neighbour(town.harbour)])
    heard, by_theirs = set[str](), set[str]()

    def theirs_hears() -> bool:
        met.turn()
        heard.update(names(met.ours))
        by_theirs.update(names(met.theirs))
        return "harbour/d1" in by_theirs

    until(theirs_hears)
    assert not heard
    words = "no vehicle keys: no separation from pier"
    until(
        lambda: any(
            words in event.text for event in met.ours.port.member.log.next_stored_events_after(0)
        )
    )


def test_a_desk_says_whether_its_line_to_a_neighbour_stands(tmp_path, monkeypatch):
    monkeypatch.setattr("ground_station.adapters.neighbour_line.STATUS_INTERVAL_S", 1.0)
    town, said = Town.made(tmp_path), list[str]()
    with closing(town.harbour.person("desk", neighbours=[PIER], say=said.append)) as desk:
        until(lambda: desk.receive(0.02) or any("pier NOT CONNECTED" in words for words in said))
        with closing(town.pier.person("desk")):
            until(lambda: desk.receive(0.02) or any("pier connected" in words for words in said))


def test_a_desk_without_its_neighbours_folder_does_not_begin(tmp_path):
    town = Town.made(tmp_path, introduced=False)
    with pytest.raises(LeewayError, match=r"pki add harbour --role neighbour"):
        town.harbour.person("desk", neighbours=[PIER])
    with closing(town.harbour.person("desk")):
        pass  # its address is available again


def test_a_folder_of_another_role_is_refused(tmp_path):
    town = Town.made(tmp_path, introduced=False)
    town.pier.pki.add_member(FLEET, Role.VIEWER, YEAR_DAYS, "")
    there = neighbour_identity_folder(town.harbour.home("desk"), PIER)
    there.parent.mkdir()
    town.pier.home(FLEET).rename(there)
    with pytest.raises(LeewayError, match="harbour is a viewer there"):
        town.harbour.person("desk", neighbours=[PIER])


# --- access rules ---------------------------------------------------------------------------------


def raw_session(folder: Path) -> zenoh.Session:
    return zenoh.open(read_and_check_zenoh_config(folder / "zenoh.json5"))


def without_rules(folder: Path) -> None:
    path = folder / "zenoh.json5"
    table = json.loads(path.read_text())
    table["access_control"]["enabled"] = False
    path.write_text(json.dumps(table))


@pytest.mark.parametrize("guarded", [True, False], ids=["rules", "canary: no rules"])
def test_a_neighbour_hears_tracks_and_rosters_tells_nothing_and_asks_nothing(
    town, tmp_path, guarded
):
    """A client with the key that harbour issued to pier, on harbour's network."""
    if not guarded:
        without_rules(town.harbour.home("desk"))
    heard: set[str] = set()
    desk, d1 = town.harbour.person("desk"), town.harbour.vehicle("d1", tmp_path / "d1")
    d2 = town.harbour.vehicle("d2", tmp_path / "d2")
    try:
        with raw_session(neighbour_identity_folder(town.pier.home("desk"), FLEET)) as neighbour:
            d1_keys = VehicleKeys(FLEET, "d1")
            every = [
                neighbour.declare_subscriber(key, lambda s: heard.add(str(s.key_expr)))
                for key in ("leeway/**", d1_keys.state_key, d1_keys.event_key, d1_keys.command_key)
            ]
            near = neighbour.declare_subscriber(
                VehicleKeys(FLEET, "*").track_key(CELL), lambda s: heard.add("near")
            )
            forged_raw = trust_of(town.harbour, "d2").sign_in_envelope(
                "track", track("d2", north_mps=9.0)
            )

            def all_told() -> bool:
                desk.receive(0.02)
                tell(d1)
                neighbour.put(VehicleKeys(FLEET, "d2").track_key(CELL), forged_raw)
                forged.extend(e.track.vel_n_mps for e in d1.port.take_received_tracks(1.0))
                return "near" in heard

            forged: list[float] = []
            until(all_told)
            limit_s = monotonic_s() + KEPT_OUT_S
            while monotonic_s() < limit_s:
                all_told()
                tell(d2)
            replies = list(
                neighbour.get(
                    VehicleKeys(FLEET, "d1").command_key, payload=b"x", timeout=KEPT_OUT_S
                )
            )
            states = list(neighbour.get(VehicleKeys(FLEET, "*").state_key, timeout=KEPT_OUT_S))
            rosters = list(neighbour.get(f"{roster_key(FLEET)}?above=0", timeout=PATIENCE_S))
            assert any(reply.ok is not None for reply in rosters)
            assert (9.0 in forged) is not guarded
            assert any(reply.ok is not None for reply in [*replies, *states]) is not guarded
            assert (d1_keys.state_key in heard) is not guarded
            assert all(key == "near" or "/track/" in key for key in heard) is guarded
            for one in every:
                one.undeclare()
            near.undeclare()
    finally:
        for one in (d1, d2, desk):
            one.close()


@pytest.mark.parametrize("guarded", [True, False], ids=["rules", "canary: no rules"])
def test_a_vehicle_hears_its_neighbours_tracks_only_and_tells_none_in_their_name(
    town, tmp_path, guarded
):
    if not guarded:
        without_rules(town.harbour.home("desk"))
    heard: set[str] = set()
    with (
        raw_session(town.harbour.home("desk")) as desk,
        raw_session(town.harbour.home("d1")) as d1,
        raw_session(town.harbour.home("d2")) as d2,
    ):
        keys = VehicleKeys(PIER, "d1")
        held = [
            d1.declare_subscriber(key, lambda s: heard.add(f"{s.key_expr} {s.payload.to_string()}"))
            for key in (keys.track_key(CELL), keys.state_key, keys.command_key, "leeway/quay/**")
        ]

        def arrives() -> bool:
            for key in (keys.track_key(CELL), keys.state_key, "leeway/quay/vehicle/d1/track/1/2"):
                desk.put(key, "desk")  # the neighbour line publishes in the same way
                d2.put(key, "d2")
            return f"{keys.track_key(CELL)} desk" in heard

        until(arrives)
        limit_s = monotonic_s() + KEPT_OUT_S
        while monotonic_s() < limit_s:
            arrives()
        assert (heard == {f"{keys.track_key(CELL)} desk"}) is guarded
        for one in held:
            one.undeclare()


def test_who_is_revoked_as_a_neighbour_hears_nothing_and_is_not_heard(town):
    before = len(town.harbour.pki.roster.neighbour_fleet_names)
    town.harbour.pki.revoke_members(PIER)
    assert (before, town.harbour.pki.roster.neighbour_fleet_names) == (1, [])
    rules = json.loads((town.harbour.home("desk") / "zenoh.json5").read_text())["access_control"]
    assert PIER not in json.dumps(rules)


# --- signatures, without access rules -------------------------------------------------------------


@pytest.fixture
def plain(town: Town, tmp_path: Path) -> Iterator[Plain]:
    """An attacker's router; harbour's d1 listens to pier's d1 and d2 and to its own fleet."""
    with plain_network(town.harbour, tmp_path) as made:
        made.d1.stop()
        keys = {n: town.pier.pki.roster.member_by_name[n].key for n in ("d1", "d2")}
        made.d1.port.member.link.subscribe_fleets([NeighbourFleet(fleet=PIER, keys=keys)])
        publisher = made.rogue.declare_publisher(VehicleKeys(PIER, "d2").track_key(CELL))
        until(lambda: publisher.matching_status.matching)
        publisher.undeclare()
        yield made


def put(net: Plain, fleet: str, vehicle: str, raw: bytes) -> None:
    key = VehicleKeys(fleet, vehicle).track_key(CELL)
    net.rogue.put(key, raw, congestion_control=zenoh.CongestionControl.BLOCK)


def heard_until_last(net: Plain, last: MemberTrust) -> list[tuple[str, float]]:
    """Return (name, speed) that d1 accepts, until pier's d2, which is published last, arrives."""
    found: list[tuple[str, float]] = []

    def last_arrives() -> bool:
        put(net, PIER, "d2", last.sign_in_envelope("track", track("d2", north_mps=1.0)))
        events = net.d1.port.take_received_tracks(1.0)
        found.extend(
            (e.full_vehicle_name, e.track.vel_n_mps)
            for e in events
            if isinstance(e, NeighbourTrackReceived)
        )
        return ("pier/d2", 1.0) in found

    until(last_arrives)
    return [one for one in found if one != ("pier/d2", 1.0)]


FORGED: dict[str, Callable[[Town], tuple[str, str, bytes]]] = {
    "by another vehicle of the neighbour": lambda town: (
        PIER, "d1", trust_of(town.pier, "d2").sign_in_envelope("track", track("d1",
        north_mps=9.0))),
    "by our own vehicle in a neighbour's name": lambda town: (
        PIER, "d1", trust_of(town.harbour, "d1").sign_in_envelope("track", track("d1",
        north_mps=9.0))),
    "by the neighbour's vehicle in our vehicle's name": lambda town: (
        FLEET, "d2", trust_of(town.pier, "d2").sign_in_envelope("track", track("d2",
        north_mps=9.0))),
    "by the neighbour's vehicle in our own name": lambda town: (
        FLEET, "d1", trust_of(town.pier, "d1").sign_in_envelope("track", track("d1",
        north_mps=9.0))),
    "by the neighbour's truck": lambda town: (
        PIER, "truck", trust_of(town.pier, "truck").sign_in_envelope("track", track("truck",
        north_mps=9.0))),
    "by a vehicle that the desk did not name": lambda town: (
        PIER, "d9", trust_of(town.pier, "d2").sign_in_envelope("track", track("d9",
        north_mps=9.0))),
    "as another kind of message": lambda town: (
        PIER, "d1", trust_of(town.pier, "d1").sign_in_envelope("state", track("d1",
        north_mps=9.0))),
    "unsigned": lambda town: (PIER, "d1", track("d1", north_mps=9.0)),
    "that tells of another": lambda town: (
        PIER, "d1", trust_of(town.pier, "d1").sign_in_envelope("track", track("d2",
        north_mps=9.0))),
}  # fmt: skip


@pytest.mark.parametrize("how", FORGED)
def test_a_forged_track_changes_nothing(plain, town, how):
    put(plain, *FORGED[how](town))
    assert heard_until_last(plain, trust_of(town.pier, "d2")) == []


def test_a_true_track_of_the_same_vehicle_is_heard_and_told_from_ours(plain, town):
    """Canary of the forged tracks; also the d2 of both fleets side by side."""
    put(
        plain,
        PIER,
        "d1",
        trust_of(town.pier, "d1").sign_in_envelope("track", track("d1", north_mps=9.0)),
    )
    ours = trust_of(town.harbour, "d2").sign_in_envelope("track", track("d2", north_mps=8.0))
    put(plain, FLEET, "d2", ours)
    heard = heard_until_last(plain, trust_of(town.pier, "d2"))
    assert sorted(set(heard)) == [("d2", 8.0), ("pier/d1", 9.0)]


def test_without_a_look_at_the_signature_the_forged_one_would_be_believed(plain, town, monkeypatch):
    from companion.fleet.envelope import decode_envelope

    monkeypatch.setattr(
        signed_link,
        "verify_neighbour_track",
        lambda neighbour, raw, speaker: decode_envelope("track", raw).message,
    )
    put(plain, *FORGED["by another vehicle of the neighbour"](town))
    assert heard_until_last(plain, trust_of(town.pier, "d2")) == [("pier/d1", 9.0)]


def test_a_flood_in_a_neighbours_names_takes_the_room_of_none_of_ours(plain, town, monkeypatch):
    taken_in: set[str] = set()

    def noting(key: str) -> tuple[str, str] | None:
        taken_in.add(key)
        return vehicle_and_cell_from_key(key)

    monkeypatch.setattr(neighbour_tracks, "vehicle_and_cell_from_key", noting)
    made_up = {f"x{number}": "0" * 64 for number in range(MAX_TRACKED_NEIGHBOURS)}
    plain.d1.port.member.link.subscribe_fleets([NeighbourFleet(fleet=PIER, keys=made_up)])
    for name in made_up:
        put(plain, PIER, name, b"x")
    raw = trust_of(town.harbour, "d2").sign_in_envelope("track", track("d2", north_mps=8.0))
    put(plain, FLEET, "d2", raw)
    until(lambda: VehicleKeys(FLEET, "d2").track_key(CELL) in taken_in)  # in publication order
    assert {VehicleKeys(PIER, name).track_key(CELL) for name in made_up} <= taken_in
    assert names(plain.d1) == ["d2"]


# --- neighbour line -------------------------------------------------------------------------------


def test_the_line_brings_tracks_of_listed_vehicles_only_and_few_of_each(town):
    """From a faulty desk of the neighbouring fleet, which publishes arbitrary keys."""
    seen: Counter[str] = Counter()
    own, here = VehicleKeys(PIER, "d1"), a_state(uptime_s=1.0, phase="outbound", **HERE)
    folder = neighbour_identity_folder(town.harbour.home("desk"), PIER)
    with (
        raw_session(town.pier.home("desk")) as wrong,
        closing(
            NeighbourConnection(FLEET, PIER, folder, lambda key, raw: seen.update([key]), print)
        ) as line,
    ):

        def put_all() -> bool:
            line.subscribe_near_own_vehicle(here)
            for vehicle in ("d1", "truck", "d9"):
                keys = VehicleKeys(PIER, vehicle)
                for key in (
                    keys.track_key(CELL),
                    keys.track_key("1/2"),
                    keys.state_key,
                    keys.event_key,
                ):
                    wrong.put(key, b"x")
            wrong.put(own.track_key(CELL), bytes(MAX_TRACK_BYTES + 1))
            return seen[own.track_key(CELL)] > 0

        until(put_all)
        began_s = monotonic_s()
        for _ in range(500):
            wrong.put(own.track_key(CELL), b"flood")
        while monotonic_s() < began_s + KEPT_OUT_S:
            put_all()
            threading.Event().wait(0.02)
        assert set(seen) == {own.track_key(CELL)}
        took_s = monotonic_s() - began_s
        assert seen[own.track_key(CELL)] <= 2 * VEHICLE_BURST + VEHICLE_RATE_HZ * took_s < 500


def test_who_is_revoked_at_a_neighbour_is_named_in_no_later_flight(town, meet):
    met = meet(town)
    assert set(met.desk.neighbour_keys(PIER)) == {"d1", "d2"}
    town.pier.pki.revoke_members("d1")
    until(lambda: met.turn() or set(met.desk.neighbour_keys(PIER)) == {"d2"})
