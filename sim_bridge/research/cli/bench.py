"""`sim-bridge research bench NAME`: what speed and size the parts have, each by one command."""

from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import command_class_with_options
from sim_bridge.research.cli.options import create_experiment_run, seed_option_or

app = typer.Typer(no_args_is_help=True, help="Measure speed and size of a part.")


@app.command("flight", cls=command_class_with_options("json_out", "out"))
def flight(
    rounds: Annotated[int, typer.Option(min=1, help="Runs of each benchmark.")] = 3,
) -> None:
    """Measure speed and size: one vehicle on one core, a fleet, a companion at real time."""
    from sim_bridge.research.benchmarks.flight_bench import run_flight_benchmarks

    run = create_experiment_run()
    run.print_and_write_report(run_flight_benchmarks(rounds, run))


fleet = typer.Typer()


@fleet.command("bench-fleet", cls=command_class_with_options("json_out", "out", "seed"))
def bench_fleet(
    vehicles: Annotated[int, typer.Option(min=1, max=10000, help="Members of the fleet.")] = 50,
    minutes: Annotated[float, typer.Option(min=0.1, help="Duration, minutes.")] = 2.0,
    routers: Annotated[
        int, typer.Option(min=0, max=16, help="zenoh routers between members and desk.")
    ] = 0,
    desks: Annotated[
        int, typer.Option(min=1, max=16, help="Desks, each with a region of the members.")
    ] = 1,
    kill_desk: Annotated[
        bool,
        typer.Option("--kill-desk", help="Kill each desk halfway and start another on its store."),
    ] = False,
    tls: Annotated[
        bool,
        typer.Option("--tls", help="Use identities, TLS and signatures (`ground-station pki`)."),
    ] = False,
    store: Annotated[
        str | None,
        typer.Option(help="URL of an empty store. Default: SQLite in a folder of its own."),
    ] = None,
    order_every: Annotated[
        float, typer.Option(min=80.0, help="Interval between the orders of a vehicle, s.")
    ] = 300.0,
    states_every: Annotated[
        float,
        typer.Option(min=1.0, max=4.0, help="Interval between state messages of a vehicle, s."),
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
    hostile: Annotated[
        int,
        typer.Option(
            min=0,
            help="With --tls: signed messages of a hostile member, 10,000 a second, beside a"
            " thousandth as many idle connections.",
        ),
    ] = 0,
) -> None:
    """A desk with many vehicles that fly orders: time to acknowledgement, load, nothing lost.

    sim-bridge research bench-fleet --vehicles 200 --minutes 2 --json fleet.json

    sim-bridge research bench-fleet --vehicles 10000 --desks 10 --routers 10 --states-every 4
    --order-every 1800 --join-apart 1
    """
    try:
        from sim_bridge.research.benchmarks.fleet_bench.bench import (
            BenchRequest,
            build_fleet_benchmark_report,
            run_fleet_benchmark,
        )
    except ImportError as error:
        raise LeewayError(f"bench-fleet needs leeway-uas[ground]: {error}") from error
    run = create_experiment_run("logs/bench-fleet")
    request = BenchRequest(
        vehicles, minutes, routers, desks, store, seed_option_or(1), order_every, kill_desk, tls,
        state_interval_s=states_every, join_delay_s=join_apart, hostile_messages=hostile,
    )  # fmt: skip
    results = run_fleet_benchmark(request, run.print_message)
    run.print_and_write_report(build_fleet_benchmark_report(results))
