"""`ground-station recall`: through the companion; past it only if it has long been silent."""

import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.fleet.command_log import CommandReply
from companion.fleet.messages import CommandStatus, Recall
from ground_station.adapters.store.database import URGENT_LOCK_TIMEOUT_MS, Database
from ground_station.adapters.store.order_store import Store
from ground_station.app.cli.main import app
from sim_bridge.app.serve.server import Host
from sim_bridge.autopilot.kinds import AutopilotKind
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port
from tests.sitl.served import free_udp_port, on_the_ground

CODE = "from ground_station.app.cli.main import main; main()"


@pytest.fixture
def recall(
    tmp_path: Path,
) -> Iterator[tuple[Callable[..., tuple[int, str]], Callable[[], Vehicle]]]:
    """Return the command on a separate network, and a function that adds a vehicle to it."""
    port = free_port()
    ours = config_file(tmp_path / "desk.json5", listen=port)
    theirs = config_file(tmp_path / "vehicle.json5", connect=port)
    made: list[Vehicle] = []
    Database(f"sqlite:///{tmp_path}/d.db").close()

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


@pytest.mark.sample
def test_a_recall_is_taken_by_the_companion_and_answered(recall):
    run, make_vehicle = recall
    vehicle = make_vehicle()
    code, said = run("--all")
    assert code == 0, said
    assert [type(command.action) for command in vehicle.done] == [Recall]


def holds(folder: Path) -> list[str]:
    store = Store(Database(f"sqlite:///{folder}/d.db", create=False), lambda: 1)
    try:
        return [hold.text for hold in store.holds_in_force()]
    finally:
        store.close()


@pytest.mark.sample
def test_what_is_recalled_is_held_by_the_person_who_did_it(recall, tmp_path: Path):
    run, make_vehicle = recall
    make_vehicle()
    code, said = run("d1", "--user", "anna")
    assert code == 0, said
    assert holds(tmp_path) == ["d1 is held by anna: recalled"]


@pytest.mark.sample
def test_a_recall_of_all_holds_every_drone_though_nobody_is_heard(recall, tmp_path: Path):
    run, _ = recall
    assert run("--all", "--user", "anna", "--wait", "1")[0] == 3
    assert holds(tmp_path) == ["every drone is held by anna: recalled"]


@pytest.mark.sample
def test_a_recall_goes_out_though_there_is_no_store_and_says_that_nobody_is_held(
    recall, tmp_path: Path
):
    run, make_vehicle = recall
    vehicle = make_vehicle()
    (tmp_path / "d.db").unlink()
    code, said = run("d1", "--wait", "2")
    assert code == 4
    assert "launch hold not stored (store" in said
    assert [type(command.action) for command in vehicle.done] == [Recall]
    assert not (tmp_path / "d.db").exists()


@pytest.mark.sample
def test_a_recall_is_written_as_soon_as_the_store_is_back(recall, tmp_path: Path):
    run, make_vehicle = recall
    vehicle = make_vehicle()
    with sqlite3.connect(tmp_path / "d.db", check_same_thread=False) as raw:
        raw.execute("BEGIN IMMEDIATE")  # an unfinished transaction of another desk
        back = threading.Thread(target=_let_go, args=(vehicle, raw))
        back.start()
        code, said = run("d1", "--user", "anna", "--wait", "60")
        back.join()
    raw.close()
    assert code == 0, said
    assert "recall continues; launch hold not stored yet" in said
    assert holds(tmp_path) == ["d1 is held by anna: recalled"]


def _let_go(vehicle: Vehicle, raw: sqlite3.Connection) -> None:
    """Release the store some time after the recall was executed without it."""
    while not vehicle.done:
        time.sleep(0.05)
    time.sleep(3 * URGENT_LOCK_TIMEOUT_MS / 1000.0)
    raw.rollback()


@pytest.mark.sample
def test_a_vehicle_that_is_not_there_is_said_within_a_second(recall):
    run, make_vehicle = recall
    make_vehicle()
    code, said = run("d9", "--wait", "2")
    assert code == 3
    assert "d9: not connected yet; connected: d1" in said


@pytest.mark.sample
def test_a_recall_of_all_that_nobody_hears_is_no_success(recall):
    run, _ = recall
    code, said = run("--all", "--wait", "1")
    assert code == 3
    assert "no vehicle connected in 1 s: none recalled" in said


@pytest.mark.sample
def test_the_direct_line_is_not_used_past_a_companion_that_lives(recall):
    run, make_vehicle = recall
    vehicle = make_vehicle()
    vehicle.answer = CommandReply(CommandStatus.REFUSED, "hands off")
    code, said = run("d1", "--direct", "udpin://127.0.0.1:1", "--silent-for", "5")
    assert code == 3
    assert "its companion is connected" in said
    assert len(vehicle.done) == 1


@pytest.mark.sample
def test_a_vehicle_whose_companion_is_silent_is_sent_home_past_it(recall):
    run, _ = recall
    port = free_udp_port()
    served = on_the_ground(AutopilotKind.ARDUPILOT)
    with Host(1.0) as host:
        host.add_vehicle(served, gcs_urls=[f"udpout:127.0.0.1:{port}"])
        with host.serve_in_thread():
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
