"""`sim-bridge research bench NAME`: what speed and size the parts have, each by one command."""

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError

if TYPE_CHECKING:
    pass

app = typer.Typer(no_args_is_help=True, help="Measure speed and size of a part.")


@app.command("flight")
def flight(
    rounds: Annotated[int, typer.Option(min=1, help="Runs of each benchmark.")] = 3,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write every value here as JSON.")
    ] = None,
    fresh_clone: Annotated[
        bool, typer.Option(help="Time `make fly` on a clone, install included (needs network).")
    ] = True,
) -> None:
    """Measure speed and size: one vehicle on one core, a fleet, a companion at real time.

    At real time also with a disk that takes 3 s to sync: no command waits for it.
    """
    from rich.console import Console

    from sim_bridge.research.benchmarks.flight_bench import bench as bench_now

    result = bench_now(rounds, Console(), fresh_clone=fresh_clone)
    if json_out is not None:
        json_out.write_text(json.dumps(result, indent=1) + "\n")


fleet = typer.Typer()


@fleet.command("bench-fleet")
def bench_fleet(
    vehicles: Annotated[int, typer.Option(min=1, max=10000, help="Members of the fleet.")] = 50,
    minutes: Annotated[float, typer.Option(min=0.1, help="How long they fly orders.")] = 2.0,
    routers: Annotated[
        int, typer.Option(min=0, max=16, help="zenoh routers between members and desk.")
    ] = 0,
    desks: Annotated[
        int, typer.Option(min=1, max=16, help="Desks, each with a region of the members.")
    ] = 1,
    kill_desk: Annotated[
        bool,
        typer.Option("--kill-desk", help="Kill each desk half way; another begins on its store."),
    ] = False,
    faults: Annotated[
        bool,
        typer.Option(
            "--faults",
            help="A quarter through a router is killed and begins anew; half way each desk dies;"
            " then the members of a router are cut off for 30 s. Needs --routers.",
        ),
    ] = False,
    tls: Annotated[
        bool,
        typer.Option(
            "--tls", help="With identities, TLS and signatures, as `ground-station pki` makes them."
        ),
    ] = False,
    store: Annotated[
        str | None,
        typer.Option(
            help="An empty store, or `postgresql`: a server of its own from this machine's"
            " programs. Default: SQLite in a folder of its own."
        ),
    ] = None,
    order_every: Annotated[
        float, typer.Option(min=80.0, help="So often each vehicle gets an order, s.")
    ] = 300.0,
    states_every: Annotated[
        float,
        typer.Option(
            min=1.0,
            max=4.0,
            help="So often each vehicle tells its state, s; more lets a larger fleet fit this"
            " machine.",
        ),
    ] = 1.0,
    join_apart: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=10.0,
            help="Between two processes of members that join, s. With 0 all of a region join at the"
            " same moment; more for a fleet that nearly fills this machine.",
        ),
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="How long each flight takes.")] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures.")] = None,
) -> None:
    """A desk with many vehicles that fly orders: time to acknowledgement, load, nothing lost.

    sim-bridge research bench-fleet --vehicles 200 --minutes 2 --json fleet.json

    sim-bridge research bench-fleet --vehicles 10000 --desks 10 --routers 10 --states-every 4
    --order-every 1800 --join-apart 1
    """
    try:
        from sim_bridge.research.benchmarks.fleet_bench.bench import Asked
        from sim_bridge.research.benchmarks.fleet_bench.bench import bench as bench_now
    except ImportError as error:
        raise LeewayError(f"bench-fleet needs leeway-uas[ground]: {error}") from error
    asked = Asked(
        vehicles, minutes, routers, desks, store, seed, order_every, kill_desk, faults, tls,
        states_every_s=states_every, join_apart_s=join_apart,
    )  # fmt: skip
    figures = json.dumps(bench_now(asked, partial(typer.echo, err=True)), indent=1)
    typer.echo(figures)
    if json_file is not None:
        json_file.write_text(figures + "\n")
