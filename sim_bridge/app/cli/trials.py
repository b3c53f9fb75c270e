"""`sim-bridge trials`: long trials that look for what nobody thought of."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.app.cli.options import ClusterOption

if TYPE_CHECKING:
    from sim_bridge.app.trials.trial import TrialRow

app = typer.Typer(no_args_is_help=True)
group = typer.Typer()
group.add_typer(
    app,
    name="trials",
    help="Long trials: lies on the wire, stalls, damaged logs, half a day of flights, whole days.",
)

SeedOption = Annotated[int, typer.Option(min=0, help="What is drawn, all of it, follows from it.")]
MinutesOption = Annotated[
    float | None, typer.Option(min=0.1, help="Begin nothing new after so many minutes.")
]
JobsOption = Annotated[int, typer.Option(min=1, help="How many side by side.")]
JsonOption = Annotated[Path | None, typer.Option("--json", help="Every row goes here.")]
RunsOption = Annotated[
    Path, typer.Option(help="Folder for what did not hold; cases/ in it holds the cases.")
]
CaseOption = Annotated[
    list[Path] | None, typer.Option(help="Try this case again, not drawn ones; once for each.")
]
RUNS = Path("logs/trials")
AUTOPILOTS = ("px4", "ardupilot")


@app.command()
def fuzz(
    count: Annotated[int, typer.Option(min=1, help="Flights.")] = 500,
    seed: SeedOption = 1,
    minutes: MinutesOption = None,
    jobs: JobsOption = 2,
    cluster: ClusterOption = None,
    case: CaseOption = None,
    json_out: JsonOption = None,
    runs: RunsOption = RUNS,
) -> None:
    """Fly with an autopilot whose messages lie, field by field.

    Example: sim-bridge trials fuzz --count 20 --seed 7 --json fuzz.json

    Each flight has a real companion in lockstep. From a drawn time on, for a while or for good, a
    drawn share of the autopilot's messages is extreme, not a number, off by a bit, negated,
    swapped, stale, at a wild time, lost, doubled, or made up; in some a pilot takes over. The
    vehicle need not come home: where it does not, that is counted. What must hold: no exception,
    an answer always, energy left never rises, nothing is commanded after hands off, nothing is
    armed or set in the air, every P is within 0 and 1.

    Exit code 0 where all hold, 1 where one does not, 2 for a mistake in the options. About five
    seconds of CPU a flight.
    """
    from sim_bridge.app.trials import fuzz as trial
    from sim_bridge.app.trials.trial import Bounds, case_lost, read_case, tried

    again = [read_case(path, trial.FuzzCase) for path in case or []]
    cases = again or [trial.drawn(seed, number) for number in range(count)]
    rows = tried(cases, trial.FuzzFlyer(runs), Bounds(jobs, minutes, cluster), case_lost, _say)
    _report("fuzz", seed, rows, len(cases), runs, json_out)


@app.command()
def stall(
    count: Annotated[
        int | None, typer.Option(min=1, help="So many drawn instants; default: all.")
    ] = None,
    autopilot: Annotated[str, typer.Option(help="px4, ardupilot or all.")] = "all",
    seed: SeedOption = 1,
    minutes: MinutesOption = None,
    jobs: JobsOption = 2,
    cluster: ClusterOption = None,
    case: CaseOption = None,
    json_out: JsonOption = None,
    runs: RunsOption = RUNS,
) -> None:
    """Let the companion stand still, and a pilot take over meanwhile.

    Example: sim-bridge trials stall --count 40 --json stall.json

    For 2, 6 and 20 s at every second of a flight, by both autopilots. One flight is shared: it is
    copied (fork) at each instant. The companion is the flight code in this process; it stops where
    it next asks what time it is, so that a stall may fall between a decision and its orders. The
    pilot's switch is moved at a drawn moment in the stall. What must hold: not one command after
    the companion could know of it, thus none based on what it knew before.

    Exit code 0 where all hold, 1 where one does not, 2 for a mistake in the options. About half a
    second of CPU a stall. Linux and macOS.
    """
    from sim_bridge.app.trials import stall as trial
    from sim_bridge.app.trials.trial import Bounds, read_case, tried

    if autopilot not in (*AUTOPILOTS, "all"):
        raise LeewayError(f"--autopilot {autopilot}: expected {', '.join(AUTOPILOTS)} or all")
    kinds = AUTOPILOTS if autopilot == "all" else (autopilot,)
    cases = [read_case(path, trial.StallCase) for path in case or []]
    if not cases and count is None:
        cases = trial.every_case(seed, kinds)
    elif not cases:
        cases = trial.some_cases(seed, kinds, count or 0)
    bounds = Bounds(jobs, minutes, cluster)
    rows = tried(trial.flights(cases), trial.StallFlyer(runs), bounds, trial.flight_lost, _say)
    _report("stall", seed, rows, len(cases), runs, json_out)


@app.command()
def logs(
    count: Annotated[int, typer.Option(min=1, help="Damaged logs.")] = 30_000,
    seed: SeedOption = 1,
    minutes: MinutesOption = None,
    jobs: JobsOption = 2,
    case: CaseOption = None,
    json_out: JsonOption = None,
    runs: RunsOption = RUNS,
) -> None:
    """Damage logs of five formats, and give them to `companion replay`.

    Example: sim-bridge trials logs --count 200 --seed 3

    MCAP, CSV, ULog, dataflash and .tlog of a made flight are torn, flipped, zeroed, swapped,
    repeated, cut, and given wild numbers and lengths. What must hold: the log is replayed as far
    as it goes, or refused in one line that names the file; no other exception, nothing printed
    beside it, no more than 512 MB, no more than 20 s of CPU. A log that was not taken well stays in
    the folder of --runs.

    Exit code 0 where all hold, 1 where one does not, 2 for a mistake in the options. About a
    quarter of a second of CPU a log.
    """
    from sim_bridge.app.trials import logs as trial
    from sim_bridge.app.trials.trial import Bounds, in_time, read_case

    again = [read_case(path, trial.LogCase) for path in case or []]
    cases = again or [trial.drawn(seed, number) for number in range(count)]
    rows = trial.attempts(in_time(cases, Bounds(jobs, minutes)), runs / "damaged", jobs)
    _report("logs", seed, rows, len(cases), runs, json_out)


@app.command()
def soak(
    hours: Annotated[float, typer.Option(min=0.1, help="Simulated hours.")] = 12.0,
    every_minutes: Annotated[
        float, typer.Option(min=3.2, help="A flight so often; between them it stands by.")
    ] = 10.0,
    seed: SeedOption = 1,
    case: CaseOption = None,
    json_out: JsonOption = None,
    runs: RunsOption = RUNS,
) -> None:
    """Let one companion process stand by and fly for half a day.

    Example: sim-bridge trials soak --hours 1 --every-minutes 5 --json soak.json

    A `companion run --fleet` process is assigned and launched over zenoh, PX4 and ArduPilot by
    turns, a fresh pack for each flight. What must hold after two flights to warm up: at most 250 MB
    of memory; from 2 hours on it grows by less than 2 MB/h (before, by less than 10 MB in all); no
    more files and threads at standby; less than 100 MB of disk for each hour assigned; every flight
    ends at standby; no exception.

    Exit code 0 where all holds, 1 where not, 2 for a mistake in the options. About four minutes of
    CPU a simulated hour.
    """
    from sim_bridge.app.trials import soak as trial
    from sim_bridge.app.trials.trial import Bounds, case_lost, read_case, tried

    again = [read_case(path, trial.SoakCase) for path in case or []]
    cases = again or [trial.SoakCase(seed=seed, hours=hours, every_minutes=every_minutes)]
    rows = tried(cases, trial.SoakRunner(runs), Bounds(jobs=1, minutes=None), case_lost)
    _report("soak", seed, rows, len(cases), runs, json_out)


@app.command()
def days(
    vehicle_hours: Annotated[
        float | None,
        typer.Option(min=0.01, help="Until vehicles were switched on for so many hours in all."),
    ] = None,
    count: Annotated[int | None, typer.Option(min=1, help="So many days at most.")] = None,
    store: Annotated[
        str, typer.Option(help="sqlite, postgresql (a server of each day's own), or both by turns.")
    ] = "sqlite",
    truck: Annotated[
        bool | None,
        typer.Option("--truck/--depot", help="Only days with a truck, or without; default: both."),
    ] = None,
    all_faults: Annotated[
        bool,
        typer.Option(
            "--all-faults", help="Each day with every kill, and its network cut for a minute."
        ),
    ] = False,
    most_drones: Annotated[int, typer.Option(min=1, max=6, help="Of a day, at most.")] = 6,
    most_orders: Annotated[
        int, typer.Option(min=1, help="Of a day for each of its drones, at most.")
    ] = 4,
    seed: SeedOption = 1,
    minutes: MinutesOption = None,
    jobs: JobsOption = 2,
    cluster: ClusterOption = None,
    case: CaseOption = None,
    json_out: JsonOption = None,
    runs: RunsOption = RUNS,
) -> None:
    """Fly whole days: desk, store, truck or depot, drones, network, under drawn faults.

    Example: sim-bridge trials days --count 10 --store both --all-faults --most-drones 3

    Each day is one of `sim-bridge day`, in one process on one clock: a shipped site, one to six
    drones on a truck or at a depot, some of its orders, a forecast, packs; and drawn with them a
    loss of messages, cuts of the network and of one member, companions and desk killed, the store
    away (PostgreSQL killed, SQLite locked), a late truck, a front, a person who takes a drone over.
    What must hold: the day ends; no vehicle is lost, no order lost or brought twice; the store
    equals the truth; the truck keeps its promises; no two come near; nothing is commanded after
    hands off; energy left never rises in flight; neither desk nor companion ends by itself; no
    exception.

    Without a bound: until Ctrl-C. Exit code 0 where all hold, 1 where one does not, 2 for a mistake
    in the options. About one minute of CPU a vehicle-hour.
    """
    from itertools import islice

    from sim_bridge.adapters.postgres_server import PostgresPrograms
    from sim_bridge.app.trials import days as trial
    from sim_bridge.app.trials.day_case import POSTGRESQL, STORES, DayCase
    from sim_bridge.app.trials.trial import Bounds, case_lost, read_case, tried

    if store not in (*STORES, "both"):
        raise LeewayError(f"--store {store}: expected {', '.join(STORES)} or both")
    stores = STORES if store == "both" else (store,)
    again = [read_case(path, DayCase) for path in case or []]
    if POSTGRESQL in (*stores, *(one.store for one in again)):
        PostgresPrograms.find()  # before the first day, not in it
    draw = trial.DayDraw(seed, stores, truck, all_faults, most_drones, most_orders)
    cases = again or islice(draw.cases(), count)
    rows = tried(cases, trial.DayFlyer(runs), Bounds(jobs, minutes, cluster), case_lost, _say)
    total = len(again) or count
    _report("days", seed, trial.until_hours(rows, vehicle_hours), total, runs, json_out)


def _say(words: str) -> None:
    typer.echo(words, err=True)


def _report(
    trial: str,
    seed: int,
    rows: "Iterable[TrialRow]",
    total: int | None,
    runs: Path,
    json_out: Path | None,
) -> None:
    """Follow a trial to its end; exit code 1 where something did not hold."""
    from sim_bridge.app.trials.report import TrialReport

    done = TrialReport(trial, seed, runs, json_out).follow(rows, total)
    if not all(row.held for row in done):
        raise typer.Exit(1)
