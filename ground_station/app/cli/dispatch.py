"""`ground-station dispatch | watch | recall | report`: the running day."""

import json
from collections.abc import Callable
from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.network import OPEN_MARK, OPEN_WORDS
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.app.cli.metrics import MetricsAddress, OpenMetrics, hold_port, serve_desk
from ground_station.app.cli.options import (
    DEFAULT_STORE,
    DayArgument,
    FleetName,
    IdentityFolder,
    OpenNetwork,
    StoreFile,
    StoreUrl,
    UserName,
    ZenohFile,
    open_at_once,
    open_day,
    open_fleet,
    open_store,
    open_when_there,
    url_of,
    who,
)
from ground_station.app.cli.order import assigner_of, list_impossible, take_orders
from ground_station.app.cli.stopping import stop_signals
from ground_station.app.views.times import time_of_day

if TYPE_CHECKING:
    from companion.fleet.messages import State
    from ground_station.adapters.zenoh_fleet import ZenohFleet
    from ground_station.adapters.zenoh_log import DoorLog
    from ground_station.app.desk.desk import Desk
    from ground_station.app.desk.desk_meter import DeskMeter
    from ground_station.app.views.certificate_reminder import CertificateReminder
    from ground_station.core.fleet.door_watch import DoorWatch
    from ground_station.core.fleet.station_message import StationWind

TURN_S = 0.2
PIPED_S = 10.0
LEAST_SILENT_S = 5.0
NOT_RECALLED = 3
NOT_HELD = 4
ORDERS_LEFT = 3

app = typer.Typer()


@app.command()
def dispatch(
    day: DayArgument,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    zenoh: ZenohFile = None,
    identity: IdentityFolder = None,
    open_network: OpenNetwork = False,
    plan: Annotated[
        Path | None,
        typer.Option(
            help="A day-plan/1 JSON file of `ground-station plan`: drones ride on a truck. Default:"
            " drones start from the depot, the nearest feasible order first."
        ),
    ] = None,
    assign: Annotated[bool, typer.Option(help="Give open orders to free drones.")] = True,
    launch: Annotated[bool, typer.Option(help="Authorise launches that are ready.")] = True,
    confirm_launch: Annotated[
        bool,
        typer.Option(
            "--confirm-launch/--auto-launch",
            help="Whether each launch from the depot waits for a named person (`ground-station"
            " order launch`). On a truck its driver says that a drone is placed.",
        ),
    ] = True,
    launch_gap: Annotated[
        float,
        typer.Option(
            min=0.0, help="Least time from a take-off at the depot to the next launch, s."
        ),
    ] = 20.0,
    until_done: Annotated[
        bool,
        typer.Option(
            "--until-done", help="End when nothing is left to do. Exit code 3: orders are left."
        ),
    ] = False,
    idle: Annotated[
        float,
        typer.Option(min=1.0, help="With --until-done: end also after so long without news, s."),
    ] = 300.0,
    metrics: MetricsAddress = None,
    open_metrics: OpenMetrics = False,
) -> None:
    """Run the day: watch the fleet, assign, launch, keep everything.

    Ctrl-C stops the desk only: what flies goes on, and the same command carries on.

    ground-station plan town --out plan.json
    ground-station dispatch town --plan plan.json --store sqlite:///desk.db
    """
    from ground_station.adapters.files.plan_files import read_day_plan
    from ground_station.app.desk.depot_dispatcher import DepotParams
    from ground_station.app.desk.open_desk import open_depot_desk, open_truck_desk
    from ground_station.app.views.certificate_reminder import CertificateReminder
    from ground_station.core.people.person import desk_of

    data = open_day(day, follows=True)
    person = who(user, identity, data.day.fleet)
    chosen = None if plan is None else read_day_plan(plan)
    open_desk_store = partial(open_store, store, store_file, create=True, goes_on=True)
    with (
        hold_port(metrics, open_metrics) as server,
        closing(open_when_there(open_desk_store, _say, Event().wait)) as opened,
    ):
        take_orders(opened, data.orders, person.name)
        assigner = assigner_of(data)
        impossible = list_impossible(data, assigner) if chosen is None else []
        by = desk_of(person)
        params = DepotParams(by, assign, launch, launch_gap, confirm_launch)
        say = _say_open if open_network else _say
        log = None if identity is None else _door_log()
        neighbours = data.day.neighbours
        network = open_fleet(data.day.fleet, zenoh, identity, open_network, log, say, neighbours)
        with closing(network) as fleet:
            if chosen is None:
                cannot = frozenset(impossible)
                desk = open_depot_desk(data, opened, fleet, say, params, cannot, None, assigner)
            elif assign and launch:
                desk = open_truck_desk(data, chosen, opened, fleet, say, by=by)
            else:
                raise LeewayError(
                    "a day with a truck is run whole: expected no --no-assign, no --no-launch"
                )
            typer.echo(f"dispatching {data.day.name} for fleet {data.day.fleet}; Ctrl-C stops")
            if open_network:
                typer.echo(OPEN_WORDS)
            meter = None if server is None else serve_desk(server, desk, fleet)
            reminder = CertificateReminder(network, say, epoch_us)
            door = _door_watch(fleet, say)
            through = _run(desk, idle if until_done else None, meter, reminder, door)
        if through:
            _end(desk)


