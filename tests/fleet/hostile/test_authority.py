"""Attacks with authority that has ended: revoked people, and rosters of a restored backup.

Authority counts where a command is executed. Each attack has a canary: with the guard removed it
succeeds.
"""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.adapters.files.disk import ImmediateRecordWriter
from companion.core.base.errors import LeewayError
from companion.fleet.command_log import MAX_LAUNCH_VALIDITY_S, CommandReply
from companion.fleet.identity import read_and_verify_identity
from companion.fleet.member import FleetMember
from companion.fleet.messages import (
    Command,
    CommandStatus,
    Launch,
    LaunchWindow,
    Recall,
    SetLimits,
    encode_message,
)
from companion.fleet.network import MemberRequest, RequestKind
from companion.fleet.signed_link import SignedLink
from companion.fleet.trust import MemberTrust
from ground_station.adapters.pki.pki_folder import PkiFolder
from ground_station.adapters.store import database
from ground_station.app.cli.main import app
from ground_station.app.desk.command_authority import CommandAuthority
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.app.views.operator_alerts import vehicle_alarm_texts
from ground_station.core.fleet.fleet_link import LivelinessChanged
from ground_station.core.fleet.fleet_status import ROSTER_DELAY_S, FleetStatus
from tests.fleet.hostile.test_vehicle_floods import ByHand
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import GUARD, trust_of
from tests.ground_station.desk.test_held_launches import DAY, Bench
from tests.ground_station.desk_parts import HandClock, Wire, a_state
from tests.ground_station.store.test_holds import aboard
from tests.ground_station.store.test_order_store import an_order, opened


@pytest.fixture
def site(tmp_path: Path) -> SecureSite:
    return SecureSite(tmp_path / "pki")


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def bench(
    site: SecureSite, tmp_path: Path, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Bench]:
    """A desk with an identity; d1 is ready with o1 and waits for a person's confirmation."""
    monkeypatch.setattr(database, "_begin_epoch_if_missing", lambda *_: None)  # ids without epoch
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        store.add_orders_unless_conflict([an_order("o1")])
        assert aboard(store) == "o1.1"
        wire = Wire()
        params = DepotParams(assigns_orders=False, launch_gap_s=0.0, requires_confirmation=True)
        desk = open_depot_desk(DAY, store, wire, said.append, params, clock=HandClock(100.0))
        desk.check_authority_by(trust_of(site, "desk"))
        wire.heard.append(LivelinessChanged("d1", "a", has_joined=True))
        yield Bench(store, wire, desk, HandClock())


def desk_gets_the_roster(bench: Bench, site: SecureSite) -> None:
    assert bench.desk.authority is not None
    raw = (site.pki.folder / "roster.json").read_bytes()
    assert bench.desk.authority.trust.store_roster_if_newer(raw) == site.pki.roster


@GUARD
def test_a_launch_that_a_since_revoked_person_confirmed_is_not_ordered(
    site, bench, said, monkeypatch, guarded
):
    if not guarded:
        monkeypatch.setattr(MemberTrust, "authority_error_or_empty", lambda *_: "")
    assert bench.store.record_launch_confirmation("o1", "ben by way of anna") == "o1.1"
    site.pki.revoke_members("anna")
    desk_gets_the_roster(bench, site)
    bench.turn()
    assert bench.wire.launches() == ([] if guarded else ["o1.1:launch1"])
    line = f"d1: launch of o1 refused: anna is revoked since roster {site.pki.roster.number}"
    assert (line in said) is guarded


def test_a_launch_that_an_authorised_person_confirmed_is_ordered(bench):
    assert bench.store.record_launch_confirmation("o1", "anna") == "o1.1"
    bench.turn()
    assert bench.wire.launches() == ["o1.1:launch1"]


@GUARD
@pytest.mark.parametrize("action", [Recall(), SetLimits(max_loss=0.4)], ids=["recall", "limits"])
def test_a_stored_command_of_a_since_revoked_person_is_not_sent(
    site, bench, said, monkeypatch, action, guarded
):
    if not guarded:
        monkeypatch.setattr(MemberTrust, "authority_error_or_empty", lambda *_: "")
    bench.store.enqueue_command("c1", "d1", action, "anna")
    site.pki.revoke_members("anna")
    desk_gets_the_roster(bench, site)
    bench.turn()
    assert ("c1" in [command.id for command in bench.wire.sent]) is not guarded
    assert (f"d1: c1 refused: anna is revoked since roster {site.pki.roster.number}" in said) is (
        guarded
    )


