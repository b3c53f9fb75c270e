"""Plays one row of the fleet: a small day by the machinery of `sim-bridge day`, and its judgement.

Desk, store, companions, truck and network run here, in one process on one clock.
"""

import contextlib
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ground_station.adapters.files.compiled_code import keep_compiled_code
from sim_bridge.app.day.build import BuiltDay, here
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.desk import Books, DeskHere, store_url
from sim_bridge.app.day.faults import DayWish
from sim_bridge.app.day.run import DayOptions, DeskSeat, fly_day
from sim_bridge.app.day.world import DayWorld
from sim_bridge.app.faults.case import BOTH
from sim_bridge.app.faults.fault_row import FaultRow, FaultTask
from sim_bridge.app.fleet_faults.desks import Desks, OwnClock
from sim_bridge.app.fleet_faults.fleet_case import FleetCase
from sim_bridge.app.fleet_faults.fleet_stage import FleetStage
from sim_bridge.app.fleet_faults.fleet_verdict import FlownDay
from sim_bridge.app.fleet_faults.small_day import day_data, plan_of

SEARCHES = 50
"""Trials of a new plan's search: two orders have few plans."""

NOTHING = {"outcome": "", "home": False, "delivered": False, "margin_wh": 0.0}
"""Of a drone that never flew."""


@dataclass(slots=True)
class FleetPerformance:
    """Plays one fault while its day goes on."""

    case: FleetCase
    task: FaultTask
    built: BuiltDay | None = None
    desks: Desks | None = None
    stage: FleetStage | None = None
    _steps: Iterator[None] = field(default_factory=lambda: iter(()))

    def take_seat(self, built: BuiltDay, folder: Path) -> DeskSeat:
        """The day's desk, by a clock of its own."""
        clock = OwnClock(built.clock)
        plan, seed = plan_of(built.data), self.task.seed
        first = DeskHere.open(built, plan, folder, seed, SEARCHES, clock)
        self.built, self.desks = built, Desks([first], clock)
        return self.desks

    def goes_on(self, world: DayWorld) -> bool:
        """A second of the day."""
        assert self.built is not None
        assert self.desks is not None
        if self.stage is None:
            rng = np.random.default_rng([self.task.seed, self.case.number])
            self.stage = FleetStage(self.built, world, self.desks, rng, self.task.phase)
            self._steps = self.case.play(self.stage)
        self.desks.plays = self.desks.plays and next(self._steps, self) is not self
        return True


def fly_fleet_fault(case: FleetCase, task: FaultTask) -> FaultRow:
    """Play one row and judge it. An exception of desk, companion or truck is what did not hold."""
    keep_compiled_code()  # before the planner's first import
    folder = task.run_root / f"{case.name}-{task.autopilot}-{task.phase}-seed{task.seed}"
    performance = FleetPerformance(case, task)
    try:
        row = _flown(performance, folder)
    except Exception as error:  # noqa: BLE001 - all of a day runs here: it is judged
        (folder / "exception.txt").write_text(traceback.format_exc())
        why = f"an exception: {type(error).__name__}: {error}"
        return _row(task, case.group, NOTHING, exceptions=1, why=why)
    assert performance.stage is not None
    with contextlib.closing(Books.open(store_url(folder), DayClock())) as books:
        kept = books.store.events(), books.store.assignments()
    return _judged(task, case, FlownDay(row, performance.stage, folder, *kept))


def _flown(performance: FleetPerformance, folder: Path) -> dict[str, Any]:
    task = performance.task
    others = [kind for kind in BOTH if kind != task.autopilot]
    options = DayOptions(
        name=performance.case.name,
        data=day_data(),
        wish=DayWish(autopilots=(task.autopilot, *others)),
        seed=task.seed,
        folder=folder,
        limit_s=performance.case.day_s,
        settings="",
        picture=False,
    )
    return fly_day(options, here(0.0, folder), performance.take_seat, performance.goes_on)


def _judged(task: FaultTask, case: FleetCase, flown: FlownDay) -> FaultRow:
    return _row(
        task,
        case.group,
        flown.struck or NOTHING,
        p_home_last_go=flown.p_home_last_go,
        commands=len(flown.row["commands_after_take_over"]),
        exceptions=flown.exceptions,
        said=flown.said,
        why="; ".join(case.wrong(flown)),
    )


def _row(
    task: FaultTask,
    group: str,
    struck: dict[str, Any],
    *,
    p_home_last_go: float | None = None,
    commands: int = 0,
    exceptions: int = 0,
    said: list[str] | None = None,
    why: str,
) -> FaultRow:
    return FaultRow(
        fault=task.fault,
        group=group,
        autopilot=task.autopilot,
        phase=task.phase,
        seed=task.seed,
        outcome=struck["outcome"],
        home=struck["home"],
        delivered=struck["delivered"],
        margin_wh=struck["margin_wh"],
        p_home_last_go=p_home_last_go,
        commands_after_takeover=commands,
        exceptions=exceptions,
        said=said or [],
        held=not why,
        why=why,
    )
