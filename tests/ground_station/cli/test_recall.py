"""`ground-station recall`: by the companion, and past it only when it has long been silent."""

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.fleet.command_log import Verdict
from companion.fleet.messages import Answered, Recall
from ground_station.app.cli.dispatch import app
from sim_bridge.app.serve.server import Host, stand_up
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from sim_bridge.truth.params import load_airframe
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port

PARAMS = Path(__file__).parents[3] / "params"
CODE = "from ground_station.app.cli.main import main; main()"


@pytest.fixture
def recall(
    tmp_path: Path,
) -> Iterator[tuple[Callable[..., tuple[int, str]], Callable[[], Vehicle]]]:
    """The command on a network of its own, and a vehicle to put there."""
    port = free_port()
    ours = config_file(tmp_path / "desk.json5", listen=port)
    theirs = config_file(tmp_path / "vehicle.json5", connect=port)
    made: list[Vehicle] = []

    def run(*arguments: str) -> tuple[int, str]:
        common = ("--fleet", FLEET, "--zenoh", str(ours), "--store", f"sqlite:///{tmp_path}/d.db")
        done = subprocess.run(
            [sys.executable, "-c", CODE, "recall", *arguments, *common],
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        return done.returncode, done.stdout + done.stderr

    def vehicle() -> Vehicle:
        made.append(Vehicle("d1", tmp_path / "d1", theirs))
        return made[-1]

    yield run, vehicle
    for one in made:
        one.close()


def test_a_recall_is_taken_by_the_companion_and_answered(recall):
    run, make_vehicle = recall
    vehicle = make_vehicle()
    code, said = run("--all")
    assert code == 0, said
    assert [type(command.deed) for command in vehicle.done] == [Recall]


def test_a_recall_of_all_that_nobody_hears_is_no_success(recall):
    run, _ = recall
    code, said = run("--all", "--wait", "1")
    assert code == 3
    assert "no vehicle was heard in 1 s: none recalled" in said


def test_the_direct_line_is_not_used_past_a_companion_that_lives(recall):
    run, make_vehicle = recall
    vehicle = make_vehicle()
    vehicle.answer = Verdict(Answered.REFUSED, "hands off")
    code, said = run("d1", "--direct", "udpin://127.0.0.1:1", "--silent-for", "5")
    assert code == 3
    assert "its companion lives" in said
    assert len(vehicle.done) == 1


def test_a_vehicle_whose_companion_is_silent_is_sent_home_past_it(recall):
    run, _ = recall
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    parameters = read_parameters(PARAMS / "autopilots" / "ardupilot.toml")
    airframe = load_airframe(PARAMS / "truth" / "m100.toml")
    served = stand_up(AutopilotKind.ARDUPILOT, airframe, parameters)
    with Host(1.0) as host:
        host.add(served, gcs=[f"udpout:127.0.0.1:{port}"])
        with host.running():
            time.sleep(1.0)
            address = f"udpin://127.0.0.1:{port}"
            code, said = run("d1", "--wait", "1", "--direct", address, "--silent-for", "5")
    assert code == 0, said
    assert "returns to launch" in said
    assert "RTL" in served.autopilot.mode.name


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "expected a vehicle, or --all"),
        (("--all", "--direct", "udpin://127.0.0.1:1"), "expected one vehicle"),
    ],
)
def test_a_mistake_is_said_before_anything_is_opened(arguments, words):
    done = CliRunner().invoke(app, ["recall", "--fleet", FLEET, *arguments])
    assert isinstance(done.exception, LeewayError)
    assert words in str(done.exception)
