"""`ground-station map`: live map of the day in a browser."""

import sys
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.network import OPEN_WARNING
from companion.fleet.service_manager import record_stop_signals
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.adapters.listening_socket import is_loopback_host
from ground_station.app.options.desk_options import (
    DeskOptions,
    desk_options,
    open_store_with_short_timeout,
    read_day_and_warn,
    resolve_operator,
    resolve_store_url,
)
from ground_station.app.options.program_options import command_class_with_options

if TYPE_CHECKING:
    from ground_station.adapters.web.map_server import MapDataSources, MapServer
    from ground_station.adapters.web.people import MapAccess
    from ground_station.app.map.map_commands import OperatorCommands
    from ground_station.core.people.person import DeskOperator
    from ground_station.core.schema.day_data import DayData

LOOPBACK_HOST = "127.0.0.1"
DEFAULT_PORT = 8714
POLL_INTERVAL_S = 0.2

app = typer.Typer()


@app.command(
    "map",
    cls=command_class_with_options(
        "date", "fleet", "store", "store_file", "zenoh", "identity", "open_network"
    ),
)
def show_map(
    day: Annotated[
        str | None,
        typer.Option(
            help="A day/1 TOML file, or the name of a bundled day: fleet, depot, areas, rally"
            " points and energy models."
        ),
    ] = None,
    basemap: Annotated[
        Path | None,
        typer.Option(
            help="A PMTiles extract of the town: vector tiles of the Protomaps or the OpenMapTiles"
            " schema."
        ),
    ] = None,
    replay: Annotated[
        str | None,
        typer.Option(
            metavar="RUN_FOLDER|STORE",
            help="Show a past day instead: a folder of `sim-bridge day` or of one flight, or a"
            " store (URL or SQLite file). The network is not used.",
        ),
    ] = None,
    records: Annotated[
        Path | None,
        typer.Option(help="With --replay: folder of the flights' records, if different."),
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port; 0: any free port.")
    ] = DEFAULT_PORT,
    tokens: Annotated[
        Path | None,
        typer.Option(
            help="File of `ground-station token`: its users may send commands from the map."
            " Default: the map is read-only."
        ),
    ] = None,
    host: Annotated[
        str,
        typer.Option(help="Address to serve on; other than loopback requires --tls and --tokens."),
    ] = LOOPBACK_HOST,
    tls: Annotated[
        tuple[Path, Path] | None,
        typer.Option("--tls", metavar="CERT KEY", help="Certificate chain and key, PEM."),
    ] = None,
    fetch: Annotated[
        bool,
        typer.Option(
            "--fetch-assets",
            help="Download the map scripts and world outline (npm registry), then exit.",
        ),
    ] = False,
) -> None:
    """Show the day on a map in a browser.

    Reads the fleet's network and the desk's store. With --tokens, users sign in with their token
    and can recall, hold, release, confirm launches and settle orders. With --replay it shows a
    past day with a time slider. Ctrl-C stops it.

    ground-station map --day town --store sqlite:///desk.db
    ground-station map --day harbour --replay logs/day-harbour-seed1
    """
    if fetch:
        _fetch_assets_and_print_progress()
        return
    require_safe_address(host, is_safe=tls is not None and tokens is not None)
    data = None if day is None else read_day_and_warn(day)
    options = desk_options()
    name = options.fleet if data is None else data.day.fleet
    if options.date is not None and replay is None:
        raise LeewayError("--date: expected --replay")
    if records is not None and replay is None:
        raise LeewayError("--records: expected --replay")
    if name is None and replay is None:
        raise LeewayError("map: expected --day, or --fleet")
    if basemap is not None:
        check_basemap_and_fetch_scripts(basemap)
    with ExitStack() as resources:
        server = resources.enter_context(closing(_create_map_server(host, port, tls)))
        reading_needs_token = not is_loopback_host(host)
        if replay is not None:
            map_access = (
                None if tokens is None else _create_map_access(tokens, None, reading_needs_token)
            )
            data_sources = _replay_sources(replay, records, name, data, basemap)
            idle = partial(Event().wait, POLL_INTERVAL_S)
            label = f"the past of {name or replay}"
            _serve_until_signal(server, replace(data_sources, access=map_access), label, idle)
            return
        assert name is not None
        map_access = None
        if tokens is not None:
            operator_commands = _operator_commands(name, options, data)
            map_access = _create_map_access(tokens, operator_commands, reading_needs_token)
        order_store = resources.enter_context(closing(options.open_store(tolerate_outage=True)))
        network = resources.enter_context(closing(options.open_fleet_network(name)))

        from ground_station.adapters.web.map_server import MapDataSources
        from ground_station.app.map.http_interface import openapi_document
        from ground_station.app.map.map_view import MapView
        from ground_station.app.map.open_map import open_map_publisher

        notes = (OPEN_WARNING,) if options.open_network else ()
        view = MapView(name, data, notes, basemap is not None, download_outline_if_missing(basemap))
        map_source = open_map_publisher(view, data, network, order_store)
        data_sources = MapDataSources(
            map_source.stream,
            map_source.margin_history_of,
            map_source.reachable_area_boundary,
            basemap,
            None,
            map_access,
            map_source.order_record_of,
            openapi_document,
        )
        _serve_until_signal(
            server, data_sources, f"the map of {name}", map_source.listen_and_publish_due_picture
        )


def _serve_until_signal(
    server: "MapServer", data_sources: "MapDataSources", label: str, poll_once: Callable[[], object]
) -> None:
    server.start_serving(data_sources)
    from companion.fleet.service_manager import Watchdog

    typer.echo(f"{label}: {server.address}/  Ctrl-C ends it")
    watchdog = Watchdog()
    with record_stop_signals() as received_signals:
        while not received_signals:
            watchdog.notify_systemd_if_due(monotonic_s())
            poll_once()


