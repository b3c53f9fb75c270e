"""`ground-station map`: the running day on a map, in a browser of this machine."""

import ipaddress
from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.cli.options import (
    DEFAULT_STORE,
    OPEN_WORDS,
    IdentityFolder,
    OpenNetwork,
    StoreFile,
    StoreUrl,
    ZenohFile,
    open_day,
    open_fleet,
    open_store,
    url_of,
)
from ground_station.app.cli.stopping import stop_signals

if TYPE_CHECKING:
    from ground_station.adapters.web.map_server import MapAnswers, MapServer
    from ground_station.core.schema.day_data import DayData

HERE = "127.0.0.1"
PORT = 8714
IDLE_S = 0.2

app = typer.Typer()


@app.command("map")
def show_map(
    day: Annotated[
        str | None,
        typer.Option(
            help="The day: a day/1 TOML file, or the name of a bundled day. It names the fleet, and"
            " has depot, areas, rally points and the energy models."
        ),
    ] = None,
    fleet: Annotated[
        str | None, typer.Option(help="The fleet's name, where no day is given.")
    ] = None,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    zenoh: ZenohFile = None,
    identity: IdentityFolder = None,
    open_network: OpenNetwork = False,
    basemap: Annotated[
        Path | None,
        typer.Option(help="A PMTiles extract of the town, vector tiles of the Protomaps schema."),
    ] = None,
    replay: Annotated[
        str | None,
        typer.Option(
            metavar="RUN_FOLDER|STORE",
            help="Show the past instead: a folder of `sim-bridge day` or of one flight, or a store"
            " (its URL or SQLite file). Nothing is listened to.",
        ),
    ] = None,
    records: Annotated[
        Path | None,
        typer.Option(
            help="With --replay: the folder that the flights' records lie in, if it is another."
        ),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: any that is free.")] = PORT,
    host: Annotated[
        str, typer.Option(help="The address to serve at: one of this machine only.")
    ] = HERE,
) -> None:
    """Show the running day on a map, in a browser of this machine. It commands nothing.

    Fed as `watch` is: by the fleet's network and the desk's store, both only read. With --replay
    it shows a past day instead, with a scrubber. Ctrl-C ends it.

    ground-station map --day town --store sqlite:///desk.db
    ground-station map --day harbour --replay logs/day-harbour-seed1
    """
    check_loopback(host)
    data = None if day is None else open_day(day)
    name = fleet if data is None else data.day.fleet
    if records is not None and replay is None:
        raise LeewayError("--records: expected --replay beside it")
    if name is None and replay is None:
        raise LeewayError("map: expected --day, or --fleet")
    if basemap is not None:
        _have_basemap(basemap)
    with ExitStack() as held:
        server = held.enter_context(closing(_server(host, port)))
        if replay is not None:
            answers = _past_answers(replay, records, name, data, basemap)
            idle = partial(Event().wait, IDLE_S)
            _serve_until_stopped(server, answers, f"the past of {name or replay}", host, idle)
            return
        assert name is not None
        opened = held.enter_context(closing(open_store(store, store_file, goes_on=True)))
        ears = held.enter_context(closing(open_fleet(name, zenoh, identity, open_network)))

        from ground_station.adapters.clock import WallClock
        from ground_station.adapters.web.map_server import MapAnswers
        from ground_station.app.map.fleet_ear import FleetEar
        from ground_station.app.map.map_feed import MapFeed
        from ground_station.app.map.map_view import MapView
        from ground_station.core.fleet.fleet_status import FleetStatus

        clock = WallClock()
        status = FleetStatus({} if data is None else data.airframes)
        notes = (OPEN_WORDS,) if open_network else ()
        ear = FleetEar(ears, clock, status)
        view = MapView(name, data, notes, basemap is not None)
        feed = MapFeed(view, ear, opened, clock)
        answers = MapAnswers(feed.stream, feed.history, feed.reach, basemap)
        _serve_until_stopped(server, answers, f"the map of {name}", host, feed.turn)


def _serve_until_stopped(
    server: "MapServer",
    answers: "MapAnswers",
    what: str,
    host: str,
    turn: Callable[[], object],
) -> None:
    server.serve(answers)
    shown = f"[{host}]" if ":" in host else host
    typer.echo(f"{what}: http://{shown}:{server.port}/  Ctrl-C ends it")
    with stop_signals() as stopped:
        while not stopped:
            turn()


def _past_answers(
    replay: str,
    records: Path | None,
    name: str | None,
    data: "DayData | None",
    basemap: Path | None,
) -> "MapAnswers":
    from ground_station.adapters.store.database import Database
    from ground_station.adapters.store.past_store import PastStore
    from ground_station.adapters.web.live_stream import LiveStream
    from ground_station.adapters.web.map_server import MapAnswers, PastAnswers
    from ground_station.app.map.map_view import MapView
    from ground_station.app.map.replay.past_folder import past_files
    from ground_station.app.map.replay.replay_feed import ReplayFeed

    files = past_files(replay, records)
    store = None
    if files.store is not None:
        with closing(Database(url_of(files.store, None), create=False)) as database:
            store = PastStore(database)
    view = MapView(name or "the past", data, (), basemap is not None)
    feed = ReplayFeed(view, store, files.records)
    for words in feed.troubles:
        typer.echo(words, err=True)
    past = PastAnswers(feed.span, feed.moment, feed.history, feed.reach)
    return MapAnswers(LiveStream(), lambda _: None, lambda _: None, basemap, past)


def check_loopback(host: str) -> None:
    """Raise LeewayError for an address that other machines reach."""
    try:
        here = ipaddress.ip_address(host).is_loopback
    except ValueError:
        here = host == "localhost"
    if not here:
        raise LeewayError(
            f"--host {host}: the map has no TLS and no token yet, so it is served to this machine"
            f" only: expected {HERE}; from elsewhere: ssh -L {PORT}:{HERE}:{PORT} THIS-MACHINE"
        )


def _server(host: str, port: int) -> "MapServer":
    try:
        from ground_station.adapters.web.map_server import MapServer
    except ImportError as error:
        raise LeewayError(f"map needs leeway-uas[ground]: {error}") from error
    return MapServer(host, port)


def _have_basemap(basemap: Path) -> None:
    """Check the file, and fetch the scripts that draw it where they are missing."""
    from ground_station.adapters.web.basemap import check_pmtiles
    from ground_station.adapters.web.npm_assets import fetch_assets, missing_assets

    check_pmtiles(basemap)
    if missing := missing_assets():
        typer.echo(f"fetching {', '.join(missing)} from the npm registry, once ...")
        fetch_assets()
