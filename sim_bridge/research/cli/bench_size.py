"""`sim-bridge research bench town` and `large-day`: how time grows with vehicles and orders."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.running import (
    OUT,
    Cluster,
    Jobs,
    Out,
    finish,
    run_journaled,
    workers_of,
    write_whole,
)

app = typer.Typer()

JsonOut = Annotated[Path | None, typer.Option("--json", help="Write every figure here as JSON.")]


@app.command("town")
def town(
    vehicles: Annotated[
        list[int] | None, typer.Option(min=1, help="In service; once for each town.")
    ] = None,
    processes: Annotated[
        list[int] | None,
        typer.Option(min=1, help="That share the town's depots; once for each division."),
    ] = None,
    minutes: Annotated[float, typer.Option(min=0.1, help="Simulated, after the start.")] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Of orders, winds, packs.")] = 1,
    json_out: JsonOut = None,
    out: Out = OUT,
) -> None:
    """How much faster than real time a town with many vehicles in service is simulated.

    Depots of up to eight drones, each with desk, store, crew and network as in `sim-bridge day`;
    orders are never short. With several processes each has its share of the depots.

    sim-bridge research bench town --vehicles 8 --vehicles 100 --processes 1 --processes 2
    """
    import msgspec

    try:
        from sim_bridge.research.benchmarks import town_bench as bench
    except ImportError as error:
        raise LeewayError(f"bench town needs leeway-uas[ground]: {error}") from error
    from sim_bridge.adapters.journal import Journal, digest_of

    flown: list[bench.TownFlown] = []
    out.mkdir(parents=True, exist_ok=True)
    for share in processes or [1, 2]:
        for count in vehicles or [8, 25, 50, 100]:
            with tempfile.TemporaryDirectory(prefix="leeway-town-") as folder:
                parts = bench.parts_of(count, share, seed, minutes, Path(folder))
                kept = Journal(out / "town.partial", digest_of(parts), bench.TownPartFlown)
                title = f"{count} vehicles, {len(parts)} processes"
                done = run_journaled(title, parts, bench.fly_part, workers_of(share, None), kept)
                kept.remove()
            flown.append(bench.TownFlown.of(done))
    finish(bench.sheet(flown), out, "town")
    if json_out is not None:
        write_whole(json_out, msgspec.json.format(msgspec.json.encode(flown)) + b"\n")


@app.command("large-day")
def large_day(
    orders: Annotated[
        list[int] | None, typer.Option(min=4, help="Once for each day; ten trucks at most.")
    ] = None,
    dynamic: Annotated[
        bool, typer.Option("--dynamic", help="By the dynamic assignment, not by the search.")
    ] = False,
    drones: Annotated[
        int,
        typer.Option(
            min=1,
            max=50,
            help="Of each truck. With twice as many a truck could"
            " have all of another's, too: no sharing does more.",
        ),
    ] = 10,
    trials: Annotated[
        int | None,
        typer.Option(min=1, help="Of each region's search; left out: by the region's size."),
    ] = None,
    balance: Annotated[
        bool, typer.Option(help="Let the trucks come back together, as `divide` does.")
    ] = True,
    seed: Annotated[int, typer.Option(min=0, help="Where orders are, and of the searches.")] = 1,
    jobs: Jobs = 0,
    cluster: Cluster = None,
    json_out: JsonOut = None,
    out: Out = OUT,
) -> None:
    """Large days divided among trucks: time and worth of the plans as orders grow.

    A truck and its drones for each hundred orders (two trucks at least, ten at most), from up to
    three depots. Each region's day is written, read back and planned; the longest is planned anew
    from half way. Beside the plans stand two bounds that no plan beats.

    sim-bridge research bench large-day --orders 100 --orders 5000 --trials 60000
    """
    import msgspec

    try:
        from sim_bridge.research.benchmarks import large_day_bench as bench
    except ImportError as error:
        raise LeewayError(f"bench large-day needs leeway-uas[ground]: {error}") from error

    policy: bench.Policy = "dynamic" if dynamic else "search"
    found: list[bench.LargeDayFigures] = []
    for count in orders or [100, 500, 1000, 5000]:

        def tell(one: "bench.RegionPlanned", count: int = count) -> None:
            typer.echo(f"{count} orders: {one.region.name} planned, {one.cpu_s:.0f} s", err=True)

        large = bench.sized(count, seed, drones)
        workers = workers_of(jobs, cluster)
        found.append(bench.bench(large, policy, trials, workers, tell, balance))
    finish(bench.sheet(found), out, "large_day")
    if json_out is not None:
        write_whole(json_out, msgspec.json.format(msgspec.json.encode(found)) + b"\n")
