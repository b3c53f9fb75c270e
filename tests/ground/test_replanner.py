"""The process beside the desk in which plans are made."""

import os
import subprocess
import sys
import time

PATIENCE_S = 20.0

DESK = """
import os, sys
from ground_station.app.replanner import worker
if __name__ == "__main__":
    pool, lifeline = worker()
    print(pool.submit(os.getpid).result(), flush=True)
    sys.stdin.read()
"""


def test_a_desk_that_is_killed_takes_its_planning_process_along(tmp_path):
    script = tmp_path / "desk.py"
    script.write_text(DESK)
    desk = subprocess.Popen(
        [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with desk:
        assert desk.stdout is not None
        planner = int(desk.stdout.readline())
        assert _lives(planner)
        desk.kill()
    until_s = time.monotonic() + PATIENCE_S
    while _lives(planner) and time.monotonic() < until_s:
        time.sleep(0.05)
    assert not _lives(planner)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as stat:
        return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
