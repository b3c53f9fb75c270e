"""Re-planning for a running desk: in a process of its own, or inline (simulated days)."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Protocol

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.compiled_code import keep_compiled_code
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
END_S = 5.0


class Readable(Protocol):
    """The desk's end of the pipe."""

    def poll(self) -> bool:
        """Whether there is something to read, or the end."""
        ...

    def recv(self) -> DayPlan | NoPlan:
        """What was sent. EOFError at the end."""
        ...

    def close(self) -> None:
        """Close this end."""
        ...


def _plan_in_process(
    pipe: Connection, data: DayData, start: DayState, seed: int, trials: int | None
) -> None:
    """The planner's process: puts one plan, or why there is none, into the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the desk, which ends this process
    threading.Thread(target=_end_with_the_desk, name="desk", daemon=True).start()
    try:
        made: DayPlan | NoPlan = make_plan(data, start, seed, trials)
    except LeewayError as error:
        made = NoPlan(str(error))
    pipe.send(made)


def _end_with_the_desk() -> None:
    """End with the desk, also where it is killed: nobody would take the plan."""
    desk = multiprocessing.parent_process()
    assert desk is not None
    desk.join()
    os._exit(1)


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
    process: SpawnProcess | None = None
    _pipe: Readable | None = None
    _asked_s: float = 0.0

    def ask(self, data: DayData, start: DayState) -> None:
        """Begin to plan."""
        self.close()
        spawn = multiprocessing.get_context("spawn")  # a fork would copy zenoh's threads
        ours, theirs = spawn.Pipe(duplex=False)
        self._pipe = ours
        self.process = spawn.Process(
            target=_plan_in_process, args=(theirs, data, start, self.seed, self.trials), daemon=True
        )
        self.process.start()
        theirs.close()  # else the end of the process would not be noticed
        self._asked_s = self.clock.monotonic_s()

    def made(self) -> DayPlan | NoPlan | None:
        """The plan, once."""
        if self._pipe is None or self.process is None:
            return None
        alive = self.process.is_alive()  # first: what it sent before its end is in the pipe then
        if alive and not self._pipe.poll():
            if self.clock.monotonic_s() - self._asked_s < self.limit_s:
                return None
            self.close()
            return NoPlan(f"the planner was not done within {self.limit_s:.0f} s", again=True)
        try:
            return self._pipe.recv()
        except EOFError:
            return NoPlan("the planner's process died", again=True)
        finally:
            self.close()

    def close(self) -> None:
        """End the process, whatever it is doing."""
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        if self.process is not None:
            self.process.kill()
            self.process.join(END_S)
            self.process = None
