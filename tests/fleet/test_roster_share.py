"""A new roster gets to everybody over TLS: to who is there, and to who was away when it joins."""

import pytest

from companion.fleet.trust import Trust
from ground_station.adapters.called_session import CalledSession
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import EventsReceived, MessageRejected, StateReceived
from tests.fleet.secure_site import SecureSite

PATIENCE_S = 20.0


def told(desk: ZenohFleet, words: str, wait_s: float = PATIENCE_S) -> bool:
    """Whether a vehicle tells this, or the desk does."""
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


@pytest.mark.parametrize("there", [True, False], ids=["it was there", "it was away"])
def test_a_vehicle_takes_the_roster_that_a_desk_tells_and_keeps_it(tmp_path, there):
    site = SecureSite(tmp_path / "pki")
    site.keep_rosters_of("d1")
    number = site.pki.roster.number + 1
    desk = site.person("desk")
    vehicle = site.vehicle("d1", tmp_path / "d1") if there else None
    if vehicle is not None:
        assert told(desk, "")
    site.pki.revoke("anna")
    site.restore_rosters()
    vehicle = vehicle or site.vehicle("d1", tmp_path / "d1")
    try:
        assert told(desk, f"roster {number} is in force")
    finally:
        vehicle.close()
        desk.close()
    kept = site.identity("d1").trust.roster
    assert (kept.number, kept.by_name["anna"].revoked) == (number, True)


@pytest.mark.parametrize("guarded", [True, False], ids=["refused", "canary: believed"])
def test_a_vehicle_that_is_revoked_is_not_believed_any_more(tmp_path, monkeypatch, guarded):
    """Where the rules of the network still let it in: the desk refuses what it signs."""
    monkeypatch.setattr(CalledSession, "is_old", lambda self, now_s: False)
    if not guarded:
        monkeypatch.setattr(Trust, "take_roster", lambda self, raw: None)
    site = SecureSite(tmp_path / "pki")
    desk, vehicle = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    try:
        assert told(desk, "")
        site.pki.revoke("d1")
        assert told(desk, "d1 is revoked", PATIENCE_S if guarded else 2.5) is guarded
    finally:
        vehicle.close()
        desk.close()
