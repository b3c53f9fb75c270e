"""Without a configuration, programs on one machine connect; no other machine can connect."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest
import zenoh
from typer.testing import CliRunner

from companion.app.cli import flying
from companion.app.flight import fleet_run
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.loaded_flight import RunOptions
from companion.app.flight.run import NO_LINK
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Decision
from companion.fleet import zenoh_config
from companion.fleet.membership import JoinOptions, read_membership
from companion.fleet.network import OPEN_WARNING
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.store.database import Database
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.cli.main import app
from ground_station.core.fleet.fleet_link import StateReceived
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port

PATIENCE_S = 20.0


@pytest.fixture(autouse=True)
def own_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use another port than other programs on this machine."""
    monkeypatch.setattr(zenoh_config, "MESH_PORT", free_port())


def vehicle_of(name: str, tmp_path: Path) -> Vehicle:
    return Vehicle.on(
        name, tmp_path / name, read_membership(VehicleKeys(FLEET, name), None).open_link
    )


def until(wanted: Callable[[], Any]) -> Any:
    limit_s = monotonic_s() + PATIENCE_S
    while monotonic_s() < limit_s:
        found = wanted()
        if found:
            return found
    raise AssertionError(f"not within {PATIENCE_S} s")


def names_heard(desk: ZenohFleet) -> set[str]:
    return {h.state.vehicle for h in desk.receive(0.1) if isinstance(h, StateReceived)}


@pytest.mark.sample
@pytest.mark.parametrize("first", ["desk", "vehicle"])
def test_who_comes_first_listens_and_when_it_ends_the_others_find_one_another(tmp_path, first):
    if first == "desk":
        desk, d1 = ZenohFleet(FLEET, None), vehicle_of("d1", tmp_path)
    else:
        d1 = vehicle_of("d1", tmp_path)
        until(lambda: not d1.port.member.link.session_thread.error_text)
        desk = ZenohFleet(FLEET, None)
    until(lambda: "d1" in names_heard(desk))
    if first == "desk":  # the listener exits and reconnects as a client
        desk.close()
        d2 = vehicle_of("d2", tmp_path)
        desk = ZenohFleet(FLEET, None)
    else:
        d1.close()
        d2 = vehicle_of("d2", tmp_path)
        d1 = vehicle_of("d1", tmp_path)
    heard: set[str] = set()
    until(lambda: heard.update(names_heard(desk)) or {"d1", "d2"} <= heard)
    for one in (desk, d1, d2):
        one.close()


def open_ports() -> set[str]:
    """Return the addresses at which other machines can reach this process."""
    found = psutil.Process().net_connections(kind="inet")
    open_ = [c for c in found if c.status == psutil.CONN_LISTEN or c.type.name == "SOCK_DGRAM"]
    return {str(c.laddr.ip) for c in open_ if not c.laddr.ip.startswith("127.")}


@pytest.mark.parametrize("told", [False, True], ids=["closed", "canary: --open-network"])
def test_nothing_listens_beyond_this_machine_unless_a_person_said_so(told):
    before = open_ports()
    with zenoh.open(read_and_check_zenoh_config(None, open_network=told)):
        assert bool(open_ports() - before) is told


OPEN = {
    "found by multicast": {"mode": "peer", "listen": {"endpoints": ["tcp/127.0.0.1:0"]}},
    r"listens on tcp/\[::\]:0 without TLS": {"mode": "peer"},
    r"listens on tcp/\[::\]:7447 without TLS": {"mode": "router"},
    "listens on tcp/0.0.0.0:7447 without TLS": {"listen": {"endpoints": ["tcp/0.0.0.0:7447"]}},
    "without requiring a client certificate": {"listen": {"endpoints": ["tls/0.0.0.0:7447"]}},
    "connects to tcp/10.0.0.1:7447 without TLS": {
        "mode": "client",
        "connect": {"endpoints": ["tcp/10.0.0.1:7447"]},
    },
}


@pytest.mark.parametrize("why", OPEN)
def test_a_configuration_that_lets_strangers_in_is_refused_without_the_word(tmp_path, why):
    alone = {"scouting": {"multicast": {"enabled": False}}}
    path = tmp_path / "zenoh.json5"
    path.write_text(json.dumps(OPEN[why] | ({} if "multicast" in why else alone)))
    with pytest.raises(LeewayError, match=f"{why}.*--open-network"):
        read_and_check_zenoh_config(path)
    read_and_check_zenoh_config(path, open_network=True)


def test_loopback_and_mutual_tls_need_no_word(tmp_path):
    read_and_check_zenoh_config(
        config_file(tmp_path / "a.json5", listen=free_port(), connect=free_port())
    )
    tls = {"transport": {"link": {"tls": {"enable_mtls": True}}}}
    table = {"listen": {"endpoints": ["tls/0.0.0.0:7447"]}, "mode": "router"}
    away = {"scouting": {"multicast": {"enabled": False}}}
    (tmp_path / "b.json5").write_text(json.dumps(table | tls | away))
    read_and_check_zenoh_config(tmp_path / "b.json5")