@GUARD
@pytest.mark.parametrize("command", ["launch", "cancel"])
def test_a_revoked_person_with_an_old_roster_changes_nothing_in_the_store(
    site, bench, tmp_path, monkeypatch, command, guarded
):
    """Anna's own folder does not have the roster that revokes her; the store has."""
    site.keep_rosters_of("anna")
    site.pki.revoke_members("anna")
    site.restore_rosters()
    desk_gets_the_roster(bench, site)
    bench.store.add_orders_unless_conflict([an_order("o2")])
    bench.turn()
    if not guarded:
        monkeypatch.setattr(MemberTrust, "store_roster_if_newer", lambda *_, **__: None)
    order = {"launch": "o1", "cancel": "o2"}[command]
    url, folder = f"sqlite:///{tmp_path}/desk.db", str(site.home("anna"))
    words = ["order", command, order, *(["--reason", "x"] if command == "cancel" else [])]
    done = CliRunner().invoke(app, [*words, "--store", url, "--identity", folder])
    assert (done.exit_code != 0) is guarded, done.output
    number = site.pki.roster.number
    assert not guarded or str(done.exception) == f"anna is revoked since roster {number}"


def test_a_store_of_a_desk_with_a_roster_needs_an_identity(bench, tmp_path):
    bench.turn()
    url = f"sqlite:///{tmp_path}/desk.db"
    with pytest.raises(LeewayError, match="expected --identity"):
        CliRunner().invoke(app, ["order", "launch", "o1", "--store", url], catch_exceptions=False)


class SlowDisk(ImmediateRecordWriter):
    """Runs each write when the test says so."""

    def __init__(self) -> None:
        super().__init__(lambda error: None)
        self.jobs: list[Callable[[], None]] = []

    def submit_write_job(self, record_name: str, job: Callable[[], None], **_: bool) -> bool:
        self.jobs.append(job)
        return True


@GUARD
def test_a_launch_that_waits_for_the_vehicles_disk_ends_with_its_authors_authority(
    site, tmp_path, monkeypatch, guarded
):
    """The roster arrives between the signature's check and the execution."""
    if not guarded:
        monkeypatch.setattr(MemberTrust, "authority_error_or_empty", lambda *_: "")
    net, disk, own = Net(), SlowDisk(), trust_of(site, "d1")
    done: list[Command] = []
    answers: list[bytes] = []

    def execute(command: Command) -> CommandReply:
        done.append(command)
        return CommandReply(CommandStatus.DONE)

    def open_link(life: str) -> SignedLink:
        return SignedLink(net, own, life, net.clock_s)  # type: ignore[arg-type]

    member = FleetMember.restore_and_open_link("d1", tmp_path / "d1", open_link, disk=disk)
    window = LaunchWindow(
        instance_id=member.instance_id, not_before_s=0.0, expires_s=MAX_LAUNCH_VALIDITY_S
    )
    launch = Command(
        id="c1", vehicle="d1", instance_id=member.instance_id, as_of_s=0.0, by="anna",
        action=Launch(assignment="o1.1", window=window),
    )  # fmt: skip
    sealed = trust_of(site, "anna").sign_in_envelope("command", encode_message(launch))
    net.waiting = [MemberRequest(RequestKind.COMMAND, answers.extend, sealed)]
    member.process_requests_and_publish_events(execute)
    assert not done, "its start is not yet on the disk"
    site.pki.revoke_members("anna")
    assert own.store_roster_if_newer((site.pki.folder / "roster.json").read_bytes())
    for job in disk.jobs:
        job()
    member.process_requests_and_publish_events(execute)
    member.log.close()
    assert bool(done) is not guarded
    line = f"anna is revoked since roster {site.pki.roster.number}"
    assert (line in str(answers)) is guarded


