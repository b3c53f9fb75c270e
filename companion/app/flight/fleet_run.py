"""A companion that serves a fleet: assignment after assignment, through restarts, until stopped."""

import gc
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from companion.adapters.autopilots.link import open_link
from companion.adapters.files.disk import DiskThread
from companion.app.flight.assignment import take_up
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions, Settings
from companion.app.flight.run import DONE, GROUNDED, STOPPED, Run, fly_to_the_end
from companion.app.flight.standby import Standby, StopSignals
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Action
from companion.fleet.membership import ON_ITS_OWN, JoinOptions, join
from companion.fleet.messages import AIRFRAME, EventKind
from companion.fleet.network import OPEN_WORDS
from companion.fleet.topics import VehicleKeys


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """Which fleet, as which vehicle, and how it joins; without a zenoh file as `join` says."""

    fleet: str
    vehicle: str
    zenoh: Path | None = None
    join: JoinOptions = ON_ITS_OWN


def open_port(fleet: FleetOptions, options: RunOptions, settings: Settings) -> FleetPort:
    """Join the fleet. Raises LeewayError for a mistake in names, files or configuration."""
    membership = join(VehicleKeys(fleet.fleet, fleet.vehicle), fleet.zenoh, fleet.join)
    airframe = Path(options.airframe).stem
    if re.match(AIRFRAME, airframe) is None:
        raise LeewayError(f"airframe {airframe!r}: no name that a fleet's messages may carry")
    try:
        port = FleetPort.open(
            fleet.vehicle,
            airframe,
            settings.airframe,
            options.run_dir,
            membership.open_link,
            trouble_until=membership.trouble_until,
            disk=None if options.record_at_once else DiskThread(lambda words: None),
        )
    except OSError as error:
        raise LeewayError(f"{options.run_dir}: {error.strerror}") from error
    if fleet.join.open_network:
        port.member.remark = OPEN_WORDS
        port.tell(EventKind.SAID, OPEN_WORDS)
    return port


def serve(
    fleet: FleetOptions,
    options: RunOptions,
    *,
    say: Callable[[str], None],
    on_action: Callable[[Action], None] | None = None,
) -> int:
    """Fly what the desk assigns; returns when stopped by a signal, or when a run broke off.

    An assignment that is aboard after a restart is gone on with before anything else: the flight's
    own checkpoint decides what is left of it.
    """
    settings = Settings.read(options)
    port = open_port(fleet, options, settings)
    try:
        while True:
            if port.current is None:
                say(f"standing by as {fleet.vehicle} of {fleet.fleet}")
                if not _stand_by(port, options, settings):
                    return STOPPED
            code = _fly_assignment(port, options, settings, say, on_action)
            if code not in (DONE, GROUNDED):
                return code
            _let_go()
    finally:
        port.close()


def fly_one(
    fleet: FleetOptions, options: RunOptions, on_action: Callable[[Action], None] | None = None
) -> int:
    """Fly a mission of one's own, seen and recalled by the fleet's desk."""
    loaded = LoadedFlight.read(options)
    port = open_port(fleet, options, loaded.settings)
    try:
        return fly_to_the_end(Run.begin(loaded, open_link, on_action=on_action, port=port))
    finally:
        port.close()


def _fly_assignment(
    port: FleetPort,
    options: RunOptions,
    settings: Settings,
    say: Callable[[str], None],
    on_action: Callable[[Action], None] | None,
) -> int:
    """Fly what is aboard to its end; the exit code. What cannot be loaded is GROUNDED."""
    assert port.current is not None
    assignment = port.current.assignment
    loaded = take_up(port, options, settings)
    if loaded is None:
        say(f"assignment {assignment}: over, or refused: see its outcome")
        return GROUNDED
    say(f"assignment {assignment}")
    code = fly_to_the_end(Run.begin(loaded, open_link, on_action=on_action, port=port))
    if code in (DONE, GROUNDED):
        port.put_ashore()
    return code


def _let_go() -> None:
    """Free the flight that is over, on the ground, before the next.

    Its parts call each other back, so that only the collector frees them. By itself that looks at
    all objects once a quarter more of them live: after a dozen flights, 2 MB each.
    """
    gc.collect()


def _stand_by(port: FleetPort, options: RunOptions, settings: Settings) -> bool:
    """Wait for work; False when a signal came first."""
    link = open_link(options.link)
    try:
        codec, stamps = settings.codec(datagrams=link.datagrams)
        with StopSignals() as signals:
            standby = Standby(port, link, codec, options, settings)
            standby.stamps = stamps
            return standby.wait(lambda: bool(signals.seen)) is not None
    finally:
        link.close()