def _door_log() -> "DoorLog | None":
    from ground_station.adapters.zenoh_log import read_zenoh_log

    return read_zenoh_log()


def _door_watch(fleet: "ZenohFleet", say: Callable[[str], None]) -> "DoorWatch | None":
    """Says who calls and should not; None: without an identity nobody has a name at the door."""
    from ground_station.core.fleet.door_watch import DoorWatch

    return None if fleet.door is None else DoorWatch(fleet.door.figures, fleet.door.roster, say)


def _run(
    desk: "Desk",
    idle_s: float | None,
    meter: "DeskMeter | None",
    reminder: "CertificateReminder",
    door: "DoorWatch | None",
) -> bool:
    """Turn until stopped, or (with `idle_s`) until the day is done; whether it was."""
    from companion.fleet.service_manager import Watchdog

    desk.begin()
    watchdog = Watchdog()
    try:
        with stop_signals() as stopped:
            while not stopped:
                watchdog.turn(monotonic_s())
                reminder.turn(monotonic_s())
                if meter is not None:
                    meter.turn()
                if door is not None:
                    door.turn(monotonic_s(), epoch_us())
                if idle_s is not None and (desk.is_done or desk.is_idle(idle_s)):
                    return True
                desk.turn(TURN_S)
    finally:
        desk.close()
    return False


def _end(desk: "Desk") -> None:
    """Say what is left over; that decides the exit code."""
    from ground_station.app.views.terminal import listing, terminal

    left = desk.left_over()
    if not left:
        typer.echo("every order is delivered or cancelled")
        return
    table = listing("order", "state", "why", title="left over")
    for row in left:
        table.add_row(row.order.id, row.state.value, desk.why_left(row))
    terminal().print(table)
    raise typer.Exit(ORDERS_LEFT)


@app.command()
def watch(
    fleet: FleetName,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    zenoh: ZenohFile = None,
    identity: IdentityFolder = None,
    open_network: OpenNetwork = False,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Watch for so long, then end.")
    ] = None,
) -> None:
    """Watch the fleet live: phase, margin, P(home), orders. It commands nothing.

    Into a pipe or file it prints at once, every 10 s, and at its end.

    ground-station watch --fleet harbour --store sqlite:///desk.db
    """
    from rich.console import RenderableType
    from rich.live import Live

    from ground_station.adapters.files.day_wind import site_wind_of
    from ground_station.adapters.store.day_store import DayStore
    from ground_station.app.desk.exchange import Exchange
    from ground_station.app.desk.recall import SAY_S
    from ground_station.app.views.attention import CERTIFICATES, ending_certificates
    from ground_station.app.views.terminal import terminal
    from ground_station.app.views.watch_view import watch_view
    from ground_station.app.views.watched_rows import WatchRows, read_rows
    from ground_station.app.views.wind_notes import wind_notes
    from ground_station.core.site_wind.wind_stations import StationBook

    opened = open_store(store, store_file, goes_on=True)
    ears = open_fleet(fleet, zenoh, identity, open_network)
    exchange = Exchange(opened, ears, lambda words: None)
    wind = site_wind_of(None)
    stations = StationBook(wind)

    def hear(state: "State") -> None:
        wind.on_state(state, monotonic_s())

    def hear_station(told: "StationWind") -> None:
        stations.take(told, monotonic_s(), epoch_us())

    exchange.on_state = hear
    exchange.on_station = hear_station
    exchange.begin()
    console, day = terminal(), DayStore(opened.database, epoch_us)
    rows = WatchRows()

    def view() -> RenderableType:
        nonlocal rows
        with exchange.store_may_be_away():
            rows = read_rows(opened, day, epoch_us())
            exchange.store_is_back()
        notes = [OPEN_WORDS] if open_network else []
        notes += [] if exchange.status.vehicles else [f"nobody is heard in fleet {fleet}"]
        notes += [] if exchange.away is None else [f"STORE AWAY, rows are old: {exchange.away}"]
        ending = ending_certificates(ears.certificates(), epoch_us())
        notes += [f"LOOK: {CERTIFICATES}: {ending}"] if ending else []
        notes += wind_notes(wind, exchange.status, monotonic_s())
        notes += stations.notes(monotonic_s())
        return watch_view(exchange.status, rows, monotonic_s(), notes)

    try:
        with stop_signals() as stopped:
            until_s = None if seconds is None else monotonic_s() + seconds
            shown = Live(view(), console=console, auto_refresh=False, transient=True)
            next_s, joined_s = 0.0, monotonic_s()
            with shown if console.is_terminal else nullcontext():
                while not stopped and (until_s is None or monotonic_s() < until_s):
                    exchange.listen(TURN_S)
                    now_s = monotonic_s()
                    known = exchange.status.vehicles or now_s - joined_s > SAY_S
                    if console.is_terminal:
                        shown.update(view(), refresh=True)
                    elif known and now_s >= next_s:
                        next_s = now_s + PIPED_S
                        console.print(view())
        console.print(view())
    finally:
        ears.close()
        opened.close()


