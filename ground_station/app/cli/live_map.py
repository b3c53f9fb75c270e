"""`ground-station map`: the running day on a map, in a browser of this machine."""

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
from companion.fleet.network import OPEN_WORDS
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.adapters.listening_socket import is_loopback
from ground_station.app.cli.options import (
    DEFAULT_STORE,
    IdentityFolder,
    OpenNetwork,
    StoreFile,
    StoreUrl,
    ZenohFile,
    open_at_once,
    open_day,
    open_fleet,
    open_store,
    url_of,
    who,
)
from ground_station.app.cli.stopping import stop_signals

if TYPE_CHECKING:
    from ground_station.adapters.web.map_server import MapAnswers, MapServer
    from ground_station.adapters.web.people import WebPeople
    from ground_station.app.map.map_people import MapPeople
    from ground_station.core.people.person import Person
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
        typer.Option(
            help="A PMTiles extract of the town: vector tiles of the Protomaps or the OpenMapTiles"
            " schema."
        ),
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
    tokens: Annotated[
        Path | None,
        typer.Option(
            help="A file of `ground-station token`: its people may order from the map. Without it"
            " the map has no way to send."
        ),
    ] = None,
    host: Annotated[
        str,
        typer.Option(help="The address to serve at; one that others reach needs --tls, --tokens."),
    ] = HERE,
    tls: Annotated[
        tuple[Path, Path] | None,
        typer.Option("--tls", metavar="CERT KEY", help="Certificate chain and key, PEM."),
    ] = None,
    fetch: Annotated[
        bool,
        typer.Option(
            "--fetch-assets",
            help="Fetch what draws base maps and the world's outline (npm registry), and end.",
        ),
    ] = False,
) -> None:
    """Show the running day on a map, in a browser.

    Fed as `watch` is: by the fleet's network and the desk's store, both only read. With --tokens
    people sign in with their token and recall, hold, release, confirm launches and settle orders,
    as by the commands of these names. With --replay it shows a past day instead, with a scrubber.
    Ctrl-C ends it.

    ground-station map --day town --store sqlite:///desk.db
    ground-station map --day harbour --replay logs/day-harbour-seed1
    """
    if fetch:
        _fetch_assets()
        return
    check_address(host, is_safe=tls is not None and tokens is not None)
    data = None if day is None else open_day(day)
    name = fleet if data is None else data.day.fleet
    if records is not None and replay is None:
        raise LeewayError("--records: expected --replay beside it")
    if name is None and replay is None:
        raise LeewayError("map: expected --day, or --fleet")
    if basemap is not None:
        have_basemap(basemap)
    with ExitStack() as held:
        server = held.enter_context(closing(_server(host, port, tls)))
        to_read = not is_loopback(host)
        if replay is not None:
            people = None if tokens is None else _people(tokens, None, to_read)
            answers = _past_answers(replay, records, name, data, basemap)
            idle = partial(Event().wait, IDLE_S)
            what = f"the past of {name or replay}"
            _serve_until_stopped(server, replace(answers, people=people), what, idle)
            return
        assert name is not None
        people = None
        if tokens is not None:
            deeds = _deeds(name, (store, store_file), zenoh, identity, open_network)
            people = _people(tokens, deeds, to_read)
        opened = held.enter_context(closing(open_store(store, store_file, goes_on=True)))
        ears = held.enter_context(closing(open_fleet(name, zenoh, identity, open_network)))

        from ground_station.adapters.clock import WallClock
        from ground_station.adapters.files.day_wind import (
            site_wind_of,
            station_book_of,
            station_files,
        )
        from ground_station.adapters.web.map_server import MapAnswers
        from ground_station.app.desk.station_desk import StationDesk
        from ground_station.app.map.fleet_ear import FleetEar
        from ground_station.app.map.map_feed import MapFeed
        from ground_station.app.map.map_view import MapView
        from ground_station.core.fleet.fleet_status import FleetStatus

        clock = WallClock()
        status = FleetStatus({} if data is None else data.airframes)
        notes = (OPEN_WORDS,) if open_network else ()
        wind = site_wind_of(data)
        files = [] if data is None else station_files(data)
        stations = StationDesk(station_book_of(wind, data), files, clock, lambda words: None)
        ear = FleetEar(ears, clock, status, wind, stations)
        view = MapView(name, data, notes, basemap is not None, has_outline(basemap))
        feed = MapFeed(view, ear, opened, clock, ears.certificates)
        answers = MapAnswers(feed.stream, feed.history, feed.reach, basemap, None, people)
        _serve_until_stopped(server, answers, f"the map of {name}", feed.turn)


