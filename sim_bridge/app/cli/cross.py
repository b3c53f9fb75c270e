"""`sim-bridge cross`: vehicles of one truck that cross each other's paths."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer()


@app.command()
def cross(
    vehicles: Annotated[int, typer.Option(min=2, max=16, help="How many.")] = 8,
    autopilot: Annotated[str, typer.Option(help="px4, ardupilot or mixed (takes turns).")] = (
        "mixed"
    ),
    fleets: Annotated[
        int, typer.Option(min=1, max=4, help="How many fleets they are of, by turns.")
    ] = 1,
    neighbours: Annotated[
        bool,
        typer.Option(
            help="With --fleets: whether each fleet hears the others; without, a seed ends when"
            " separation is broken."
        ),
    ] = True,
    seeds: Annotated[str, typer.Option(help="FIRST:LAST, both included.")] = "1:1",
    late_s: Annotated[
        float, typer.Option(min=0.0, max=5.0, help="How late neighbours' places come.")
    ] = 0.2,
    off_m: Annotated[
        float, typer.Option(min=0.0, max=50.0, help="How far off they are (1 sigma an axis).")
    ] = 2.0,
    separation_filter: Annotated[
        bool,
        typer.Option(
            "--filter/--no-filter",
            help="no-filter: set-points straight on; a seed ends when separation is broken.",
        ),
    ] = True,
    policy: Annotated[
        str | None,
        typer.Option(help="A learned actor wishes where to (avoid); default: straight on."),
    ] = None,
    set_points: Annotated[
        bool, typer.Option(help="no-set-points: missions only, nobody keeps away from anybody.")
    ] = True,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Every seed's row goes here.")
    ] = None,
    runs: Annotated[Path, typer.Option(help="Where the run folders go.")] = Path("logs"),
) -> None:
    """Leave one truck at once, in one layer, and cross: what keeps apart are the companions.

    Example: sim-bridge cross --vehicles 8 --seeds 1:20 --json cross.json. Separation is judged by
    truth: 5 m sideways or 4 m of height, plus the airframe's span. Exit code 0 whatever came of it.
    """
    from rich.console import Console

    from sim_bridge.app.crossing.crossing import CrossOptions
    from sim_bridge.app.crossing.report import cross_seeds, flights_table, verdict_words
    from sim_bridge.app.day.faults import AUTOPILOTS

    if autopilot not in (*AUTOPILOTS, "mixed"):
        raise LeewayError(f"--autopilot {autopilot}: expected px4, ardupilot or mixed")
    first, _, last = seeds.partition(":")
    if not (first.isdecimal() and (last or first).isdecimal()):
        raise LeewayError(f"--seeds {seeds}: expected FIRST:LAST, such as 1:20")
    console = Console()
    options = CrossOptions(
        vehicles=vehicles,
        autopilot=autopilot,
        fleets=fleets,
        neighbours=neighbours,
        late_s=late_s,
        off_m=off_m,
        keep_apart=set_points,
        separation_filter=separation_filter,
        policy=policy,
        run_root=runs,
    )
    rows = cross_seeds(options, range(int(first), int(last or first) + 1), console, json_out)
    if len(rows) == 1:
        console.print(flights_table(rows[0]))
    console.print(verdict_words(rows), highlight=False)
