"""Disk queue: order of writes, no blocking of the caller, failure on a full or broken disk."""

import errno
import os
import threading
from pathlib import Path

import pytest

from companion.adapters.files.disk import ImmediateRecordWriter, ThreadedRecordWriter


def full() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def troubles() -> list[str]:
    return []


@pytest.fixture
def disk(troubles):
    made = ThreadedRecordWriter(troubles.append)
    yield made
    made.close()


def test_what_is_asked_for_is_done_in_order_and_all_of_it_before_the_end(troubles):
    disk, done = ThreadedRecordWriter(troubles.append), []
    for k in range(500):
        disk.submit_write_job("log", lambda k=k: done.append(k))
    disk.close()
    assert done == list(range(500))
    assert troubles == []


def test_nobody_waits_while_the_disk_hangs(disk):
    hangs, done = threading.Event(), []
    disk.submit_write_job("checkpoint", hangs.wait)
    for k in range(100):
        disk.submit_write_job("log", lambda k=k: done.append(k))
    assert done == []  # this line is reached although the disk still hangs
    hangs.set()
    disk.wait_until_done()
    assert len(done) == 100


def test_of_checkpoints_that_wait_only_the_newest_is_written(disk):
    hangs, written = threading.Event(), []
    disk.submit_write_job("log", hangs.wait)
    for k in range(5):
        disk.submit_write_job("checkpoint", lambda k=k: written.append(k), replace_queued_job=True)
    disk.submit_write_job("checkpoint", lambda: written.append("phase"))
    disk.submit_write_job("checkpoint", lambda: written.append("after"), replace_queued_job=True)
    hangs.set()
    disk.wait_until_done()
    assert written == [4, "phase", "after"]


@pytest.mark.parametrize("kind", [ThreadedRecordWriter, ImmediateRecordWriter])
def test_a_record_is_given_up_at_its_first_fault_the_others_go_on_and_it_is_told_once(
    kind, troubles
):
    disk, done = kind(troubles.append), []
    for _ in range(3):
        disk.submit_write_job("log", full)
        disk.submit_write_job("log", lambda: done.append("log"))
        disk.submit_write_job("stream", lambda: done.append("stream"))
    disk.close()
    assert done == ["stream"] * 3
    assert troubles == ["log: No space left on device"]


def test_a_file_that_is_replaced_whole_is_tried_again_when_there_is_space(disk, troubles):
    done: list[str] = []
    disk.submit_write_job("checkpoint", full, is_replaced_at_each_write=True)
    disk.submit_write_job(
        "checkpoint", lambda: done.append("written"), is_replaced_at_each_write=True
    )
    disk.wait_until_done()
    assert done == ["written"]
    assert len(troubles) == 1


def test_where_too_much_waits_rows_are_lost_and_that_is_told(troubles):
    disk, hangs, done = ThreadedRecordWriter(troubles.append, max_queued=10), threading.Event(), []
    disk.submit_write_job("log", hangs.wait)
    for k in range(100):
        disk.submit_write_job("log", lambda k=k: done.append(k))
    hangs.set()
    disk.close()
    assert 9 <= len(done) <= 10
    assert troubles == ["records: disk too slow, rows are lost"]


def test_where_no_thread_can_be_had_records_are_given_up(monkeypatch, troubles):
    def refuse(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    disk = ThreadedRecordWriter(troubles.append)
    disk.submit_write_job("log", lambda: Path("/nowhere/log").touch())
    disk.close()
    assert troubles == ["records: can't start new thread"]
