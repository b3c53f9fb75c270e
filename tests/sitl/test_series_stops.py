"""A stopped series: none of its processes continues, and the same command finishes it."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

pytestmark = pytest.mark.sitl

ENTRY = "from sim_bridge.main import main; main()"
PATIENCE_S = 280.0  # for a loaded machine


def command(flight: Path, folder: Path, last_seed: int, jobs: int = 1) -> list[str]:
    return [
        *(sys.executable, "-c", ENTRY, "fly", str(flight), f"--seeds=1:{last_seed}"),
        *("--autopilot=px4", "--gate=on", f"--jobs={jobs}"),
        *(f"--json={folder / 'rows.json'}", f"--runs={folder / 'runs'}"),
    ]


@contextmanager
def started(arguments: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(arguments, start_new_session=True) as process:
        yield process
        if process.poll() is None:
            process.kill()


def await_(said: Callable[[], object], process: subprocess.Popen[bytes]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not said():
        assert process.poll() is None, "the series ended by itself"
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def companions(process: subprocess.Popen[bytes]) -> list[psutil.Process]:
    family = psutil.Process(process.pid).children(recursive=True)
    return [p for p in family if any("companion" in word for word in p.cmdline())]


def rows(folder: Path) -> list[dict[str, object]]:
    path = folder / "rows.json"
    return json.loads(path.read_text())["flights"] if path.exists() else []


def all_gone(family: list[psutil.Process]) -> bool:
    _, alive = psutil.wait_procs(family, timeout=5.0)
    return not alive


@pytest.mark.night  # three flights; resuming by day: tests/sim_bridge/app/flight/test_series.py
@pytest.mark.timeout(900)
def test_sigterm_ends_every_process_and_the_same_command_flies_only_what_is_left(
    short_file, tmp_path
):
    with started(command(short_file, tmp_path, 3, jobs=2)) as process:
        await_(lambda: rows(tmp_path), process)
        family = list[psutil.Process]()

        def another_flight_runs() -> bool:
            family[:] = psutil.Process(process.pid).children(recursive=True)
            return len(family) >= 2 and bool(companions(process))  # a worker and its companion

        await_(another_flight_runs, process)
        process.terminate()
        assert process.wait(PATIENCE_S) == 128 + signal.SIGTERM
    assert all_gone(family)
    first = rows(tmp_path)
    assert subprocess.run(command(short_file, tmp_path, 3, jobs=2), check=False).returncode == 0
    assert sorted(row["seed"] for row in rows(tmp_path)) == [1, 2, 3]
    assert all(row in rows(tmp_path) for row in first)
    for row in first:
        assert len(list((tmp_path / "runs").glob(f"*-seed{row['seed']}*"))) == 1


@pytest.mark.sample
def test_ctrl_c_ends_every_process(short_file, tmp_path):
    with started(command(short_file, tmp_path, 1)) as process:
        await_(lambda: companions(process), process)
        family = psutil.Process(process.pid).children(recursive=True)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the foreground group
        assert process.wait(PATIENCE_S) == 128 + signal.SIGINT
    assert all_gone(family)


def test_sigterm_ends_a_single_flight_and_its_companion(short_file, tmp_path):
    arguments = [sys.executable, "-c", ENTRY, "fly", str(short_file), f"--runs={tmp_path}"]
    with started(arguments) as process:
        await_(lambda: companions(process), process)
        family = companions(process)
        process.terminate()
        assert process.wait(PATIENCE_S) == 128 + signal.SIGTERM
    assert all_gone(family)
    assert list(tmp_path.glob("*/INTERRUPTED"))
