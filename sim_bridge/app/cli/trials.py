"""`sim-bridge trials`: long randomised trials. What a trial does is imported when it runs."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from enum import StrEnum
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import (
    command_class_with_options,
    require_options_not_given,
)
from sim_bridge.app.cli.options import RunOptions, run_options, selected_or_all
from sim_bridge.autopilot.kinds import AUTOPILOTS

if TYPE_CHECKING:
    from sim_bridge.app.trials.trial import TrialRow

app = typer.Typer()

RUN_ROOT = "logs/trials"
SOAK_PANEL = "Options of soak"
DAYS_PANEL = "Options of days"


class Kind(StrEnum):
    """The trials."""

    FUZZ = "fuzz"
    STALL = "stall"
    LOGS = "logs"
    SOAK = "soak"
    DAYS = "days"


USED_BY: dict[str, frozenset[Kind]] = {
    "count": frozenset(Kind) - {Kind.SOAK},
    "minutes": frozenset(Kind) - {Kind.SOAK},
    "jobs": frozenset(Kind) - {Kind.SOAK},
    "cluster": frozenset({Kind.FUZZ, Kind.STALL, Kind.DAYS}),
    "autopilot": frozenset({Kind.STALL}),
    **dict.fromkeys(("hours", "every_minutes"), frozenset({Kind.SOAK})),
    **dict.fromkeys(
        ("vehicle_hours", "store", "truck", "all_faults", "most_drones", "most_orders"),
        frozenset({Kind.DAYS}),
    ),
}
"""Options that only some trials use."""


@app.command(
    cls=command_class_with_options("seed", "case", "json_out", "runs", "minutes", "jobs", "cluster")
)
def trials(
    context: typer.Context,
    kind: Annotated[Kind, typer.Argument(help="The trial.")],
    count: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of cases; soak has one.",
            show_default="fuzz 500, logs 30000, stall: all; days: no limit",
        ),
    ] = None,
    autopilot: Annotated[
        str, typer.Option(help="Autopilot of stall: px4, ardupilot or all.")
    ] = "all",
    hours: Annotated[
        float, typer.Option(min=0.1, help="Simulated hours.", rich_help_panel=SOAK_PANEL)
    ] = 12.0,
    every_minutes: Annotated[
        float,
        typer.Option(min=3.2, help="Interval between take-offs.", rich_help_panel=SOAK_PANEL),
    ] = 10.0,
    vehicle_hours: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            help="End after this operating time, all vehicles.",
            rich_help_panel=DAYS_PANEL,
        ),
    ] = None,
    store: Annotated[
        str,
        typer.Option(
            help="Database: sqlite, postgresql (one server per day), or both in turn.",
            rich_help_panel=DAYS_PANEL,
        ),
    ] = "sqlite",
    truck: Annotated[
        bool | None,
        typer.Option(
            "--truck/--depot",
            help="Only days with a truck, or only without; default: both.",
            rich_help_panel=DAYS_PANEL,
        ),
    ] = None,
    all_faults: Annotated[
        bool,
        typer.Option(
            "--all-faults",
            help="Inject each kind of kill and a network outage of a minute into each day.",
            rich_help_panel=DAYS_PANEL,
        ),
    ] = False,
    most_drones: Annotated[
        int, typer.Option(min=1, max=6, help="Most drones of a day.", rich_help_panel=DAYS_PANEL)
    ] = 6,
    most_orders: Annotated[
        int, typer.Option(min=1, help="Most orders of a drone and day.", rich_help_panel=DAYS_PANEL)
    ] = 4,
) -> None:
    """Run randomised trials: false telemetry, stalls, damaged logs, long operation, whole days.

    fuzz: flights with false autopilot messages, about 5 s of CPU each. stall: the companion stops
    for 2 to 20 s while a pilot takes over, 0.5 s each. logs: damaged recordings for `companion
    replay`, 0.25 s each. soak: one companion process stands by and flies for half a day, 4 minutes
    of CPU per hour. days: whole days of desk, truck and drones with injected faults, one minute of
    CPU per vehicle-hour.

    A failed case is written to the run folder; --case FILE runs it again. Ctrl-C ends all
    processes. Exit code 0: all passed, 1: a failure, 2: invalid options.

    Example: sim-bridge trials fuzz --count 20 --seed 7 --json fuzz.json
    """
    unused = [name for name, kinds in USED_BY.items() if kind not in kinds]
    require_options_not_given(context, unused, f"`trials {kind}` does not use it")
    run = run_options()
    if kind is Kind.FUZZ:
        rows, total = _fuzz_trial_rows(run, count or 500)
    elif kind is Kind.STALL:
        rows, total = _stall_trial_rows(run, count, autopilot)
    elif kind is Kind.LOGS:
        rows, total = _damaged_log_trial_rows(run, count or 30_000)
    elif kind is Kind.SOAK:
        rows, total = _soak_trial_rows(run, hours, every_minutes)
    else:
        bounds = {"max_vehicles": most_drones, "max_orders_per_vehicle": most_orders}
        draw = {"truck": truck, "all_faults": all_faults, **bounds}
        rows, total = _days_trial_rows(run, count, vehicle_hours, store, draw)
    from sim_bridge.app.trials.report import show_and_save_rows

    folder = run.run_root_or_default(RUN_ROOT)
    if not show_and_save_rows(kind.value, run.seed_or_1, rows, total, folder, run.json_out):
        raise typer.Exit(1)


def _recorded_or_drawn(run: RunOptions, case_type: type[Any], drawn: Iterable[Any]) -> list[Any]:
    """Return the cases of --case, or those drawn."""
    from sim_bridge.app.trials.trial import read_case_file

    return [read_case_file(path, case_type) for path in run.case or []] or list(drawn)


def _rows_by_folder(
    run: RunOptions, run_case: Callable[..., "TrialRow"], cases: Iterable[Any]
) -> "Iterator[TrialRow]":
    """Run each case in a folder of its own, in parallel."""
    from sim_bridge.app.trials import trial

    attempt = partial(trial.run_in_own_folder, run_case, run.run_root_or_default(RUN_ROOT))
    todo = trial.cases_until_time_limit(cases, run.minutes)
    lost_rows = trial.failed_rows_for_lost_worker
    return trial.run_trial(todo, attempt, run.workers(), lost_rows, _print_message)


Trial = tuple["Iterable[TrialRow]", int | None]
"""Rows as they are finished, and their number if it is known."""


def _fuzz_trial_rows(run: RunOptions, count: int) -> Trial:
    from sim_bridge.app.trials import fuzz as trial

    drawn = (trial.draw_case(run.seed_or_1, number) for number in range(count))
    cases = _recorded_or_drawn(run, trial.FuzzCase, drawn)
    return _rows_by_folder(run, trial.run_case, cases), len(cases)


def _stall_trial_rows(run: RunOptions, count: int | None, autopilot: str) -> Trial:
    from sim_bridge.app.trials import stall as trial
    from sim_bridge.app.trials.trial import cases_until_time_limit, run_trial

    kinds = selected_or_all(autopilot, AUTOPILOTS, "autopilot")
    drawn = (
        trial.draw_cases_for_every_second(run.seed_or_1, kinds)
        if count is None
        else trial.draw_random_subset_of_cases(run.seed_or_1, kinds, count)
    )
    cases = _recorded_or_drawn(run, trial.StallCase, drawn)
    flyer = partial(trial.run_flight, run.run_root_or_default(RUN_ROOT))
    flights = cases_until_time_limit(trial.group_cases_into_shared_flights(cases), run.minutes)
    rows = run_trial(flights, flyer, run.workers(), trial.lost_flight_rows, _print_message)
    return rows, len(cases)


def _damaged_log_trial_rows(run: RunOptions, count: int) -> Trial:
    from sim_bridge.app.trials import logs as trial
    from sim_bridge.app.trials.trial import cases_until_time_limit

    drawn = (trial.draw_case(run.seed_or_1, number) for number in range(count))
    cases = _recorded_or_drawn(run, trial.LogCase, drawn)
    todo = cases_until_time_limit(cases, run.minutes)
    folder = run.run_root_or_default(RUN_ROOT) / "damaged"
    return trial.read_damaged_logs_in_parallel(todo, folder, run.process_count()), len(cases)


def _soak_trial_rows(run: RunOptions, hours: float, every_minutes: float) -> Trial:
    from sim_bridge.app.trials import soak as trial

    drawn = [trial.SoakCase(seed=run.seed_or_1, hours=hours, flight_interval_min=every_minutes)]
    cases = _recorded_or_drawn(run, trial.SoakCase, drawn)
    return _rows_by_folder(replace(run, jobs=1, minutes=None), trial.run_case, cases), len(cases)


def _days_trial_rows(
    run: RunOptions,
    count: int | None,
    vehicle_hours: float | None,
    store: str,
    case_generator_options: dict[str, Any],
) -> Trial:
    from sim_bridge.adapters.postgres_server import PostgresExecutables
    from sim_bridge.app.trials import days as trial
    from sim_bridge.app.trials.day_case import POSTGRESQL, STORE_KINDS, DayCase

    if store not in (*STORE_KINDS, "both"):
        raise LeewayError(f"--store {store}: expected {', '.join(STORE_KINDS)} or both")
    store_kinds = STORE_KINDS if store == "both" else (store,)
    recorded_cases = _recorded_or_drawn(run, DayCase, ())
    if POSTGRESQL in (*store_kinds, *(one.store for one in recorded_cases)):
        PostgresExecutables.find()  # before the first day, not in it
    drawn = trial.DayCaseGenerator(run.seed_or_1, store_kinds, **case_generator_options)
    cases = recorded_cases or islice(drawn.generate_endless_cases(), count)
    rows = _rows_by_folder(run, trial.run_case, cases)
    return trial.rows_until_vehicle_hours(rows, vehicle_hours), len(recorded_cases) or count


def _print_message(message: str) -> None:
    typer.echo(message, err=True)
