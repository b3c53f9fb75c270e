"""Commands for an absent fleet or vehicle report it within a second of joining the network."""

import subprocess
import sys
from pathlib import Path

import pytest

from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.store.database import Database
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port

SAID_S = 1.0
TRIES = 3
"""Number of attempts, of which the best counts: the test machine may be busy."""

JOINED = "joined the network"
CODE = f"""
from ground_station.adapters.zenoh_fleet import ZenohFleet
join = ZenohFleet.__init__

def told(self, *args, **more):
    join(self, *args, **more)
    print("{JOINED}", flush=True)

ZenohFleet.__init__ = told
from ground_station.app.cli.main import main
main()
"""


class Nobody:
    """A store, and a network that is empty or has one vehicle."""

    def __init__(self, folder: Path) -> None:
        port = free_port()
        self.theirs = config_file(folder / "vehicle.json5", connect=port)
        self.words = ["--zenoh", str(config_file(folder / "desk.json5", listen=port))]
        self.words += ["--store", f"sqlite:///{folder}/desk.db"]
        Database(f"sqlite:///{folder}/desk.db").close()

    def is_said(
        self, expected: str, *words: str, within_s: float = SAID_S, tries: int = TRIES
    ) -> bool:
        """Return whether the command prints this text soon enough after it joins the network."""
        return any(self._once_s(expected, *words) < within_s for _ in range(tries))

    def _once_s(self, expected: str, *words: str) -> float:
        command = [sys.executable, "-c", CODE, *words, *self.words]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdout=pipe, stderr=subprocess.STDOUT, text=True) as process:
            assert process.stdout is not None
            joined_s: float | None = None
            said: list[str] = []
            for line in process.stdout:
                said.append(line)
                if JOINED in line:
                    joined_s = monotonic_s()
                if expected in line and joined_s is not None:
                    process.kill()
                    return monotonic_s() - joined_s
        raise AssertionError(f"{expected!r} was not said: {''.join(said)}")


@pytest.fixture
def nobody(tmp_path: Path) -> Nobody:
    return Nobody(tmp_path)


@pytest.mark.sample
@pytest.mark.parametrize(
    ("expected", "words"),
    [
        ("no member connected in fleet nowhere", ["watch"]),
        ("d9: not connected yet; connected: none", ["recall", "d9"]),
        ("no vehicle connected yet", ["recall", "--all"]),
    ],
    ids=["watch", "recall d9", "recall --all"],
)
def test_a_fleet_that_is_not_there_is_said_within_a_second(nobody, expected, words):
    assert nobody.is_said(expected, *words, "--fleet", "nowhere")


@pytest.mark.sample
def test_a_vehicle_that_is_not_there_is_said_within_a_second_beside_one_that_is(nobody, tmp_path):
    d1 = Vehicle("d1", tmp_path / "d1", nobody.theirs)
    try:
        assert nobody.is_said("d9: not connected", "recall", "d9", "--fleet", FLEET)
    finally:
        d1.close()


@pytest.mark.sample
def test_what_watch_says_comes_through_a_pipe_while_it_runs(nobody, tmp_path):
    d1 = Vehicle("d1", tmp_path / "d1", nobody.theirs)
    try:
        assert nobody.is_said("d1", "watch", "--fleet", FLEET, within_s=3.0)
    finally:
        d1.close()


@pytest.mark.sample
def test_canary_a_command_that_waits_before_it_says_a_word_is_noticed(nobody):
    """The final message of a recall appears at the end of its wait."""
    words = ("recall", "--all", "--wait", "2", "--fleet", "nowhere")
    assert not nobody.is_said("none recalled", *words, tries=1)