@app.command()
def recall(
    fleet: FleetName,
    vehicle: Annotated[str | None, typer.Argument(help="The vehicle, for example d1.")] = None,
    everybody: Annotated[bool, typer.Option("--all", help="Every vehicle that is heard.")] = False,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    zenoh: ZenohFile = None,
    identity: IdentityFolder = None,
    open_network: OpenNetwork = False,
    wait: Annotated[float, typer.Option(min=1.0, help="Time-out of an answer, s.")] = 10.0,
    direct: Annotated[
        str | None,
        typer.Option(
            help="Address of its autopilot for MAVSDK (udpin://0.0.0.0:14550). Used only when the"
            " companion has been silent for --silent-for."
        ),
    ] = None,
    silent_for: Annotated[
        float, typer.Option(min=LEAST_SILENT_S, help="Silence that allows --direct, s.")
    ] = 15.0,
) -> None:
    """Recall a vehicle through its companion, which chooses the safe way home, and hold it.

    It is not launched again before `ground-station release`. Exit code 3: at least one has not
    answered. 4: all have, but the store could not be reached: nobody is held.

    ground-station recall d1 --fleet harbour
    """
    if (vehicle is None) != everybody:
        raise LeewayError("recall: expected a vehicle, or --all")
    if direct is not None and vehicle is None:
        raise LeewayError("--direct: expected one vehicle, not --all")

    from ground_station.app.desk.person_deeds import recall as recall_by
    from ground_station.app.desk.recall import Recaller, recall_past_companion
    from ground_station.core.schema.holds import check_vehicle

    def past_companion(caller: Recaller, missing: set[str]) -> set[str]:
        if direct is None or vehicle is None or vehicle not in missing:
            return set()
        return recall_past_companion(caller, vehicle, direct, silent_for)

    if vehicle is not None:
        check_vehicle(vehicle)
    url, person = url_of(store, store_file), who(user, identity, fleet)
    ears = open_fleet(fleet, zenoh, identity, open_network)
    with closing(ears):
        done = recall_by(
            ears,
            partial(open_at_once, url),
            vehicle,
            person.name,
            _say,
            _look,
            wait,
            past_companion,
        )
    if done.missing or done.nobody:
        raise typer.Exit(NOT_RECALLED)
    if not done.held:
        raise typer.Exit(NOT_HELD)


@app.command()
def report(
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the figures into this file.")
    ] = None,
) -> None:
    """The day in figures: orders, flights, promises and their outcomes.

    ground-station report --store sqlite:///desk.db
    """
    from ground_station.adapters.store.day_store import DayStore
    from ground_station.app.views.day_report import report_of, report_view
    from ground_station.app.views.terminal import terminal

    opened = open_store(store, store_file)
    figures = report_of(opened, DayStore(opened.database, epoch_us))
    opened.close()
    terminal().print(report_view(figures))
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1))


def _look(words: str) -> None:
    typer.echo(words, err=True)


def _say_open(words: str) -> None:
    _say(f"{OPEN_MARK} {words}")


def _say(words: str) -> None:
    typer.echo(f"{time_of_day(epoch_us())} {words}")
