"""Days planned, flown and kept in their folders; a finished day is not flown again."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from companion.adapters.files.params import params_dir
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import first_state
from sim_bridge.app.day.build import BuiltDay, DayWish, here
from sim_bridge.app.day.desk import DeskHere
from sim_bridge.app.day.processes import DeskProcess, apart
from sim_bridge.app.day.report import watched
from sim_bridge.app.day.run import RESULT, DayOptions, DeskSeat, fly_day
from sim_bridge.app.flight.series import PROGRAM

LONGEST_S = 5400.0
"""A day is meant to take an hour at most; one that takes half as long again is broken off."""

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
    processes: bool = False

    def row(self, seed: int, *, picture: bool) -> dict[str, Any]:
        """One day's row: of the day that lies finished in its folder, or flown now."""
        folder = self.runs / f"day-{self.data.day.name}{self._marks()}-seed{seed}"
        known = finished(folder, self.settings)
        if known is not None:
            self.console.print(f"{folder}: finished before, not flown again", highlight=False)
            return known
        options = DayOptions(
            name=self.data.day.name,
            data=self.data,
            wish=self.wish,
            seed=seed,
            folder=folder,
            limit_s=LONGEST_S,
            settings=self.settings,
            picture=picture,
        )
        with watched(self.console, f"{self.data.day.name}, seed {seed}", LONGEST_S) as view:

            def take_seat(built: BuiltDay, where: Path) -> DeskSeat:
                plan = self._planned(built.data, seed, view.planning)
                view.expect(plan.makespan_s)
                if self.processes:
                    return DeskProcess.open(self.path, built, plan, where)
                return DeskHere.open(built, plan, where, seed, self.trials)

            loss = self.wish.loss
            plumb = apart(folder, loss) if self.processes else here(loss, folder)
            return fly_day(options, plumb, take_seat, view.update)

    def _marks(self) -> str:
        """Of the faults, so that a folder's name says what was flown."""
        wish = self.wish
        marks: dict[str, float] = {
            "loss": wish.loss,
            "companions": wish.companion_kills,
            "ground": wish.ground_kills,
            "late": wish.truck_late_s,
        }
        apart_ = "-processes" if self.processes else ""
        return apart_ + "".join(f"-{name}{value:g}" for name, value in marks.items() if value)

    def _planned(self, data: DayData, seed: int, tell: Callable[[float, float], None]) -> DayPlan:
        return plan_day(data, first_state(data), PlanParams(trials=self.trials, seed=seed), tell)


def finished(folder: Path, settings: str) -> dict[str, Any] | None:
    """The row of a day that was flown to its end with these settings; None: it is to be flown."""
    try:
        row = json.loads((folder / RESULT).read_text())
    except (OSError, json.JSONDecodeError):
        return None
    same = isinstance(row, dict) and row.get(SETTINGS) == settings
    return row if same else None


def settings_of(path: Path, wish: DayWish, trials: int | None) -> str:
    """A digest of all that decides a day but its seed: its files, the options, the program."""
    options = {k: str(v) for k, v in asdict(wish).items()} | {"trials": str(trials)}
    digest = hashlib.sha256(json.dumps(options, sort_keys=True).encode())
    named = [wish.wind_log, wish.wind_table]
    files = [*path.parent.glob("*"), *params_dir().rglob("*"), *(p for p in named if p is not None)]
    for package in ("companion", "ground_station", "sim_bridge"):
        files += (PROGRAM / package).rglob("*.py")
    for file in sorted(p for p in files if p.is_file()):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:12]
