"""`sim-bridge faults`: the standing suite of faults that must cost no vehicle."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.app.cli.options import ClusterOption

app = typer.Typer()

ALL = "all"

INTERRUPTED = 130
"""The shell's exit code for a program that Ctrl-C ended."""


@app.command()
def faults(
    names: Annotated[
        list[str] | None, typer.Argument(help="Faults by name or number; without one, all.")
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="Name the faults and fly nothing.")] = False,
    only: Annotated[
        list[str] | None, typer.Option(help="The same: --only NAME ..., or once for each.")
    ] = None,
    autopilot: Annotated[str, typer.Option(help="px4, ardupilot or all.")] = ALL,
    phase: Annotated[
        str,
        typer.Option(help="ready, climb, outbound, drop, return, land or all: where it begins."),
    ] = ALL,
    seeds: Annotated[str, typer.Option(help="FIRST:LAST, both included.")] = "1:1",
    jobs: Annotated[int, typer.Option(min=1, help="Flights side by side.")] = 2,
    cluster: ClusterOption = None,
    minutes: Annotated[
        float | None, typer.Option(min=0.1, help="Begin no flight after so many minutes.")
    ] = None,
    tight: Annotated[
        bool,
        typer.Option(
            "--tight",
            help="Draw each pack's charge from too little to plenty, and judge P(home) over all"
            " flights: rows 21 to 39, which the model does not know.",
        ),
    ] = False,
    json_out: Annotated[Path | None, typer.Option("--json", help="Every row goes here.")] = None,
    runs: Annotated[Path, typer.Option(help="Where the run folders go.")] = Path("logs/faults"),
) -> None:
    """Inject one fault into each of many short flights, and judge by truth what came of it.

    Example: sim-bridge faults --only 7 packs-5-apart --seeds 1:5 --json faults.json

    A fault begins in the phase that is named, at a moment drawn by seed. A row holds where the
    vehicle is home with its reserve (or what else the fault leaves to be asked), nothing is
    commanded after a person has taken over, nothing false is promised and no exception is raised.
    With --json it can be flown in pieces: after Ctrl-C, or --minutes, the same command goes on
    where it stopped. With --minutes the order is drawn by seed: what has been flown is a sample.
    A flight whose process is killed (out of memory) is flown once more, and lost if that is, too.

    With --tight a flight need not come home: of those that went on with a P(home) of 0.99 or more
    at least 95 % have to, in each group.

    Exit code 0 where all rows hold, 1 where one does not or is lost, 130 after Ctrl-C.
    """
    from sim_bridge.app.fault_suite import report, suite
    from sim_bridge.app.fault_suite.catalogue import chosen, tight_enough
    from sim_bridge.app.fault_suite.promises import by_group
    from sim_bridge.app.fault_suite.session import Session
    from sim_bridge.app.faults.case import BOTH, PHASES
    from sim_bridge.app.trials.trial import Bounds

    cases = chosen([*(only or []), *(names or [])])
    if tight:
        cases = tight_enough(cases, named=bool(only or names))
    if show:
        for line in report.listing(cases):
            typer.echo(line)
        return
    todo = suite.tasks(
        cases,
        _of(autopilot, BOTH, "autopilot"),
        _of(phase, PHASES, "phase"),
        _range(seeds),
        runs,
        tight=tight,
    )
    if not todo:
        raise LeewayError(f"--phase {phase}: these faults begin in other phases: see --list")
    session = Session(todo, Bounds(jobs, minutes, cluster), json_out)
    try:
        rows = session.run()
    except KeyboardInterrupt:
        if session.journal is None:
            raise
        path = session.journal.path
        typer.echo(f"stopped; {path} keeps what was flown, the same command goes on")
        raise typer.Exit(INTERRUPTED) from None
    kept = not tight or all(group.is_kept for group in by_group(rows))
    if session.lost or not kept or not all(row.held for row in rows):
        raise typer.Exit(1)


def _of(asked: str, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    if asked == ALL:
        return known
    if asked not in known:
        raise LeewayError(f"--{option} {asked}: expected {', '.join(known)} or {ALL}")
    return (asked,)


def _range(seeds: str) -> range:
    first, _, last = seeds.partition(":")
    if not (first.isdecimal() and (last or first).isdecimal()):
        raise LeewayError(f"--seeds {seeds}: expected FIRST:LAST, such as 1:5")
    return range(int(first), int(last or first) + 1)