def _replay_sources(
    replay: str,
    records: Path | None,
    name: str | None,
    data: "DayData | None",
    basemap: Path | None,
) -> "MapDataSources":
    from ground_station.adapters.store.database import Database
    from ground_station.adapters.store.past_store import PastStore
    from ground_station.adapters.web.live_stream import LiveStream
    from ground_station.adapters.web.map_server import MapDataSources, PastDataSources
    from ground_station.app.map.map_view import MapView
    from ground_station.app.map.replay.past_folder import find_replay_files
    from ground_station.app.map.replay.replay_feed import ReplayDataSource

    files = find_replay_files(replay, records)
    store = None
    if files.store is not None:
        with closing(Database(resolve_store_url(files.store, None), create=False)) as database:
            desk_options().select_date(database)
            store = PastStore(database)
    view = MapView(
        name or "the past", data, (), basemap is not None, download_outline_if_missing(basemap)
    )
    map_source = ReplayDataSource(view, store, files.records)
    for message in map_source.record_fault_texts:
        typer.echo(message, err=True)
    past = PastDataSources(
        map_source.time_line_data,
        map_source.picture_at,
        map_source.margin_history_until,
        map_source.reachable_area_boundary_at,
    )
    return MapDataSources(LiveStream(), lambda _: None, lambda _: None, basemap, past)


def require_safe_address(host: str, *, is_safe: bool) -> None:
    """Raise LeewayError for an address that other machines reach, unless `is_safe`."""
    if not (is_safe or is_loopback_host(host)):
        raise LeewayError(
            f"--host {host} can be reached by other machines: add --tls CERT KEY and --tokens FILE,"
            f" or use {LOOPBACK_HOST} and an SSH tunnel: ssh -L"
            f" {DEFAULT_PORT}:{LOOPBACK_HOST}:{DEFAULT_PORT} THIS-MACHINE"
        )


def _create_map_access(
    tokens: Path, operator_commands: "OperatorCommands | None", reading_needs_token: bool
) -> "MapAccess":
    from ground_station.adapters.files.token_file import TokenFileMonitor
    from ground_station.adapters.web.people import MapAccess

    token_monitor = TokenFileMonitor(tokens)
    return MapAccess(
        token_monitor.current_tokens,
        None if operator_commands is None else operator_commands.execute_command,
        reading_needs_token,
    )


def _operator_commands(
    fleet: str, options: DeskOptions, data: "DayData | None"
) -> "OperatorCommands":
    """Return the commands of map users; with an identity the audit records its member."""
    from ground_station.app.map.map_commands import OperatorCommands

    def audit_identity(operator: "DeskOperator") -> "DeskOperator":
        unsigned = options.identity is None
        return operator if unsigned else resolve_operator(operator.name, options.identity, fleet)

    return OperatorCommands(
        audit_identity=audit_identity,
        open_store=options.open_store,
        open_reachable_store=partial(open_store_with_short_timeout, options.store_url),
        open_fleet=partial(options.open_fleet_network, fleet),
        data=data,
    )


def _create_map_server(host: str, port: int, tls: tuple[Path, Path] | None) -> "MapServer":
    try:
        from ground_station.adapters.web.map_server import MapServer
        from ground_station.adapters.web.tls_files import load_checked_tls_files
    except ImportError as error:
        raise LeewayError(f"map: {error}: run pip install 'leeway-uas[ground]'") from error
    return MapServer(host, port, None if tls is None else load_checked_tls_files(*tls, epoch_us()))


def check_basemap_and_fetch_scripts(basemap: Path) -> None:
    """Check the base map file and download its scripts if they are missing."""
    from ground_station.adapters.files.basemap import require_vector_pmtiles_file
    from ground_station.adapters.web.npm_assets import (
        ASSETS,
        asset_fetch_command,
        can_write_folder,
        packages_with_missing_files,
    )

    require_vector_pmtiles_file(basemap)
    if missing := packages_with_missing_files():
        if not can_write_folder():
            raise LeewayError(
                f"--basemap: {ASSETS} lacks {', '.join(missing)}, and this user cannot write there:"
                f" run `{asset_fetch_command()}` once"
            )
        _fetch_assets_and_print_progress()


def _fetch_assets_and_print_progress() -> None:
    from ground_station.adapters.web.npm_assets import (
        ALL_PACKAGES,
        fetch_missing_assets,
        packages_with_missing_files,
    )

    if missing := packages_with_missing_files(ALL_PACKAGES):
        typer.echo(f"fetching {', '.join(missing)} from the npm registry, once ...")
        fetch_missing_assets()
    typer.echo(f"installed: {', '.join(f'{one.name} {one.version}' for one in ALL_PACKAGES)}")


def download_outline_if_missing(basemap: Path | None) -> bool:
    """Return whether the world's outline is available. At a terminal it is downloaded if missing; a
    service never waits for a registry and logs the command instead.
    """
    from ground_station.adapters.web.npm_assets import (
        OUTLINE,
        asset_fetch_command,
        can_write_folder,
        packages_with_missing_files,
    )

    if not packages_with_missing_files(OUTLINE):
        return True
    if basemap is not None:
        return False
    if not sys.stdout.isatty() or not can_write_folder():
        typer.echo(f"world outline missing: run `{asset_fetch_command()}` once")
        return False
    typer.echo("world outline missing: downloading; Ctrl-C continues without it")
    try:
        _fetch_assets_and_print_progress()
    except LeewayError as error:
        typer.echo(f"{error}; the map continues without the outline", err=True)
    except KeyboardInterrupt:
        typer.echo("world outline missing: run `ground-station map --fetch-assets` once")
    return not packages_with_missing_files(OUTLINE)
