"""Workers of a Ray cluster (the extra `ray`): an actor for each of its processors."""

import contextlib
import logging
import os
import socket
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.answers import (
    Answer,
    WorkerDied,
    WorkRaised,
    WorkReturned,
    answer_of,
)

Work = TypeVar("Work")
Result = TypeVar("Result")

LOCAL = "local"
NO_ADDRESS = (LOCAL, "auto")
ANSWERS_WITHIN_S = 10.0


class RayCrew(Generic[Work, Result]):
    """Actors that are started when they are needed first, and replaced where they die.

    The cluster's machines need this program, and the work's files at the same paths.
    """

    def __init__(self, do: Callable[[Work], Result], cluster: str) -> None:
        self._ray = _ray(cluster)
        self._do = self._ray.put(do)
        self._size = max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._worker = self._ray.remote(num_cpus=1, max_restarts=0)(_RemoteWorker)
        self._idle: list[Any] = []
        self._busy: dict[Any, tuple[int, Any]] = {}

    @property
    def size(self) -> int:
        """One for each processor that the cluster had at the start."""
        return self._size

    def begin(self, index: int, piece: Work) -> None:
        """Send a piece to a worker."""
        worker = self._idle.pop() if self._idle else self._worker.remote(self._do, os.getcwd())
        self._busy[worker.answer.remote(piece)] = index, worker

    def ended(self) -> list[tuple[int, Answer[Result]]]:
        """Wait for an answer or a death."""
        ready, _ = self._ray.wait(list(self._busy), num_returns=1)
        return [self._answer(reference) for reference in ready]

    def close(self) -> None:
        """End all actors, and leave the cluster."""
        for worker in (*self._idle, *(worker for _, worker in self._busy.values())):
            with contextlib.suppress(self._ray.exceptions.RayError):
                self._ray.kill(worker)
        self._idle, self._busy = [], {}
        self._ray.shutdown()

    def _answer(self, reference: Any) -> tuple[int, Answer[Result]]:
        index, worker = self._busy.pop(reference)
        errors = self._ray.exceptions
        try:
            answer = self._ray.get(reference)
        except errors.RayTaskError as error:  # not of the work: the worker could not begin
            return index, WorkRaised(LeewayError(str(error.cause or error)))
        except errors.RayError as error:
            return index, WorkerDied(f"a worker died: {str(error).splitlines()[0]}")
        self._idle.append(worker)
        return index, answer


class _RemoteWorker:
    """An actor: keeps `do`, and with it what that has built."""

    def __init__(self, do: Callable[[Any], Any], folder: str) -> None:
        if not os.path.isdir(folder):
            raise LeewayError(
                f"{folder}: not on this machine of the cluster; expected a shared one"
            )
        os.chdir(folder)
        self._do = do

    def answer(self, piece: Any) -> WorkReturned[Any] | WorkRaised:
        return answer_of(self._do, piece)


def _ray(cluster: str) -> Any:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise LeewayError("ray is not installed: pip install 'leeway-uas[ray]'") from None
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # else it tells its makers of each use
    _check_answers(cluster)
    try:
        ray.init(
            address=None if cluster == LOCAL else cluster,
            log_to_driver=False,
            logging_level=logging.ERROR,
            include_dashboard=False,
        )
    except Exception as error:
        raise LeewayError(f"--cluster {cluster}: {error}") from error
    return ray


def _check_answers(cluster: str) -> None:
    """Ray itself waits for minutes where nobody listens."""
    host, _, port = cluster.rpartition(":")
    if cluster in NO_ADDRESS or "//" in cluster:
        return
    if not (host and port.isdecimal()):
        raise LeewayError(f"--cluster {cluster}: expected {', '.join(NO_ADDRESS)} or HOST:PORT")
    try:
        socket.create_connection((host, int(port)), ANSWERS_WITHIN_S).close()
    except OSError as error:
        raise LeewayError(f"--cluster {cluster}: no cluster answers: {error}") from error
