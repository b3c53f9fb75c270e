"""SIGTERM ends the program in order: the stack unwinds, and started processes end with it."""

import multiprocessing
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.pool import Pool
from types import FrameType

LEAVES_AT_ONCE = threading.Event()
"""Set by what opens zenoh sessions: their threads can keep an interpreter from ending."""


def _begin_worker() -> None:
    """In a worker: the terminal's Ctrl-C is for the parent, which sends SIGTERM to all workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    stop_by_signal(signal.SIGTERM)


@contextmanager
def worker_pool(jobs: int) -> Iterator[Pool]:
    """Worker processes; whatever stops their parent, Ctrl-C and SIGTERM too, ends them."""
    pool = multiprocessing.get_context("spawn").Pool(jobs, _begin_worker)
    try:
        yield pool
        pool.close()
    except BaseException:
        pool.terminate()
        raise
    finally:
        pool.join()


def stop_by_signal(number: int) -> None:
    """From now on this signal raises SystemExit(128 + number) once; later ones change nothing."""

    def stop(number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_IGN)
        raise SystemExit(128 + number)

    signal.signal(number, stop)
