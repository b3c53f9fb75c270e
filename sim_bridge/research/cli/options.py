"""Options that research commands share."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from sim_bridge.app.cli.options import run_options

if TYPE_CHECKING:
    from collections.abc import Callable

    from sim_bridge.research.study.run import Experiment, ExperimentRun, Report

Case = TypeVar("Case")
Result = TypeVar("Result")

EXPERIMENT_OPTIONS = ("out", "json_out", "jobs", "cluster")
"""Options of `sim-bridge` that a study uses."""

Airframe = Annotated[str, typer.Option(help="Prior: a name in params/airframes or a .toml file.")]


class Tier(StrEnum):
    """Difficulty of the missions."""

    HARD = "hard"
    EASY = "easy"
    STRESS = "stress"


TierOption = Annotated[
    Tier,
    typer.Option(
        help="Round trips that need, in the last 30 s of wind, 50 to 110 % of the budget (hard;"
        " stress: at wind/air 0.63) or 20 to 110 % (easy)."
    ),
]
MaxLoss = Annotated[
    float, typer.Option(min=1e-6, max=0.999999, help="Accepted loss probability per mission.")
]


def create_experiment_run(out: str = "logs/experiments", processes: int = 0) -> "ExperimentRun":
    """Make the run of a study, by the options of `sim-bridge` and these defaults."""
    from sim_bridge.research.study.run import ExperimentRun

    given = run_options()
    return ExperimentRun(given.out or Path(out), given.workers(processes), given.json_out)


def run_experiment(
    experiment: "Experiment[Case, Result]", report: "Callable[[list[Result]], Report]"
) -> None:
    """Run one experiment, and print and write its report."""
    run = create_experiment_run()
    run.print_and_write_report(report(run.run_cases_and_return_results(experiment)))


def seed_option_or(default: int) -> int:
    """Return the seed, or this one where none was given."""
    seed = run_options().seed
    return default if seed is None else seed
