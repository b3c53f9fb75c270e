"""Implementation of `companion run`, `check` and `restore`; not imported for `--help`."""

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.autopilots.link import open_link
from companion.adapters.files.monitor_file import service_monitor_folder
from companion.adapters.files.params import flight_file_path, read_flight
from companion.adapters.files.signing_files import read_signing_key
from companion.adapters.files.vehicle_settings import default_settings_folder
from companion.app.cli.check_report import check_report_lines_and_is_ready, reason_no_check_ran
from companion.app.flight.loaded_flight import RunOptions
from companion.app.flight.run import DONE, GROUNDED, NO_LINK, UNCHECKABLE_PHASES, fly_mission
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Action, AlertReport, Decision, LogNote, PhaseChanged
from companion.core.pilot.transitions import Phase
from companion.fleet.network import OPEN_MARK

if TYPE_CHECKING:
    from companion.app.flight.autopilot_client import AutopilotClient
    from companion.app.flight.fleet_run import FleetOptions


def run_options(
    *,
    mission: Path | None,
    airframe: str | None,
    params: Path | None,
    settings_folder: Path | None,
    monitor_folder: Path | None,
    **others: Any,
) -> RunOptions:
    """Return a run's options with their defaults: the airframe is that of the flight file."""
    flight = None if mission is None else flight_file_path(mission, params)
    if airframe is None and flight is not None:
        airframe = read_flight(flight).vehicle.airframe
    return RunOptions(
        airframe=airframe or "",
        mission=flight or Path(),
        params=params,
        settings_folder=settings_folder or default_settings_folder(),
        monitor_folder=monitor_folder or service_monitor_folder(),
        **others,
    )


def fly_and_return_exit_code(options: RunOptions) -> int:
    """Fly the mission. Returns the exit code."""
    code, pilot = fly_mission(options, on_action=print_action)
    if code == NO_LINK:
        print_line_if_possible(no_autopilot_message(options.link))
    if pilot.settings.original_values_to_restore:
        words = ["companion", "restore", "--link", options.link]
        words += ["--vehicle-settings", str(options.settings_folder)]
        words += [] if options.signing_key is None else ["--signing-key", str(options.signing_key)]
        words += [] if options.system_id is None else ["--system", str(options.system_id)]
        print_line_if_possible(f"settings NOT restored: disarm, then run `{shlex.join(words)}`")
    return code


CONNECTION_HINTS = {
    "udpin": "the autopilot must send to this port: PX4's onboard link to 14540, MAVProxy --out",
    "udpout": "the autopilot must listen there and reply to the sender",
    "tcp": "the autopilot must listen there: ArduPilot's SITL at tcp:127.0.0.1:5760",
    "serial": "check baud rate, TX/RX and the port's protocol: ArduPilot SERIALn_PROTOCOL 2, PX4"
    " MAV_n_CONFIG",
}


def no_autopilot_message(link: str) -> str:
    """Return the message for a link without an autopilot, with a hint."""
    hint = CONNECTION_HINTS.get(link.partition(":")[0])
    return f"no answer from an autopilot on {link}" + (f" ({hint})" if hint else "")


def fly_in_fleet_and_return_exit_code(
    fleet: "FleetOptions", options: RunOptions, *, one_mission: bool
) -> int:
    """Fly one mission that the desk monitors, or fly the desk's missions until the process ends.

    Zenoh is loaded only here. Its threads can block interpreter exit: end the process with
    `companion.fleet.zenoh_link.flush_and_exit_process_immediately`.
    """
    from companion.app.flight.fleet_run import (
        fly_fleet_assignments_until_stopped,
        fly_local_mission_in_fleet,
    )

    is_open = fleet.join.open_network
    show = print_action_with_open_network_mark if is_open else print_action
    if one_mission:
        return fly_local_mission_in_fleet(fleet, options, show)
    return fly_fleet_assignments_until_stopped(
        fleet,
        options,
        print_line=lambda line: print_line_if_possible(_marked(line) if is_open else line),
        on_action=show,
    )


def restore_settings_and_return_exit_code(
    link: str,
    folder: Path | None,
    signing_key: Path | None,
    system: int | None,
    silence_limit_s: float,
) -> int:
    """Restore the settings that a flight left changed on the vehicle. Returns the exit code."""
    from companion.app.tools.restore import restore_stored_vehicle_settings

    with _autopilot_client(link, signing_key, system) as client:
        done = restore_stored_vehicle_settings(
            client, folder or default_settings_folder(), silence_limit_s, typer.echo
        )
    if done is None:
        typer.echo(no_autopilot_message(link))
        return NO_LINK
    return DONE if done else GROUNDED


