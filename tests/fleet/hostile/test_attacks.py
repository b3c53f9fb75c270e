"""Attacks by strangers, impostors and members without the right, over zenoh. Each attack has a
canary: with the guard removed it succeeds.

Where a signature is the guard, the network is an unprotected loopback network with the attacker's
router, so the signature is the only protection.
"""

import json
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
import zenoh

from companion.core.separation.track import Track
from companion.fleet.command_log import CommandLog
from companion.fleet.messages import (
    CommandStatus,
    EventKind,
    FleetEvent,
    Recall,
    Result,
    encode_message,
)
from companion.fleet.roles import Role
from companion.fleet.topics import VehicleKeys
from companion.fleet.trust import MemberTrust
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.pki import certificates
from ground_station.core.fleet.fleet_link import (
    EventsReceived,
    FleetInput,
    MessageRejected,
    StateReceived,
)
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import (
    GUARD,
    KEPT_OUT_S,
    PATIENCE_S,
    Plain,
    answered,
    believe_all,
    forged_state,
    hears,
    limits,
    plain_network,
    trust_of,
)
from tests.fleet.zenoh_net import FLEET, HERE, config_file, free_port


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> SecureSite:
    return SecureSite(tmp_path_factory.mktemp("site") / "pki")


# --- TLS certificates ------------------------------------------------------------------------


def listens_to_all(config: zenoh.Config, wait_s: float) -> list[str]:
    """Return the state keys that a session receives, by subscription or by query."""
    found: list[str] = []
    with zenoh.open(config) as session:
        everything = f"leeway/{FLEET}/**"
        held = session.declare_subscriber(everything, lambda s: found.append(str(s.key_expr)))
        limit_s = monotonic_s() + wait_s
        while not found and monotonic_s() < limit_s:
            for reply in session.get(everything, timeout=0.3):
                found += [str(reply.ok.key_expr)] if reply.ok is not None else []
        held.undeclare()
    return found


@GUARD
def test_a_stranger_without_a_certificate_hears_nothing(tmp_path, guarded):
    site = SecureSite(tmp_path / "pki")
    table = json.loads((site.home("desk") / "zenoh.json5").read_text())
    if not guarded:
        table["transport"]["link"]["tls"]["enable_mtls"] = False
        table["access_control"]["enabled"] = False
        (site.home("desk") / "zenoh.json5").write_text(json.dumps(table))
    stranger = {"mode": "client", "scouting": {"multicast": {"enabled": False}}}
    stranger["connect"] = {"endpoints": [f"tls/127.0.0.1:{site.port}"], "exit_on_failure": False}
    tls = {"root_ca_certificate": str(site.home("desk") / "ca.pem")}
    stranger["transport"] = {"link": {"tls": tls}}
    desk, vehicle = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    try:
        assert hears(desk, lambda h: isinstance(h, StateReceived), PATIENCE_S)
        wait_s = KEPT_OUT_S if guarded else PATIENCE_S
        heard = try_to_listen(zenoh.Config.from_json5(json.dumps(stranger)), wait_s)
    finally:
        vehicle.close()
        desk.close()
    assert bool(heard) is not guarded


def try_to_listen(config: zenoh.Config, wait_s: float) -> list[str]:
    try:
        return listens_to_all(config, wait_s)
    except zenoh.ZError:
        return []


@pytest.mark.sample
@GUARD
def test_nobody_stands_at_the_desks_address_with_a_vehicles_certificate(
    tmp_path, monkeypatch, guarded
):
    if not guarded:
        roles = frozenset(Role)
        monkeypatch.setattr(certificates, "SERVERS", roles)
        monkeypatch.setattr(certificates, "server_address_or_empty", lambda member: "127.0.0.1:1")
    site = SecureSite(tmp_path / "pki")
    home = site.home("d2")
    table = {
        "mode": "router",
        "scouting": {"multicast": {"enabled": False}},
        "listen": {"endpoints": [f"tls/127.0.0.1:{site.port}"]},
        "transport": {
            "link": {
                "tls": {
                    "root_ca_certificate": str(home / "ca.pem"),
                    "listen_private_key": str(home / "tls.key"),
                    "listen_certificate": str(home / "tls.pem"),
                    "enable_mtls": True,
                }
            }
        },
    }
    vehicle = site.vehicle("d1", tmp_path / "d1")
    try:
        wait_s = KEPT_OUT_S if guarded else PATIENCE_S
        heard = listens_to_all(zenoh.Config.from_json5(json.dumps(table)), wait_s)
    finally:
        vehicle.close()
    assert bool(heard) is not guarded


@pytest.mark.sample
@GUARD
def test_an_expired_certificate_is_not_let_in(tmp_path, guarded):
    site = SecureSite(tmp_path / "pki")
    if guarded:
        site.pki.now -= timedelta(days=400)
        site.pki.renew_member_certificates(["d1"], 365)
    desk, vehicle = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    try:
        wait_s = KEPT_OUT_S if guarded else PATIENCE_S
        heard = hears(desk, lambda h: isinstance(h, StateReceived), wait_s)
    finally:
        vehicle.close()
        desk.close()
    assert bool(heard) is not guarded


