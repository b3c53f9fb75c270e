"""Re-planning for a running desk: in a separate process, or inline (simulated days)."""

from collections.abc import Callable
from dataclasses import dataclass

from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known
from ground_station.adapters.workers.answers import WorkRaised, WorkReturned
from ground_station.adapters.workers.beside import InlineWorker, ItemWorker, ProcessWorker
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import DayState


@dataclass(frozen=True, slots=True)
class NoPlan:
    """Reason why no plan was found. `can_retry`: the process ended without a result, so a second
    try may succeed.
    """

    reason: str
    can_retry: bool = False


def compute_plan(data: DayData, start: DayState, seed: int, trials: int | None) -> DayPlan:
    """Compute a plan from the day's present state by the default policy."""
    enable_compile_cache_and_check_if_known()
    from ground_station.core.planning.day_planner import PlanParams, plan_day  # it compiles

    return plan_day(data, start, PlanParams("search", trials, seed))


PLANNING_TIMEOUT_S = 900.0
"""Planning time limit. A thousand customers take five minutes; three times as long is a hang."""


@dataclass(frozen=True, slots=True)
class DayPlanRequest:
    """Inputs of a plan."""

    data: DayData
    start: DayState
    seed: int
    trials: int | None


@dataclass(slots=True)
class Replanner:
    """Computes one plan at a time, in a separate process or (simulated days) inline.

    The truck waits while a plan is computed, so a failed planner must not block the day: a crash is
    detected immediately, and a process that hangs is killed after `PLANNING_TIMEOUT_S`.
    """

    worker: ItemWorker[DayPlanRequest, DayPlan]
    seed: int = 0
    trials: int | None = None

    def start_planning(self, data: DayData, start: DayState) -> None:
        """Start planning."""
        self.worker.start_item(DayPlanRequest(data, start, self.seed, self.trials))

    def take_finished_plan(self) -> DayPlan | NoPlan | None:
        """Return the finished plan once; None while it is being computed."""
        match self.worker.take_outcome():
            case None:
                return None
            case WorkReturned(plan):
                return plan
            case WorkRaised(error):
                return NoPlan(str(error))
            case failure:
                return NoPlan(f"the planner: {failure.reason}", can_retry=True)

    def close(self) -> None:
        """Cancel the plan that is being computed."""
        self.worker.close()


def create_process_planner(clock: Clock) -> ProcessWorker[DayPlanRequest, DayPlan]:
    """Return a planner that uses one process for each plan, so that the desk is not blocked."""
    return ProcessWorker(_compute_requested_plan, clock, PLANNING_TIMEOUT_S)


def create_inline_planner(
    plan_function: Callable[[DayData, DayState, int, int | None], DayPlan] = compute_plan,
) -> InlineWorker[DayPlanRequest, DayPlan]:
    """Return a planner in the caller's thread."""
    return InlineWorker(
        lambda request: plan_function(request.data, request.start, request.seed, request.trials)
    )


def _compute_requested_plan(request: DayPlanRequest) -> DayPlan:
    return compute_plan(request.data, request.start, request.seed, request.trials)
