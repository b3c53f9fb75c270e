"""Arguments and options that several commands share: the day, the store, the network."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.core.base.import_report import ImportReport, report_lines
from ground_station.adapters.clock import WallClock, epoch_us, monotonic_s
from ground_station.app.options.program_options import (
    SHARED_PANEL,
    current_group_option_values,
    names_of_typed_options,
)
from ground_station.app.views.times import format_date_and_time, format_time_of_day

if TYPE_CHECKING:
    from companion.fleet.membership import JoinOptions
    from ground_station.adapters.store.database import Database
    from ground_station.adapters.store.order_store import Store
    from ground_station.adapters.zenoh_fleet import ZenohFleet
    from ground_station.core.people.person import DeskOperator
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
        rich_help_panel=SHARED_PANEL,
        help="Database of the day: sqlite:///FILE, or the URL of a PostgreSQL database.",
        show_default="leeway-desk.db in this folder",
    ),
]
DEFAULT_STORE = "sqlite:///leeway-desk.db"

StoreFile = Annotated[
    Path | None,
    typer.Option(
        rich_help_panel=SHARED_PANEL,
        help="File (mode 0600) whose one line is the store's URL, for a URL with a password.",
    ),
]
UserName = Annotated[
    str | None,
    typer.Option(
        "--user",
        rich_help_panel=SHARED_PANEL,
        help="Name of the operator in the audit. Default: the identity's member, else the login.",
    ),
]
ZenohFile = Annotated[
    Path | None,
    typer.Option(
        "--zenoh",
        rich_help_panel=SHARED_PANEL,
        help="Configuration of zenoh (JSON5). Default: the identity's, else loopback only.",
    ),
]
IdentityFolder = Annotated[
    Path | None,
    typer.Option(
        "--identity",
        rich_help_panel=SHARED_PANEL,
        help="Your folder of `ground-station pki`: messages are signed, and the audit names its"
        " member (docs: secure-a-fleet).",
    ),
]
OpenNetwork = Annotated[
    bool,
    typer.Option(
        "--open-network",
        rich_help_panel=SHARED_PANEL,
        help="Permit a network without TLS or with multicast discovery.",
    ),
]
Date = Annotated[
    str | None,
    typer.Option(
        "--date",
        metavar="YYYY-MM-DD",
        rich_help_panel=SHARED_PANEL,
        help="A past day of the store, to read. Default: its current day.",
    ),
]
FleetName = Annotated[
    str | None,
    typer.Option(
        "--fleet",
        rich_help_panel=SHARED_PANEL,
        help="Name of the fleet. Default: the settings file's; truck and map --day: the day's.",
    ),
]


ForecastFile = Annotated[
    Path | None,
    typer.Option(
        "--forecast",
        metavar="FILE",
        help="Wind forecast: GRIB2, or Open-Meteo's JSON (docs: forecasts); requires --at.",
    ),
]


@dataclass(frozen=True)
class DeskOptions:
    """Options of the program that the running command uses (see `command_class_with_options`)."""

    store: str = DEFAULT_STORE
    store_file: Path | None = None
    user: str | None = None
    identity: Path | None = None
    zenoh: Path | None = None
    open_network: bool = False
    fleet: str | None = None
    date: str | None = None

    @property
    def store_url(self) -> str:
        """The URL of the store. Raises LeewayError for a URL with a password."""
        return resolve_store_url(self.store, self.store_file)

    def current_operator(self, fleet: str | None = None) -> "DeskOperator":
        """Return the person who runs the command; see `resolve_operator`."""
        return resolve_operator(self.user, self.identity, fleet)

    def open_store(self, *, create: bool = False, tolerate_outage: bool = False) -> "Store":
        """Open the store. Raises StoreError with the reason why it cannot be opened.

        It stamps by the clock of a running desk, which is not set meanwhile: launches are compared
        with the day's time. Only a command that begins a day creates a store (`create`). With
        `tolerate_outage` the caller continues while the store is unreachable, and does not wait for
        it.
        """
        from ground_station.adapters.store.database import Database
        from ground_station.adapters.store.order_store import Store
        from ground_station.adapters.store.outage import Outage

        outage = Outage(monotonic_s) if tolerate_outage else None
        database = Database(self.store_url, create=create, outage=outage)
        self.select_date(database)
        return Store(database, WallClock().epoch_us)

    def select_date(self, database: "Database") -> None:
        """Read the past day of --date. Raises LeewayError if the store has no such day."""
        if self.date is not None:
            from ground_station.adapters.store.shift.days import past_day_or_none

            database.day = past_day_or_none(database, self.date)

    @contextmanager
    def operator_and_store(self, *, create: bool = False) -> "Iterator[tuple[str, Store]]":
        """Yield the name of the person who runs the command, and the open store.

        The newest roster known here decides on the person's right: the store holds the desk's.
        """
        self.current_operator()  # refused before a store is created
        with closing(self.open_store(create=create)) as store:
            yield resolve_operator(self.user, self.identity, None, store).name, store

    def open_fleet_network(
        self,
        fleet: str,
        log_line: Callable[[str], None] = lambda words: None,
        neighbours: Sequence[str] = (),
    ) -> "ZenohFleet":
        """Open the network of the fleet, with the tracks of neighbouring fleets.

        `log_line` receives a line when the session was opened again. Raises LeewayError where a
        file is not valid, or would admit strangers.
        """
        from ground_station.adapters.zenoh_fleet import ZenohFleet

        network = ZenohFleet(fleet, self.zenoh, self.join_options(), log_line, neighbours)
        if network.own_certificate_warning:
            typer.echo(network.own_certificate_warning, err=True)
        return network

    def require_fleet_name(self) -> str:
        """Return the fleet's name. Raises LeewayError where neither option nor settings name it."""
        if self.fleet is None:
            raise LeewayError("expected --fleet NAME, or `fleet` in leeway-desk.toml")
        return self.fleet

    def resolve_fleet_name(self, day: "DayData") -> str:
        """Return the fleet's name: of the command line, else of the day; not of the settings."""
        typed = self.fleet if "fleet" in names_of_typed_options() else None
        return typed or day.day.fleet

    def join_options(self) -> "JoinOptions":
        """Return what joining the network depends on."""
        from companion.fleet.membership import JoinOptions

        return JoinOptions(self.identity, self.open_network)


