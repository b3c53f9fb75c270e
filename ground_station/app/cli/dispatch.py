"""`ground-station dispatch | watch | recall | report`: the running day."""

import json
import secrets
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console, RenderableType
from rich.live import Live
from rich.table import Table

from companion.core.base.errors import LeewayError
from companion.fleet.messages import Answered, Recall
from ground_station.adapters.direct_line import return_to_launch
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.plan_files import read_day_plan
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet, epoch_us, monotonic_s
from ground_station.app.cli.options import DEFAULT_STORE, FleetName, StoreUrl, ZenohFile, open_store
from ground_station.app.cli.order import list_impossible, take_orders
from ground_station.app.cli.stopping import stop_signals
from ground_station.app.desk.desk import Desk, DeskOptions
from ground_station.app.desk.open_desk import is_done, is_idle, left_over, open_desk, why_left
from ground_station.app.views.day_report import report_of, report_view
from ground_station.app.views.watch_view import day_shown, watch_view
from ground_station.core.fleet.truck_state import TRUCK

TURN_S = 0.2
LEAST_SILENT_S = 5.0
NOT_RECALLED = 3
ORDERS_LEFT = 3

app = typer.Typer()


@app.command()
def dispatch(
    day: Annotated[Path, typer.Argument(help="The day, a day/1 TOML file.")],
    store: StoreUrl = DEFAULT_STORE,
    zenoh: ZenohFile = None,
    plan: Annotated[
        Path | None,
        typer.Option(
            help="A day-plan/1 JSON file (ground-station plan): drones from a truck; default: from"
            " the depot, nearest feasible first."
        ),
    ] = None,
    assign: Annotated[bool, typer.Option(help="Give open orders to free drones.")] = True,
    launch: Annotated[bool, typer.Option(help="Authorise what is aboard and ready.")] = True,
    launch_gap: Annotated[
        float, typer.Option(min=0.0, help="Seconds between two launches at the depot.")
    ] = 20.0,
    until_done: Annotated[
        bool,
        typer.Option(
            "--until-done", help="End when nothing is left to do; exit code 3: orders are left."
        ),
    ] = False,
    idle: Annotated[
        float,
        typer.Option(min=1.0, help="With --until-done: end, too, when nothing moved for so long."),
    ] = 300.0,
) -> None:
    """Run the day: watch the fleet, assign, launch, keep everything. Ctrl-C stops the desk only:
    what flies flies on, and the same command carries on where it was.

    ground-station dispatch params/days/town.toml --plan plan.json --store sqlite:///desk.db
    """
    data = read_day(day)
    chosen = None if plan is None else read_day_plan(plan)
    opened = open_store(store)
    try:
        take_orders(opened, data.orders)
        impossible = frozenset(list_impossible(data)) if chosen is None else frozenset()
        options = DeskOptions(assigns=assign, launches=launch, launch_gap_s=launch_gap)
        fleet = ZenohFleet(data.day.fleet, zenoh)
        try:
            desk = open_desk(data, chosen, opened, fleet, _say, options)
            typer.echo(f"dispatching {data.day.name} for fleet {data.day.fleet}; Ctrl-C stops")
            through = _run(desk, impossible, idle if until_done else None)
        finally:
            fleet.close()
        if through:
            _end(desk)
    finally:
        opened.close()


def _run(desk: Desk, impossible: frozenset[str], idle_s: float | None) -> bool:
    """Turn until stopped, or (`idle_s` given) through; whether it was."""
    desk.begin()
    try:
        with stop_signals() as stopped:
            while not stopped:
                if idle_s is not None and (is_done(desk, impossible) or is_idle(desk, idle_s)):
                    return True
                desk.turn(TURN_S)
    finally:
        if desk.day is not None:
            desk.day.close()
    return False


def _end(desk: Desk) -> None:
    """Say what is left, and end by it."""
    left = left_over(desk)
    if not left:
        typer.echo("every order is delivered or cancelled")
        return
    table = Table("order", "state", "why", title="left")
    for row in left:
        table.add_row(row.order.id, row.state.value, why_left(desk, row))
    Console().print(table)
    raise typer.Exit(ORDERS_LEFT)


