"""`sim-bridge faults`: the standing suite of faults that must cost no vehicle."""

from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import command_class_with_options
from sim_bridge.app.cli.options import SeedsOption, run_options, seed_range, selected_or_all

app = typer.Typer()

PAIRS_PER_SEED = 1000
EXIT_INTERRUPTED = 130
"""The shell's exit code for a program that Ctrl-C ended."""


@app.command(cls=command_class_with_options("jobs", "cluster", "minutes", "json_out", "runs"))
def faults(
    names: Annotated[
        list[str] | None, typer.Argument(help="Faults by name or number, see --list. Default: all.")
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="List the faults and fly nothing.")] = False,
    only: Annotated[
        list[str] | None, typer.Option(help="Another fault, by name or number; repeatable.")
    ] = None,
    autopilot: Annotated[str, typer.Option(help="Autopilot: px4, ardupilot or all.")] = "all",
    phase: Annotated[
        str,
        typer.Option(help="Phase of the fault: ready, climb, outbound, drop, return, land or all."),
    ] = "all",
    seeds: SeedsOption = "1:1",
    tight: Annotated[
        bool,
        typer.Option(
            "--tight",
            help="Draw each pack's charge from too little to plenty, and judge P(home) over all"
            " flights. Only faults 21 to 39, which the model does not know.",
        ),
    ] = False,
    pairs: Annotated[
        int,
        typer.Option(
            max=PAIRS_PER_SEED,
            help="Fly so many flights with two faults instead, each drawn by its own seed, from"
            " 1000 times the first of --seeds on.",
        ),
    ] = 0,
) -> None:
    """Inject one fault into each of many short flights, and judge the outcome by true state.

    Example: sim-bridge faults --only 7 packs-5-apart --seeds 1:5 --json faults.json

    A fault begins in the stated phase, at a moment drawn by seed. A row, one flight, holds if the
    vehicle is home with its reserve (or as the fault permits), nothing is commanded after a person
    has taken over, nothing false is promised and no exception is raised. With --json it can be
    flown in pieces: after Ctrl-C, or --minutes, the same command continues there. With
    --minutes the order is drawn by seed: what has been flown is a sample. A flight whose process is
    killed (out of memory) is flown once more, and lost if that is, too.

    With --tight a flight need not come home: of those that went on with a P(home) of 0.99 or more
    at least 95 % have to, in each group.

    Exit codes: 0 all rows hold; 1 one does not, or is lost; 130 after Ctrl-C.
    """
    from sim_bridge.app.fault_suite import suite
    from sim_bridge.app.fault_suite.catalogue import select_cases, select_tight_cases
    from sim_bridge.app.fault_suite.promises import p_home_calibration
    from sim_bridge.app.fault_suite.session import FaultSuiteSession
    from sim_bridge.app.faults.fault import PHASES
    from sim_bridge.app.faults.pair import draw_pair_task
    from sim_bridge.autopilot.kinds import AUTOPILOTS

    cases = select_cases([*(only or []), *(names or [])])
    if tight:
        cases = select_tight_cases(cases, named_explicitly=bool(only or names))
    if show:
        for case in cases:
            typer.echo(f"{case.number:>2} {case.name} ({case.group}: {', '.join(case.phases)})")
            typer.echo(f"   {case.description}")
        return
    run = run_options()
    kinds = selected_or_all(autopilot, AUTOPILOTS, "autopilot")
    phases = selected_or_all(phase, PHASES, "phase")
    flown_seeds, root = seed_range(seeds), run.run_root_or_default("logs/faults")
    if pairs:
        first_seed = PAIRS_PER_SEED * flown_seeds[0]
        pair_seeds = range(first_seed, first_seed + pairs)
        todo = [draw_pair_task(cases, kinds, phases, seed, root) for seed in pair_seeds]
    else:
        todo = suite.list_tasks(cases, kinds, phases, flown_seeds, root, tight=tight)
    if not todo:
        raise LeewayError(f"--phase {phase}: these faults begin in other phases: see --list")
    session = FaultSuiteSession(todo, run.workers(), run.minutes, run.json_out)
    try:
        rows = session.fly_and_store_remaining_flights()
    except KeyboardInterrupt:
        path = session.progress_log.path
        if path is None:
            raise
        typer.echo(f"stopped; {path} keeps what was flown; run the same command to continue")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    kept = not tight or all(group.is_high_p_home_reliable for group in p_home_calibration(rows))
    if session.lost_flights or not kept or not all(row.passed for row in rows):
        raise typer.Exit(1)