@pytest.mark.sample
@pytest.mark.parametrize(("name", "may"), [("anna", True), ("otto", False)])
def test_through_the_desk_a_dispatcher_commands_and_a_viewer_only_looks(tmp_path, name, may):
    site = SecureSite(tmp_path / "pki")
    desk, vehicle = site.person("desk"), site.vehicle("d1", tmp_path / "d1")
    person = site.person(name)
    try:
        assert hears(person, lambda h: isinstance(h, StateReceived), PATIENCE_S)
        person.request_events("d1", 0, 2.0)
        person.send(limits(vehicle), PATIENCE_S if may else KEPT_OUT_S)
        answer = hears(person, answered, PATIENCE_S)
        assert (answer.result is not None) is may
        assert [command.by for command in vehicle.done] == (["desk by way of anna"] if may else [])
    finally:
        person.close()
        vehicle.close()
        desk.close()


# --- signatures ------------------------------------------------------------------------------


@pytest.fixture
def plain(site: SecureSite, tmp_path: Path) -> Iterator[Plain]:
    with plain_network(site, tmp_path) as made:
        yield made


def forged_outcome() -> bytes:
    return encode_message(
        FleetEvent(
            vehicle="d1",
            log="forged",
            seq=1,
            epoch_us=0,
            kind=EventKind.OUTCOME,
            text="home",
            outcome="SUC",
            delivered=True,
            home=True,
        )
    )


FORGED = {"state": forged_state, "event": forged_outcome}


def is_forged(heard: FleetInput) -> bool:
    if isinstance(heard, EventsReceived):
        return heard.events[0].log == "forged"
    return isinstance(heard, StateReceived) and heard.state.instance_id == "forged"


SIGNERS = [("d2", True), ("anna", True), ("nobody", True), ("d2", False)]
"""The last case is the canary: the guard is removed."""


@pytest.mark.parametrize(("signer", "guarded"), SIGNERS)
@pytest.mark.parametrize("kind", ["state", "event"])
def test_no_state_or_outcome_counts_but_the_vehicles_own(plain, monkeypatch, kind, signer, guarded):
    if not guarded:
        believe_all(monkeypatch)
    raw = FORGED[kind]()
    author = trust_of(plain.site, "d2" if signer == "nobody" else signer)
    author.name = "d1" if signer == "nobody" else signer  # signs as d1 with a key that is not d1's
    plain.put(kind, author.sign_in_envelope(kind, raw))

    def telling(heard: FleetInput) -> FleetInput | None:
        return heard if is_forged(heard) or isinstance(heard, MessageRejected) else None

    told = hears(plain.desk, telling, PATIENCE_S)
    assert is_forged(told) is not guarded
    assert not guarded or (told.key == "d1" and "not believed" in told.reason)


@GUARD
def test_a_track_counts_only_from_the_vehicle_that_flies_it(plain, monkeypatch, guarded):
    if not guarded:
        believe_all(monkeypatch)
    zero = {**HERE, "alt_amsl_m": 50.0, "gnss_s": 1.8e9}
    speed = {"vel_n_mps": 0.0, "vel_e_mps": 0.0, "vel_d_mps": 0.0}
    errors = {"pos_std_m": 1.0, "alt_std_m": 1.0, "vel_std_mps": 1.0, "avoiding": False}
    raw = encode_message(Track(vehicle="truck", **zero, **speed, **errors))
    d1 = plain.d1
    d1.stop()
    plain.put("track", trust_of(plain.site, "d2").sign_in_envelope("track", raw), "truck")
    own = encode_message(Track(vehicle="d2", **zero, **speed, **errors))
    limit_s, heard = monotonic_s() + PATIENCE_S, []
    while "d2" not in heard and monotonic_s() < limit_s:
        plain.put("track", trust_of(plain.site, "d2").sign_in_envelope("track", own), "d2")
        heard += [event.track.vehicle for event in d1.port.take_received_tracks(1.0)]
    assert ("truck" in heard) is not guarded


def test_a_neighbour_that_publishes_as_another_on_its_own_key_is_nobodys_track(plain):
    """Without signatures too, the key expression and the name in the message must match."""
    d1, track = plain.d1, {"gnss_s": 1.8e9, **HERE, "alt_amsl_m": 50.0}
    rest = dict.fromkeys(("pos_std_m", "alt_std_m", "vel_std_mps"), 1.0)
    still = dict.fromkeys(("vel_n_mps", "vel_e_mps", "vel_d_mps"), 0.0)
    raw = encode_message(Track(vehicle="d7", **track, **rest, **still, avoiding=False))
    d1.stop()
    author, limit_s = trust_of(plain.site, "d2"), monotonic_s() + PATIENCE_S
    while not d1.port.member.link.link.drain_tracks() and monotonic_s() < limit_s:
        plain.put("track", author.sign_in_envelope("track", raw), "d2")
    plain.put("track", author.sign_in_envelope("track", raw), "d2")
    assert d1.port.take_received_tracks(1.0) == []


