"""A run folder has one companion: the second gets the process ID of the first."""

import os
import subprocess
import sys

import pytest

from companion.adapters.files.folder_lock import LOCK_NAME, FolderLock
from companion.core.base.errors import LeewayError

HOLD = """
import sys
from pathlib import Path
from companion.adapters.files.folder_lock import FolderLock
lock = FolderLock.acquire(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that uses the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_companion_is_refused_and_told_which_process_flies(tmp_path, holder):
    with pytest.raises(LeewayError, match=rf"another companion uses.*process {holder.pid}\)"):
        FolderLock.acquire(tmp_path)


def test_a_killed_companion_leaves_the_folder_free(tmp_path, holder):
    holder.kill()
    holder.wait()
    FolderLock.acquire(tmp_path).release()
    assert (tmp_path / LOCK_NAME).read_text() == str(os.getpid())


def test_a_folder_that_cannot_be_made_stops_no_flight(tmp_path):
    (tmp_path / "file").write_text("")
    FolderLock.acquire(tmp_path / "file").release()
