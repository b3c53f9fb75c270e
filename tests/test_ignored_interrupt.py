"""A test run that was started with SIGINT ignored, as by `nohup make test &`."""

import subprocess
import sys
from pathlib import Path

CONFTEST = Path(__file__).with_name("conftest.py")
CASE = """
import signal, subprocess, sys, time

def test_a_child_can_be_interrupted():
    code = "import time; print(1, flush=True); time.sleep(60)"
    child = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    child.stdout.readline()
    child.send_signal(signal.SIGINT)
    assert child.wait(30) != 0
"""
IGNORING = (
    "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN);"
    "os.execv(sys.executable, sys.argv[1:])"
)


def test_programs_under_test_can_be_interrupted(tmp_path: Path):
    (tmp_path / "conftest.py").write_text(CONFTEST.read_text())
    (tmp_path / "test_case.py").write_text(CASE)
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-c", IGNORING, *words], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout
