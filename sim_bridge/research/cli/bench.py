"""`sim-bridge research bench NAME`: what speed and size the parts have, each by one command."""

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.running import (
    OUT,
    Cluster,
    Jobs,
    Out,
    finish,
    progress_bar,
    run_journaled,
    workers_of,
)

if TYPE_CHECKING:
    from sim_bridge.research.benchmarks.paths_bench import Compared
    from sim_bridge.research.benchmarks.way_bench import Planned

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


@app.command("draw")
def draw(
    seeds: Annotated[int, typer.Option(min=1, help="Flights of each autopilot in each air.")] = 3,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write every figure here as JSON.")
    ] = None,
    out: Out = OUT,
    jobs: Jobs = 0,
    cluster: Cluster = None,
) -> None:
    """How soon a rise of the draw is told in calm, usual and rough air, and how soon it could be.

    Example: sim-bridge research bench draw --seeds 3 --json draw.json

    Flights that nothing befalls are flown; the companion's own detector then hears them again with
    the draw raised from some second on. Some 15 s of CPU a flight, three airs, two
    autopilots.
    """
    import msgspec

    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.benchmarks import draw_bench as bench

    work = bench.tasks(seeds)
    kept = Journal(out / "draw.partial", digest_of(work), list[bench.HeardRow])
    rows = bench.by_air(
        work, run_journaled("draw", work, bench.fly_one, workers_of(jobs, cluster), kept)
    )
    finish(bench.sheet(rows), out, "draw")
    if json_out is not None:
        json_out.write_bytes(msgspec.json.format(msgspec.json.encode(rows)) + b"\n")
    kept.remove()


@app.command("hot")
def hot(
    rounds: Annotated[int, typer.Option(min=1, help="Flights, and starts of each process.")] = 3,
    autopilot: Annotated[str, typer.Option(help="px4 or ardupilot.")] = "px4",
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write every value here as JSON.")
    ] = None,
) -> None:
    """Where the CPU of a simulated flight goes: each process's start, and its parts in flight."""
    if autopilot not in ("px4", "ardupilot"):
        raise LeewayError(f"--autopilot {autopilot}: expected px4 or ardupilot")
    from rich.console import Console

    from sim_bridge.research.benchmarks.hot_bench import bench as bench_now

    result = bench_now(rounds, autopilot, Console())
    if json_out is not None:
        json_out.write_text(json.dumps(result, indent=1) + "\n")


@app.command("dispatch")
def dispatch(
    vehicles: Annotated[int, typer.Option(min=1, max=500, help="Connected vehicles.")] = 100,
    orders: Annotated[int, typer.Option(min=10, help="Orders dispatched, one at a time.")] = 500,
    seed: Annotated[int, typer.Option(min=0, help="Which vehicle gets which order.")] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures.")] = None,
) -> None:
    """Time the dispatch of one order, command to acknowledgement, with many vehicles connected.

    sim-bridge research bench dispatch --vehicles 100 --orders 500
    """
    try:
        from sim_bridge.research.benchmarks.dispatch_bench import bench as bench_now
    except ImportError as error:
        raise LeewayError(f"bench dispatch needs leeway-uas[ground]: {error}") from error
    bench_now(vehicles, orders, seed, json_file)


@app.command("map")
def live_map(
    drones: Annotated[int, typer.Option(min=1, max=2000, help="Drones in the air.")] = 200,
    orders: Annotated[int, typer.Option(min=1, help="Orders of the day.")] = 1000,
    windows: Annotated[int, typer.Option(min=0, max=32, help="Browsers that follow it.")] = 3,
    seconds: Annotated[float, typer.Option(min=1.0, help="How long it is measured.")] = 20.0,
    seed: Annotated[int, typer.Option(min=0, help="Places, winds and speeds.")] = 1,
    browser: Annotated[
        bool,
        typer.Option(
            "--browser",
            help="Also count the frames of the page in a headless Chromium, drawn in software: at"
            " rest, panned and zoomed, the median of five runs. They go with the machine's load.",
        ),
    ] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures.")] = None,
) -> None:
    """The share of a core that `ground-station map` takes with many drones and orders.

    sim-bridge research bench map --drones 200 --orders 1000 --browser
    """
    try:
        from sim_bridge.research.benchmarks.map_bench import bench as bench_now
    except ImportError as error:
        raise LeewayError(f"bench map needs leeway-uas[ground]: {error}") from error
    bench_now(drones, orders, windows, seconds, seed, json_file, browser)


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


@app.command("tracks")
def tracks(
    drones: Annotated[int, typer.Option(min=2, max=500, help="In the air.")] = 100,
    across_km: Annotated[float, typer.Option(min=1.0, help="Side of the square.")] = 10.0,
    seconds: Annotated[float, typer.Option(min=1.0, help="How long is counted.")] = 20.0,
    seed: Annotated[int, typer.Option(min=0, help="Where they fly.")] = 1,
    fleets: Annotated[
        int, typer.Option(min=1, max=16, help="Neighbouring fleets that they are of, by turns.")
    ] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures.")] = None,
) -> None:
    """What a drone hears of the others a second: of all, and by grid cell; of several fleets also
    where each hears its own only.

    sim-bridge research bench tracks --drones 100 --across-km 10
    """
    from dataclasses import asdict

    from sim_bridge.research.benchmarks.fleet_bench.track_bench import bench as bench_now
    from sim_bridge.research.benchmarks.fleet_bench.track_flights import TrackFlights

    heard = bench_now(TrackFlights(drones, 1000.0 * across_km, seed, fleets), seconds)
    figures = json.dumps([asdict(one) for one in heard], indent=1)
    typer.echo(figures)
    if json_file is not None:
        json_file.write_text(figures + "\n")


@app.command("start")
def start(
    orders: Annotated[int, typer.Option(min=1, help="Orders of the day.")] = 5000,
    drones: Annotated[int, typer.Option(min=1, max=500, help="Drones at the depot.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Where the orders are.")] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures.")] = None,
) -> None:
    """How long a desk takes to begin a large day: its orders' import, its first assignment.

    sim-bridge research bench start --orders 5000 --drones 100
    """
    from dataclasses import asdict

    try:
        from sim_bridge.research.benchmarks.fleet_bench.start_bench import bench as bench_now
    except ImportError as error:
        raise LeewayError(f"bench start needs leeway-uas[ground]: {error}") from error
    figures = json.dumps(asdict(bench_now(orders, drones, seed)), indent=1)
    typer.echo(figures)
    if json_file is not None:
        json_file.write_text(figures + "\n")


@app.command("planner")
def planner(
    out: Out = OUT, large: Annotated[bool, typer.Option(help="10,000 vertices too")] = False
) -> None:
    """Speed and size of planners and campaigns beside their plain alternatives."""
    from sim_bridge.research.benchmarks import planner_bench as bench

    finish(bench.sheet(large), out, "planner_bench")


@app.command("estimator")
def estimator(
    out: Out = OUT,
    jobs: Jobs = 0,
    cluster: Cluster = None,
    flights: Annotated[
        int, typer.Option(min=2, help="flights for each place in the envelope")
    ] = 20,
    bounds: Annotated[
        int | None,
        typer.Option(min=2, help="flights of these whose bound is computed; left out: all"),
    ] = None,
    only: Annotated[
        str, typer.Option(help='conditions with this in their name, say "step" or "hover"')
    ] = "",
    seed: Annotated[int, typer.Option(help="of winds, gusts, sensors and drag")] = 2024,
    anemometer: Annotated[
        Path | None,
        typer.Option(help="a flight with an anemometer, CSV at 5 Hz; left out: none"),
    ] = None,
    airframe: Annotated[str, typer.Option(help="of the real flight: name or file")] = "generic",
    draws: Annotated[int, typer.Option(min=1, help="airspeed errors drawn")] = 8,
    pitot: Annotated[bool, typer.Option(help="a pitot aboard in the envelope")] = False,
    envelope: Annotated[bool, typer.Option(help="fly the envelope, too (minutes)")] = True,
    states: Annotated[
        bool,
        typer.Option("--states", help="fly with each state left out instead: what it is worth"),
    ] = False,
) -> None:
    """The wind estimator on a real flight with an anemometer, and beside the bound.

    For example: sim-bridge research bench estimator --no-envelope, which takes half a minute;
    or --states --flights 24, which takes some ten.
    """
    from companion.adapters.files.params import params_dir, read_airframe
    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.wind import estimator_bench as bench
    from sim_bridge.research.wind import states_bench
    from sim_bridge.research.wind.anemometer_flight import read_recording
    from sim_bridge.truth.params import load_airframe

    conditions = states_bench.CONDITIONS if states else bench.CONDITIONS
    names = [condition.name for condition in conditions]
    if not any(only in name for name in names):
        raise typer.BadParameter(f"--only: {only!r} is in no condition's name: {'; '.join(names)}")
    believed = read_airframe(airframe)
    if anemometer is None:
        typer.echo("no real flight: --anemometer FILE names one", err=True)
    else:
        recording = read_recording(anemometer, believed.mass_kg(0.0))
        with progress_bar() as bar:
            bar.add_task("real flight", total=None)
            rows = bench.flight_rows(recording, believed, bench.airspeed_draws(draws, seed))
        out.mkdir(parents=True, exist_ok=True)
        finish(bench.flight_sheet(rows), out, "estimator_flight")
        bench.draw_flight(recording, rows, out / "estimator_flight.png")
        for name, airspeed in (("tilt only", False), ("with airspeed", True)):
            median, most = bench.update_us(recording, believed, airspeed=airspeed)
            typer.echo(f"update, {name}: {median:.0f} us of CPU (median), {most:.0f} us (p99)")
    if not envelope:
        return
    truth, vehicle = load_airframe(params_dir() / "truth" / "m100.toml"), read_airframe("m100")
    if states:
        left_out = states_bench.states_jobs(flights, seed, truth, vehicle, pitot)
        left_out = [job for job in left_out if only in job.condition.name]
        kept = Journal(
            out / "estimator_states.partial", digest_of(left_out), states_bench.StatesRow
        )
        rows_found = run_journaled(
            "states", left_out, states_bench.fly_states, workers_of(jobs, cluster), kept
        )
        finish(states_bench.states_sheet(rows_found, seed), out, "estimator_states")
        kept.remove()
        return
    bounded = min(flights, bounds or flights)
    work = bench.jobs_of(flights, bounded, seed, truth, vehicle, pitot)
    work = [job for job in work if only in job.condition.name]
    stem = "estimator_envelope" + ("_pitot" if pitot else "")
    kept = Journal(out / f"{stem}.partial", digest_of(work), bench.EnvelopeRow)
    found = run_journaled("envelope", work, bench.fly_condition, workers_of(jobs, cluster), kept)
    finish(bench.envelope_sheet(found, seed, pitot), out, stem)
    kept.remove()


@app.command("air")
def air(
    out: Out = OUT,
    jobs: Jobs = 0,
    cluster: Cluster = None,
    seeds: Annotated[int, typer.Option(min=1, help="flights of each autopilot and place")] = 1,
    stated: Annotated[
        bool, typer.Option("--stated", help="the flight file states the air's temperature")
    ] = False,
) -> None:
    """Flights at 0, 1,500 and 3,000 m and at -10, 15 and 40 degrees C: wind, P(home), energy.

    For example: sim-bridge research bench air --seeds 1
    """
    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.wind import air_bench as bench

    work = bench.tasks(seeds, out / "air_runs", stated=stated)
    kept = Journal(out / "air.partial", digest_of(work), bench.AirRow)
    found = run_journaled("air", work, bench.fly_in_air, workers_of(jobs, cluster), kept)
    finish(bench.sheet(found, seeds, stated=stated), out, "air")
    kept.remove()


@app.command("paths")
def paths(
    out: Out = OUT,
    pairs: Annotated[
        int, typer.Option("--paths", help="pairs of poses in each wind", min=1)
    ] = 20_000,
    seed: Annotated[int, typer.Option(help="of the poses", min=0)] = 1,
) -> None:
    """Paths a second and their lengths, beside OMPL's Dubins and trochoids (pip install ompl).

    Example: sim-bridge research bench paths --paths 5000
    """
    from sim_bridge.research.benchmarks import paths_bench as experiment

    rows: list[Compared] = []
    with progress_bar() as shown:
        task = shown.add_task("paths", total=len(experiment.WINDS_MPS))
        for wind_mps in experiment.WINDS_MPS:
            rows.append(experiment.compare(wind_mps, pairs, seed))
            shown.advance(task)
    finish(experiment.sheet(rows), out, "paths_bench")


@app.command("way")
def way(
    out: Out = OUT,
    sites: Annotated[int, typer.Option(min=1, help="drawn for each number of towers")] = 5,
) -> None:
    """What planning one delivery costs a vehicle, by how many towers stand on the way.

    Example: sim-bridge research bench way --sites 5
    """
    from sim_bridge.research.benchmarks import way_bench as experiment

    rows: list[Planned] = []
    with progress_bar() as shown:
        task = shown.add_task("way", total=len(experiment.TOWERS) * sites)
        for count in experiment.TOWERS:
            for seed in range(1, sites + 1):
                rows.append(experiment.plan(count, seed))
                shown.advance(task)
    finish(experiment.sheet(rows), out, "way_bench")


@app.command("field")
def field(
    out: Out = OUT,
    seed: Annotated[int, typer.Option(min=0, help="of places and winds")] = 1,
) -> None:
    """What an update of the fleet's wind costs with 1, 8, 24 and 100 drones, and amid a front.

    CPU time, so that other work on the machine matters less; the least is what a quiet one takes.

    Example: OMP_NUM_THREADS=1 sim-bridge research bench field
    """
    from sim_bridge.research.benchmarks import field_bench as experiment

    with progress_bar() as bar:
        shown = bar.add_task("field", total=len(experiment.DRONES) + 1)
        costs = []
        for drones in experiment.DRONES:
            costs.append(experiment.measured(drones, seed))
            bar.advance(shown)
        costs.append(experiment.measured(experiment.DRONES[-1], seed, front=True))
        bar.advance(shown)
    finish(experiment.sheet(costs), out, "field_bench")


@app.command("avoid")
def avoid(
    scenes: Annotated[int, typer.Option(min=1, help="decisions of each kind")] = 400,
    neighbours: Annotated[int, typer.Option(min=0, max=200, help="about the drone")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="of the scenes")] = 1,
    card: Annotated[
        str, typer.Option(help="the actor: a name in params/policies, or a card's path")
    ] = "avoid",
    out: Annotated[Path, typer.Option(help="folder for the table")] = OUT,
) -> None:
    """Time one decision on board: the safety filter among neighbours, and the actor with its view.

    CPU time, so that other work on the machine matters less; the least is what a quiet one takes.

    Example: OMP_NUM_THREADS=1 sim-bridge research bench avoid --neighbours 20
    """
    from companion.adapters.files.policy_file import read_policy
    from sim_bridge.research.benchmarks import avoid_bench as experiment

    policy, _ = read_policy(card)
    with progress_bar() as bar:
        shown = bar.add_task("decisions", total=2 * scenes)
        costs = experiment.measured(policy, scenes, neighbours, seed, lambda: bar.advance(shown))
    finish(experiment.sheet(costs, neighbours), out, "avoid_bench")
