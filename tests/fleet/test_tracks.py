"""Neighbours' tracks where the network's router is an attacker's: neither forged tracks nor made-up
names take the room of a true one.
"""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.core.separation.track import Track
from companion.fleet import zenoh_link
from companion.fleet.messages import encode
from companion.fleet.topics import track_of
from companion.fleet.trust import Trust
from companion.fleet.zenoh_link import TRACKS, TRACKS_EACH
from ground_station.adapters.clock import monotonic_s
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import PATIENCE_S, Plain, plain_network, trust_of
from tests.fleet.zenoh_net import HERE

GUARD = pytest.mark.parametrize("guarded", [True, False], ids=["kept", "canary: lost"])


@pytest.fixture
def taken_in(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Names whose tracks d1's subscriber has taken in: zenoh calls it in the order of the puts."""
    names: set[str] = set()

    def noting(key: str) -> tuple[str, str] | None:
        found = track_of(key)
        names.add(found[0] if found is not None else "")
        return found

    monkeypatch.setattr(zenoh_link, "track_of", noting)
    return names


@pytest.fixture
def net(tmp_path: Path, taken_in: set[str]) -> Iterator[Plain]:
    """d1's own thread is stopped: the tests ask for its neighbours."""
    with plain_network(SecureSite(tmp_path / "pki"), tmp_path) as made:
        made.d1.stop()
        yield made


def track(vehicle: str, north_mps: float) -> bytes:
    told = Track(
        vehicle=vehicle, **HERE, alt_amsl_m=50.0, gnss_s=1.8e9,
        vel_n_mps=north_mps, vel_e_mps=0.0, vel_d_mps=0.0,
        pos_std_m=1.0, alt_std_m=1.0, vel_std_mps=1.0, aside=False,
    )  # fmt: skip
    return encode(told)


def neighbours(net: Plain, taken_in: set[str]) -> list[tuple[str, float]]:
    """(name, speed) of those that d1 has heard, once all that was put has been taken in: so has one
    that was put last, in a name that gets no room.
    """
    last, limit_s = f"last{len(taken_in)}", monotonic_s() + PATIENCE_S
    while last not in taken_in:
        assert monotonic_s() < limit_s
        net.put("track", b"x", last)
        threading.Event().wait(0.05)
    heard = [event.track for event in net.d1.port.neighbours(1.0)]
    return [(one.vehicle, one.vel_n_mps) for one in heard]


@GUARD
def test_forged_tracks_behind_the_true_one_do_not_hide_it(net, taken_in, monkeypatch, guarded):
    if not guarded:
        monkeypatch.setattr(zenoh_link, "TRACKS_EACH", 1)
    d2, truck = trust_of(net.site, "d2"), trust_of(net.site, "truck")
    net.put("track", d2.seal("track", track("d2", 3.0)), "d2")
    for _ in range(TRACKS_EACH - 1):
        net.put("track", truck.seal("track", track("d2", 9.0)), "d2")
    assert neighbours(net, taken_in) == ([("d2", 3.0)] if guarded else [])


def test_of_a_neighbours_tracks_the_newest_counts_and_few_are_looked_at(net, taken_in, monkeypatch):
    looked: list[bytes] = []
    told = Trust.told

    def counting(self: Trust, kind: str, raw: bytes, speaker: str | None) -> object:
        looked.append(raw)
        return told(self, kind, raw, speaker)

    monkeypatch.setattr(Trust, "told", counting)
    d2 = trust_of(net.site, "d2")
    for north_mps in range(50):
        net.put("track", d2.seal("track", track("d2", float(north_mps))), "d2")
    assert neighbours(net, taken_in) == [("d2", 49.0)]
    assert len(looked) == 1
    for _ in range(50):
        net.put("track", b"forged", "d2")
    assert neighbours(net, taken_in) == []
    assert len(looked) == 1 + TRACKS_EACH


@GUARD
def test_names_that_the_roster_does_not_list_take_no_neighbours_room(net, taken_in, guarded):
    made_up = [f"x{number}" for number in range(TRACKS)]
    if not guarded:
        listed = net.d1.port.link.trust.roster.by_name
        listed.update(dict.fromkeys(made_up, listed["d2"]))
    for name in made_up:
        net.put("track", b"x", name)
    net.put("track", trust_of(net.site, "d2").seal("track", track("d2", 3.0)), "d2")
    assert neighbours(net, taken_in) == ([("d2", 3.0)] if guarded else [])
