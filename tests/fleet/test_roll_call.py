"""Members whose join was missed: the desk finds them by a roll call, and a member that receives no
request joins again.
"""

import json
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from companion.fleet import zenoh_link
from companion.fleet.identity import ROSTER
from companion.fleet.roles import Role
from companion.fleet.roster import Roster
from companion.fleet.signed_link import SignedLink
from companion.fleet.topics import VehicleKeys, vehicle_and_instance_from_key
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_link import ZenohLink
from ground_station.adapters import called_session
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.fleet_inbox import NOT_ON_ROSTER
from ground_station.adapters.pki.access_rules import access_control_config
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import FleetInput, LivelinessChanged, MessageRejected
from tests.fleet.secure_site import YEAR_DAYS, SecureSite
from tests.fleet.strangers import KEPT_OUT_S, PATIENCE_S, hears, plain_network
from tests.fleet.test_called_session import Running, running
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port


def is_not_listed(heard: FleetInput) -> bool:
    return isinstance(heard, MessageRejected) and heard.reason == NOT_ON_ROSTER


def d3_joined(heard: FleetInput) -> bool:
    return isinstance(heard, LivelinessChanged) and heard.vehicle == "d3"


@pytest.mark.sample
@pytest.mark.parametrize("asks", [True, False], ids=["found", "canary: missed"])
def test_who_joined_before_the_roster_listed_it_is_found_by_the_roll_call(tmp_path, asks):
    site = SecureSite(tmp_path / "pki")
    held = site.home("desk") / ROSTER
    old = held.read_bytes()
    site.pki.add_member("d3", Role.VEHICLE, YEAR_DAYS, "")
    new = held.read_bytes()
    held.write_bytes(old)
    with plain_network(site, tmp_path) as net:
        d3 = site.vehicle("d3", tmp_path / "d3", zenoh=tmp_path / "client.json5")
        assert hears(net.desk, is_not_listed, PATIENCE_S)
        held.write_bytes(new)
        limit_s = monotonic_s() + PATIENCE_S
        while "d3" not in listed(net.desk):
            assert monotonic_s() < limit_s
            net.desk.receive(0.1)
        found = any(called(net.desk, asks) for _ in range(3))  # a desk calls the roll each minute
        d3.close()
    assert found is asks


def called(desk: ZenohFleet, asks: bool) -> bool:
    if asks:
        desk.request_states(PATIENCE_S)
    return bool(hears(desk, d3_joined, PATIENCE_S / 2.0 if asks else 1.0))


def listed(desk: ZenohFleet) -> set[str]:
    figures = desk.certificate_expiry_dates()
    assert figures is not None
    return {name for name, _ in figures.member_expiries_us}


@contextmanager
def router(folder: Path) -> Iterator[tuple[zenoh.Session, Path]]:
    port = free_port()
    listens = config_file(folder / "router.json5", listen=port, mode="router")
    calls = config_file(folder / "client.json5", connect=port)
    calls.write_text(json.dumps(json.loads(calls.read_text()) | {"mode": "client"}))
    with zenoh.open(read_and_check_zenoh_config(listens)) as session:
        yield session, calls


@pytest.mark.sample
@pytest.mark.parametrize("asked", [False, True], ids=["joins anew", "canary: stays"])
def test_a_connected_member_that_nobody_asks_joins_anew(tmp_path, monkeypatch, asked):
    monkeypatch.setattr(zenoh_link, "REJOIN_WITHOUT_REQUEST_S", 1.5)
    keys, seen, idle = VehicleKeys(FLEET, "d1"), [], threading.Event()
    with router(tmp_path) as (session, calls):

        def hear(sample: zenoh.Sample) -> None:
            assert vehicle_and_instance_from_key(str(sample.key_expr)) == ("d1", "a")
            seen.append(sample.kind)

        ear = session.liveliness().declare_subscriber(keys.alive_key(), hear, history=True)
        link = ZenohLink(read_and_check_zenoh_config(calls), keys, "a", lambda: None)
        link.publish_state(b"state")
        answers, until_s = 0, monotonic_s() + (5.0 if asked else PATIENCE_S)
        while monotonic_s() < until_s and seen.count(zenoh.SampleKind.PUT) < 2:
            if asked:
                answers += len(list(session.get(keys.state_key, timeout=0.3)))
            else:
                idle.wait(0.1)
        link.close()
        ear.undeclare()
    assert (seen[:3] == [zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE, zenoh.SampleKind.PUT]) is (
        not asked
    )
    assert bool(answers) is asked


def asked_by(fleet: Running, vehicle: Vehicle) -> bool:
    """Return whether the desk's request for all states reaches this vehicle."""
    link = vehicle.port.member.link
    assert isinstance(link, SignedLink)
    assert isinstance(link.link, ZenohLink)
    assert link.link.do_all_clients_read_wind_cov() is False
    fleet.desk.request_states(KEPT_OUT_S)
    return fleet.until(link.link.do_all_clients_read_wind_cov, KEPT_OUT_S)


@pytest.mark.sample
@pytest.mark.drawn(of="called")
@pytest.mark.parametrize("called", ["desk", "router"])
@pytest.mark.parametrize("allowed", [True, False], ids=["asked", "canary: no rule"])
def test_over_tls_the_roll_call_gets_to_every_vehicle(tmp_path, monkeypatch, called, allowed):
    if not allowed:
        monkeypatch.setattr(called_session, "access_control_config", without_the_rule)
    with (
        running(called, tmp_path) as fleet,
        closing(fleet.site.vehicle("d1", tmp_path / "d1")) as d1,
    ):
        assert fleet.hears(d1)
        assert asked_by(fleet, d1) is allowed


def without_the_rule(roster: Roster) -> dict[str, Any]:
    table = access_control_config(roster)
    for policy in table["policies"]:
        policy["rules"] = [rule for rule in policy["rules"] if rule != "state-asked"]
    table["rules"] = [rule for rule in table["rules"] if rule["id"] != "state-asked"]
    return table
