"""Plan, fly and store days in their folders; a finished day is not repeated."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import initial_state
from sim_bridge.app.day.desk import SteppedDesk
from sim_bridge.app.day.faults import DayWorldOptions
from sim_bridge.app.day.report import day_progress_view
from sim_bridge.app.day.run import (
    DAY_TIME_LIMIT_S,
    RESULT,
    DayOptions,
    fly_day_and_write_result,
)
from sim_bridge.app.day.world import DayWorld, SimulatedDesk
from sim_bridge.app.flight.run_folder import compute_inputs_digest

SETTINGS_KEY = "settings"


@dataclass(frozen=True, slots=True)
class DayRunner:
    """Plans and flies days. `settings`: digest of all files, options and code of a day."""

    console: Console
    data: DayData
    world_options: DayWorldOptions
    trials: int | None
    output_dir: Path
    settings: str

    def read_or_fly_day_result_row(self, seed: int, *, draws_picture: bool) -> dict[str, Any]:
        """Return a day's result row: read from its finished folder, or flown now."""
        folder = (
            self.output_dir
            / f"day-{self.data.day.name}{self._fault_options_folder_suffix()}-seed{seed}"
        )
        finished_row = read_result_row_if_settings_match(folder, self.settings)
        if finished_row is not None:
            self.console.print(f"{folder}: already finished, not repeated", highlight=False)
            return finished_row
        options = DayOptions(
            name=self.data.day.name,
            data=self.data,
            world_options=self.world_options,
            seed=seed,
            folder=folder,
            settings=self.settings,
            picture=draws_picture,
        )
        with day_progress_view(
            self.console, f"{self.data.day.name}, seed {seed}", DAY_TIME_LIMIT_S
        ) as view:

            def plan_day_and_open_desk(world: DayWorld, day_folder: Path) -> SimulatedDesk:
                plan = plan_whole_day(
                    world.data,
                    seed,
                    self.trials,
                    lambda done_frac, best_s: view.bar.update(
                        view.task, said=f"planning: {done_frac:.0%}, {best_s / 60.0:.1f} min"
                    ),
                )
                view.bar.update(view.task, total=plan.makespan_s)
                return SteppedDesk.start_truck_desk(world, plan, day_folder, seed, self.trials)

            return fly_day_and_write_result(
                options, plan_day_and_open_desk, view.show_progress_and_continue
            )

    def _fault_options_folder_suffix(self) -> str:
        """Return the folder name suffix that states the faults."""
        world_options = self.world_options
        marks: dict[str, float] = {
            "loss": world_options.loss,
            "companions": world_options.companion_kills,
            "ground": world_options.ground_kills,
            "late": world_options.truck_late_s,
            "front": world_options.passing_front_mps,
        }
        return "-forecast" * (not world_options.shares_wind) + "".join(
            f"-{name}{value:g}" for name, value in marks.items() if value
        )


def plan_whole_day(
    data: DayData,
    seed: int,
    trials: int | None,
    report_progress: Callable[[float, float], None] = lambda done_frac, best_s: None,
) -> DayPlan:
    """Plan a day from its start."""
    return plan_day(
        data, initial_state(data), PlanParams(trials=trials, seed=seed), report_progress
    )


def read_result_row_if_settings_match(
    folder: Path, expected_settings_digest: str
) -> dict[str, Any] | None:
    """Return the result row of a day flown with these settings, or None."""
    try:
        row = json.loads((folder / RESULT).read_text())
    except (OSError, json.JSONDecodeError):
        return None
    same = isinstance(row, dict) and row.get(SETTINGS_KEY) == expected_settings_digest
    return row if same else None


def compute_day_inputs_digest(
    day_file: Path, world_options: DayWorldOptions, planning_trials: int | None
) -> str:
    """Return the digest of all inputs of a day except its seed: files, options, program."""
    options = asdict(world_options) | {"trials": planning_trials}
    files = [value for value in options.values() if isinstance(value, Path)]
    return compute_inputs_digest(options, [*day_file.parent.glob("*"), *files])
