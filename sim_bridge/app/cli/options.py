"""Options that several commands share, and how their texts are read."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import WorkerOptions
from ground_station.app.options.program_options import SHARED_PANEL, current_group_option_values

SeedOption = Annotated[
    int | None,
    typer.Option(
        min=0,
        rich_help_panel=SHARED_PANEL,
        help="Seed of all random draws: wind, gusts, sensor errors, faults.",
        show_default="1, or as the command states",
    ),
]
JobsOption = Annotated[
    int | None,
    typer.Option(
        min=0,
        rich_help_panel=SHARED_PANEL,
        help="Number of parallel processes; 0: all cores.",
        show_default="2; research: 0; research avoid: 1",
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        rich_help_panel=SHARED_PANEL,
        help="Ray cluster in place of --jobs: local (started here), auto (of this machine) or an"
        " address.",
    ),
]
MinutesOption = Annotated[
    float | None,
    typer.Option(
        min=0.1, rich_help_panel=SHARED_PANEL, help="Start nothing after this many minutes."
    ),
]
JsonOption = Annotated[
    Path | None,
    typer.Option(
        "--json",
        rich_help_panel=SHARED_PANEL,
        help="Write the results to this file as JSON. Commands that fly many times add each result"
        " as it is there, and continue from the file after Ctrl-C.",
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option(
        "--out",
        rich_help_panel=SHARED_PANEL,
        help="Folder for tables and pictures; train-avoid: for policies; serve: a .tlog file.",
        show_default="a folder in logs; serve: none",
    ),
]
RunFolderOption = Annotated[
    Path | None,
    typer.Option(
        rich_help_panel=SHARED_PANEL,
        help="Folder for run folders.",
        show_default="a folder in logs",
    ),
]
CaseOption = Annotated[
    list[Path] | None,
    typer.Option(
        rich_help_panel=SHARED_PANEL,
        help="Run this recorded case instead of drawn ones; repeatable.",
    ),
]
PictureOption = Annotated[bool, typer.Option(help="Draw a picture into each run folder.")]
SeedsOption = Annotated[str, typer.Option(help="Seeds FIRST:LAST, both included.")]
WindLogOption = Annotated[
    Path | None,
    typer.Option(
        help="Recording (t_s, wind_speed_mps, wind_from_deg) in place of the wind; the seed selects"
        " its start."
    ),
]


@dataclass(frozen=True)
class RunOptions:
    """The options of `sim-bridge` that the running command uses, and the defaults of the others."""

    seed: int | None = None
    jobs: int | None = None
    cluster: str | None = None
    minutes: float | None = None
    json_out: Path | None = None
    out: Path | None = None
    runs: Path | None = None
    case: list[Path] | None = None

    @property
    def seed_or_1(self) -> int:
        """The seed, 1 where none was given."""
        return 1 if self.seed is None else self.seed

    def process_count(self, default: int = 2) -> int:
        """The number of parallel processes; all cores for 0."""
        jobs = default if self.jobs is None else self.jobs
        return jobs or len(os.sched_getaffinity(0))

    def workers(self, default: int = 2) -> WorkerOptions:
        """The parallel processes, or the cluster."""
        return WorkerOptions(self.process_count(default), self.cluster)

    def run_root_or_default(self, default: str) -> Path:
        """The folder for run folders."""
        return self.runs or Path(default)


def run_options() -> RunOptions:
    """Return the options of `sim-bridge` that the running command uses."""
    return RunOptions(**current_group_option_values())


def seed_range(seeds: str) -> range:
    """The seeds of FIRST:LAST, or of one number.

    Raises: LeewayError for anything else.
    """
    first, _, last = seeds.partition(":")
    if not (first.isdecimal() and (last or first).isdecimal() and int(last or first) >= int(first)):
        raise LeewayError(f"--seeds {seeds}: expected FIRST:LAST, such as 1:20")
    return range(int(first), int(last or first) + 1)


def selected_or_all(value: str, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    """The value that was asked for, or all of them.

    Raises: LeewayError for a value that is not known.
    """
    if value == "all":
        return known
    if value not in known:
        raise LeewayError(f"--{option} {value}: expected {', '.join(known)} or all")
    return (value,)
