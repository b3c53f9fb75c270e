"""`ground-station dispatch | watch | recall | report`: operation of a day."""

import json
from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.network import OPEN_MARK, OPEN_WARNING
from companion.fleet.service_manager import record_stop_signals
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.app.cli.orders.order import (
    add_orders_and_print_count,
    depot_assigner,
    print_infeasible_orders,
)
from ground_station.app.options.desk_options import (
    DayArgument,
    StrictImport,
    desk_options,
    echo_with_time_of_day,
    open_store_when_reachable,
    open_store_with_short_timeout,
    read_day_and_warn,
)
from ground_station.app.options.program_options import command_class_with_options

if TYPE_CHECKING:
    from companion.fleet.messages import State
    from ground_station.app.desk.desk import Desk
    from ground_station.app.views.certificate_reminder import CertificateReminder
    from ground_station.core.fleet.station_message import StationWind

LOOP_INTERVAL_S = 0.2
PIPED_PRINT_INTERVAL_S = 10.0
MIN_SILENCE_S = 5.0
EXIT_RECALL_FAILED = 3
EXIT_HOLD_FAILED = 4
EXIT_ORDERS_REMAINING = 3

app = typer.Typer()


@app.command(
    cls=command_class_with_options(
        "store", "store_file", "user", "zenoh", "identity", "open_network"
    )
)
def dispatch(
    day: DayArgument,
    plan: Annotated[
        Path | None,
        typer.Option(
            help="A day-plan/1 JSON file of `ground-station plan`: drones ride on a truck. Default:"
            " drones start from the depot, the nearest feasible order first."
        ),
    ] = None,
    assign: Annotated[bool, typer.Option(help="Give open orders to free drones.")] = True,
    launch: Annotated[
        bool, typer.Option(help="Authorise ready launches; --no-launch: an operator authorises.")
    ] = True,
    confirm_launch: Annotated[
        bool,
        typer.Option(
            "--confirm-launch/--auto-launch",
            help="confirm: each launch from the depot waits for `ground-station order launch`;"
            " auto: none does. On a truck the driver confirms that a drone is placed.",
        ),
    ] = True,
    launch_gap: Annotated[
        float, typer.Option(min=0.0, help="Minimum interval between launches at the depot, s.")
    ] = 20.0,
    until_done: Annotated[
        bool,
        typer.Option(
            "--until-done", help="End when all orders are closed. Exit code 3: orders remain."
        ),
    ] = False,
    idle: Annotated[
        float,
        typer.Option(
            min=1.0, help="With --until-done: also end after this time without change, s."
        ),
    ] = 300.0,
    new_day: Annotated[
        bool,
        typer.Option(
            "--new-day", help="Begin today in the store; open orders of its last day go over to it."
        ),
    ] = False,
    strict: StrictImport = False,
) -> None:
    """Run a day: monitor the fleet, assign orders, authorise launches.

    Adds the day's orders to the store, then dispatches the store's orders. Ctrl-C stops the desk
    only; flights continue. Run the same command to resume.

    ground-station plan town --out plan.json
    ground-station dispatch town --plan plan.json --store sqlite:///desk.db
    """
    from msgspec import UNSET
    from msgspec.structs import replace

    from ground_station.adapters.files.day_files import read_day_plan
    from ground_station.app.desk.depot_dispatcher import DepotParams
    from ground_station.app.desk.open_desk import open_depot_desk, open_truck_desk
    from ground_station.app.desk.operator_commands import (
        begin_or_continue_day,
        data_with_stored_spares,
    )
    from ground_station.app.views.certificate_reminder import CertificateReminder
    from ground_station.core.people.person import desk_signing_name

    data = read_day_and_warn(day, keep_forecast=True, strict=strict)
    options = desk_options()
    operator = options.current_operator(data.day.fleet)
    day_plan = None if plan is None else replace(read_day_plan(plan), imports=UNSET)
    open_desk_store = partial(options.open_store, create=True, tolerate_outage=True)
    with closing(
        open_store_when_reachable(open_desk_store, echo_with_time_of_day, Event().wait)
    ) as order_store:
        if text := begin_or_continue_day(order_store, operator.name, new_day=new_day):
            typer.echo(text)
        add_orders_and_print_count(order_store, data.orders, operator.name)
        by = desk_signing_name(operator)
        params = DepotParams(by, assign, launch, launch_gap, confirm_launch)
        log_line = (
            _log_line_with_open_network_mark if options.open_network else echo_with_time_of_day
        )
        network = options.open_fleet_network(data.day.fleet, log_line, data.day.neighbours)

        def open_desk() -> "Desk":
            with_spares = data_with_stored_spares(data, order_store)
            if day_plan is not None:
                return open_truck_desk(
                    with_spares, day_plan, order_store, network, log_line, issuer=by
                )
            assigner = depot_assigner(with_spares)
            infeasible = frozenset(print_infeasible_orders(with_spares, assigner))
            return open_depot_desk(
                with_spares, order_store, network, log_line, params, infeasible, None, assigner
            )

        if day_plan is not None and not (assign and launch):
            raise LeewayError("--plan cannot be combined with --no-assign or --no-launch")
        with closing(network):
            reminder = CertificateReminder(network, log_line, epoch_us)
            while True:
                desk = open_desk()
                typer.echo(f"dispatching {data.day.name} for fleet {data.day.fleet}; Ctrl-C stops")
                desk.check_authority_by(network.trust)
                if options.open_network:
                    typer.echo(OPEN_WARNING)
                max_idle_s = idle if until_done else None
                completed = _run_desk_until_signal_or_done(desk, max_idle_s, reminder)
                if not desk.has_new_spare:
                    break
        if completed:
            _print_remaining_orders_and_exit_if_any(desk)


