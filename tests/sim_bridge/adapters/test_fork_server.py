"""Forked processes behave as newly started ones: streams, session, exit codes, termination."""

import json
import os
import select
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from sim_bridge.adapters.fork_server import ForkedProcess, ForkServer

MAIN = """
import json, os, sys, time
print(json.dumps([sys.argv, os.getcwd(), os.getsid(0), os.environ["A"], os.environ.get("B")]))
if "raise" in sys.argv: raise ValueError("broken")
if "busy" in sys.argv:
    while time.process_time() < 1.0: pass
if "wait" in sys.argv: sys.stdout.flush(); time.sleep(60.0)
sys.exit(int(sys.argv[1]))
"""
LIMIT_S = 30.0


@pytest.fixture
def server() -> Iterator[ForkServer]:
    forks = ForkServer(("json",), MAIN, {"A": "added"})
    yield forks
    forks.close()


def started(server: ForkServer, output: Path, *arguments: str) -> ForkedProcess:
    with output.open("ab") as file:
        return server.start(arguments, file)


def said(output: Path) -> str:
    return output.read_text()


def test_each_has_its_arguments_folder_environment_session_and_exit_code(
    server: ForkServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for code, (value, folder) in enumerate((("one", tmp_path), ("two", Path("/")))):
        monkeypatch.setenv("B", value)
        monkeypatch.chdir(folder)
        output = tmp_path / f"{value}.out"
        process = started(server, output, str(code), "more")
        assert process.wait(LIMIT_S) == code
        argv, cwd, session, added, ours = json.loads(said(output))
        assert argv[1:] == [str(code), "more"]
        assert Path(cwd) == folder
        assert session == process.pid != os.getsid(0)
        assert (added, ours) == ("added", value)


def test_the_cpu_of_what_has_ended_is_counted(server: ForkServer, tmp_path: Path) -> None:
    assert started(server, tmp_path / "idle", "0").wait(LIMIT_S) == 0
    idle_s = server.cpu_s
    assert started(server, tmp_path / "busy", "0", "busy").wait(LIMIT_S) == 0
    assert server.cpu_s - idle_s > 0.5


def test_an_exception_is_printed_and_ends_it_with_1(server: ForkServer, tmp_path: Path) -> None:
    process = started(server, tmp_path / "out", "raise")
    assert process.wait(LIMIT_S) == 1
    assert "ValueError: broken" in said(tmp_path / "out").splitlines()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_signal_that_ended_it_is_its_exit_code(
    server: ForkServer, tmp_path: Path, number: signal.Signals
) -> None:
    beside = started(server, tmp_path / "beside", "wait")
    process = started(server, tmp_path / "out", "wait")
    assert process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.01)
    process.send_signal(number)
    assert process.wait(LIMIT_S) == -number
    assert beside.poll() is None
    process.kill()  # no effect any more


def test_what_still_runs_ends_with_the_server(server: ForkServer, tmp_path: Path) -> None:
    process = started(server, tmp_path / "out", "wait")
    watch = os.pidfd_open(process.pid)
    server.close()
    with os.fdopen(watch):
        assert select.select([watch], [], [], LIMIT_S)[0]  # readable once the process has ended
