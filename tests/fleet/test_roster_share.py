"""A new roster reaches every member over TLS: connected ones at once, absent ones at their join."""

import pytest
import zenoh

from companion.fleet.topics import roster_key
from companion.fleet.trust import MemberTrust
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from ground_station.adapters.called_session import ServerSession
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import EventsReceived, MessageRejected, StateReceived
from tests.fleet.secure_site import SecureSite
from tests.fleet.zenoh_net import FLEET

PATIENCE_S = 20.0


def told(desk: ZenohFleet, words: str, wait_s: float = PATIENCE_S) -> bool:
    """Return whether the desk receives or reports a text that contains these words."""
    limit_s = monotonic_s() + wait_s
    while monotonic_s() < limit_s:
        for heard in desk.receive(0.05):
            texts = (
                [event.text for event in heard.events] if isinstance(heard, EventsReceived) else []
            )
            texts += [heard.reason] if isinstance(heard, MessageRejected) else []
            texts += [heard.state.text] if isinstance(heard, StateReceived) else []
            if any(words in text for text in texts):
                return True
    return False


@pytest.mark.sample
@pytest.mark.parametrize("there", [True, False], ids=["it was there", "it was away"])
def test_a_vehicle_takes_the_roster_that_a_desk_tells_and_keeps_it(tmp_path, there):
    site = SecureSite(tmp_path / "pki")
    site.keep_rosters_of("d1")
    number = site.pki.roster.number + 1
    desk = site.person("desk")
    vehicle = site.vehicle("d1", tmp_path / "d1") if there else None
    if vehicle is not None:
        assert told(desk, "")
    site.pki.revoke_members("anna")
    site.restore_rosters()
    vehicle = vehicle or site.vehicle("d1", tmp_path / "d1")
    try:
        assert told(desk, f"roster {number} is in force")
    finally:
        vehicle.close()
        desk.close()
    kept = site.identity("d1").trust.roster
    assert (kept.number, kept.member_by_name["anna"].revoked) == (number, True)


@pytest.mark.sample
def test_who_joins_is_told_the_number_and_the_whole_goes_to_all_only_when_it_is_new(tmp_path):
    site = SecureSite(tmp_path / "pki")
    desk = site.person("desk")
    told_bytes: list[bytes] = []
    with zenoh.open(read_and_check_zenoh_config(site.home("otto") / "zenoh.json5")) as otto:
        spy = otto.declare_subscriber(
            roster_key(FLEET), lambda sample: told_bytes.append(sample.payload.to_bytes())
        )
        vehicle = site.vehicle("d1", tmp_path / "d1")
        number = str(site.pki.roster.number).encode()
        try:
            assert told(desk, "")
            limit_s = monotonic_s() + PATIENCE_S
            while number not in told_bytes and monotonic_s() < limit_s:
                desk.receive(0.05)
            assert set(told_bytes) == {number}
            site.pki.revoke_members("d2")
            assert told(desk, f"roster {site.pki.roster.number} is in force")
            assert site.identity("desk").read_roster_file() in told_bytes
        finally:
            vehicle.close()
            desk.close()
        spy.undeclare()


@pytest.mark.sample
@pytest.mark.parametrize("guarded", [True, False], ids=["refused", "canary: believed"])
def test_a_vehicle_that_is_revoked_is_not_believed_any_more(tmp_path, monkeypatch, guarded):
    """Even if the network's rules still admit it, the desk refuses the messages that it signs."""
    monkeypatch.setattr(ServerSession, "poll_and_check_if_reopen_due", lambda self, now_s: False)
    if not guarded:
        monkeypatch.setattr(MemberTrust, "store_roster_if_newer", lambda self, raw: None)
    site = SecureSite(tmp_path / "pki")
    desk, vehicle = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    try:
        assert told(desk, "")
        site.pki.revoke_members("d1")
        assert told(desk, "d1 is revoked", PATIENCE_S if guarded else 2.5) is guarded
    finally:
        vehicle.close()
        desk.close()
