"""`sim-bridge cross`: vehicles of one truck that cross each other's paths."""

from typing import Annotated

import typer

from ground_station.app.options.program_options import command_class_with_options
from sim_bridge.app.cli.options import SeedsOption, run_options, seed_range

app = typer.Typer()


@app.command(cls=command_class_with_options("json_out", "runs"))
def cross(
    vehicles: Annotated[int, typer.Option(min=2, max=16, help="Number of vehicles.")] = 8,
    fleets: Annotated[
        int, typer.Option(min=1, max=4, help="Number of fleets; vehicles are assigned in turn.")
    ] = 1,
    neighbours: Annotated[
        bool,
        typer.Option(
            help="With --fleets: each fleet receives the others' tracks; if not, a seed ends when"
            " separation is broken."
        ),
    ] = True,
    seeds: SeedsOption = "1:1",
    separation_filter: Annotated[
        bool,
        typer.Option(
            "--filter/--no-filter",
            help="no-filter: straight set-points; a seed ends when separation is broken.",
        ),
    ] = True,
) -> None:
    """Fly drones that take off together from one truck, cross at one height and keep separation.

    Example: sim-bridge cross --vehicles 8 --seeds 1:20 --json cross.json. Separation is judged by
    the simulator's true state: 5 m sideways or 4 m of height, plus the airframe's span. Exit code 0
    for any outcome.
    """
    from rich.console import Console

    from sim_bridge.app.crossing.crossing import CrossOptions
    from sim_bridge.app.crossing.report import flights_table, fly_crossings, format_overall_result

    console, run = Console(), run_options()
    options = CrossOptions(
        vehicles=vehicles,
        fleets=fleets,
        neighbours=neighbours,
        separation_filter=separation_filter,
        run_root=run.run_root_or_default("logs"),
    )
    rows = fly_crossings(options, seed_range(seeds), console, run.json_out)
    if len(rows) == 1:
        console.print(flights_table(rows[0]))
    console.print(format_overall_result(rows), highlight=False)