class Net(ByHand):
    """A link that drops what is published."""

    def publish_event(self, event_bytes: bytes) -> None: ...


# --- forks and rollbacks -------------------------------------------------------------------------


@pytest.fixture
def forked(site: SecureSite, tmp_path: Path) -> PkiFolder:
    """A PKI restored from a backup: its next roster has the number of the one that revokes d2."""
    backup = Path(shutil.copytree(site.pki.folder, tmp_path / "backup"))
    site.pki.revoke_members("d2")
    restored = PkiFolder.read(backup, site.pki.now)
    restored.renew_member_certificates(["anna"], 30)
    assert restored.roster.number == site.pki.roster.number
    return restored


@GUARD
def test_a_second_roster_of_one_number_is_refused_and_is_an_alarm(
    site, forked, monkeypatch, guarded
):
    import companion.fleet.trust as module

    if not guarded:
        monkeypatch.setattr(module, "roster_difference", lambda *_: module.RosterDifference.NEWER)
    d1 = trust_of(site, "d1")
    d1.store_roster_if_newer((forked.folder / "roster.json").read_bytes())
    assert d1.roster.member_by_name["d2"].revoked is guarded
    assert ("a fork of" in d1.roster_alarm) is guarded


@pytest.mark.parametrize("case", ["fork", "desk is older", "vehicle is older"])
def test_a_vehicle_with_another_roster_is_an_alarm_and_gets_no_order(site, forked, case):
    own, theirs = {
        "fork": (trust_of(site, "desk"), SecureSite.of(forked.folder, 1).identity("d1").trust),
        "desk is older": (SecureSite.of(forked.folder, 1).identity("desk").trust, None),
        "vehicle is older": (trust_of(site, "desk"), None),
    }[case]
    stamp = theirs.roster_stamp if theirs else f"{99 if case == 'desk is older' else 2}:{'a' * 16}"
    status = FleetStatus(trust=own)
    status.record_liveliness_change("d1", "a", has_joined=True)
    for uptime_s in (1.0, 1.0 + ROSTER_DELAY_S + 1.0):
        state = a_state("d1", uptime_s=uptime_s, roster=stamp)
        status.record_state_and_new_doubts(state, uptime_s, 0)
    vehicle = status.status_of("d1")
    alarms = list(vehicle_alarm_texts(vehicle, None, uptime_s))
    word = {"fork": "fork", "desk is older": "newer", "vehicle is older": "older"}[case]
    assert any(word in alarm and stamp in alarm for alarm in alarms)
    assert not vehicle.can_take_assignment(uptime_s)
    state = a_state("d1", uptime_s=uptime_s + 1.0, roster=own.roster_stamp)
    status.record_state_and_new_doubts(state, uptime_s + 1.0, 0)
    assert vehicle.can_take_assignment(uptime_s + 1.0), "canary: one roster, no doubt"


@GUARD
def test_a_desk_restored_to_an_old_roster_gets_the_newest_from_its_store(
    site, bench, tmp_path, said, monkeypatch, guarded
):
    backup = Path(shutil.copytree(site.home("desk"), tmp_path / "old-desk"))
    site.pki.revoke_members("anna")
    desk_gets_the_roster(bench, site)
    bench.turn()
    restored = read_and_verify_identity(backup).trust
    if not guarded:
        monkeypatch.setattr(MemberTrust, "store_roster_if_newer", lambda *_, **__: None)
    authority = CommandAuthority(restored, bench.store, said.append, lambda: 1)
    authority.exchange_roster_with_store()
    assert restored.roster.member_by_name["anna"].revoked is guarded


def test_a_restored_pki_continues_with_a_members_roster(site, forked):
    """As in docs/how-to/secure-a-fleet.md."""
    newest = site.home("desk") / "roster.json"
    site.pki.renew_member_certificates(["anna"], 30)
    shutil.copy(newest, forked.folder / "roster.json")
    again = PkiFolder.read(forked.folder, site.pki.now)
    assert again.roster == site.pki.roster
    again.renew_member_certificates(["anna"], 60)
    assert again.roster.number == site.pki.roster.number + 1
    assert again.roster.member_by_name["d2"].revoked