@app.command()
def watch(
    fleet: FleetName,
    store: StoreUrl = DEFAULT_STORE,
    zenoh: ZenohFile = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Watch so long, then print once and end.")
    ] = None,
) -> None:
    """See the fleet live: phase, margin, P(home), what each brings; commands nothing.

    ground-station watch --fleet harbour --store sqlite:///desk.db
    """
    opened = open_store(store)
    ears = ZenohFleet(fleet, zenoh)
    desk = Desk(opened, ears, lambda words: None, DeskOptions(assigns=False))
    desk.begin()
    console, day = Console(), DayStore(opened.database, epoch_us)

    def view() -> RenderableType:
        rows = opened.assignments(in_force=True)
        shown = day_shown(day, epoch_us())
        return watch_view(desk.picture, rows, opened.orders(), monotonic_s(), shown)

    try:
        with stop_signals() as stopped:
            until_s = None if seconds is None else monotonic_s() + seconds
            with Live(view(), console=console, auto_refresh=False, transient=True) as live:
                while not stopped and (until_s is None or monotonic_s() < until_s):
                    desk.listen(TURN_S)
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
    wait: Annotated[
        float, typer.Option(min=1.0, help="Seconds in which an answer is waited for.")
    ] = 10.0,
    direct: Annotated[
        str | None,
        typer.Option(
            help="Where its autopilot is, for MAVSDK (udpin://0.0.0.0:14550): used only when the"
            " companion has been silent for --silent-for."
        ),
    ] = None,
    silent_for: Annotated[
        float, typer.Option(min=LEAST_SILENT_S, help="Seconds of silence that allow --direct.")
    ] = 15.0,
) -> None:
    """Bring a vehicle home by its companion, by the way home that its gate finds safe; exit code 3
    where one did not answer.

    ground-station recall d1 --fleet harbour
    """
    if (vehicle is None) != everybody:
        raise LeewayError("recall: expected a vehicle, or --all")
    if direct is not None and vehicle is None:
        raise LeewayError("--direct: expected one vehicle, not --all")
    opened = open_store(store)
    ears = ZenohFleet(fleet, zenoh)
    desk = Desk(opened, ears, _say, DeskOptions(assigns=False, launches=False))
    desk.begin()
    try:
        missing = _recall(desk, opened, vehicle, wait)
        if direct is not None and vehicle in missing:
            missing -= _past_the_companion(desk, vehicle or "", direct, silent_for)
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
        Path | None, typer.Option("--json", help="Write the figures there.")
    ] = None,
) -> None:
    """The day in numbers: orders, flights, promises and what became of them.

    ground-station report --store sqlite:///desk.db
    """
    opened = open_store(store)
    figures = report_of(opened, DayStore(opened.database, epoch_us))
    opened.close()
    Console().print(report_view(figures))
    if json_file is not None:
        json_file.write_text(json.dumps(figures, indent=1))


def _recall(desk: Desk, store: Store, vehicle: str | None, wait_s: float) -> set[str]:
    """Recall over zenoh; the names of those that did not take it."""
    heard_until_s = monotonic_s() + min(wait_s, 2.0)
    while monotonic_s() < heard_until_s and (vehicle is None or not _here(desk, vehicle)):
        desk.listen(TURN_S)
    names = {vehicle} if vehicle else {name for name in desk.picture.vehicles if _here(desk, name)}
    if not names:
        typer.echo("no vehicle is heard")
    asked = {f"recall-{name}-{secrets.token_hex(6)}": name for name in names if name}
    for id_, name in asked.items():
        store.command(id_, name, Recall(), "operator")
    until_s = monotonic_s() + wait_s
    waiting = dict(asked)
    while waiting and monotonic_s() < until_s:
        desk.listen(TURN_S)
        desk.send_outbox(only=set(waiting))
        pending = {row.id for row in store.outbox()}
        waiting = {id_: name for id_, name in waiting.items() if id_ in pending}
    for id_ in waiting:
        store.give_up(id_, "not answered in time")  # a recall must not come as a surprise later
    answers = store.answers(list(asked))
    return {name for id_, name in asked.items() if answers.get(id_) is not Answered.DONE}


def _here(desk: Desk, vehicle: str) -> bool:
    seen = desk.picture.of(vehicle)
    return seen.state is not None and bool(seen.lives) and vehicle != TRUCK


def _past_the_companion(desk: Desk, vehicle: str, url: str, silent_for_s: float) -> set[str]:
    """Return to launch by MAVSDK, once the companion has said nothing for the stated time."""
    typer.echo(f"{vehicle}: listening {silent_for_s:.0f} s for its companion first")
    begin_s = monotonic_s()
    while monotonic_s() - begin_s < silent_for_s:
        desk.listen(TURN_S)
        seen = desk.picture.of(vehicle)
        if seen.lives or (seen.heard_s is not None and seen.heard_s > begin_s):
            typer.echo(f"{vehicle}: its companion lives: recalled by it, or not at all")
            return set()
    done = return_to_launch(url)
    typer.echo(f"{vehicle}: autopilot {done.system} returns to launch, told past its companion")
    return {vehicle}


def _say(words: str) -> None:
    seconds = epoch_us() // 1_000_000 % 86_400
    stamp = f"{seconds // 3600:02d}:{seconds % 3600 // 60:02d}:{seconds % 60:02d}Z"
    typer.echo(f"{stamp} {words}")