def desk_options() -> DeskOptions:
    """Return the options of the program that the running command uses."""
    values, typed = current_group_option_values(), names_of_typed_options()
    if "store" in typed and "store_file" not in typed:  # not the file that the settings name
        values = {**values, "store_file": None}
    return DeskOptions(**values)


StrictImport = Annotated[
    bool,
    typer.Option("--strict", help="Refuse files of which a part is skipped or suspicious."),
]


def read_day_and_warn(
    day_name_or_file: str,
    *,
    keep_forecast: bool = False,
    forecast: Path | None = None,
    start_s: float | None = None,
    strict: bool = False,
    orders_file: Path | None = None,
    column_headings: Mapping[str, str] | None = None,
) -> "DayData":
    """Read a day and all its files; print what was skipped. Raises DayFilesError with all errors.

    With `keep_forecast` the whole forecast is kept, not only the current wind. `forecast` replaces
    the day's file, `start_s` is the start of the day. `orders_file` and `column_headings`: as in
    `read_day`.
    """
    from ground_station.adapters.files.day_files import read_day
    from ground_station.adapters.files.forecast_files import ForecastRequest
    from ground_station.adapters.files.params import resolve_day_file_path

    data = read_day(
        resolve_day_file_path(day_name_or_file),
        ForecastRequest(forecast, start_s, keep_forecast),
        orders_file,
        column_headings,
    )
    print_import_reports(data.imports, strict=strict)
    return data


