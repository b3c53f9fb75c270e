"""Rosters and certificates that change while a desk or router runs, over live TLS on loopback."""

import socket
import ssl
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from datetime import timedelta
from pathlib import Path

import pytest
import zenoh
from cryptography import x509

from companion.fleet.zenoh_config import read_and_check_zenoh_config
from ground_station.adapters.called_session import MIN_REOPEN_INTERVAL_S, ServerSession
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.adapters.pki.pki_folder import utc_datetime
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.adapters.zenoh_router import ZenohRouter
from ground_station.core.fleet.fleet_link import FleetInput, StateReceived
from tests.fleet.programs import program, short_day
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import KEPT_OUT_S, PATIENCE_S
from tests.fleet.zenoh_net import FLEET, Vehicle

BY_WHOM = pytest.mark.parametrize("called", ["desk", "router"])
DRAWN = pytest.mark.drawn(of="called")
FOLLOWS = pytest.mark.parametrize("follows", [True, False], ids=["follows", "canary"])


class Running:
    """A desk and its router, if any, updated together."""

    def __init__(self, site: SecureSite, stack: ExitStack, said: list[str]) -> None:
        self.site = site
        self.router: ZenohRouter | None = None
        if "r1" in site.pki.roster.member_by_name:
            opened = ZenohRouter.open_router(site.home("r1"), said.append, said.append)
            self.router = stack.enter_context(closing(opened))
        self.desk: ZenohFleet = stack.enter_context(closing(site.person("desk")))

    def until(self, is_so: Callable[[], bool], wait_s: float = PATIENCE_S) -> bool:
        limit_s = monotonic_s() + wait_s
        while monotonic_s() < limit_s:
            self.turn()
            if is_so():
                return True
        return False

    def turn(self) -> list[FleetInput]:
        if self.router is not None:
            self.router.accept_roster_and_reopen_if_stale(monotonic_s())
        return self.desk.receive(0.05)

    def hears(self, vehicle: Vehicle, wait_s: float = PATIENCE_S) -> bool:
        """Return whether the desk receives a newer state of this life."""
        from_s, life = vehicle.port.member.uptime_s, vehicle.port.member.instance_id
        limit_s = monotonic_s() + wait_s
        while monotonic_s() < limit_s:
            for heard in self.turn():
                state = heard.state if isinstance(heard, StateReceived) else None
                if state is not None and state.instance_id == life and state.uptime_s > from_s:
                    return True
        return False


@contextmanager
def running(called: str, folder: Path, said: list[str] | None = None) -> Iterator[Running]:
    site = SecureSite(folder / "pki", routers=("r1",) if called == "router" else ())
    with ExitStack() as stack:
        yield Running(site, stack, [] if said is None else said)


def stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ServerSession, "poll_and_check_if_reopen_due", lambda self, now_s: False)


@pytest.mark.sample
@DRAWN
@BY_WHOM
@FOLLOWS
def test_who_is_revoked_hears_nothing_any_more(tmp_path, monkeypatch, called, follows):
    if not follows:
        stays_as_it_is(monkeypatch)
    seen: list[float] = []
    with (
        running(called, tmp_path) as fleet,
        closing(fleet.site.vehicle("d1", tmp_path / "d1")) as d1,
        zenoh.open(read_and_check_zenoh_config(fleet.site.home("otto") / "zenoh.json5")) as otto,
    ):
        spy = otto.declare_subscriber(
            f"leeway/{FLEET}/vehicle/*/state", lambda sample: seen.append(monotonic_s())
        )
        assert fleet.until(lambda: bool(seen)), "canary: a viewer hears states"
        fleet.site.pki.revoke_members("otto")
        if follows:
            assert fleet.until(lambda: seen[-1] < monotonic_s() - KEPT_OUT_S)
        assert fleet.hears(d1)
        from_s = monotonic_s()
        assert fleet.until(lambda: seen[-1] > from_s, KEPT_OUT_S) is not follows
        spy.undeclare()