def test_an_open_desk_says_so(tmp_path):
    config = config_file(tmp_path / "a.json5", listen=free_port())
    desk = ZenohFleet(FLEET, config, JoinOptions(open_network=True))
    assert desk.open_network
    desk.close()


def test_every_status_of_an_open_network_says_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = str(config_file(tmp_path / "a.json5", listen=free_port()))
    Database("sqlite:///desk.db").close()
    words = ["watch", "--fleet", FLEET, "--zenoh", config, "--seconds", "0.1"]
    words += ["--store", "sqlite:///desk.db"]
    assert "OPEN NETWORK" not in CliRunner().invoke(app, words).output
    assert "OPEN NETWORK" in CliRunner().invoke(app, [*words, "--open-network"]).output


@pytest.mark.parametrize("told", [False, True], ids=["canary: closed", "open"])
def test_where_a_driver_stands_is_marked_on_an_open_network(tmp_path, monkeypatch, told):
    monkeypatch.chdir(tmp_path)
    config = str(config_file(tmp_path / "a.json5", listen=free_port()))
    words = ["truck", "harbour", "--zenoh", config, *(["--open-network"] if told else [])]
    shown = CliRunner().invoke(app, words, input="2\nq\n").output.splitlines()
    where = [line for line in shown if "at depot" in line]
    assert where
    assert all(line.startswith("[OPEN NETWORK] ") is told for line in where)


@pytest.mark.parametrize("told", [False, True], ids=["canary: closed", "open"])
def test_each_line_of_a_companion_on_an_open_network_says_so(tmp_path, monkeypatch, capsys, told):
    """Checks the standby line and a flight's decisions; the desk receives the warning at start."""
    zenoh_file = config_file(tmp_path / "a.json5", connect=free_port())
    said: list[str] = []

    def one_flight(port: FleetPort, *flight: Any) -> int:
        *_, on_action = flight
        on_action(Decision(1.0, "gate", "open: going"))
        port.member.wait_for_disk_and_publish_events()
        said.extend(
            [
                port.member.status_text,
                *(event.text for event in port.member.log.next_stored_events_after(0)),
            ]
        )
        return NO_LINK  # ends the fleet's loop

    monkeypatch.setattr(fleet_run, "_wait_for_assignment", lambda *given: True)
    monkeypatch.setattr(fleet_run, "_fly_assignment", one_flight)
    line = fleet_run.FleetOptions(FLEET, "d1", zenoh_file, JoinOptions(None, told))
    flying.fly_in_fleet_and_return_exit_code(
        line, RunOptions("memory", "m100", Path(), tmp_path), one_mission=False
    )
    printed = capsys.readouterr().out.splitlines()
    assert [one.replace("[OPEN NETWORK] ", "") for one in printed] == [
        "standing by as d1 of harbour",
        "      1.0 s  gate: open: going",
    ]
    assert all(one.startswith("[OPEN NETWORK] ") is told for one in printed)
    assert said == ([OPEN_WARNING, OPEN_WARNING] if told else [""])


@pytest.mark.sample
def test_a_fleet_without_identities_loads_no_cryptography():
    code = (
        "import sys; import companion.app.flight.fleet_run, ground_station.adapters.zenoh_fleet;"
        "print('cryptography' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


JOIN_400 = """
import os, sys, zenoh
from pathlib import Path
from companion.fleet.zenoh_config import read_and_check_zenoh_config
ours = lambda path: read_and_check_zenoh_config(Path(path))
opened = {"ours": ours, "zenoh's": zenoh.Config.from_file}[sys.argv[1]]
held = [zenoh.open(opened(sys.argv[2]))]
try:
    for number in range(400):
        held.append(zenoh.open(opened(sys.argv[3])))
except zenoh.ZError:
    pass
print(len(held) - 1, flush=True)
os._exit(0)
"""


def test_a_desk_is_joined_by_400_members(tmp_path):
    """Canary: with zenoh's default shared-memory settings the 352nd member is refused."""
    port = free_port()
    desk, member = config_file(tmp_path / "desk.json5", listen=port), tmp_path / "member.json5"
    calls = {"connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
    alone = {"scouting": {"multicast": {"enabled": False}}}
    member.write_text(json.dumps({"mode": "client", **calls, **alone}))
    joined: dict[str, int] = {}
    for whose in ("ours", "zenoh's"):
        words = [sys.executable, "-c", JOIN_400, whose, str(desk), str(member)]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
        joined[whose] = int(done.stdout)
    assert joined["ours"] == 400
    assert joined["zenoh's"] < 400
