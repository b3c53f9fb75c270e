"""Execution of planning work: in a separate thread while the loop receives, or in the loop.

Each error in the work, also lack of memory, yields `NoRoute`: the vehicle stays on the ground, and
the operator receives the reason.
"""

import queue
import threading
import traceback
from pathlib import Path

from companion.core.mission.find_plan import FindPlan
from companion.core.mission.flight_plan import FlightPlan
from companion.core.routing.route_planner import NoRoute

PlanningResult = tuple[int, FlightPlan | NoRoute]
"""Number of a `FindPlan`, and its result."""


def compute_plan_or_error(find_plan: FindPlan) -> PlanningResult:
    """Run the work and return its result; an exception becomes `NoRoute`."""
    try:
        return find_plan.request_number, find_plan.compute_plan()
    except Exception as error:  # noqa: BLE001 - see above
        last = traceback.extract_tb(error.__traceback__)[-1]
        error_text = f"{type(error).__name__} {error}".strip()
        at = f"{Path(last.filename).name}:{last.lineno}"
        return find_plan.request_number, NoRoute(f"planning failed: {error_text} ({at})")


class PlanningExecutor:
    """Runs each work item in a thread, or synchronously for a simulated world that waits; the pilot
    ignores the result of an obsolete one.
    """

    def __init__(self, *, synchronous: bool) -> None:
        self._is_synchronous = synchronous
        self._results: queue.SimpleQueue[PlanningResult] = queue.SimpleQueue()

    def start_planning(self, find_plan: FindPlan) -> None:
        """Start the work. Runs synchronously if no thread can be started."""
        if self._is_synchronous:
            self._compute_and_queue_result(find_plan)
        else:
            self._start_thread(find_plan)

    def _start_thread(self, find_plan: FindPlan) -> None:
        try:
            threading.Thread(
                target=self._compute_and_queue_result, args=(find_plan,), name="plan", daemon=True
            ).start()
        except RuntimeError:  # no memory, or too many processes
            self._compute_and_queue_result(find_plan)

    def _compute_and_queue_result(self, find_plan: FindPlan) -> None:
        self._results.put(compute_plan_or_error(find_plan))

    def take_next_result(self) -> PlanningResult | None:
        """Return the next result, if any."""
        try:
            return self._results.get_nowait()
        except queue.Empty:
            return None
