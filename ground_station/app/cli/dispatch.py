"""`ground-station dispatch | watch | recall | report`: the running day."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.app.cli.options import (
    DEFAULT_STORE,
    DayArgument,
    FleetName,
    StoreUrl,
    ZenohFile,
    open_day,
    open_store,
)
from ground_station.app.cli.order import list_impossible, take_orders
from ground_station.app.cli.stopping import stop_signals

if TYPE_CHECKING:
    from ground_station.app.desk.desk import Desk

TURN_S = 0.2
LEAST_SILENT_S = 5.0
NOT_RECALLED = 3
ORDERS_LEFT = 3

app = typer.Typer()


@app.command()
def dispatch(
    day: DayArgument,
    store: StoreUrl = DEFAULT_STORE,
    zenoh: ZenohFile = None,
    plan: Annotated[
        Path | None,
        typer.Option(
            help="A day-plan/1 JSON file of `ground-station plan`: drones ride on a truck. Default:"
            " drones start from the depot, the nearest feasible order first."
        ),
    ] = None,
    assign: Annotated[bool, typer.Option(help="Give open orders to free drones.")] = True,
    launch: Annotated[bool, typer.Option(help="Authorise launches that are ready.")] = True,
    launch_gap: Annotated[
        float, typer.Option(min=0.0, help="Least time between two launches at the depot, s.")
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
) -> None:
    """Run the day: watch the fleet, assign, launch, keep everything.

    Ctrl-C stops the desk only: what flies goes on, and the same command carries on.

    ground-station plan town --out plan.json
    ground-station dispatch town --plan plan.json --store sqlite:///desk.db
    """
    from ground_station.adapters.files.plan_files import read_day_plan
    from ground_station.adapters.zenoh_fleet import ZenohFleet
    from ground_station.app.desk.depot_dispatcher import DepotParams
    from ground_station.app.desk.open_desk import open_depot_desk, open_truck_desk

    data = open_day(day)
    chosen = None if plan is None else read_day_plan(plan)
    opened = open_store(store)
    try:
        take_orders(opened, data.orders)
        impossible = frozenset(list_impossible(data)) if chosen is None else frozenset()
        params = DepotParams(assigns=assign, launches=launch, launch_gap_s=launch_gap)
        fleet = ZenohFleet(data.day.fleet, zenoh)
        try:
            if chosen is None:
                desk = open_depot_desk(data, opened, fleet, _say, params, impossible)
            elif assign and launch:
                desk = open_truck_desk(data, chosen, opened, fleet, _say)
            else:
                raise LeewayError(
                    "a day with a truck is run whole: expected no --no-assign, no --no-launch"
                )
            typer.echo(f"dispatching {data.day.name} for fleet {data.day.fleet}; Ctrl-C stops")
            through = _run(desk, idle if until_done else None)
        finally:
            fleet.close()
        if through:
            _end(desk)
    finally:
        opened.close()


def _run(desk: "Desk", idle_s: float | None) -> bool:
    """Turn until stopped, or (with `idle_s`) until the day is done; whether it was."""
    from companion.fleet.service_manager import Watchdog

    desk.begin()
    watchdog = Watchdog()
    try:
        with stop_signals() as stopped:
            while not stopped:
                watchdog.turn(monotonic_s())
                if idle_s is not None and (desk.is_done or desk.is_idle(idle_s)):
                    return True
                desk.turn(TURN_S)
    finally:
        desk.close()
    return False


def _end(desk: "Desk") -> None:
    """Say what is left over; that decides the exit code."""
    from rich.table import Table

    from ground_station.app.views.terminal import terminal

    left = desk.left_over()
    if not left:
        typer.echo("every order is delivered or cancelled")
        return
    table = Table("order", "state", "why", title="left over")
    for row in left:
        table.add_row(row.order.id, row.state.value, desk.why_left(row))
    terminal().print(table)
    raise typer.Exit(ORDERS_LEFT)


@app.command()
def watch(
    fleet: FleetName,
    store: StoreUrl = DEFAULT_STORE,
    zenoh: ZenohFile = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Watch for so long, print once, end.")
    ] = None,
) -> None:
    """Watch the fleet live: phase, margin, P(home), orders. It commands nothing.

    ground-station watch --fleet harbour --store sqlite:///desk.db
    """
    from rich.console import RenderableType
    from rich.live import Live

    from ground_station.adapters.store.day_store import DayStore
    from ground_station.adapters.zenoh_fleet import ZenohFleet
    from ground_station.app.desk.exchange import Exchange
    from ground_station.app.views.terminal import terminal
    from ground_station.app.views.watch_view import day_shown, watch_view

    opened = open_store(store)
    ears = ZenohFleet(fleet, zenoh)
    exchange = Exchange(opened, ears, lambda words: None)
    exchange.begin()
    console, day = terminal(), DayStore(opened.database, epoch_us)

    def view() -> RenderableType:
        rows = opened.assignments(in_force=True)
        shown = day_shown(day, epoch_us())
        return watch_view(exchange.status, rows, opened.orders(), monotonic_s(), shown)

    try:
        with stop_signals() as stopped:
            until_s = None if seconds is None else monotonic_s() + seconds
            with Live(view(), console=console, auto_refresh=False, transient=True) as live:
                while not stopped and (until_s is None or monotonic_s() < until_s):
                    exchange.listen(TURN_S)
                    live.update(view(), refresh=console.is_terminal)
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
    zenoh: ZenohFile = None,
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
    """Recall a vehicle through its companion, which chooses the safe way home.

    Exit code 3: at least one has not answered.

    ground-station recall d1 --fleet harbour
    """
    if (vehicle is None) != everybody:
        raise LeewayError("recall: expected a vehicle, or --all")
    if direct is not None and vehicle is None:
        raise LeewayError("--direct: expected one vehicle, not --all")

    from ground_station.adapters.zenoh_fleet import ZenohFleet
    from ground_station.app.desk.exchange import Exchange
    from ground_station.app.desk.recall import NobodyHeardError, recall_past_companion
    from ground_station.app.desk.recall import recall as recall_fleet

    opened = open_store(store)
    ears = ZenohFleet(fleet, zenoh)
    exchange = Exchange(opened, ears, _say)
    exchange.begin()
    try:
        missing = recall_fleet(exchange, vehicle, wait)
        if direct is not None and vehicle in missing:
            missing -= recall_past_companion(exchange, vehicle, direct, silent_for)
    except NobodyHeardError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(NOT_RECALLED) from None
    finally:
        ears.close()
        opened.close()
    if missing:
        typer.echo(f"not recalled: {', '.join(sorted(missing))}", err=True)
        raise typer.Exit(NOT_RECALLED)


@app.command()
def report(
    store: StoreUrl = DEFAULT_STORE,
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

    opened = open_store(store)
    figures = report_of(opened, DayStore(opened.database, epoch_us))
    opened.close()
    terminal().print(report_view(figures))
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1))


def _say(words: str) -> None:
    seconds = epoch_us() // 1_000_000 % 86_400
    stamp = f"{seconds // 3600:02d}:{seconds % 3600 // 60:02d}:{seconds % 60:02d}Z"
    typer.echo(f"{stamp} {words}")
