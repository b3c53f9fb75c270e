"""A companion that serves a fleet: assignment after assignment, through restarts, until stopped."""

import gc
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from companion.adapters.autopilots.codec import MavlinkCodec, read_signing_key
from companion.adapters.autopilots.link import open_link
from companion.adapters.files.params import read_airframe
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.run import DONE, GROUNDED, STOPPED, RunOptions, run
from companion.app.flight.standby import MISSION, Standby, StopSignals
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Action
from companion.fleet.membership import ON_ITS_OWN, JoinOptions, join
from companion.fleet.topics import VehicleKeys


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """Which fleet, as which vehicle, and how it joins; without a zenoh file as `join` says."""

    fleet: str
    vehicle: str
    zenoh: Path | None = None
    join: JoinOptions = ON_ITS_OWN


def open_port(fleet: FleetOptions, options: RunOptions) -> FleetPort:
    """Join the fleet. Raises LeewayError for a mistake in names, files or configuration."""
    membership = join(VehicleKeys(fleet.fleet, fleet.vehicle), fleet.zenoh, fleet.join)
    airframe = read_airframe(options.airframe, options.params)
    try:
        return FleetPort.open(
            fleet.vehicle,
            Path(options.airframe).stem,
            airframe,
            options.run_dir,
            membership.open_link,
            trouble_until=membership.trouble_until,
        )
    except OSError as error:
        raise LeewayError(f"{options.run_dir}: {error.strerror}") from error


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
    port = open_port(fleet, options)
    try:
        while True:
            if port.current is None:
                say(f"standing by as {fleet.vehicle} of {fleet.fleet}")
                if not _stand_by(port, options):
                    return STOPPED
            assert port.current is not None
            assignment = port.current.assignment
            if not port.log.has_outcome(assignment):
                say(f"assignment {assignment}")
                folder = port.folder_of(assignment)
                flight = replace(options, mission=folder / MISSION, run_dir=folder)
                code = run(flight, on_action=on_action, port=port)[0]
                if code not in (DONE, GROUNDED):
                    return code
            port.put_ashore()
            _let_go()
    finally:
        port.close()


def fly_one(
    fleet: FleetOptions, options: RunOptions, on_action: Callable[[Action], None] | None = None
) -> int:
    """Fly a mission of one's own, seen and recalled by the fleet's desk."""
    port = open_port(fleet, options)
    try:
        return run(options, on_action=on_action, port=port)[0]
    finally:
        port.close()


def _let_go() -> None:
    """Free the flight that is over, on the ground, before the next.

    Its parts call each other back, so that only the collector frees them. By itself that looks at
    all objects once a quarter more of them live: after a dozen flights, 2 MB each.
    """
    gc.collect()


def _stand_by(port: FleetPort, options: RunOptions) -> bool:
    """Wait for work; False when a signal came first."""
    key = read_signing_key(options.signing_key) if options.signing_key is not None else None
    link = open_link(options.link)
    try:
        codec = MavlinkCodec(datagrams=link.datagrams, signing_key=key)
        with StopSignals() as signals:
            standby = Standby(port, link, codec, options.system_id)
            return standby.wait(lambda: bool(signals.seen)) is not None
    finally:
        link.close()
