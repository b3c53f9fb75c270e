"""Days planned, flown and stored in their folders; a finished day is not flown again."""

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
from sim_bridge.app.day.build import BuiltDay, here
from sim_bridge.app.day.desk import DeskHere
from sim_bridge.app.day.faults import DayWish
from sim_bridge.app.day.processes import DeskProcess, apart
from sim_bridge.app.day.report import watched
from sim_bridge.app.day.run import RESULT, DayOptions, DeskSeat, fly_day
from sim_bridge.app.flight.series import PROGRAM

LONGEST_S = 5400.0
"""Time limit of a day: a day should take at most one hour; this is 1.5 times that."""

SETTINGS = "settings"


@dataclass(frozen=True, slots=True)
class Flyer:
    """Plans and flies days. `settings` is the digest of all files, options and code of a day."""

    console: Console
    path: Path
    data: DayData
    wish: DayWish
    trials: int | None
    runs: Path
    settings: str
    processes: bool = False

    def row(self, seed: int, *, picture: bool) -> dict[str, Any]:
        """One day's result row: read from its finished folder, or flown now."""
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
        """Folder name suffix that states the faults and the mode."""
        wish = self.wish
        marks: dict[str, float] = {
            "loss": wish.loss,
            "companions": wish.companion_kills,
            "ground": wish.ground_kills,
            "late": wish.truck_late_s,
            "front": wish.passing_front_mps,
        }
        apart_ = "-processes" * self.processes + "-forecast" * (not wish.shares_wind)
        return apart_ + "".join(f"-{name}{value:g}" for name, value in marks.items() if value)

    def _planned(self, data: DayData, seed: int, tell: Callable[[float, float], None]) -> DayPlan:
        return plan_day(data, first_state(data), PlanParams(trials=self.trials, seed=seed), tell)


def finished(folder: Path, settings: str) -> dict[str, Any] | None:
    """The row of a day flown with these settings; None if there is none."""
    try:
        row = json.loads((folder / RESULT).read_text())
    except (OSError, json.JSONDecodeError):
        return None
    same = isinstance(row, dict) and row.get(SETTINGS) == settings
    return row if same else None


def settings_of(path: Path, wish: DayWish, trials: int | None) -> str:
    """Digest of everything that determines a day except its seed: files, options, program."""
    options = {k: str(v) for k, v in asdict(wish).items()} | {"trials": str(trials)}
    digest = hashlib.sha256(json.dumps(options, sort_keys=True).encode())
    named = [wish.wind_log, wish.wind_table]
    files = [*path.parent.glob("*"), *params_dir().rglob("*"), *(p for p in named if p is not None)]
    for package in ("companion", "ground_station", "sim_bridge"):
        files += (PROGRAM / package).rglob("*.py")
    for file in sorted(p for p in files if p.is_file()):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:12]
