"""Re-planning for a running desk: in a process of its own, or inline (simulated days)."""

from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.context import SpawnProcess
from typing import Protocol

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.compiled_code import keep_compiled_code
from ground_station.adapters.workers.answers import WorkRaised, WorkReturned
from ground_station.adapters.workers.beside import Beside
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import DayState


@dataclass(frozen=True, slots=True)
class NoPlan:
    """Why no plan was made. `again`: the process ended without an answer, so a second try may
    help.
    """

    reason: str
    again: bool = False


class Replanner(Protocol):
    """Makes one plan at a time."""

    def ask(self, data: DayData, start: DayState) -> None:
        """Begin to plan."""
        ...

    def made(self) -> DayPlan | NoPlan | None:
        """The plan, once; None while it is being made."""
        ...

    def close(self) -> None:
        """Give up the plan that is being made."""
        ...


def make_plan(data: DayData, start: DayState, seed: int, trials: int | None) -> DayPlan:
    """A plan from the day's present state, by the default policy."""
    keep_compiled_code()
    from ground_station.core.planning.day_planner import PlanParams, plan_day  # it compiles

    return plan_day(data, start, PlanParams("search", trials, seed))


@dataclass(slots=True)
class InlineReplanner:
    """Plans in the caller's thread: for simulated days, whose time stands still meanwhile."""

    seed: int = 0
    trials: int | None = None
    plan: Callable[[DayData, DayState, int, int | None], DayPlan] = make_plan
    _made: DayPlan | NoPlan | None = None

    def ask(self, data: DayData, start: DayState) -> None:
        """Make the plan now."""
        try:
            self._made = self.plan(data, start, self.seed, self.trials)
        except LeewayError as error:
            self._made = NoPlan(str(error))

    def made(self) -> DayPlan | NoPlan | None:
        """The plan, once."""
        made, self._made = self._made, None
        return made

    def close(self) -> None:
        """Nothing runs."""


LIMIT_S = 900.0
"""A thousand customers take five minutes; a planner that takes three times as long has hung."""


@dataclass(frozen=True, slots=True)
class _Asked:
    """What a plan is made from."""

    data: DayData
    start: DayState
    seed: int
    trials: int | None


def _plan(asked: _Asked) -> DayPlan:
    return make_plan(asked.data, asked.start, asked.seed, asked.trials)


@dataclass(slots=True)
class ProcessReplanner:
    """Plans in a process of its own, one for each plan; the desk goes on meanwhile.

    The truck stays while a plan is made, so a process that dies or hangs must not hold up the day:
    its death is noticed at once, and it is killed after `limit_s`.
    """

    clock: Clock
    seed: int = 0
    trials: int | None = None
    limit_s: float = LIMIT_S
    _beside: Beside[_Asked, DayPlan] = field(init=False)

    def __post_init__(self) -> None:
        self._beside = Beside(_plan, self.clock, self.limit_s)

    @property
    def process(self) -> SpawnProcess | None:
        """Where a plan is being made."""
        return self._beside.process

    def ask(self, data: DayData, start: DayState) -> None:
        """Begin to plan."""
        self._beside.ask(_Asked(data, start, self.seed, self.trials))

    def made(self) -> DayPlan | NoPlan | None:
        """The plan, once."""
        match self._beside.answer():
            case None:
                return None
            case WorkReturned(plan):
                return plan
            case WorkRaised(error):
                return NoPlan(str(error))
            case died:
                return NoPlan(f"the planner: {died.why}", again=True)

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self._beside.close()
