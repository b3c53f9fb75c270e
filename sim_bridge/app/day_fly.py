"""Day after day: planned, flown, kept in its folder; what is finished is not flown again."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from ground_station.adapters.compiled_code import keep_compiled_code

keep_compiled_code()  # before the planner's first import

from ground_station.core.day_data import DayData  # noqa: E402
from ground_station.core.day_plan import DayPlan  # noqa: E402
from ground_station.core.day_planning import PlanParams, plan_day  # noqa: E402
from ground_station.core.day_state import first_state  # noqa: E402
from sim_bridge.app.day_build import BuiltDay, DayWish, here  # noqa: E402
from sim_bridge.app.day_desk import DeskHere  # noqa: E402
from sim_bridge.app.day_report import watched  # noqa: E402
from sim_bridge.app.day_run import RESULT, DayOptions, fly_day  # noqa: E402

LONGEST_S = 3600.0
"""A day of the issue is an hour at most; one that takes twice that is broken off."""

SETTINGS = "settings"


@dataclass(frozen=True, slots=True)
class Flyer:
    """`settings` tells days apart that a change of file, option or program makes others."""

    console: Console
    path: Path
    data: DayData
    wish: DayWish
    trials: int | None
    runs: Path
    settings: str

    def row(self, seed: int, *, picture: bool) -> dict[str, Any]:
        """One day's row: of the day that lies finished in its folder, or flown now."""
        folder = self.runs / f"day-{self.data.day.name}{self._marks()}-seed{seed}"
        known = self._finished(folder)
        if known is not None:
            self.console.print(f"{folder}: finished before, not flown again", highlight=False)
            return known
        options = DayOptions(
            name=self.data.day.name,
            data=self.data,
            wish=self.wish,
            seed=seed,
            folder=folder,
            limit_s=2.0 * LONGEST_S,
            settings=self.settings,
            picture=picture,
        )
        with watched(self.console, f"{self.data.day.name}, seed {seed}", LONGEST_S) as view:

            def take_seat(built: BuiltDay, where: Path) -> DeskHere:
                plan = self._planned(built.data, seed, view.planning)
                view.expect(plan.makespan_s)
                return DeskHere.open(built, plan, where, seed, self.trials)

            return fly_day(options, here(self.wish.loss, folder), take_seat, view.update)

    def _marks(self) -> str:
        """Of the faults, so that a folder's name says what was flown."""
        wish = self.wish
        marks = {
            "loss": wish.loss,
            "companions": wish.companion_kills,
            "ground": wish.ground_kills,
            "late": wish.truck_late_s,
        }
        return "".join(f"-{name}{value:g}" for name, value in marks.items() if value)

    def _finished(self, folder: Path) -> dict[str, Any] | None:
        try:
            row = json.loads((folder / RESULT).read_text())
        except (OSError, json.JSONDecodeError):
            return None
        same = isinstance(row, dict) and row.get(SETTINGS) == self.settings
        return row if same else None

    def _planned(self, data: DayData, seed: int, tell: Callable[[float, float], None]) -> DayPlan:
        return plan_day(data, first_state(data), PlanParams(trials=self.trials, seed=seed), tell)
