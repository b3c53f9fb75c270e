"""Certificate expiry, change of the authority and revocation of members, over live TLS."""

import shutil
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from companion.core.separation.track import Track
from companion.fleet.membership import JoinOptions, read_membership
from companion.fleet.messages import encode_message
from companion.fleet.topics import VehicleKeys
from companion.fleet.trust import MemberTrust
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from ground_station.adapters.called_session import ServerSession
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import FleetInput, MessageRejected, StateReceived
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import GUARD, KEPT_OUT_S, PATIENCE_S, hears, trust_of
from tests.fleet.zenoh_net import CELL, FLEET, HERE, Vehicle


@pytest.fixture
def site(tmp_path: Path) -> SecureSite:
    return SecureSite(tmp_path / "pki")


def is_heard(desk: ZenohFleet, vehicle: Vehicle, wait_s: float = PATIENCE_S) -> bool:
    """Return whether the desk receives a newer state of this life of the vehicle."""
    from_s, life = vehicle.port.member.uptime_s, vehicle.port.member.instance_id

    def new(heard: FleetInput) -> bool:
        state = heard.state if isinstance(heard, StateReceived) else None
        return state is not None and state.instance_id == life and state.uptime_s > from_s

    return bool(hears(desk, new, wait_s))


@pytest.mark.sample
def test_a_vehicle_whose_certificate_has_ended_joins_again_once_it_is_renewed(site, tmp_path):
    site.pki.now -= timedelta(days=400)
    site.pki.renew_member_certificates(["d1"], 365)
    desk, late = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    try:
        assert not is_heard(desk, late, KEPT_OUT_S)
    finally:
        late.close()
    site.pki.now += timedelta(days=400)
    site.pki.renew_member_certificates(["d1"], 365)
    renewed = site.vehicle("d1", tmp_path / "d1")
    try:
        assert is_heard(desk, renewed)
    finally:
        renewed.close()
        desk.close()


@pytest.mark.sample
def test_a_connected_vehicle_lives_through_a_change_of_the_authority(site, tmp_path):
    """As in docs/how-to/secure-a-fleet.md: trust both authorities, renew all, end the old one."""
    site.pki.add_second_authority()
    desk, d1 = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    old = Path(shutil.copytree(site.home("d2"), tmp_path / "old-d2"))
    late: Vehicle | None = None
    try:
        assert is_heard(desk, d1)
        for name in ("desk", "d1", "d2"):
            site.pki.renew_member_certificates([name], 365)
        desk = restarted(site, desk)
        assert is_heard(desk, d1), "it knows both: it comes back by itself"
        late = joined_with(old, "d2", tmp_path / "d2")
        assert is_heard(desk, late), "canary: the old authority's certificate counts until retired"
        d1.close()
        d1 = site.vehicle("d1", tmp_path / "d1")  # loads its new certificate
        assert is_heard(desk, d1)
        site.pki.remove_oldest_authority()
        desk = restarted(site, desk)
        assert is_heard(desk, d1), "it comes back by itself"
        assert not is_heard(desk, late, KEPT_OUT_S), "the old authority's certificate is no more"
    finally:
        for one in (late, d1, desk):
            if one is not None:
                one.close()


def restarted(site: SecureSite, desk: ZenohFleet) -> ZenohFleet:
    desk.close()
    return site.person("desk")


def joined_with(folder: Path, name: str, kept: Path) -> Vehicle:
    membership = read_membership(VehicleKeys(FLEET, name), None, JoinOptions(folder))
    return Vehicle.on(name, kept, membership.open_link)


TRACK: dict[str, Any] = {
    **HERE, "alt_amsl_m": 50.0, "gnss_s": 1.8e9, "avoiding": False,
    **dict.fromkeys(("vel_n_mps", "vel_e_mps", "vel_d_mps"), 0.0),
    **dict.fromkeys(("pos_std_m", "alt_std_m", "vel_std_mps"), 1.0),
}  # fmt: skip


@pytest.mark.sample
@GUARD
def test_a_revoked_member_whose_line_is_open_is_heard_by_nobody(
    site, tmp_path, monkeypatch, guarded
):
    """Neither the desk nor its neighbours accept it, before the desk's session is reopened."""
    import zenoh

    monkeypatch.setattr(ServerSession, "poll_and_check_if_reopen_due", lambda self, now_s: False)
    if not guarded:
        monkeypatch.setattr(MemberTrust, "store_roster_if_newer", lambda self, raw: None)
    author, key = trust_of(site, "d2"), VehicleKeys(FLEET, "d2")
    track = author.sign_in_envelope("track", encode_message(Track(vehicle="d2", **TRACK)))
    desk, d1 = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    try:
        assert is_heard(desk, d1)
        d1.stop()
        with zenoh.open(read_and_check_zenoh_config(site.home("d2") / "zenoh.json5")) as d2:

            def hears_track(wait_s):
                return heard_track(desk, d1, d2, key.track_key(CELL), track, wait_s)

            assert hears_track(PATIENCE_S)
            site.pki.revoke_members("d2")
            if guarded:
                taken(desk, d1, site.pki.roster.number)
            assert hears_track(KEPT_OUT_S if guarded else PATIENCE_S) is not guarded
            d2.put(key.state_key, author.sign_in_envelope("state", b"{}"))
            said = hears(desk, rejected, PATIENCE_S)
            assert ("d2 is revoked" in said) is guarded, "its line is open"
    finally:
        d1.close()
        desk.close()


def rejected(heard: FleetInput) -> str:
    return heard.reason if isinstance(heard, MessageRejected) and heard.key == "d2" else ""


def turn(desk: ZenohFleet, vehicle: Vehicle) -> None:
    desk.receive(0.02)
    vehicle.port.process_commands(lambda command: vehicle.answer)


def taken(desk: ZenohFleet, vehicle: Vehicle, number: int) -> None:
    """Wait until the desk and the vehicle have this roster in force."""
    limit_s = monotonic_s() + PATIENCE_S
    while vehicle.port.member.link.trust.roster.number < number:
        assert monotonic_s() < limit_s
        turn(desk, vehicle)


def heard_track(
    desk: ZenohFleet, d1: Vehicle, d2: Any, key: str, track: bytes, wait_s: float
) -> bool:
    limit_s = monotonic_s() + wait_s
    while monotonic_s() < limit_s:
        d2.put(key, track)
        turn(desk, d1)
        if any(event.track.vehicle == "d2" for event in d1.port.take_received_tracks(1.0)):
            return True
    return False
