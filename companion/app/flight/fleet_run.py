"""A companion in a fleet: flies assignments in sequence, across restarts, until stopped."""

import gc
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from companion.adapters.autopilots.link import open_link
from companion.adapters.files.disk import ThreadedRecordWriter
from companion.app.flight.assignment import load_current_assignment
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions, Settings
from companion.app.flight.run import (
    DONE,
    GROUNDED,
    INTERRUPTED,
    Run,
    run_until_exit_and_return_code,
)
from companion.app.flight.standby import Standby
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Action
from companion.fleet.membership import DEFAULT_JOIN_OPTIONS, JoinOptions, read_membership
from companion.fleet.messages import AIRFRAME, EventKind
from companion.fleet.network import OPEN_WARNING
from companion.fleet.service_manager import record_stop_signals
from companion.fleet.topics import VehicleKeys


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """Fleet, vehicle name and network; without a zenoh file, `join` defines the network."""

    fleet: str
    vehicle: str
    zenoh: Path | None = None
    join: JoinOptions = DEFAULT_JOIN_OPTIONS


def open_fleet_port(fleet: FleetOptions, options: RunOptions, settings: Settings) -> FleetPort:
    """Join the fleet. Raises LeewayError for an error in names, files or configuration."""
    membership = read_membership(VehicleKeys(fleet.fleet, fleet.vehicle), fleet.zenoh, fleet.join)
    airframe = Path(options.airframe).stem
    if re.match(AIRFRAME, airframe) is None:
        raise LeewayError(f"airframe {airframe!r}: expected a name allowed in fleet messages")
    try:
        port = FleetPort.open(
            fleet.vehicle,
            airframe,
            settings.airframe,
            options.run_dir,
            membership.open_link,
            refusal_reason_within=membership.certificate_error_within,
            disk=None if options.record_synchronously else ThreadedRecordWriter(lambda words: None),
        )
    except OSError as error:
        raise LeewayError(f"{options.run_dir}: {error.strerror}") from error
    if fleet.join.open_network:
        port.member.status_text = OPEN_WARNING
        port.record_event(EventKind.TEXT, OPEN_WARNING)
    return port


def fly_fleet_assignments_until_stopped(
    fleet: FleetOptions,
    options: RunOptions,
    *,
    print_line: Callable[[str], None],
    on_action: Callable[[Action], None] | None = None,
) -> int:
    """Fly the desk's assignments; return when a signal or a failed run ends the service.

    An assignment that is loaded after a restart is resumed first: the flight's checkpoint defines
    what remains.
    """
    settings = Settings.read_settings_files(options)
    port = open_fleet_port(fleet, options, settings)
    try:
        while True:
            if port.current is None:
                print_line(f"standing by as {fleet.vehicle} of {fleet.fleet}")
                if not _wait_for_assignment(port, options, settings):
                    return INTERRUPTED
            code = _fly_assignment(port, options, settings, print_line, on_action)
            if code not in (DONE, GROUNDED):
                return code
            # On the ground: the flight's objects form cycles that only the collector frees. It
            # would start by itself at a quarter more objects: after a dozen flights, 2 MB each.
            gc.collect()
    finally:
        port.close()


def fly_local_mission_in_fleet(
    fleet: FleetOptions, options: RunOptions, on_action: Callable[[Action], None] | None = None
) -> int:
    """Fly a local mission that the fleet's desk can monitor and recall."""
    loaded = LoadedFlight.read_and_validate(options)
    port = open_fleet_port(fleet, options, loaded.settings)
    try:
        return run_until_exit_and_return_code(
            Run.begin(loaded, open_link, on_action=on_action, port=port)
        )
    finally:
        port.close()


def _fly_assignment(
    port: FleetPort,
    options: RunOptions,
    settings: Settings,
    print_line: Callable[[str], None],
    on_action: Callable[[Action], None] | None,
) -> int:
    """Fly the loaded assignment; return the exit code, GROUNDED if it cannot be loaded."""
    assert port.current is not None
    assignment = port.current.assignment
    loaded = load_current_assignment(port, options, settings)
    if loaded is None:
        print_line(f"assignment {assignment}: ended or refused: see its outcome")
        return GROUNDED
    print_line(f"assignment {assignment}")
    code = run_until_exit_and_return_code(
        Run.begin(loaded, open_link, on_action=on_action, port=port)
    )
    if code in (DONE, GROUNDED):
        port.unload_assignment()
    return code


def _wait_for_assignment(port: FleetPort, options: RunOptions, settings: Settings) -> bool:
    """Wait for an assignment; return False if a signal arrives first."""
    link = open_link(options.link)
    try:
        codec, stamps = settings.build_codec(datagrams=link.datagrams)
        with record_stop_signals() as received_signals:
            standby = Standby(port, link, codec, options, settings, stamps=stamps)
            return standby.wait_for_assignment(lambda: bool(received_signals)) is not None
    finally:
        link.close()
