"""Arguments and options that several commands share: the day, the store, the network."""

from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import WallClock, epoch_us, monotonic_s

if TYPE_CHECKING:
    from ground_station.adapters.store.order_store import Store
    from ground_station.adapters.zenoh_fleet import ZenohFleet
    from ground_station.adapters.zenoh_log import DoorLog
    from ground_station.core.people.person import Person
    from ground_station.core.schema.day_data import DayData


class PolicyName(StrEnum):
    """The planner's policy."""

    SEARCH = "search"
    DYNAMIC = "dynamic"


DayArgument = Annotated[
    str, typer.Argument(help="The day: a day/1 TOML file, or the name of a bundled day (town).")
]
StoreUrl = Annotated[
    str,
    typer.Option(
        "--store",
        help="Where the day is kept: sqlite:///FILE, or the URL of a PostgreSQL database.",
        show_default="leeway-desk.db in this folder",
    ),
]
DEFAULT_STORE = "sqlite:///leeway-desk.db"

StoreFile = Annotated[
    Path | None,
    typer.Option(
        help="A file (mode 0600) whose one line is the store's URL, for one with a password."
    ),
]
UserName = Annotated[
    str | None,
    typer.Option(
        "--user",
        help="Who does this, for the audit. Default: the identity's member, else the login name.",
    ),
]

ZenohFile = Annotated[
    Path | None,
    typer.Option(
        "--zenoh",
        help="zenoh's configuration (JSON5). Default: the identity's, else loopback only.",
    ),
]
IdentityFolder = Annotated[
    Path | None,
    typer.Option(
        "--identity",
        help="Your folder of `ground-station pki`: then all messages are signed"
        " (docs: secure-a-fleet).",
    ),
]
SignedBy = Annotated[
    Path | None,
    typer.Option(
        "--identity",
        help="Your folder of `ground-station pki`: the audit names its member; a viewer may"
        " change nothing.",
    ),
]
OpenNetwork = Annotated[
    bool,
    typer.Option(
        "--open-network",
        help="Allow a network that lets strangers in: without TLS, or found by multicast.",
    ),
]
FleetName = Annotated[str, typer.Option("--fleet", help="The fleet's name, as in the day file.")]


ForecastFile = Annotated[
    Path | None,
    typer.Option(
        "--forecast",
        metavar="FILE",
        help="The wind of this forecast: GRIB2, or Open-Meteo's JSON (docs: forecasts).",
    ),
]


def open_day(day: str, *, follows: bool = False) -> "DayData":
    """The day and all its files. DayFilesError lists everything that is wrong in them.

    `follows`: its forecast is kept for later, and not only the wind of now.
    """
    from ground_station.adapters.files.day_files import read_day
    from ground_station.adapters.files.forecast_files import ForecastWanted
    from ground_station.adapters.files.params import day_file

    data = read_day(day_file(day), ForecastWanted(later=follows))
    report_reach(data)
    return data


def report_reach(data: "DayData") -> None:
    """Warn on stderr where zones or obstacles of the day lie beyond the depot's reach."""
    if note := data.reach_note():
        typer.echo(note, err=True)


def open_fleet(
    fleet: str,
    zenoh: Path | None,
    identity: Path | None,
    open_network: bool,
    door_log: "DoorLog | None" = None,
    say: Callable[[str], None] = lambda words: None,
    neighbours: Sequence[str] = (),
) -> "ZenohFleet":
    """The fleet's network. `door_log`: who is turned away there. `say`: that it has opened anew.
    `neighbours`: fleets whose tracks are brought to our vehicles.

    LeewayError where a file is not valid, or would let strangers in.
    """
    from companion.fleet.membership import JoinOptions
    from ground_station.adapters.zenoh_fleet import ZenohFleet

    options = JoinOptions(identity, open_network)
    ears = ZenohFleet(fleet, zenoh, options, door_log, say, neighbours)
    if ears.warning:
        typer.echo(ears.warning, err=True)
    return ears


def open_store(
    url: str, file: Path | None = None, *, create: bool = False, goes_on: bool = False
) -> "Store":
    """The store. StoreError says in one line why it cannot be opened.

    It stamps by the clock of a running desk, which nobody sets meanwhile: launches are compared
    with the day's time. Only a command that begins a day makes a store that is not there
    (`create`). `goes_on`: who opens it goes on while it is away, and does not wait for it.
    """
    from ground_station.adapters.store.database import Database
    from ground_station.adapters.store.order_store import Store
    from ground_station.adapters.store.outage import Outage

    outage = Outage(monotonic_s) if goes_on else None
    return Store(Database(url_of(url, file), create=create, outage=outage), WallClock().epoch_us)


def open_when_there(
    attempt: "Callable[[], Store]",
    say: Callable[[str], None],
    wait: Callable[[float], object],
) -> "Store":
    """What `attempt` opens, as soon as that is there; why it waits is said once.

    A desk that was killed while its store was away is started again by its service before the
    store is: it would end as by a mistake in its settings, and stay down.
    """
    from ground_station.adapters.store.database import StoreAway
    from ground_station.adapters.store.outage import FIRST_S, MOST_S

    wait_s = FIRST_S
    while True:
        try:
            return attempt()
        except StoreAway as error:
            if wait_s == FIRST_S:
                say(f"STORE AWAY: waits for it, Ctrl-C stops: {error}")
        wait(wait_s)
        wait_s = min(2.0 * wait_s, MOST_S)


def open_at_once(url: str) -> "Store":
    """A store that is there, or StoreError without a long wait: for what cannot wait for it."""
    from ground_station.adapters.store.database import SOON_MS, Database
    from ground_station.adapters.store.order_store import Store

    return Store(Database(url, create=False, busy_ms=SOON_MS), epoch_us)


def url_of(url: str, file: Path | None) -> str:
    """The store's URL, of a file where one is named. Raises LeewayError where it is not safe."""
    from ground_station.adapters.files.store_file import read_store_file, refuse_password

    if file is not None:
        return read_store_file(file)
    refuse_password(url)
    return url


def who(user: str | None, identity: Path | None = None, fleet: str | None = None) -> "Person":
    """The person who runs this command: of an identity the member that the roster lists.

    LeewayError where that member may command nobody, before anything is written down. `fleet`: it
    must be of this one.
    """
    from ground_station.core.people.person import person_behind, person_of

    if identity is None:
        from ground_station.adapters.login import login_name

        return person_of(user or login_name())
    from companion.fleet.identity import identity_of, read_identity

    trust = (read_identity(identity) if fleet is None else identity_of(identity, fleet)).trust
    trouble = trust.command_trouble()
    if trouble or trust.me is None:
        raise LeewayError(trouble)
    return person_behind(trust.name, trust.me.role, user)
