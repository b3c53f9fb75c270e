"""Workers of a Ray cluster (the extra `ray`): one actor per processor."""

import contextlib
import logging
import os
import socket
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.answers import (
    WorkerTerminated,
    WorkOutcome,
    WorkRaised,
    WorkReturned,
    run_item_catching_errors,
)

Work = TypeVar("Work")
Result = TypeVar("Result")

LOCAL = "local"
CLUSTER_NAMES = (LOCAL, "auto")
CONNECT_TIMEOUT_S = 10.0


class ClusterPool(Generic[Work, Result]):
    """Actors, started on demand and replaced when they die.

    The cluster's machines need this program, and the work's files at the same paths.
    """

    def __init__(self, do: Callable[[Work], Result], cluster: str) -> None:
        self._api = _connect_to_ray_cluster(cluster)
        self._do = self._api.put(do)
        self._size = max(1, int(self._api.cluster_resources().get("CPU", 1)))
        self._worker = self._api.remote(num_cpus=1, max_restarts=0)(_RemoteWorker)
        self._idle: list[Any] = []
        self._active: dict[Any, tuple[int, Any]] = {}

    @property
    def max_concurrent_items(self) -> int:
        """Number of processors of the cluster at the start."""
        return self._size

    def start_item(self, index: int, item: Work) -> None:
        """Send a work item to a worker."""
        worker = self._idle.pop() if self._idle else self._worker.remote(self._do, os.getcwd())
        self._active[worker.run_work_item.remote(item)] = index, worker

    def wait_outcomes(self) -> list[tuple[int, WorkOutcome[Result]]]:
        """Wait for an outcome or a death."""
        ready, _ = self._api.wait(list(self._active), num_returns=1)
        return [self._receive_outcome(reference) for reference in ready]

    def close(self) -> None:
        """End all actors and leave the cluster."""
        for worker in (*self._idle, *(worker for _, worker in self._active.values())):
            with contextlib.suppress(self._api.exceptions.RayError):
                self._api.kill(worker)
        self._idle, self._active = [], {}
        self._api.shutdown()

    def _receive_outcome(self, reference: Any) -> tuple[int, WorkOutcome[Result]]:
        index, worker = self._active.pop(reference)
        errors = self._api.exceptions
        try:
            outcome = self._api.get(reference)
        except errors.RayTaskError as error:  # not from the work item: the worker could not start
            return index, WorkRaised(LeewayError(str(error.cause or error)))
        except errors.RayError as error:
            return index, WorkerTerminated(f"a worker died: {str(error).splitlines()[0]}")
        self._idle.append(worker)
        return index, outcome


class _RemoteWorker:
    """Ray actor: keeps `do` and its state between work items."""

    def __init__(self, do: Callable[[Any], Any], folder: str) -> None:
        if not os.path.isdir(folder):
            raise LeewayError(
                f"{folder}: missing on a machine of the cluster, expected a shared folder"
            )
        os.chdir(folder)
        self._do = do

    def run_work_item(self, item: Any) -> WorkReturned[Any] | WorkRaised:
        return run_item_catching_errors(self._do, item)


def _connect_to_ray_cluster(cluster: str) -> Any:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise LeewayError("ray is not installed: pip install 'leeway-uas[ray]'") from None
    os.environ.setdefault(
        "RAY_USAGE_STATS_ENABLED", "0"
    )  # otherwise Ray reports each use to its developers
    _require_cluster_reachable(cluster)
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


def _require_cluster_reachable(cluster: str) -> None:
    """Raise LeewayError if the port is closed; Ray itself waits for minutes."""
    host, _, port = cluster.rpartition(":")
    if cluster in CLUSTER_NAMES or "//" in cluster:
        return
    if not (host and port.isdecimal()):
        raise LeewayError(f"--cluster {cluster}: expected {', '.join(CLUSTER_NAMES)} or HOST:PORT")
    try:
        socket.create_connection((host, int(port)), CONNECT_TIMEOUT_S).close()
    except OSError as error:
        raise LeewayError(f"--cluster {cluster}: no cluster responds: {error}") from error
