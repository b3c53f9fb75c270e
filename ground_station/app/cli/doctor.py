"""`ground-station doctor`: checks what a day needs, and says what to do."""

import json
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import monotonic_s
from ground_station.app.options.desk_options import DeskOptions, desk_options, read_day_and_warn
from ground_station.app.options.program_options import command_class_with_options
from ground_station.app.options.settings_file import SETTINGS_FILE
from ground_station.app.views.times import format_local_time

if TYPE_CHECKING:
    from ground_station.adapters.store.order_store import Store
    from ground_station.core.schema.day_data import DayData

EXIT_TO_DO = 3

COMMAND_BY_KIND = {
    "launch": "ground-station order launch {}",
    "stuck": "ground-station order settle {} --reason TEXT, with --delivered, --lost or --back",
}
"""Command that ends an item of the attention list, by the kind in its key."""

app = typer.Typer()


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check. `to_do`: what a person has to do; empty: nothing."""

    subject: str
    text: str
    to_do: str = ""


@app.command(
    cls=command_class_with_options(
        "fleet", "store", "store_file", "zenoh", "identity", "open_network"
    )
)
def doctor(
    day: Annotated[
        str | None,
        typer.Argument(help="A day/1 TOML file, or the name of a bundled day; read and checked."),
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=1.0, max=600.0, help="Time to listen to the fleet, s.")
    ] = 5.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check day, identity, store, network, desk, vehicles and map; say what to do.

    Changes nothing. Exit code 3: there is something to do.

    ground-station doctor harbour --store sqlite:///desk.db
    """
    findings = []
    for finding in _check_all(day, desk_options(), seconds):
        findings.append(finding)
        if not as_json:
            mark = "TO DO" if finding.to_do else "ok"
            typer.echo(f"{mark:5}  {finding.subject:9} {finding.text}")
            if finding.to_do:
                typer.echo(f"{'':17}{finding.to_do}")
    if as_json:
        typer.echo(json.dumps([asdict(one) for one in findings], indent=1))
    if any(one.to_do for one in findings):
        raise typer.Exit(EXIT_TO_DO)


def _check_all(day: str | None, options: DeskOptions, seconds: float) -> Iterator[Finding]:
    settings = SETTINGS_FILE if SETTINGS_FILE.is_file() else None
    yield Finding("settings", "defaults" if settings is None else str(settings.resolve()))
    data = None
    if day is not None:
        try:
            data = read_day_and_warn(day)
            text = f"{len(data.day.drones)} drones, {len(data.orders)} orders in its file"
            yield Finding("day", f"{data.day.fleet}: {text}")
        except LeewayError as error:
            yield Finding("day", str(error), "Correct the file, then run this command again.")
    yield from _check_identity(options)
    yield _check_map_scripts()
    fleet = options.fleet or (None if data is None else data.day.fleet)
    try:
        order_store = options.open_store()
    except LeewayError as error:
        yield Finding("store", str(error), "Begin a day: ground-station order import FILE.")
        return
    with closing(order_store):
        yield from _check_store(options, order_store)
        if fleet is None:
            to_do = "Name a day, or add --fleet NAME; vehicles were not checked."
            yield Finding("network", "the fleet's name is not known", to_do)
            return
        yield from _check_fleet(fleet, data, options, order_store, seconds)


def _check_identity(options: DeskOptions) -> Iterator[Finding]:
    if options.identity is None:
        text = "none, messages are not signed; for other machines: ground-station pki init"
        yield Finding("identity", text)
        return
    try:
        operator = options.current_operator()
    except LeewayError as error:
        yield Finding(
            "identity", str(error), "Check the folder, or make it again: ground-station pki add."
        )
        return
    yield Finding("identity", operator.name)


def _check_map_scripts() -> Finding:
    from ground_station.adapters.web.npm_assets import packages_with_missing_files

    missing = packages_with_missing_files()
    if missing:
        text = "without base map and coasts; for both: ground-station map --fetch-assets"
        return Finding("map", text)
    return Finding("map", "scripts and outline are here")


def _check_store(options: DeskOptions, order_store: "Store") -> Iterator[Finding]:
    from ground_station.adapters.store.check import find_store_faults

    faults = find_store_faults(options.store_url)
    states = Counter(row.state.value for row in order_store.orders())
    counts = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
    text = f"{order_store.database.shown_url}: {counts or 'no orders'}"
    if faults:
        to_do = "File mode: chmod 600. Damage: stop the desk, ground-station store restore FILE."
        yield Finding("store", f"{text}; {'; '.join(faults)}", to_do)
    elif not states:
        yield Finding("store", text, "Add orders: ground-station order import FILE.")
    else:
        yield Finding("store", text)


def _check_fleet(
    fleet: str, data: "DayData | None", options: DeskOptions, order_store: "Store", seconds: float
) -> Iterator[Finding]:
    """Listen, then report contact and the items of the attention list."""
    from ground_station.app.map.map_view import MapView
    from ground_station.app.map.open_map import open_map_publisher

    try:
        network = options.open_fleet_network(fleet)
    except LeewayError as error:
        yield Finding("network", str(error), "Correct --zenoh or --identity.")
        return
    with closing(network):
        publisher = open_map_publisher(MapView(fleet, data), data, network, order_store)
        end_s = monotonic_s() + seconds
        while monotonic_s() < end_s:
            publisher.listen_and_publish_due_picture()
        picture = publisher.build_picture(monotonic_s())
    yield from fleet_findings(fleet, picture, seconds)


def fleet_findings(fleet: str, picture: dict[str, Any], seconds: float) -> Iterator[Finding]:
    """Yield the findings on network, desk and vehicles, from the map's picture."""
    heard = {name: one for name, one in picture.get("drones", {}).items() if "heard_us" in one}
    if heard or "desk_heard_us" in picture:
        yield Finding("network", f"drones of {fleet} in contact: {len(heard)}")
    else:
        yield Finding(
            "network",
            f"no member of {fleet} within {seconds:g} s",
            "Start a vehicle (companion run --fleet, sim-bridge serve), or check --zenoh, --fleet"
            " and the router (ground-station router).",
        )
    if "desk_heard_us" in picture:
        yield Finding("desk", "in contact")
    else:
        yield Finding("desk", "no heartbeat", "Start it: ground-station dispatch DAY.")
    items = picture.get("attention", [])
    subjects = {item["who"] for item in items}
    for name, one in heard.items():
        if name not in subjects:
            yield Finding(name, one.get("phase", "in contact"))
    for item in items:
        kind, _, subject = item["key"].partition(" ")
        command = COMMAND_BY_KIND.get(kind, "").format(subject)
        times = {name: format_local_time(us) for name, us in item.get("times", {}).items()}
        text = item.get("words", "").format_map(times)
        to_do = " ".join(part for part in (text, command) if part)
        yield Finding(item["who"], f"{item['title']}.", to_do or "See the map.")
