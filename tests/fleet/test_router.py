"""A router between its clients, the desk and the vehicles, over TLS on loopback, with the files
that `ground-station pki` creates.
"""

import json
import signal
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from companion.core.base.errors import LeewayError
from companion.fleet.messages import Assign, CommandStatus, Result
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.adapters.zenoh_router import ZenohRouter
from ground_station.core.fleet.fleet_link import CommandResponse, FleetInput, StateReceived
from tests.fleet.programs import Program, program
from tests.fleet.secure_site import SecureSite
from tests.fleet.strangers import KEPT_OUT_S, PATIENCE_S, believe_all, hears, limits
from tests.fleet.zenoh_net import Vehicle

ASSIGNMENT = Assign(assignment="a1", order="o1", flight={"format": "flight/1"})


@contextmanager
def router_program(site: SecureSite, name: str) -> Iterator[Program]:
    with program("router", "--identity", site.home(name)) as router:
        router.said(f"{name}: router of harbour")
        yield router


def answer_to(fleet: ZenohFleet, id_: str, wait_s: float = PATIENCE_S) -> Result | None:
    def answer(heard: FleetInput) -> CommandResponse | None:
        mine = isinstance(heard, CommandResponse) and heard.command_id == id_
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
    """Start the desk and d1, and wait until d1 has joined."""
    with closing(site.person("desk")) as desk, closing(site.vehicle("d1", folder / "d1")) as d1:
        assert is_heard_after(desk, 0.0)
        yield desk, d1


@pytest.mark.sample
def test_an_assignment_goes_through_and_when_one_router_is_killed_through_the_other(tmp_path):
    site = SecureSite(tmp_path / "pki", routers=("r1", "r2"))
    with (
        program("router", "--identity", site.home("r1")) as first,
        router_program(site, "r2") as second,
    ):
        first.said("r1: router of harbour")
        with members(site, tmp_path) as (desk, d1):
            desk.send(limits(d1, "c1", action=ASSIGNMENT), PATIENCE_S)
            told = answer_to(desk, "c1")
            assert told is not None
            assert told.status is CommandStatus.DONE
            before_s = d1.port.member.uptime_s
            first.end(signal.SIGKILL)
            assert is_heard_after(desk, before_s + 0.5)
            desk.send(limits(d1, "c2"), PATIENCE_S)
            assert answer_to(desk, "c2") is not None
            assert [command.id for command in d1.done] == ["c1", "c2"]
        assert second.end(signal.SIGTERM) == 0
        assert second.words.endswith(b"r2: stopped\r\n")


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
    site.keep_rosters_of("anna")  # a revoked member keeps its old roster
    site.pki.revoke_members("anna")
    site.restore_rosters()
    if not rules:
        open_the_router(site.home("r1"))
    if not signatures:
        believe_all(monkeypatch)
    with (
        closing(ZenohRouter.open_router(site.home("r1"), lambda why: None)),
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
        link: Any = d1.port.member.link
        assert link.rejections.total == (2 if signatures and not rules else 0)


def open_the_router(home: Path) -> None:
    table = json.loads((home / "zenoh.json5").read_text())
    table["access_control"]["enabled"] = False
    (home / "zenoh.json5").write_text(json.dumps(table))


def refused(folder: Path) -> str:
    with pytest.raises(LeewayError) as error:
        ZenohRouter.open_router(folder, lambda why: None)
    return str(error.value)


def test_a_folder_that_is_no_routers_or_a_port_that_is_taken_is_said(tmp_path):
    site = SecureSite(tmp_path / "pki", routers=("r1",))
    assert refused(site.home("d1")).endswith("d1 is a vehicle, expected a router")
    home = site.home("r1")
    host, _, port = site.pki.roster.member_by_name["r1"].address.rpartition(":")
    with socket.create_server((host, int(port))):
        assert "in use" in refused(home)
    site.pki.revoke_members("r1")
    (home / "roster.json").write_bytes((site.pki.folder / "roster.json").read_bytes())
    assert refused(home) == f"{home}: r1 is revoked since roster {site.pki.roster.number}"