def _run_desk_until_signal_or_done(
    desk: "Desk",
    max_idle_s: float | None,
    reminder: "CertificateReminder",
) -> bool:
    """Run the desk until a signal or a new spare, or with `max_idle_s` until the day is done
    (returns True).
    """
    from companion.fleet.service_manager import Watchdog

    desk.start_dispatching()
    watchdog = Watchdog()
    try:
        with record_stop_signals() as received_signals:
            while not (received_signals or desk.has_new_spare):
                watchdog.notify_systemd_if_due(monotonic_s())
                reminder.log_expiring_certificates_if_due(monotonic_s())
                if max_idle_s is not None and (
                    desk.is_done or desk.has_been_idle_longer_than(max_idle_s)
                ):
                    return True
                desk.run_cycle(LOOP_INTERVAL_S)
    finally:
        desk.close()
    return False


def _print_remaining_orders_and_exit_if_any(desk: "Desk") -> None:
    """Print the orders that remain; exit with EXIT_ORDERS_REMAINING if there are any."""
    from ground_station.app.views.terminal import plain_console, plain_table

    remaining = desk.undelivered_orders()
    if not remaining:
        typer.echo("every order is closed")
        return
    table = plain_table("order", "state", "reason", title="not delivered")
    for row in remaining:
        table.add_row(row.order.id, row.state.value, desk.undelivered_reason(row))
    plain_console().print(table)
    raise typer.Exit(EXIT_ORDERS_REMAINING)


@app.command(
    cls=command_class_with_options(
        "fleet", "store", "store_file", "zenoh", "identity", "open_network"
    )
)
def watch(
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Duration, s. Default: until Ctrl-C.")
    ] = None,
) -> None:
    """Monitor the fleet: phase, margin, P(home), orders. Read-only.

    In a pipe or file it prints immediately, every 10 s, and at the end.

    ground-station watch --fleet harbour --store sqlite:///desk.db
    """
    from rich.console import RenderableType
    from rich.live import Live

    from ground_station.adapters.files.day_wind import create_site_wind
    from ground_station.adapters.store.day_store import DayStore
    from ground_station.app.desk.exchange import FleetExchange
    from ground_station.app.desk.recall import SILENCE_REPORT_DELAY_S
    from ground_station.app.views.day_content import DisplayRows, read_display_rows
    from ground_station.app.views.operator_alerts import (
        CERTIFICATES_SUBJECT,
        expiring_certificates_text,
    )
    from ground_station.app.views.terminal import plain_console
    from ground_station.app.views.watch_view import watch_view
    from ground_station.app.views.wind_notes import wind_field_and_front_lines
    from ground_station.core.site_wind.wind_stations import StationRegistry

    options = desk_options()
    fleet = options.require_fleet_name()
    order_store = options.open_store(tolerate_outage=True)
    network = options.open_fleet_network(fleet)
    exchange = FleetExchange(order_store, network, lambda message: None)
    wind = create_site_wind(None)
    stations = StationRegistry(wind)

    def on_state_message(state: "State") -> None:
        wind.update_from_state(state, monotonic_s())

    def on_station_message(station_wind: "StationWind") -> None:
        stations.record_station_message(station_wind, monotonic_s(), epoch_us())

    exchange.status.trust = network.trust
    exchange.on_state = on_state_message
    exchange.on_station = on_station_message
    exchange.request_initial_states()
    console, day = plain_console(), DayStore(order_store.database, epoch_us)
    rows = DisplayRows()

    def render() -> RenderableType:
        nonlocal rows
        with exchange.suppress_and_record_store_outage():
            rows = read_display_rows(order_store, day, epoch_us())
            exchange.clear_store_outage()
        notes = [OPEN_WARNING] if options.open_network else []
        notes += [] if exchange.status.vehicles else [f"no member connected in fleet {fleet}"]
        notes += (
            []
            if exchange.store_error is None
            else [f"store unreachable, rows are old: {exchange.store_error}"]
        )
        alarm = exchange.status.roster_alarm
        silence = exchange.status.desks.alarm_text(monotonic_s())
        notes += [f"WARNING: {text}" for text in (alarm, silence) if text]
        ending = expiring_certificates_text(network.certificate_expiry_dates(), epoch_us())
        notes += [f"WARNING: {CERTIFICATES_SUBJECT}: {ending}"] if ending else []
        notes += wind_field_and_front_lines(wind, exchange.status, monotonic_s())
        notes += stations.station_status_lines(monotonic_s())
        return watch_view(exchange.status, rows, monotonic_s(), notes)

    try:
        with record_stop_signals() as received_signals:
            deadline_s = None if seconds is None else monotonic_s() + seconds
            live_view = Live(render(), console=console, auto_refresh=False, transient=True)
            next_print_s, joined_s = 0.0, monotonic_s()
            with live_view if console.is_terminal else nullcontext():
                while not received_signals and (deadline_s is None or monotonic_s() < deadline_s):
                    exchange.receive_and_process_messages(LOOP_INTERVAL_S)
                    now_s = monotonic_s()
                    known = exchange.status.vehicles or now_s - joined_s > SILENCE_REPORT_DELAY_S
                    if console.is_terminal:
                        live_view.update(render(), refresh=True)
                    elif known and now_s >= next_print_s:
                        next_print_s = now_s + PIPED_PRINT_INTERVAL_S
                        console.print(render())
        console.print(render())
    finally:
        network.close()
        order_store.close()


