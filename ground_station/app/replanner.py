"""Re-planning beside the running desk: in a process of its own, or at once (simulated days)."""

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Protocol

from companion.core.errors import LeewayError
from ground_station.adapters.compiled_code import keep_compiled_code
from ground_station.core.day_data import DayData
from ground_station.core.day_plan import DayPlan
from ground_station.core.day_state import DayState


@dataclass(frozen=True, slots=True)
class NoPlan:
    """Why none was made."""

    reason: str


class Replanner(Protocol):
    """Makes one plan at a time."""

    def ask(self, data: DayData, start: DayState) -> None:
        """Begin."""
        ...

    def made(self) -> DayPlan | NoPlan | None:
        """The plan, once; None while it is being made."""
        ...

    def close(self) -> None:
        """Give up what is being made."""
        ...


def replanned(data: DayData, start: DayState, seed: int, trials: int | None) -> DayPlan:
    """A plan from where the day stands, by the default policy."""
    keep_compiled_code()
    from ground_station.core.day_planning import PlanParams, plan_day  # compiles

    return plan_day(data, start, PlanParams("search", trials, seed))


@dataclass(slots=True)
class ReplannerAtOnce:
    """In the caller's own time: for simulated days, where time stands meanwhile."""

    seed: int = 0
    trials: int | None = None
    plan: Callable[[DayData, DayState, int, int | None], DayPlan] = replanned
    _made: DayPlan | NoPlan | None = None

    def ask(self, data: DayData, start: DayState) -> None:
        """Make it now."""
        try:
            self._made = self.plan(data, start, self.seed, self.trials)
        except LeewayError as error:
            self._made = NoPlan(str(error))

    def made(self) -> DayPlan | NoPlan | None:
        """The plan, once."""
        made, self._made = self._made, None
        return made

    def close(self) -> None:
        """Nothing is left."""


class Lifeline(Protocol):
    """One end of a pipe between two processes (its class is another on other systems)."""

    def recv(self) -> Any:
        """Waits; EOFError where the other end is closed."""
        ...

    def close(self) -> None:
        """Let go of it."""
        ...


def worker() -> tuple[ProcessPoolExecutor, Lifeline]:
    """One process to plan in, and its lifeline: it ends when that is closed, whatever it is at, and
    so with this process, also where this one is killed (it waits on a queue whose other end it
    holds itself, and would wait there for ever).
    """
    context = multiprocessing.get_context("spawn")  # a fork would copy zenoh's threads
    theirs, ours = context.Pipe(duplex=False)
    return ProcessPoolExecutor(1, context, _end_with, (theirs,)), ours


def _end_with(lifeline: Lifeline) -> None:
    def wait() -> None:
        try:
            lifeline.recv()
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=wait, name="lifeline", daemon=True).start()


@dataclass(slots=True)
class ReplannerBeside:
    """In a process of its own, which a killed desk takes along: the desk goes on meanwhile."""

    seed: int = 0
    trials: int | None = None
    _pool: ProcessPoolExecutor | None = None
    _lifeline: Lifeline | None = None
    _future: "Future[DayPlan] | None" = field(default=None)

    def ask(self, data: DayData, start: DayState) -> None:
        """Begin; the process starts with the first plan."""
        if self._pool is None:
            self._pool, self._lifeline = worker()
        self._future = self._pool.submit(replanned, data, start, self.seed, self.trials)

    def made(self) -> DayPlan | NoPlan | None:
        """The plan, once."""
        if self._future is None or not self._future.done():
            return None
        future, self._future = self._future, None
        error = future.exception()
        if error is None:
            return future.result()
        if not isinstance(error, LeewayError):  # its process died: the next gets a new one
            self.close()
        return NoPlan(f"{type(error).__name__}: {error}"[:300])

    def close(self) -> None:
        """Give up what is being made: nobody waits for it."""
        if self._pool is None or self._lifeline is None:
            return
        idle = self._future is None or self._future.done()
        if not idle:
            self._lifeline.close()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._lifeline.close()
        self._pool = self._lifeline = self._future = None
