"""Work for the disk: in order, waited for by nobody, given up where the disk is full or broken."""

import errno
import os
import threading
from pathlib import Path

import pytest

from companion.adapters.files.disk import DiskAtOnce, DiskThread


def full() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def troubles() -> list[str]:
    return []


@pytest.fixture
def disk(troubles):
    made = DiskThread(troubles.append)
    yield made
    made.close()


def test_what_is_asked_for_is_done_in_order_and_all_of_it_before_the_end(troubles):
    disk, done = DiskThread(troubles.append), []
    for k in range(500):
        disk.do("log", lambda k=k: done.append(k))
    disk.close()
    assert done == list(range(500))
    assert troubles == []


def test_nobody_waits_while_the_disk_hangs(disk):
    hangs, done = threading.Event(), []
    disk.do("checkpoint", hangs.wait)
    for k in range(100):
        disk.do("log", lambda k=k: done.append(k))
    assert done == []  # we are here although the disk still hangs
    hangs.set()
    disk.settle()
    assert len(done) == 100


def test_of_checkpoints_that_wait_only_the_newest_is_written(disk):
    hangs, written = threading.Event(), []
    disk.do("log", hangs.wait)
    for k in range(5):
        disk.do("checkpoint", lambda k=k: written.append(k), newest_only=True)
    disk.do("checkpoint", lambda: written.append("phase"))
    disk.do("checkpoint", lambda: written.append("after"), newest_only=True)
    hangs.set()
    disk.settle()
    assert written == [4, "phase", "after"]


@pytest.mark.parametrize("kind", [DiskThread, DiskAtOnce])
def test_a_record_is_given_up_at_its_first_fault_the_others_go_on_and_it_is_told_once(
    kind, troubles
):
    disk, done = kind(troubles.append), []
    for _ in range(3):
        disk.do("log", full)
        disk.do("log", lambda: done.append("log"))
        disk.do("stream", lambda: done.append("stream"))
    disk.close()
    assert done == ["stream"] * 3
    assert troubles == ["log: No space left on device"]


def test_a_file_that_is_replaced_whole_is_tried_again_when_there_is_space(disk, troubles):
    done: list[str] = []
    disk.do("checkpoint", full, whole=True)
    disk.do("checkpoint", lambda: done.append("written"), whole=True)
    disk.settle()
    assert done == ["written"]
    assert len(troubles) == 1


def test_where_too_much_waits_rows_are_lost_and_that_is_told(troubles):
    disk, hangs, done = DiskThread(troubles.append, waiting_limit=10), threading.Event(), []
    disk.do("log", hangs.wait)
    for k in range(100):
        disk.do("log", lambda k=k: done.append(k))
    hangs.set()
    disk.close()
    assert 9 <= len(done) <= 10
    assert troubles == ["records: the disk is too slow, rows are lost"]


def test_where_no_thread_can_be_had_records_are_given_up(monkeypatch, troubles):
    def refuse(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    disk = DiskThread(troubles.append)
    disk.do("log", lambda: Path("/nowhere/log").touch())
    disk.close()
    assert troubles == ["records: can't start new thread"]
