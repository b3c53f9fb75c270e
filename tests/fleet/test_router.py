"""A router between a desk that nobody can call and its vehicles, over TLS on loopback, with what
`ground-station pki` makes.
"""

import json
import signal
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.messages import Answered, Assign, Result
from companion.fleet.zenoh_config import read_config
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.adapters.zenoh_router import ZenohRouter
from ground_station.core.fleet.fleet_link import CommandAnswered, FleetInput, StateReceived
from tests.fleet.programs import Program, program, short_day
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import KEPT_OUT_S, PATIENCE_S, believe_all, hears, limits
from tests.fleet.zenoh_net import Vehicle, free_port
from tests.ground_station.metrics.scrape import Scrape, scrape_until

ASSIGNMENT = Assign(assignment="a1", order="o1", flight={"format": "flight/1"})


@contextmanager
def router_program(site: SecureSite, name: str, *more: str) -> Iterator[Program]:
    with program("router", "--identity", site.home(name), *more) as router:
        router.said(f"{name}: router of harbour")
        yield router


def answer_to(fleet: ZenohFleet, id_: str, wait_s: float = PATIENCE_S) -> Result | None:
    def answer(heard: FleetInput) -> CommandAnswered | None:
        mine = isinstance(heard, CommandAnswered) and heard.command_id == id_
        return heard if mine else None  # pyright: ignore[reportReturnType]

    found = hears(fleet, answer, wait_s)
    assert found is not None
    return found.result


def is_heard_after(desk: ZenohFleet, uptime_s: float) -> bool:
    def later(heard: FleetInput) -> bool:
        return isinstance(heard, StateReceived) and heard.state.uptime_s > uptime_s

    return bool(hears(desk, later, PATIENCE_S))


@contextmanager
def members(site: SecureSite, folder: Path) -> Iterator[tuple[ZenohFleet, Vehicle]]:
    """The desk and d1, joined."""
    with closing(site.person("desk")) as desk, closing(site.vehicle("d1", folder / "d1")) as d1:
        assert is_heard_after(desk, 0.0)
        yield desk, d1


def test_an_assignment_goes_through_and_when_one_router_is_killed_through_the_other(tmp_path):
    site, port = SecureSite(tmp_path / "pki", routers=("r1", "r2")), free_port()
    metrics = ("--metrics", str(port))
    with (
        program("router", "--identity", site.home("r1")) as first,
        router_program(site, "r2", *metrics) as second,
    ):
        first.said("r1: router of harbour")
        with members(site, tmp_path) as (desk, d1):
            desk.send(limits(d1, "c1", deed=ASSIGNMENT), PATIENCE_S)
            told = answer_to(desk, "c1")
            assert told is not None
            assert told.answer is Answered.DONE
            before_s = d1.port.uptime_s
            first.end(signal.SIGKILL)
            assert is_heard_after(desk, before_s + 0.5)
            desk.send(limits(d1, "c2"), PATIENCE_S)
            assert answer_to(desk, "c2") is not None
            assert [command.id for command in d1.done] == ["c1", "c2"]
            seen = scrape_until(port, lambda seen: line_of(seen, "d1") and line_of(seen, "desk"))
        assert router_sample(seen, "sessions", kind="client") == 2
        assert 364 < (router_sample(seen, "certificate_days_left") or 0.0) <= 365
        assert (router_sample(seen, "seconds_since_turn") or 0.0) < PATIENCE_S
        assert second.end(signal.SIGTERM) == 0
        assert second.words.endswith(b"r2: stopped\r\n")


def router_sample(seen: Scrape, name: str, **labels: str) -> float | None:
    return seen.values.get((f"leeway_router_{name}", frozenset(labels.items())))


def line_of(seen: Scrape, member: str) -> float | None:
    return router_sample(seen, "lines", member=member)


GUARDS = pytest.mark.parametrize(
    ("rules", "signatures"),
    [(True, True), (False, True), (False, False)],
    ids=["refused", "an open router: refused by the vehicle", "canary: succeeds"],
)


