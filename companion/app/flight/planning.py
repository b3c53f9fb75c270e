"""Who works on a plan: a thread of its own, while the loop goes on hearing, or the loop itself.

Whatever breaks in the work, memory that is not to be had too, is no plan: the vehicle stays on the
ground, and the operator is told why.
"""

import queue
import threading
import traceback
from pathlib import Path
from typing import Protocol

from companion.core.mission.find_plan import FindPlan
from companion.core.mission.flight_plan import FlightPlan
from companion.core.routing.route_planner import NoRoute

Found = tuple[int, FlightPlan | NoRoute]
"""The number of a `FindPlan`, and what came of it."""


def worked_out(asked: FindPlan) -> Found:
    """What came of the work."""
    try:
        return asked.number, asked.work()
    except Exception as error:  # noqa: BLE001 - see above
        last = traceback.extract_tb(error.__traceback__)[-1]
        what = f"{type(error).__name__} {error}".strip()
        at = f"{Path(last.filename).name}:{last.lineno}"
        return asked.number, NoRoute(f"planning failed: {what} ({at})")


class Planning(Protocol):
    """Takes work, and hands out what came of it."""

    def begin(self, asked: FindPlan) -> None:
        """Work on it, at once or beside the loop."""
        ...

    def found(self) -> Found | None:
        """One result that was not handed out yet."""
        ...


class PlanAtOnce:
    """Does the work where it is asked for, in a world that waits for us."""

    def __init__(self) -> None:
        self._done: list[Found] = []

    def begin(self, asked: FindPlan) -> None:
        """See `Planning`."""
        self._done.append(worked_out(asked))

    def found(self) -> Found | None:
        """See `Planning`."""
        return self._done.pop(0) if self._done else None


class PlanBeside:
    """Does the work on a thread of its own; one that is not wanted any more ends unheard."""

    def __init__(self) -> None:
        self._done: queue.SimpleQueue[Found] = queue.SimpleQueue()

    def begin(self, asked: FindPlan) -> None:
        """See `Planning`. Where no thread can be had, the loop does the work."""
        try:
            threading.Thread(target=self._work, args=(asked,), name="plan", daemon=True).start()
        except RuntimeError:  # no memory, or too many processes
            self._work(asked)

    def _work(self, asked: FindPlan) -> None:
        self._done.put(worked_out(asked))

    def found(self) -> Found | None:
        """See `Planning`."""
        try:
            return self._done.get_nowait()
        except queue.Empty:
            return None
