"""`ground-station pki`: the commands of docs/how-to/secure-a-fleet.md exactly as documented."""

import re
import shlex
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.fleet.identity import read_and_verify_identity
from companion.fleet.messages import Command, CommandStatus, Recall
from companion.fleet.roles import Role
from companion.fleet.roster import Roster
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.pki.pki_folder import PkiFolder, utc_datetime
from ground_station.adapters.store.database import Database
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.cli.main import app
from ground_station.core.fleet.fleet_link import CommandResponse, StateReceived
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import hears
from tests.fleet.zenoh_net import FLEET, free_port

DAY = str(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "secure-a-fleet.md"
PATIENCE_S = 20.0


def pki(*words: str) -> str:
    """Run one command and return its output."""
    result = CliRunner().invoke(app, ["pki", *words], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def commands_of_the_page() -> list[list[str]]:
    block = re.search(r"## A desk and two drones.*?```\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert block
    return [shlex.split(line) for line in block.group(1).splitlines()]


def state_of(vehicle: str, fleet: ZenohFleet) -> StateReceived | None:
    return hears(
        fleet,
        lambda h: h if isinstance(h, StateReceived) and h.state.vehicle == vehicle else None,
        PATIENCE_S,
    )


def test_the_five_commands_of_the_page_secure_a_desk_and_two_drones(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    commands = commands_of_the_page()
    assert len(commands) == 5
    port = free_port()
    for program, part, *words in commands:
        assert (program, part) == ("ground-station", "pki")
        pki(*(w.replace("desk.harbour.example:7447", f"127.0.0.1:{port}") for w in words))
    site = SecureSite.of(tmp_path / "fleet-pki", port)
    desk = site.person("desk")
    drones = [site.vehicle(name, tmp_path / name) for name in ("d1", "d2")]
    try:
        for drone in drones:
            assert state_of(drone.port.member.vehicle, desk)
        told = {"id": "r", "vehicle": "d2", "instance_id": "x", "as_of_s": 0.0, "by": "anna"}
        desk.send(Command(**told, action=Recall()), PATIENCE_S)
        answer = hears(desk, lambda h: h if isinstance(h, CommandResponse) else None, PATIENCE_S)
        assert answer.result.status is CommandStatus.DONE
        assert [command.by for command in drones[1].done] == ["anna by way of desk"]
        assert drones[0].done == []
    finally:
        for one in (*drones, desk):
            one.close()


def test_watch_says_whose_certificate_ends_within_a_month(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    site = SecureSite(tmp_path / "pki", days={"d2": 20})
    Database("sqlite:///desk.db").close()
    words = ["watch", "--fleet", FLEET, "--identity", str(site.home("otto")), "--seconds", "0.1"]
    with closing(site.person("desk")):
        shown = CliRunner().invoke(app, [*words, "--store", "sqlite:///desk.db"]).output
    assert "WARNING: certificates: d2 ends in 20 days (ground-station pki renew)" in shown


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    pki("init", "harbour")
    pki("add", "d1", "--role", "vehicle")
    return tmp_path / "fleet-pki"


def test_private_keys_are_for_their_owner_only(fleet):
    private = [p for p in fleet.rglob("*") if p.suffix == ".key"]
    assert {p.name for p in private} == {"tls.key", "signing.key", "roster.key"}
    assert {p.stat().st_mode & 0o777 for p in private} == {0o600}
    assert (fleet / "authority" / "1").stat().st_mode & 0o777 == 0o700
    assert fleet.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize(("days", "code"), [("32", 0), ("30", 3), ("1", 3)])
def test_status_ends_with_a_code_of_its_own_a_month_before_an_end(fleet, days, code):
    pki("add", "d2", "--role", "vehicle", "--days", days)
    result = CliRunner().invoke(app, ["pki", "status"])
    assert result.exit_code == code
    assert ("pki renew d2" in result.output) is (code == 3)
    pki("renew", "d2")
    assert CliRunner().invoke(app, ["pki", "status"]).exit_code == 0


def test_who_is_revoked_is_not_asked_to_be_renewed_and_may_come_again_with_new_keys(fleet):
    pki("add", "d2", "--role", "vehicle", "--days", "1")
    before = PkiFolder.read(fleet, utc_datetime(epoch_us())).roster.member_by_name["d2"]
    assert "roster 4 revokes d2" in pki("revoke", "d2")
    assert "revoked" in pki("status")
    pki("add", "d2", "--role", "vehicle")
    after = PkiFolder.read(fleet, utc_datetime(epoch_us())).roster.member_by_name["d2"]
    assert after.key != before.key
    assert not after.revoked


def test_several_are_added_renewed_and_revoked_by_one_roster_each(fleet):
    def roster() -> Roster:
        return PkiFolder.read(fleet, utc_datetime(epoch_us())).roster

    number = roster().number
    pki("add", "d2", "d3", "d4", "--role", "vehicle", "--days", "20")
    assert roster().number == number + 1
    keys = {name: roster().member_by_name[name].key for name in ("d2", "d3", "d4")}
    assert len(set(keys.values())) == 3
    assert "no certificate expires within 10 days" in pki("renew", "--ending", "10")
    said = pki("renew", "--ending", "30")
    assert [f"copy tls.pem to {name} " in said for name in ("d1", "d2", "d3", "d4")] == [
        *(False, True, True, True)
    ]
    assert roster().number == number + 2
    left = {m.name: (m.not_after - utc_datetime(epoch_us())).days for m in roster().members}
    assert min(left.values()) >= 363
    for name, key in keys.items():
        assert roster().member_by_name[name].key == key
        assert read_and_verify_identity(fleet / "members" / name).trust.roster.number == number + 2
    assert "revokes d3, d4" in pki("revoke", "d3", "d4")
    assert [m.name for m in roster().members if m.revoked] == ["d3", "d4"]


def two_fleets(*more: str) -> None:
    for name, folder in (("north", "a"), ("south", "b")):
        pki("init", name, "--pki", folder)
        pki("add", "desk", "--role", "desk", "--pki", folder)
        pki("add", "d1", *more, "--role", "vehicle", "--pki", folder)


def test_fleets_of_one_operator_become_neighbours_by_one_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    two_fleets()
    shown = pki("add", "b", "--role", "neighbour", "--pki", "a")
    given = Path("a") / "members" / "desk" / "neighbours" / "south"
    assert str(given) in shown
    assert given.stat().st_mode & 0o777 == 0o700
    assert (given / "signing.key").stat().st_mode & 0o777 == 0o600
    theirs = read_and_verify_identity(given).trust
    assert (theirs.fleet, theirs.name, theirs.own_roster_entry.role) == (
        "south",
        "north",
        Role.NEIGHBOUR,
    )
    assert set(theirs.roster.member_by_name) == {"desk", "d1", "north"}
    roster = PkiFolder.read(Path("a"), utc_datetime(epoch_us())).roster
    assert roster.neighbour_fleet_names == ["south"]
    number, key = roster.number, theirs.private_key
    pki("add", "b", "--role", "neighbour", "--pki", "a")
    again = PkiFolder.read(Path("a"), utc_datetime(epoch_us())).roster
    assert (again.number, read_and_verify_identity(given).trust.private_key) == (number, key), (
        "nothing is new"
    )
    pki("revoke", "south", "--pki", "a")
    pki("add", "b", "--role", "neighbour", "--pki", "a")
    assert read_and_verify_identity(given).trust.private_key == key, "south's word for north stands"
    anew = Path("b") / "members" / "desk" / "neighbours" / "north"
    revived = PkiFolder.read(Path("a"), utc_datetime(epoch_us())).roster.member_by_name["south"]
    assert read_and_verify_identity(anew).trust.own_roster_entry == revived


@pytest.mark.parametrize(
    ("folders", "more", "why"),
    [
        (["a"], (), "expected fleets of different names"),
        (["b"], ("south",), "south is a vehicle"),
        (["c"], (), "no desk on the roster"),
    ],
)
def test_who_cannot_be_neighbours_is_told_why_and_nothing_is_made(
    tmp_path, monkeypatch, folders, more, why
):
    monkeypatch.chdir(tmp_path)
    two_fleets(*more)
    pki("init", "east", "--pki", "c")
    result = CliRunner().invoke(app, ["pki", "add", *folders, "--role", "neighbour", "--pki", "a"])
    assert isinstance(result.exception, LeewayError)
    assert why in str(result.exception)
    assert PkiFolder.read(Path("a"), utc_datetime(epoch_us())).roster.neighbour_fleet_names == []


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("init harbour", "holds a fleet already"),
        ("add d1 --role vehicle", "on the roster already, as vehicle"),
        ("add d2 --role vehicle --address a:1", "a vehicle has no address"),
        ("add r1 --role router", "expected HOST:PORT"),
        ("add desk --role desk --address nowhere", "desk: "),
        ("add D2 --role vehicle", "expected 1 to 32 small letters"),
        ("add d2 d3 d1 --role vehicle", "on the roster already, as vehicle"),
        ("add d2 d2 --role vehicle", "d2: named twice"),
        ("add r1 r2 --role router --address a:1", "expected one member at an address"),
        ("renew d9", "not on the roster"),
        ("renew d1 d9", "d9: not on the roster"),
        ("renew", "expected names, or --ending DAYS"),
        ("renew d1 --ending 30", "expected names, or --ending DAYS"),
        ("revoke d9", "not on the roster"),
        ("revoke d1 d9", "d9: not on the roster"),
        ("status --pki elsewhere", "no such folder"),
    ],
)
def test_a_mistake_is_told_in_one_line_and_changes_nothing(fleet, words, why):
    before = (fleet / "roster.toml").read_bytes()
    with pytest.raises(LeewayError, match=why):
        pki(*words.split())
    assert (fleet / "roster.toml").read_bytes() == before


def test_only_desks_and_routers_at_an_address_bear_it_and_may_be_servers(fleet):
    from cryptography import x509
    from cryptography.x509.oid import ExtendedKeyUsageOID

    for name, role in (("anna", "dispatcher"), ("eve", "supervisor"), ("van", "truck")):
        pki("add", name, "--role", role)
    pki("add", "desk", "--role", "desk", "--address", "desk.example:7447")
    pki("add", "r1", "--role", "router", "--address", "10.0.0.1:7447")
    for home in (fleet / "members").iterdir():
        made = x509.load_pem_x509_certificate((home / "tls.pem").read_bytes())
        uses = made.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        names = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        serves = ExtendedKeyUsageOID.SERVER_AUTH in uses
        assert serves is (home.name in ("desk", "r1"))
        hosts = names.get_values_for_type(x509.DNSName) + [
            str(ip) for ip in names.get_values_for_type(x509.IPAddress)
        ]
        assert hosts == {"desk": ["desk.example"], "r1": ["10.0.0.1"]}.get(home.name, [])


@pytest.mark.parametrize("command", ["recall", "dispatch"])
def test_a_viewer_writes_no_command_into_the_store_that_a_desk_would_send(fleet, command):
    pki("add", "desk", "--role", "desk", "--address", f"127.0.0.1:{free_port()}")
    pki("add", "otto", "--role", "viewer")
    words = {"recall": ["recall", "--all", "--fleet", "harbour"], "dispatch": ["dispatch", DAY]}
    options = ["--identity", str(fleet / "members" / "otto"), "--store", "sqlite:///desk.db"]
    with pytest.raises(LeewayError, match="otto is a viewer: may not command"):
        CliRunner().invoke(app, [*words[command], *options], catch_exceptions=False)
    assert not Path("desk.db").exists()