@GUARDS
def test_a_revoked_member_and_a_viewer_command_nothing_through_it(
    tmp_path, monkeypatch, rules, signatures
):
    site = SecureSite(tmp_path / "pki", routers=("r1",))
    site.keep_rosters_of("anna")  # who is revoked does not go along with it
    site.pki.revoke("anna")
    site.restore_rosters()
    if not rules:
        open_the_router(site.home("r1"))
    if not signatures:
        believe_all(monkeypatch)
    with (
        closing(ZenohRouter.open(site.home("r1"), lambda why: None)) as router,
        members(site, tmp_path) as (_, d1),
        closing(site.person("anna")) as anna,
        closing(site.person("otto")) as otto,
    ):
        wait_s = KEPT_OUT_S if rules else PATIENCE_S
        for person, id_ in ((anna, "a"), (otto, "o")):
            person.send(limits(d1, id_), wait_s)
        answers = [answer_to(anna, "a"), answer_to(otto, "o")]
        assert {command.id for command in d1.done} == (set() if signatures else {"a", "o"})
        assert all(answer is None for answer in answers) is signatures
        link: Any = d1.port.link
        assert link.refusals.total == (2 if signatures and not rules else 0)
        assert "anna" in router.door.figures().unwelcome
        assert "otto" not in router.door.figures().unwelcome


def open_the_router(home: Path) -> None:
    table = json.loads((home / "zenoh.json5").read_text())
    table["access_control"]["enabled"] = False
    (home / "zenoh.json5").write_text(json.dumps(table))


def called(program: str, folder: Path) -> tuple[SecureSite, str, list[str | Path]]:
    """A site, who is called there, and with which command it is started."""
    if program == "router":
        site = SecureSite(folder / "pki", routers=("r1",))
        return site, "r1", ["router", "--identity", site.home("r1")]
    site = SecureSite(folder / "pki")
    store = f"sqlite:///{folder}/desk.db"
    start = ["dispatch", short_day(folder), "--identity", site.home("desk"), "--store", store]
    return site, "desk", start


@pytest.mark.parametrize("kind", ["router", pytest.param("desk", marks=pytest.mark.night)])
def test_who_calls_and_should_not_is_said_and_counted(tmp_path, kind):
    (site, name, start), port = called(kind, tmp_path), free_port()
    site.pki.now -= timedelta(days=400)
    site.pki.renew("otto", 365)
    site.pki.now += timedelta(days=400)
    site.keep_rosters_of("anna")
    site.pki.revoke("anna")
    site.restore_rosters()

    def sample(seen: Scrape, of: str, **labels: str) -> float | None:
        return seen.values.get((f"leeway_{kind}_{of}", frozenset(labels.items())))

    with program(*start, "--metrics", str(port)) as called_at:
        called_at.said("Ctrl-C stops")
        with session_of(site, "anna"):
            called_at.said("ON A LINE: anna is revoked")
            scrape_until(port, lambda seen: sample(seen, "unwelcome_member", member="anna"))
        scrape_until(port, lambda seen: not sample(seen, "unwelcome_member", member="anna"))
        host, _, at = site.pki.roster.by_name[name].address.rpartition(":")
        with socket.create_connection((host, int(at))) as line:
            line.sendall(b"\x16\x03\x01 who has no certificate")
            called_at.said("turned away: 1 without a certificate of this fleet")
        with suppress(zenoh.ZError), session_of(site, "otto"):
            pass
        seen = scrape_until(port, lambda seen: sample(seen, "calls_turned_away_total", why="ended"))
        assert sample(seen, "calls_turned_away_total", why="stranger") == 1
        assert called_at.end(signal.SIGINT) == 0


def session_of(site: SecureSite, name: str) -> zenoh.Session:
    return zenoh.open(read_config(site.home(name) / "zenoh.json5"))


def refused(folder: Path) -> str:
    with pytest.raises(LeewayError) as error:
        ZenohRouter.open(folder, lambda why: None)
    return str(error.value)


def test_a_folder_that_is_no_routers_or_a_port_that_is_taken_is_said(tmp_path):
    site = SecureSite(tmp_path / "pki", routers=("r1",))
    assert refused(site.home("d1")).endswith("d1 is a vehicle, expected a router's")
    home = site.home("r1")
    host, _, port = site.pki.roster.by_name["r1"].address.rpartition(":")
    with socket.create_server((host, int(port))):
        assert "in use" in refused(home)
    site.pki.revoke("r1")
    (home / "roster.json").write_bytes((site.pki.folder / "roster.json").read_bytes())
    assert refused(home) == f"{home}: r1 is revoked"