def print_import_reports(reports: "Sequence[ImportReport]", *, strict: bool) -> None:
    """Print import reports on stderr. With `strict` raises LeewayError for a skipped part."""
    for line in report_lines(reports):
        typer.echo(line, err=True)
    refused = [text for report in reports for text in report.strict_refusals()] if strict else []
    if refused:
        raise LeewayError("\n".join(f"--strict: {text}" for text in refused))


def echo_with_time_of_day(message: str) -> None:
    """Print a line of the log."""
    typer.echo(f"{format_time_of_day(epoch_us())} {message}")


def open_store_when_reachable(
    open_store: "Callable[[], Store]",
    log_line: Callable[[str], None],
    wait: Callable[[float], object],
) -> "Store":
    """Return the store that `open_store` opens; retry while it is unreachable, and log that once.

    After a kill during a store outage, a service restarts the desk before the store is available.
    Without the retry the desk would exit as for invalid settings and not be restarted.
    """
    from ground_station.adapters.store.database import StoreUnreachable
    from ground_station.adapters.store.outage import FIRST_RETRY_S, MAX_RETRY_S

    wait_s = FIRST_RETRY_S
    while True:
        try:
            return open_store()
        except StoreUnreachable as error:
            if wait_s == FIRST_RETRY_S:
                log_line(f"store unreachable: waiting, Ctrl-C stops: {error}")
        wait(wait_s)
        wait_s = min(2.0 * wait_s, MAX_RETRY_S)


def open_store_with_short_timeout(url: str) -> "Store":
    """Open a reachable store. Raises StoreError after a short timeout."""
    from ground_station.adapters.store.database import URGENT_LOCK_TIMEOUT_MS, Database
    from ground_station.adapters.store.order_store import Store

    return Store(Database(url, create=False, lock_timeout_ms=URGENT_LOCK_TIMEOUT_MS), epoch_us)


def resolve_store_url(url: str, url_file: Path | None) -> str:
    """Return the store's URL, or that of `url_file`. Raises LeewayError for a password in it."""
    from ground_station.adapters.files.store_file import (
        raise_if_url_has_password,
        read_private_store_url,
    )

    if url_file is not None:
        return read_private_store_url(url_file)
    raise_if_url_has_password(url)
    return url


def resolve_operator(
    user: str | None,
    identity: Path | None = None,
    fleet: str | None = None,
    store: "Store | None" = None,
) -> "DeskOperator":
    """Return the operator of this command; with an identity, the member that the roster lists.

    `store`: holds the desk's roster. Raises LeewayError if that member has no permission to send
    commands or is not a member of `fleet`, and for no identity where the desk has a roster.
    """
    from ground_station.core.people.person import local_supervisor_operator, member_operator

    trust = None
    if identity is not None:
        from companion.fleet import identity as member_folder

        trust = (
            member_folder.read_and_verify_identity(identity)
            if fleet is None
            else member_folder.read_identity_of_fleet_and_member(identity, fleet)
        ).trust
    if store is not None:
        from ground_station.app.desk.command_authority import accept_roster_of_store

        if (refused := accept_roster_of_store(trust, store)) is not None:
            raise LeewayError(refused.reason)
    if trust is None:
        from ground_station.adapters.login import operating_system_account_name

        return local_supervisor_operator(user or operating_system_account_name())
    refusal = trust.command_permission_error_or_empty()
    if refusal or trust.own_roster_entry is None:
        raise LeewayError(refusal)
    return member_operator(trust.name, trust.own_roster_entry.role, user)


def with_start_if_windows(data: "DayData", at: str | None) -> "DayData":
    """Return the day with its start, if orders have delivery windows."""
    from ground_station.adapters.files.forecast_files import parse_utc_time_s

    if all(order.window == (None, None) for order in data.orders):
        if at is not None and data.forecast is None:
            raise LeewayError("--at: expected a forecast file, or orders with delivery windows")
        return data
    start_us = epoch_us() if at is None else round(1e6 * parse_utc_time_s(at))
    typer.echo(f"delivery windows: the truck leaves at {format_date_and_time(start_us)} (--at)")
    return replace(data, start_us=start_us)
