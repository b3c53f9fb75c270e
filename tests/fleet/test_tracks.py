"""Neighbours' tracks on a network with an attacker's router: neither forged tracks nor invented
names use the capacity for a genuine track.
"""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.fleet import neighbour_tracks
from companion.fleet.neighbour_tracks import MAX_TRACKED_NEIGHBOURS, MAX_TRACKS_PER_NEIGHBOUR
from companion.fleet.topics import vehicle_and_cell_from_key
from companion.fleet.trust import MemberTrust
from ground_station.adapters.clock import monotonic_s
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import PATIENCE_S, Plain, plain_network, trust_of
from tests.fleet.test_near_tracks import track

GUARD = pytest.mark.parametrize("guarded", [True, False], ids=["kept", "canary: lost"])


@pytest.fixture
def taken_in(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Names whose tracks d1's subscriber has processed; zenoh calls it in publication order."""
    names: set[str] = set()

    def noting(key: str) -> tuple[str, str] | None:
        found = vehicle_and_cell_from_key(key)
        names.add(found[0] if found is not None else "")
        return found

    monkeypatch.setattr(neighbour_tracks, "vehicle_and_cell_from_key", noting)
    return names


@pytest.fixture
def net(tmp_path: Path, taken_in: set[str]) -> Iterator[Plain]:
    """Stop d1's own thread: the tests poll its neighbours."""
    with plain_network(SecureSite(tmp_path / "pki"), tmp_path) as made:
        made.d1.stop()
        yield made


def neighbours(net: Plain, taken_in: set[str]) -> list[tuple[str, float]]:
    """Return (name, speed) of the neighbours that d1 received, after all published tracks are
    processed: an unlisted name is published last and awaited.
    """
    last, limit_s = f"last{len(taken_in)}", monotonic_s() + PATIENCE_S
    while last not in taken_in:
        assert monotonic_s() < limit_s
        net.put("track", b"x", last)
        threading.Event().wait(0.05)
    heard = [event.track for event in net.d1.port.take_received_tracks(1.0)]
    return [(one.vehicle, one.vel_n_mps) for one in heard]


@GUARD
def test_forged_tracks_behind_the_true_one_do_not_hide_it(net, taken_in, monkeypatch, guarded):
    if not guarded:
        monkeypatch.setattr(neighbour_tracks, "MAX_TRACKS_PER_NEIGHBOUR", 1)
    d2, truck = trust_of(net.site, "d2"), trust_of(net.site, "truck")
    net.put("track", d2.sign_in_envelope("track", track("d2", north_mps=3.0)), "d2")
    for _ in range(MAX_TRACKS_PER_NEIGHBOUR - 1):
        net.put("track", truck.sign_in_envelope("track", track("d2", north_mps=9.0)), "d2")
    assert neighbours(net, taken_in) == ([("d2", 3.0)] if guarded else [])


def test_of_a_neighbours_tracks_the_newest_counts_and_few_are_looked_at(net, taken_in, monkeypatch):
    looked: list[bytes] = []
    told = MemberTrust.verify_message_of_signer

    def counting(self: MemberTrust, kind: str, raw: bytes, speaker: str | None) -> object:
        looked.append(raw)
        return told(self, kind, raw, speaker)

    monkeypatch.setattr(MemberTrust, "verify_message_of_signer", counting)
    d2 = trust_of(net.site, "d2")
    for north_mps in range(50):
        net.put(
            "track", d2.sign_in_envelope("track", track("d2", north_mps=float(north_mps))), "d2"
        )
    assert neighbours(net, taken_in) == [("d2", 49.0)]
    assert len(looked) == 1
    for _ in range(50):
        net.put("track", b"forged", "d2")
    assert neighbours(net, taken_in) == []
    assert len(looked) == 1 + MAX_TRACKS_PER_NEIGHBOUR


@GUARD
def test_names_that_the_roster_does_not_list_take_no_neighbours_room(net, taken_in, guarded):
    made_up = [f"x{number}" for number in range(MAX_TRACKED_NEIGHBOURS)]
    if not guarded:
        listed = net.d1.port.member.link.trust.roster.member_by_name
        listed.update(dict.fromkeys(made_up, listed["d2"]))
    for name in made_up:
        net.put("track", b"x", name)
    net.put(
        "track",
        trust_of(net.site, "d2").sign_in_envelope("track", track("d2", north_mps=3.0)),
        "d2",
    )
    assert neighbours(net, taken_in) == ([("d2", 3.0)] if guarded else [])