def _serve_until_stopped(
    server: "MapServer", answers: "MapAnswers", what: str, turn: Callable[[], object]
) -> None:
    server.serve(answers)
    from companion.fleet.service_manager import Watchdog

    typer.echo(f"{what}: {server.address}/  Ctrl-C ends it")
    watchdog = Watchdog()
    with stop_signals() as stopped:
        while not stopped:
            watchdog.turn(monotonic_s())
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
    view = MapView(name or "the past", data, (), basemap is not None, has_outline(basemap))
    feed = ReplayFeed(view, store, files.records)
    for words in feed.troubles:
        typer.echo(words, err=True)
    past = PastAnswers(feed.span, feed.moment, feed.history, feed.reach)
    return MapAnswers(LiveStream(), lambda _: None, lambda _: None, basemap, past)


def check_address(host: str, *, is_safe: bool) -> None:
    """Raise LeewayError for an address that other machines reach, where strangers would see."""
    if not (is_safe or is_loopback(host)):
        raise LeewayError(
            f"--host {host}: other machines reach it: expected --tls CERT KEY and --tokens FILE"
            f" beside it, or {HERE}; without: ssh -L {PORT}:{HERE}:{PORT} THIS-MACHINE"
        )


def _people(tokens: Path, deeds: "MapPeople | None", to_read: bool) -> "WebPeople":
    from ground_station.adapters.files.token_file import WatchedTokens
    from ground_station.adapters.web.people import WebPeople

    watched = WatchedTokens(tokens)
    return WebPeople(watched.book, None if deeds is None else deeds.do, to_read)


def _deeds(
    fleet: str,
    store: tuple[str, Path | None],
    zenoh: Path | None,
    identity: Path | None,
    open_network: bool,
) -> "MapPeople":
    """What people order; with an identity the audit names its member behind them."""
    from ground_station.app.map.map_people import MapPeople

    def acting(person: "Person") -> "Person":
        return person if identity is None else who(person.name, identity, fleet)

    url = url_of(*store)
    return MapPeople(
        acting=acting,
        open_store=partial(open_store, *store),
        open_soon=partial(open_at_once, url),
        open_fleet=partial(open_fleet, fleet, zenoh, identity, open_network),
    )


def _server(host: str, port: int, tls: tuple[Path, Path] | None) -> "MapServer":
    try:
        from ground_station.adapters.web.map_server import MapServer
        from ground_station.adapters.web.tls_files import tls_files
    except ImportError as error:
        raise LeewayError(f"map needs leeway-uas[ground]: {error}") from error
    return MapServer(host, port, None if tls is None else tls_files(*tls, epoch_us()))


def have_basemap(basemap: Path) -> None:
    """Check the file, and fetch the scripts that draw it where they are missing."""
    from ground_station.adapters.files.basemap import check_pmtiles
    from ground_station.adapters.web.npm_assets import (
        ASSETS,
        fetch_command,
        may_write,
        missing_assets,
    )

    check_pmtiles(basemap)
    if missing := missing_assets():
        if not may_write():
            raise LeewayError(
                f"--basemap: {ASSETS} lacks {', '.join(missing)}, and this user cannot write there:"
                f" once, `{fetch_command()}`"
            )
        _fetch_assets()


def _fetch_assets() -> None:
    from ground_station.adapters.web.npm_assets import ALL, fetch_assets, missing_assets

    if missing := missing_assets(ALL):
        typer.echo(f"fetching {', '.join(missing)} from the npm registry, once ...")
        fetch_assets()
    typer.echo(f"here: {', '.join(f'{one.name} {one.version}' for one in ALL)}")


def has_outline(basemap: Path | None) -> bool:
    """Whether the world's outline can be drawn. A person at a terminal waits for it once; a service
    never waits for a registry, and says how to have it.
    """
    from ground_station.adapters.web.npm_assets import (
        OUTLINE,
        fetch_command,
        may_write,
        missing_assets,
    )

    if not missing_assets(OUTLINE):
        return True
    if basemap is not None:
        return False
    if not sys.stdout.isatty() or not may_write():
        typer.echo(f"no outline of the world: `{fetch_command()}` brings it, once")
        return False
    typer.echo("the world's outline is not here yet; Ctrl-C goes on without it")
    try:
        _fetch_assets()
    except LeewayError as error:
        typer.echo(f"{error}; the map goes on without the outline", err=True)
    except KeyboardInterrupt:
        typer.echo("without the outline: `ground-station map --fetch-assets` brings it")
    return not missing_assets(OUTLINE)
