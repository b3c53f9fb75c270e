"""Author of a change: with an identity the audit names the signing member and its role applies."""

from datetime import timedelta
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.fleet.identity import SIGNING_KEY
from companion.fleet.roles import Role
from companion.fleet.trust import MemberTrust
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.app.cli.main import app
from ground_station.app.options.desk_options import resolve_operator
from ground_station.core.people.person import desk_signing_name, member_operator
from tests.fleet.secure_site import SecureSite
from tests.ground_station.store.test_holds import aboard
from tests.ground_station.store.test_order_store import an_order, opened

PLACE = ("--lat=55", "--lon=8", "--alt=3", "--mass=0.4")
WRITING = {
    "hold": ("hold", "d1", "--reason", "gusts"),
    "release": ("release", "d2"),
    "order add": ("order", "add", "o9", *PLACE),
    "order import": ("order", "import", "harbour"),
    "order cancel": ("order", "cancel", "o2", "--reason", "asked"),
    "order change": ("order", "change", "o2", "--phone", "12"),
    "order proof": ("order", "proof", "o4", "--photo", "d.db"),
    "order settle, cancelled": ("order", "settle", "o3", "--back", "--reason", "found"),
    "order launch": ("order", "launch", "o1"),
    "order settle": ("order", "settle", "o1", "--back", "--reason", "it stands here"),
    "store restore": ("store", "restore", "copy.db", "--replace", "before.db"),
    "store upgrade": ("store", "upgrade", "--backup", "before.db"),
    "dispatch": ("dispatch", "harbour", "--until-done"),
    "recall": ("recall", "--all", "--fleet", "harbour"),
}
"""Every command that writes to the store."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> SecureSite:
    return SecureSite(tmp_path_factory.mktemp("site") / "pki")


@pytest.fixture
def url(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A store with an order assigned to d1, an open one, a cancelled one, and a hold of d2."""
    monkeypatch.chdir(tmp_path)
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2"), an_order("o3")])
        aboard(store)
    run(url, "order", "cancel", "o3", "--reason", "asked")
    run(url, "hold", "d2", "--reason", "propeller")
    return url


def run(url: str, *words: str) -> None:
    done = CliRunner().invoke(app, [*words, "--store", url], catch_exceptions=False)
    assert done.exit_code == 0, done.output


def audited(url: str) -> list[tuple[str, str]]:
    with opened(url) as store:
        rows, _ = read_audit_rows_and_head(store.database)
    return [(row.entry.who, row.entry.deed) for row in rows]


@pytest.mark.parametrize("command", ["hold", "release", "order launch", "order settle"])
def test_with_an_identity_the_audit_names_the_member_that_the_roster_lists(site, url, command):
    run(url, *WRITING[command], "--identity", str(site.home("anna")))
    assert "anna" in {who for who, _ in audited(url)}


def test_another_name_beside_an_identity_stands_before_the_member_who_proves_it(site, url):
    run(url, *WRITING["hold"], "--identity", str(site.home("anna")), "--user", "ben")
    assert audited(url)[-1] == ("ben by way of anna", "hold")
    run(url, "release", "d1", "--identity", str(site.home("anna")), "--user", "anna")
    assert audited(url)[-1] == ("anna", "release")


@pytest.mark.parametrize("command", WRITING)
def test_a_viewer_changes_nothing_in_the_store_by_any_command(site, url, command):
    before = audited(url)
    with pytest.raises(LeewayError, match="otto is a viewer: may not command"):
        run(url, *WRITING[command], "--identity", str(site.home("otto")))
    assert audited(url) == before


def test_canary_without_the_look_at_the_role_a_viewer_would_hold_a_drone(site, url, monkeypatch):
    monkeypatch.setattr(MemberTrust, "command_permission_error_or_empty", lambda self: "")
    run(url, *WRITING["hold"], "--identity", str(site.home("otto")))
    assert audited(url)[-1] == ("otto", "hold")


def test_who_is_revoked_or_expired_or_has_another_members_name_does_nothing(tmp_path):
    site = SecureSite(tmp_path / "pki")
    site.pki.revoke_members("d2")
    site.keep_rosters_of("anna")
    theirs = site.home("anna") / SIGNING_KEY
    key = theirs.read_bytes()
    theirs.write_bytes((site.home("otto") / SIGNING_KEY).read_bytes())
    with pytest.raises(LeewayError, match="the signing key is not the one of anna on the roster"):
        resolve_operator(None, site.home("anna"))
    theirs.write_bytes(key)
    assert resolve_operator(None, site.home("anna")).name == "anna"
    site.pki.now -= timedelta(days=400)
    site.pki.renew_member_certificates(["anna"], 365)
    with pytest.raises(LeewayError, match="the certificate of anna has expired"):
        resolve_operator(None, site.home("anna"))
    site.pki.revoke_members("anna")
    (site.home("anna") / "roster.json").write_bytes((site.pki.folder / "roster.json").read_bytes())
    with pytest.raises(LeewayError, match="anna is revoked"):
        resolve_operator(None, site.home("anna"))


def test_an_identity_of_another_fleet_does_nothing(site):
    with pytest.raises(LeewayError, match="of fleet harbour, expected elsewhere"):
        resolve_operator(None, site.home("anna"), "elsewhere")


def test_a_desk_signs_its_own_decisions_by_its_own_name_and_says_who_started_it(site):
    desk = site.home("desk")
    assert desk_signing_name(resolve_operator(None, desk)) == "desk"
    assert resolve_operator("anna", desk).name == "anna by way of desk"
    assert desk_signing_name(resolve_operator(None, site.home("anna"))) == "desk/anna"


def test_the_name_said_and_the_member_fit_into_a_command_or_are_refused():
    member = "a" * 32
    person = member_operator(member, Role.DISPATCHER, "b" * 16)
    assert len(desk_signing_name(person)) == 64
    with pytest.raises(LeewayError, match=f"expected at most 16 characters with {member}"):
        member_operator(member, Role.DISPATCHER, "b" * 17)