@app.command(
    cls=command_class_with_options(
        "fleet", "store", "store_file", "user", "zenoh", "identity", "open_network"
    )
)
def recall(
    vehicle: Annotated[str | None, typer.Argument(help="The vehicle, for example d1.")] = None,
    everybody: Annotated[
        bool, typer.Option("--all", help="Recall every connected vehicle; launch hold on all.")
    ] = False,
    wait: Annotated[float, typer.Option(min=1.0, help="Timeout of the acknowledgement, s.")] = 10.0,
    direct: Annotated[
        str | None,
        typer.Option(
            help="Address of its autopilot for MAVSDK (udpin://0.0.0.0:14550). Used only when the"
            " companion has been silent for --silent-for."
        ),
    ] = None,
    silent_for: Annotated[
        float,
        typer.Option(
            min=MIN_SILENCE_S, help="Time without companion messages that permits --direct, s."
        ),
    ] = 15.0,
) -> None:
    """Recall a vehicle: it returns and lands, and a launch hold blocks its next launch.

    The launch hold ends by `ground-station release d1`, after --all by `release --all`. Exit code
    3: at least one vehicle did not acknowledge. 4: all did, but the store was unreachable: no
    launch hold is stored.

    ground-station recall d1 --fleet harbour
    """
    if (vehicle is None) != everybody:
        raise LeewayError("recall: expected a vehicle, or --all")
    if direct is not None and vehicle is None:
        raise LeewayError("--direct: expected one vehicle, not --all")

    from ground_station.app.desk.operator_commands import recall_hold_and_record as recall_by
    from ground_station.app.desk.recall import Recaller, command_return_to_launch_if_silent
    from ground_station.core.schema.holds import raise_if_invalid_vehicle_name

    def recall_without_companion(recaller: Recaller, missing: set[str]) -> set[str]:
        if direct is None or vehicle is None or vehicle not in missing:
            return set()
        return command_return_to_launch_if_silent(recaller, vehicle, direct, silent_for)

    if vehicle is not None:
        raise_if_invalid_vehicle_name(vehicle)
    options = desk_options()
    fleet = options.require_fleet_name()
    url, operator = options.store_url, options.current_operator(fleet)
    network = options.open_fleet_network(fleet)
    with closing(network):
        done = recall_by(
            network,
            partial(open_store_with_short_timeout, url),
            vehicle,
            operator.name,
            echo_with_time_of_day,
            partial(typer.echo, err=True),
            wait,
            recall_without_companion,
        )
    if done.not_recalled or done.no_vehicle_reason:
        raise typer.Exit(EXIT_RECALL_FAILED)
    if not done.is_recorded:
        raise typer.Exit(EXIT_HOLD_FAILED)


@app.command(cls=command_class_with_options("store", "store_file", "date"))
def report(
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the report as JSON.")
    ] = None,
) -> None:
    """Report the day in the store: orders, flights, predictions and outcomes.

    ground-station report --store sqlite:///desk.db
    """
    from ground_station.adapters.store.day_store import DayStore
    from ground_station.app.views.day_report import day_report_of, report_tables
    from ground_station.app.views.terminal import plain_console

    with closing(desk_options().open_store()) as order_store:
        statistics = day_report_of(order_store, DayStore(order_store.database, epoch_us))
    plain_console().print(report_tables(statistics))
    if json_file is not None:
        json_file.write_text(json.dumps(statistics, indent=1))


def _log_line_with_open_network_mark(message: str) -> None:
    echo_with_time_of_day(f"{OPEN_MARK} {message}")