def init_and_exit_code_unless_checkable(
    source: str,
    link: str,
    flight_file: Path,
    airframe: str | None,
    signing_key: Path | None,
    system: int | None,
    silence_limit_s: float,
) -> int | None:
    """Write the flight file and what it names. Returns an exit code if no check can follow."""
    from companion.app.tools import init_flight, vehicle_facts

    init_flight.check_new_files(flight_file)
    from_plan = source != vehicle_facts.FROM_AUTOPILOT
    vehicle, site = vehicle_facts.VehicleFacts(), None
    if from_plan:
        site = vehicle_facts.read_site_of_plan(Path(source))
    if link:
        with _autopilot_client(link, signing_key, system) as client:
            asked = vehicle_facts.ask_autopilot(client, silence_limit_s, with_site=not from_plan)
        if asked is None:
            typer.echo(no_autopilot_message(link))
            return NO_LINK
        vehicle, site = asked[0], site or asked[1]
    if site is None:
        raise LeewayError("--init autopilot: expected --link")
    paths, notes = init_flight.write_flight_files(flight_file, vehicle, site, airframe)
    typer.echo("wrote " + ", ".join(map(str, paths)))
    typer.echo("".join(f"note     {note}\n" for note in notes), nl=False)
    if link and init_flight.find_customer(site) is not None:
        return None
    typer.echo("NOT CHECKED" + ("" if link else ": no --link"))
    return GROUNDED


@contextmanager
def _autopilot_client(
    link: str, signing_key: Path | None, system: int | None
) -> "Iterator[AutopilotClient]":
    from companion.app.flight.autopilot_client import AutopilotClient

    key = read_signing_key(signing_key) if signing_key is not None else None
    connection = open_link(link)
    try:
        codec = MavlinkCodec(datagrams=connection.datagrams, signing_key=key)
        yield AutopilotClient(connection, codec, system)
    finally:
        connection.close()


def check_vehicle_and_return_exit_code(options: RunOptions) -> int:
    """Check the vehicle and print what this mission lacks. Returns the exit code."""
    code, pilot = fly_mission(options, on_action=_print_check_action)
    if pilot.phase in UNCHECKABLE_PHASES:
        typer.echo(f"MISSING  {reason_no_check_ran(pilot)}\nNOT READY")
        return code
    if pilot.phase is not Phase.GROUNDED:
        texts = {NO_LINK: no_autopilot_message(options.link), GROUNDED: "NOT CHECKED"}
        typer.echo(texts.get(code, "the check was interrupted"))
        return code
    lines, ready = check_report_lines_and_is_ready(pilot)
    typer.echo("\n".join(lines))
    return DONE if ready else GROUNDED


def print_action(action: Action) -> None:
    """Print the action's text, if it has one."""
    _print_nonempty_line(_action_text(action))


def print_action_with_open_network_mark(action: Action) -> None:
    """Print the action's text with the mark of an open network."""
    _print_nonempty_line(_marked(_action_text(action)))


def _print_nonempty_line(line: str) -> None:
    """Print and flush a line, unless it is empty."""
    if line:
        typer.echo(line)
        sys.stdout.flush()


def print_line_if_possible(line: str) -> None:
    """Print a line; a full disk or a closed terminal changes neither the flight nor its code."""
    with suppress(OSError):
        _print_nonempty_line(line)


def _marked(line: str) -> str:
    return f"{OPEN_MARK} {line}" if line else ""


def _action_text(action: Action) -> str:
    """Return the line to print for the action, or an empty string."""
    match action:
        case AlertReport():
            return f"  {action.text}"
        case PhaseChanged():
            return f"{action.t_s:9.1f} s  {action.before} -> {action.now}"
        case Decision():
            promise = f"  P(home): {action.p_home_text}" if action.p_home_text is not None else ""
            return f"{action.t_s:9.1f} s  {action.kind}: {action.reason}{promise}"
        case LogNote(in_run=True):
            return f"  {action.text}"
        case _:
            return ""


def _print_check_action(action: Action) -> None:
    """Print only what the check waits for; the report follows at its end."""
    match action:
        case AlertReport():
            typer.echo(f"{action.severity.name}: {action.text}")
        case LogNote(in_check=True):
            typer.echo(action.text)
        case _:
            return
    sys.stdout.flush()