@GUARD
def test_nobody_answers_for_a_vehicle(plain, monkeypatch, guarded):
    if not guarded:
        believe_all(monkeypatch)
    d1 = plain.d1
    command = limits(d1)
    d1.close()
    lie = Result(
        id="c1", vehicle="d1", instance_id=d1.port.member.instance_id, status=CommandStatus.DONE
    )
    raw = trust_of(plain.site, "d2").sign_in_envelope("result", encode_message(lie))
    key = VehicleKeys(FLEET, "d1").command_key

    def answer(query: zenoh.Query) -> None:
        query.reply(key, raw)
        query.drop()

    held = plain.rogue.declare_queryable(key, answer)
    plain.desk.send(command, PATIENCE_S)
    told = hears(plain.desk, answered, PATIENCE_S)
    held.undeclare()
    assert (told.result is None) is guarded


@pytest.mark.parametrize(
    ("signer", "guarded"), [("d2", True), ("otto", True), ("nobody", True), ("d2", False)]
)
def test_a_command_of_who_may_not_command_is_not_carried_out(plain, monkeypatch, signer, guarded):
    if not guarded:
        believe_all(monkeypatch)
    author = trust_of(plain.site, "d2" if signer == "nobody" else signer)
    author.name = "desk" if signer == "nobody" else signer
    result = plain.ask(author.sign_in_envelope("command", encode_message(limits(plain.d1))))
    assert len(plain.d1.done) == (0 if guarded else 1)
    expected = ("", CommandStatus.REFUSED) if guarded else ("c1", CommandStatus.DONE)
    assert (result.id, result.status) == expected


def test_who_is_named_by_way_of_the_signer_already_is_named_so_once(plain):
    told = encode_message(limits(plain.d1, by="ben by way of anna"))
    plain.ask(trust_of(plain.site, "anna").sign_in_envelope("command", told))
    assert [command.by for command in plain.d1.done] == ["ben by way of anna"]


@GUARD
def test_a_replayed_command_is_carried_out_once(plain, monkeypatch, guarded):
    if not guarded:
        monkeypatch.setattr(CommandLog, "reply_without_execution_or_none", lambda *_: None)
    sealed = trust_of(plain.site, "desk").sign_in_envelope(
        "command", encode_message(limits(plain.d1))
    )
    for _ in range(3):
        assert plain.ask(sealed).status is CommandStatus.DONE
    assert len(plain.d1.done) == (1 if guarded else 3)


@GUARD
def test_a_command_from_the_future_is_not_fresh_for_ever(plain, monkeypatch, guarded):
    if not guarded:
        monkeypatch.setattr(CommandLog, "reply_without_execution_or_none", lambda *_: None)
    late = encode_message(limits(plain.d1, as_of_s=1e9))
    result = plain.ask(trust_of(plain.site, "desk").sign_in_envelope("command", late))
    assert result.status is (CommandStatus.REFUSED if guarded else CommandStatus.DONE)


def test_a_recall_of_an_honest_person_is_taken_whatever_its_stamp(plain):
    late = encode_message(
        limits(plain.d1, as_of_s=1e9, instance_id="another", by="anna", action=Recall())
    )
    assert (
        plain.ask(trust_of(plain.site, "anna").sign_in_envelope("command", late)).status
        is CommandStatus.DONE
    )


@pytest.mark.sample
@GUARD
def test_a_revoked_person_commands_no_more_once_the_desk_has_the_roster(
    tmp_path, monkeypatch, guarded
):
    site, port = SecureSite(tmp_path / "pki"), free_port()
    anna = trust_of(site, "anna")
    if not guarded:
        monkeypatch.setattr(MemberTrust, "store_roster_if_newer", lambda self, raw: None)
    ours = config_file(tmp_path / "desk.json5", listen=port)
    theirs = config_file(tmp_path / "d1.json5", connect=port)
    site.keep_rosters_of("d1")
    desk, vehicle = site.person("desk", ours), site.vehicle("d1", tmp_path / "d1", zenoh=theirs)
    rogue = zenoh.open(read_and_check_zenoh_config(theirs))
    try:
        assert hears(desk, lambda h: isinstance(h, StateReceived), PATIENCE_S)
        plain = Plain(site, desk, vehicle, rogue)
        plain.ask(anna.sign_in_envelope("command", encode_message(limits(vehicle, "before"))))
        site.pki.revoke_members("anna")
        site.restore_rosters()
        news = "roster 8 is in force"
        hears(desk, lambda h: news in str(h), PATIENCE_S if guarded else 1.0)
        plain.ask(anna.sign_in_envelope("command", encode_message(limits(vehicle, "after"))))
        assert [c.id for c in vehicle.done] == (["before"] if guarded else ["before", "after"])
    finally:
        rogue.close()
        vehicle.close()
        desk.close()
