"""Signatures, roles, revocation, expiry and rosters, with keys generated here."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from companion.core.base.errors import LeewayError
from companion.fleet.command_log import CommandLog
from companion.fleet.envelope import decode_envelope
from companion.fleet.identity import SIGNING_KEY, MemberIdentity, read_and_verify_identity
from companion.fleet.messages import (
    Command,
    CommandStatus,
    EventKind,
    FleetEvent,
    Recall,
    Refused,
    SetLimits,
    encode_message,
)
from companion.fleet.network import MemberRequest
from companion.fleet.roles import Role
from companion.fleet.roster import RosterMember, roster_from_toml, roster_to_toml_text
from companion.fleet.signed_link import RejectionCounter, SignedLink
from companion.fleet.trust import MemberTrust, SignedCommand
from ground_station.adapters.pki.pki_folder import PkiFolder

NOW = datetime(2026, 11, 23, 9, 0, tzinfo=UTC)
DAYS = 365


@pytest.fixture
def pki(tmp_path: Path) -> PkiFolder:
    made = PkiFolder.create_fleet(tmp_path / "pki", "harbour", NOW)
    made.add_member("desk", Role.DESK, DAYS, "127.0.0.1:7447")
    for name, role in (("d1", Role.VEHICLE), ("d2", Role.VEHICLE), ("truck", Role.TRUCK)):
        made.add_member(name, role, DAYS, "")
    made.add_member("anna", Role.DISPATCHER, 10, "")
    made.add_member("otto", Role.VIEWER, DAYS, "")
    return made


def identity(pki: PkiFolder, name: str, now: datetime = NOW) -> MemberIdentity:
    return read_and_verify_identity(
        pki.folder / "members" / name, lambda: round(now.timestamp() * 1e6)
    )


def trust(pki: PkiFolder, name: str, now: datetime = NOW) -> MemberTrust:
    return identity(pki, name, now).trust


def event(vehicle: str = "d1") -> bytes:
    outcome = {"outcome": "SUC", "delivered": True, "home": True}
    told = {"vehicle": vehicle, "log": "l", "seq": 1, "epoch_us": 0, "text": "home", **outcome}
    return encode_message(FleetEvent(kind=EventKind.OUTCOME, **told))


def command(deed: object = None, id_: str = "c1") -> bytes:
    asked = SetLimits(max_loss=0.1) if deed is None else deed
    made = {"id": id_, "vehicle": "d1", "instance_id": "x", "as_of_s": 0.0, "by": "desk"}
    return encode_message(Command(**made, action=asked))


def signed_event(pki: PkiFolder, signer: str = "d1", vehicle: str = "d1") -> bytes:
    return trust(pki, signer).sign_in_envelope("event", event(vehicle))


def signed_command(pki: PkiFolder, signer: str, deed: object = None) -> bytes:
    return trust(pki, signer).sign_in_envelope("command", command(deed))


def why(found: object) -> str:
    assert isinstance(found, Refused), found
    return found.reason


@pytest.mark.parametrize("late_days", [0, 999], ids=["valid", "expired: flies to its end"])
def test_what_a_vehicle_signs_is_believed_of_it_and_comes_out_as_it_went_in(pki, late_days):
    desk = trust(pki, "desk", NOW + timedelta(days=late_days))
    assert desk.verify_message_of_signer("event", signed_event(pki), "d1") == event()


@pytest.mark.parametrize(
    ("signer", "vehicle", "expected", "words"),
    [
        ("d2", "d1", "d1", "event: signed by d2"),
        ("d1", "d1", None, "event: signed by d1"),
        ("anna", "anna", "anna", "event: anna is a dispatcher"),
    ],
)
def test_nobody_speaks_for_another_and_no_person_is_a_vehicle(
    pki, signer, vehicle, expected, words
):
    forged = signed_event(pki, signer, vehicle)
    assert why(trust(pki, "desk").verify_message_of_signer("event", forged, expected)) == words


def test_a_signature_is_for_one_kind_one_fleet_one_signer_and_these_bytes(pki):
    desk, sealed = trust(pki, "desk"), signed_event(pki)
    assert "not the signature" in why(desk.verify_message_of_signer("state", sealed, "d1"))
    envelope = decode_envelope("event", sealed)
    assert not isinstance(envelope, Refused)
    other = replace_bytes(sealed, b'"seq":1', b'"seq":2')
    assert "not the signature" in why(desk.verify_message_of_signer("event", other, "d1"))
    elsewhere = msgspec.structs.replace(desk.roster, fleet="inland")
    assert "not the signature" in why(
        replace(desk, roster=elsewhere).verify_message_of_signer("event", sealed, "d1")
    )
    renamed = replace_bytes(sealed, b"\xa2d1\xc4", b"\xa2d2\xc4")
    assert "not the signature of d2" in why(desk.verify_message_of_signer("event", renamed, "d2"))


def replace_bytes(raw: bytes, old: bytes, new: bytes) -> bytes:
    assert raw.count(old) == 1
    return raw.replace(old, new)


@pytest.mark.parametrize("raw", [b"", b"{}", event(), b"\x94\xa8signed/1", b"\xc1" * 50])
def test_what_is_in_no_envelope_is_not_believed(pki, raw):
    found = trust(pki, "desk").verify_message_of_signer("event", raw, "d1")
    assert why(found) == "event: not signed"


def test_too_many_bytes_are_not_even_read(pki):
    assert why(trust(pki, "d1").verify_command(b"\x94" * (2 << 20))) == "command: 2097152 bytes"


@pytest.mark.parametrize("name", ["desk", "anna"])
def test_a_dispatcher_and_the_desk_command(pki, name):
    found = trust(pki, "d1").verify_command(signed_command(pki, name))
    assert found == SignedCommand(command(), name)


@pytest.mark.parametrize(
    ("name", "role"), [("otto", "viewer"), ("d2", "vehicle"), ("truck", "truck")]
)
def test_a_viewer_a_vehicle_and_a_truck_command_nobody(pki, name, role):
    found = trust(pki, "d1").verify_command(signed_command(pki, name))
    assert why(found) == f"command: a {role} may not command ({name})"


def test_of_an_expired_person_only_a_recall_is_taken(pki):
    d1 = trust(pki, "d1", NOW + timedelta(days=11))
    assert why(d1.verify_command(signed_command(pki, "anna"))) == (
        "command: anna's certificate has expired"
    )
    assert isinstance(d1.verify_command(signed_command(pki, "anna", Recall())), SignedCommand)


def test_a_clock_that_stands_at_1970_finds_nobody_expired(pki):
    d1 = trust(pki, "d1", datetime(1970, 1, 1, tzinfo=UTC))
    assert isinstance(d1.verify_command(signed_command(pki, "anna")), SignedCommand)


def test_a_revoked_member_is_refused_as_soon_as_the_new_roster_is_taken_and_after_a_restart(pki):
    d1, sealed = trust(pki, "d1"), signed_command(pki, "anna")
    newer = revoked(pki, "anna")
    assert isinstance(d1.verify_command(sealed), SignedCommand)
    assert d1.store_roster_if_newer(newer) == pki.roster
    assert (
        why(d1.verify_command(sealed))
        == f"command: anna is revoked since roster {pki.roster.number}"
    )
    assert trust(pki, "d1").roster.number == pki.roster.number


def revoked(pki: PkiFolder, name: str) -> bytes:
    """Return the roster that revokes a member, not yet stored by any member."""
    before = {p: p.read_bytes() for p in (pki.folder / "members").glob("*/roster.json")}
    pki.revoke_members(name)
    for path, content in before.items():
        path.write_bytes(content)
    return (pki.folder / "roster.json").read_bytes()


def test_an_older_roster_is_not_taken_again(pki):
    old = (pki.folder / "roster.json").read_bytes()
    pki.revoke_members("anna")
    d1 = trust(pki, "d1")
    assert "a predecessor of" in why(d1.store_roster_if_newer(old))
    assert d1.roster_alarm
    assert d1.store_roster_if_newer(old, may_be_older=True) is None
    assert d1.roster.member_by_name["anna"].revoked


def test_a_roster_of_a_foreign_authority_or_with_a_changed_word_is_not_taken(pki, tmp_path):
    d1 = trust(pki, "d1")
    foreign = PkiFolder.create_fleet(tmp_path / "foreign", "harbour", NOW)
    for n in range(9):
        foreign.add_member(f"x{n}", Role.DESK, DAYS, "")
    assert "not signed by an authority" in why(
        d1.store_roster_if_newer((foreign.folder / "roster.json").read_bytes())
    )
    newer = revoked(pki, "anna")
    changed = replace_bytes(newer, b"revoked = true", b"revoked = false")
    assert "not signed by an authority" in why(d1.store_roster_if_newer(changed))


@pytest.mark.sample
@pytest.mark.parametrize(
    "text",
    [
        'fleet = "harbour"\n' + ".".join(["a"] * 50_000) + " = 1\n",  # quadratic time in tomllib
        'fleet = "harbour"\n' + "a = " + "[" * 50_000,
        'fleet = "harbour"\n] this is no TOML',
    ],
    ids=["dotted", "nested", "broken"],
)
def test_the_text_of_a_roster_is_not_parsed_before_its_signature_is_verified(pki, text):
    signed = msgspec.json.decode((pki.folder / "roster.json").read_bytes())
    raw = msgspec.json.encode(signed | {"roster": text})
    assert why(trust(pki, "d1").store_roster_if_newer(raw)) == (
        "roster: not signed by an authority of this fleet"
    )


def test_a_roster_that_the_disk_does_not_take_is_in_force_all_the_same(pki):
    d1 = trust(pki, "d1")

    def full(_: object) -> None:
        raise OSError(28, "No space left on device")

    d1.store_roster = full
    with pytest.raises(OSError, match="No space"):
        d1.store_roster_if_newer(revoked(pki, "anna"))
    assert d1.roster.member_by_name["anna"].revoked


def test_two_authorities_overlap_and_the_older_ends(pki):
    old = trust(pki, "d1")  # has the first authority only
    pki.add_second_authority()
    signed = (pki.folder / "roster.json").read_bytes()
    assert old.store_roster_if_newer(signed) == pki.roster
    both = trust(pki, "d2")
    assert len(both.authority_keys) == 2
    with pytest.raises(LeewayError, match="two authorities"):
        pki.add_second_authority()
    pki.remove_oldest_authority()
    alone = (pki.folder / "roster.json").read_bytes()
    assert both.store_roster_if_newer(alone) == pki.roster
    assert "not signed" in why(old.store_roster_if_newer(alone))
    with pytest.raises(LeewayError, match="one authority only"):
        pki.remove_oldest_authority()


def test_a_renewed_member_keeps_its_keys_so_that_nothing_is_cut(pki):
    before, anna = pki.roster.member_by_name["anna"], trust(pki, "anna")
    pki.renew_member_certificates(["anna"], DAYS)
    after = pki.roster.member_by_name["anna"]
    assert (after.key, after.not_after - before.not_after) == (before.key, timedelta(days=355))
    late = trust(pki, "d1", NOW + timedelta(days=11))
    assert isinstance(
        late.verify_command(anna.sign_in_envelope("command", command())), SignedCommand
    )


def test_a_signing_key_that_others_can_read_is_refused(pki):
    home = pki.folder / "members" / "d1"
    assert (home / SIGNING_KEY).stat().st_mode & 0o777 == 0o600
    (home / SIGNING_KEY).chmod(0o640)
    with pytest.raises(LeewayError, match="others may read it"):
        read_and_verify_identity(home)


@pytest.mark.parametrize("left", [31, 29, -1])
def test_a_month_before_its_end_a_member_says_what_is_to_be_done(pki, left):
    words = trust(pki, "d1", NOW + timedelta(days=DAYS - left)).certificate_warning_or_empty()
    assert words == (
        "" if left > 30 else f"certificate of d1: {left} days left (ground-station pki renew)"
    )


def test_nothing_may_begin_that_outlasts_the_certificate(pki):
    d1 = trust(pki, "d1", NOW + timedelta(days=DAYS) - timedelta(minutes=30))
    assert d1.certificate_error_within(1700.0) == ""
    assert d1.certificate_error_within(1900.0) == (
        "the certificate of d1 ends in 30 min, expected at least 32 min more"
        " (ground-station pki renew)"
    )


class SilentLink:
    """A link without requests."""

    def drain_requests(self) -> list[MemberRequest]:
        return []


def test_a_member_that_runs_across_the_day_says_it_and_again_every_day(pki):
    """The process started 31.5 days before the end of validity, without a new roster."""
    start_us = round((NOW + timedelta(days=DAYS - 31.5)).timestamp() * 1e6)
    d1, now_s = trust(pki, "d1"), 0.0
    d1.validity.epoch_us = lambda: start_us + round(now_s * 1e6)
    link = SignedLink(cast(Any, SilentLink()), d1, "life", lambda: now_s)
    said: list[tuple[float, str]] = []
    for hour in range(24 * 4):
        now_s = 3600.0 * hour
        said += [(hour / 24.0, asked.payload.decode()) for asked in link.drain_requests()]
    words = "certificate of d1: {} days left (ground-station pki renew)"
    assert said == [(2.0, words.format(30)), (3.0, words.format(28))]  # 29.5 and 28.5


TLS = "tls.pem"
NEAR = NOW + timedelta(days=DAYS) - timedelta(minutes=10)
"""Ten minutes before the certificates of `pki` end."""


@pytest.mark.parametrize("looks", [True, False], ids=["ours", "canary: the roster alone"])
def test_a_renewed_roster_does_not_lengthen_a_certificate_that_was_not_carried(pki, looks):
    """`pki renew d1` writes both; the desk sends the roster, an operator copies `tls.pem` later."""
    home, d1 = pki.folder / "members" / "d1", trust(pki, "d1", NEAR)
    if not looks:
        d1.validity.read_own_end_us, d1.validity.own_end_us = (lambda: None), None
    old = (home / TLS).read_bytes()
    assert "ends in 10 min" in d1.certificate_error_within(3600.0)
    pki.now = NEAR
    pki.renew_member_certificates(["d1"], DAYS)
    new = (home / TLS).read_bytes()
    (home / TLS).write_bytes(old)
    assert d1.store_roster_if_newer((pki.folder / "roster.json").read_bytes()) == pki.roster
    remedy = "(renewed until 2028-11-22: copy tls.pem to d1)"
    assert (d1.certificate_error_within(3600.0), d1.certificate_warning_or_empty()) == (
        (
            f"the certificate of d1 ends in 10 min, expected at least 60 min more {remedy}",
            f"certificate of d1: 0 days left {remedy}",
        )
        if looks
        else ("", "")
    )
    (home / TLS).write_bytes(new)
    assert (d1.certificate_error_within(3600.0), d1.certificate_warning_or_empty()) == ("", "")


@pytest.mark.parametrize("name", ["desk", "d1"])
def test_who_is_called_by_others_counts_by_what_its_session_was_opened_with(pki, name):
    """zenoh reads a listener's certificate when it starts to listen, a caller's at each call."""
    one = trust(pki, name, NEAR)
    pki.now = NEAR
    pki.renew_member_certificates([name], DAYS)
    one.store_roster_if_newer((pki.folder / "roster.json").read_bytes())
    assert one.certificate_warning_or_empty() == (
        "certificate of desk: 0 days left (renewed until 2028-11-22: copy tls.pem to desk)"
        if name == "desk"
        else ""
    )
    one.validity.reload_own_end_if_complete()
    assert one.certificate_warning_or_empty() == ""


@pytest.mark.parametrize("spoilt", [b"", b"-----BEGIN CERTIFICATE-----\nAAAA\n", None])
def test_a_certificate_that_is_only_half_carried_leaves_the_one_before(pki, spoilt):
    path, d1 = pki.folder / "members" / "d1" / TLS, trust(pki, "d1", NEAR)
    _ = path.unlink() if spoilt is None else path.write_bytes(spoilt)
    assert "0 days left" in d1.certificate_warning_or_empty()
    assert "ends in 10 min" in d1.certificate_error_within(3600.0)


def test_a_certificate_that_is_none_is_said_at_the_start(pki):
    (pki.folder / "members" / "d1" / TLS).write_text("no certificate")
    with pytest.raises(LeewayError, match=r"d1/tls\.pem: not a certificate"):
        trust(pki, "d1")


def test_a_roster_that_names_an_earlier_end_than_the_certificate_holds(pki):
    """The certificate was copied before the roster arrived: other members use the roster."""
    d1, before = trust(pki, "d1", NEAR), (pki.folder / "roster.json").read_bytes()
    pki.now = NEAR
    pki.renew_member_certificates(["d1"], DAYS)
    assert d1.store_roster_if_newer(before) is None
    assert d1.certificate_error_within(3600.0).endswith("60 min more (ground-station pki renew)")


def test_a_roster_file_is_read_strictly_and_written_as_it_was(pki):
    text = (pki.folder / "roster.toml").read_bytes()
    assert roster_to_toml_text(roster_from_toml(text, "roster.toml")).encode() == text
    for wrong in (b'role = "captain"', b'role = "vehicle"\ncaptain = true'):
        with pytest.raises(LeewayError, match=r"roster\.toml"):
            roster_from_toml(text.replace(b'role = "vehicle"', wrong), "roster.toml")
    twice = text + text[text.index(b"[[members]]") :]
    with pytest.raises(LeewayError, match="each name once"):
        roster_from_toml(twice, "roster.toml")


def test_a_member_without_an_end_in_a_time_zone_is_refused():
    bare = {"name": "d1", "role": "vehicle", "key": "0" * 64, "not_after": datetime(2026, 1, 1)}
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(bare, RosterMember)


def test_a_command_that_rests_on_a_state_from_the_future_is_refused():
    asked = msgspec.structs.replace(
        msgspec.json.decode(command(), type=Command), as_of_s=1e9, instance_id="x"
    )
    verdict = CommandLog().reply_without_execution_or_none(asked, "x", 100.0)
    assert verdict is not None
    assert verdict.status is CommandStatus.REFUSED
    assert "in the future" in verdict.reason
    home = msgspec.structs.replace(asked, action=Recall())
    assert CommandLog().reply_without_execution_or_none(home, "x", 100.0) is None


def test_what_is_not_believed_is_counted_and_said_once_a_minute():
    heard = RejectionCounter()
    assert heard.pop_report_if_due(0.0) is None
    for n in range(500):
        heard.count_rejection("forged" if n % 2 else f"made up {n}")
    assert "forged (250)" in (heard.pop_report_if_due(0.0) or "")
    heard.count_rejection("forged")
    assert heard.pop_report_if_due(59.9) is None
    assert heard.pop_report_if_due(60.0) == "rejected: forged (1)"
    assert heard.total == 501
