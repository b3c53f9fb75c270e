"""Child processes end with a parent that was killed without cleanup."""

import os
import subprocess
import sys
import time

import pytest

PATIENCE_S = 20.0

PARENT = """
import subprocess, sys
from sim_bridge.adapters.lifeline import code_tied_to_parent_process
child = "import time; print('up', flush=True); time.sleep(600)"
code = code_tied_to_parent_process(child)
held = subprocess.Popen(
    [sys.executable, "-c", code], stdout=subprocess.PIPE, start_new_session=True
)
held.stdout.readline()
print(held.pid, flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="prctl(2) is Linux's")
def test_a_child_with_a_lifeline_dies_with_a_killed_parent():
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        os.kill(child, 0)
        parent.kill()
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        try:
            os.kill(child, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    os.kill(child, 9)
    raise AssertionError("the child outlived its parent")