@pytest.mark.sample
@DRAWN
@BY_WHOM
@FOLLOWS
def test_a_member_that_is_added_joins_what_runs(tmp_path, monkeypatch, called, follows):
    from companion.fleet.roles import Role

    if not follows:
        stays_as_it_is(monkeypatch)
    said: list[str] = []
    with (
        running(called, tmp_path, said) as fleet,
        closing(fleet.site.vehicle("d1", tmp_path / "d1")) as d1,
    ):
        assert fleet.hears(d1)
        fleet.site.pki.add_member("d3", Role.VEHICLE, 365, "")
        with closing(fleet.site.vehicle("d3", tmp_path / "d3")) as d3:
            assert fleet.hears(d3, PATIENCE_S if follows else KEPT_OUT_S) is follows
        assert fleet.hears(d1)
    number = fleet.site.pki.roster.number
    words = [f"session reopened for roster {number}: members reconnect"]
    assert said == (words if called == "router" and follows else [])


def shown_end(site: SecureSite, name: str) -> float:
    """Return the expiry time of the certificate that this member presents to d1."""
    context = ssl.create_default_context(cafile=str(site.home("d1") / "ca.pem"))
    context.load_cert_chain(site.home("d1") / "tls.pem", site.home("d1") / "tls.key")
    context.check_hostname = False
    host, _, port = site.pki.roster.member_by_name[name].address.rpartition(":")
    with (
        socket.create_connection((host, int(port)), PATIENCE_S) as line,
        context.wrap_socket(line) as tls,
    ):
        shown = tls.getpeercert(binary_form=True)
    assert shown is not None
    return x509.load_der_x509_certificate(shown).not_valid_after_utc.timestamp()


@pytest.mark.sample
@DRAWN
@BY_WHOM
@FOLLOWS
def test_a_renewed_certificate_is_shown_by_what_runs(tmp_path, monkeypatch, called, follows):
    if not follows:
        stays_as_it_is(monkeypatch)
    with running(called, tmp_path) as fleet:
        name = "r1" if called == "router" else "desk"
        before_s = shown_end(fleet.site, name)
        fleet.site.pki.now = utc_datetime(epoch_us()) + timedelta(seconds=1)
        fleet.site.pki.renew_member_certificates([name], 500)

        def is_new() -> bool:
            return shown_end(fleet.site, name) > before_s + 100 * 86400.0

        assert fleet.until(is_new, PATIENCE_S if follows else KEPT_OUT_S) is follows


def test_a_folder_that_is_half_carried_changes_nothing(tmp_path):
    site = SecureSite(tmp_path / "pki")
    home, other = site.home("desk"), site.home("d1")
    called = ServerSession(site.identity("desk"))
    key, config = (home / "tls.key").read_bytes(), (home / "zenoh.json5").read_bytes()
    clock_s = 0.0

    def is_old() -> bool:
        nonlocal clock_s
        clock_s += MIN_REOPEN_INTERVAL_S + 1.0
        return called.poll_and_check_if_reopen_due(clock_s)

    with called.open_session():
        assert not is_old()
        (home / "tls.key").write_bytes((other / "tls.key").read_bytes())
        assert not is_old(), "a key of another certificate"
        (home / "tls.key").write_bytes(key)
        (home / "zenoh.json5").write_bytes(config[:-40])
        assert not is_old(), "a torn network file"
        (home / "zenoh.json5").unlink()
        assert not is_old(), "no network file"
        (home / "zenoh.json5").write_bytes(config)
        assert not is_old(), "all as it was"
        site.pki.renew_member_certificates(["desk"], 700)
        assert is_old(), "canary: whole, and new"


def test_a_second_change_waits_until_all_have_had_time_to_call(tmp_path):
    site = SecureSite(tmp_path / "pki")
    called = ServerSession(site.identity("desk"))
    session = called.open_session()
    try:
        site.pki.renew_member_certificates(["desk"], 500)
        assert called.poll_and_check_if_reopen_due(10.0), "the first at once"
        session = called.close_and_reopen_session(session, 10.0)
        site.pki.renew_member_certificates(["desk"], 600)
        assert not called.poll_and_check_if_reopen_due(10.0 + MIN_REOPEN_INTERVAL_S - 1.0)
        assert called.poll_and_check_if_reopen_due(10.0 + MIN_REOPEN_INTERVAL_S + 1.0)
    finally:
        session.close()


@pytest.mark.sample
def test_the_desk_says_it(tmp_path):
    site = SecureSite(tmp_path / "pki")
    store = f"sqlite:///{tmp_path}/desk.db"
    day = short_day(tmp_path)
    with program("dispatch", day, "--identity", site.home("desk"), "--store", store) as desk:
        desk.said("Ctrl-C stops")
        site.pki.revoke_members("otto")
        desk.said(f"session reopened for roster {site.pki.roster.number}: members reconnect")
