"""What `companion run` and `companion check` do; imported when they run, not for `--help`."""

import sys
from dataclasses import dataclass
from pathlib import Path

import typer

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.autopilots.link import open_link
from companion.adapters.files.params import flight_path, read_flight
from companion.adapters.files.signing_files import read_signing_key
from companion.app.cli.check_report import report, why_not_checked
from companion.app.flight.loaded_flight import RunOptions
from companion.app.flight.run import DONE, GROUNDED, NO_LINK, NOT_TO_BE_CHECKED, run
from companion.core.mission.actions import Action, Decision, Note, PhaseChanged, Say
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.transitions import Phase
from companion.fleet.network import OPEN_MARK

SHOWN_NOTES = ("pre-flight", "not granted", "setting ", "settings ")
"""How the notes begin that `run` prints: what is missing, refused, or changed on the vehicle."""


@dataclass(frozen=True, slots=True)
class CommandLine:
    """The options that `run` and `check` share: which vehicle, which flight, which folders."""

    link: str
    mission: Path | None
    airframe: str | None
    wind_process: str | None
    run_dir: Path
    params: Path | None
    signing_key: Path | None
    system: int | None
    silence_limit_s: float

    def options(self, pilot: PilotOptions, *, policy: str | None = None) -> RunOptions:
        """The run's options; the airframe comes from the flight file where none is named."""
        mission = None if self.mission is None else flight_path(self.mission, self.params)
        airframe = self.airframe
        if airframe is None and mission is not None:
            airframe = read_flight(mission).vehicle.airframe
        return RunOptions(
            link=self.link,
            airframe=airframe or "",
            wind_process=self.wind_process,
            mission=mission or Path(),
            run_dir=self.run_dir,
            params=self.params,
            signing_key=self.signing_key,
            system_id=self.system,
            silence_limit_s=self.silence_limit_s,
            policy=policy,
            pilot=pilot,
        )


def fly(options: RunOptions) -> int:
    """Fly the mission; the exit code."""
    code, _ = run(options, on_action=show_action)
    if code == NO_LINK:
        typer.echo(nobody_there(options.link))
    return code


HINTS = {
    "udpin": "it has to send there by itself: PX4's onboard link to 14540, MAVProxy --out",
    "udpout": "it has to listen there, and answers who speaks first",
    "tcp": "it has to listen there: ArduPilot's SITL at tcp:127.0.0.1:5760",
    "serial": "baud rate, TX and RX, and its port's protocol: ArduPilot SERIALn_PROTOCOL 2, PX4"
    " MAV_n_CONFIG",
}


def nobody_there(link: str) -> str:
    """What to say, and what to look at, where no autopilot is heard on a link."""
    hint = HINTS.get(link.partition(":")[0])
    return f"no answer from an autopilot on {link}" + (f" ({hint})" if hint else "")


@dataclass(frozen=True, slots=True)
class FleetLine:
    """The options of `run` about the fleet."""

    fleet: str
    vehicle: str
    zenoh: Path | None
    identity: Path | None
    open_network: bool


def fly_in_fleet(said: FleetLine, options: RunOptions, *, one_mission: bool) -> int:
    """Fly one mission that the desk watches, or serve the desk until the process ends.

    Zenoh is loaded only here. Its threads can keep an interpreter from ending: leave the process
    with `companion.fleet.zenoh_link.leave_process`.
    """
    from companion.app.flight.fleet_run import FleetOptions, fly_one, serve
    from companion.fleet.membership import JoinOptions

    join = JoinOptions(said.identity, said.open_network)
    fleet = FleetOptions(said.fleet, said.vehicle, said.zenoh, join)
    show = show_open if said.open_network else show_action
    if one_mission:
        return fly_one(fleet, options, show)
    return serve(fleet, options, say=_say_open if said.open_network else _say, on_action=show)


def put_settings_back(
    link: str, folder: Path, signing_key: Path | None, system: int | None, silence_limit_s: float
) -> int:
    """Put back what a flight left changed on the vehicle; the exit code."""
    from companion.app.tools.restore import Caller, restore

    key = read_signing_key(signing_key) if signing_key is not None else None
    opened = open_link(link)
    try:
        codec = MavlinkCodec(datagrams=opened.datagrams, signing_key=key)
        caller = Caller(opened, codec, system)
        done = restore(caller, folder, silence_limit_s, typer.echo)
    finally:
        opened.close()
    if done is None:
        typer.echo(nobody_there(link))
        return NO_LINK
    return DONE if done else GROUNDED


def check(options: RunOptions) -> int:
    """Ask the vehicle, print what is missing for this mission; the exit code."""
    code, pilot = run(options, on_action=_show_check)
    if pilot.phase in NOT_TO_BE_CHECKED:
        typer.echo(f"MISSING  {why_not_checked(pilot)}\nNOT READY")
        return code
    if pilot.phase is not Phase.GROUNDED:
        silent = code == NO_LINK
        typer.echo(nobody_there(options.link) if silent else "the check was cut short")
        return code
    lines, ready = report(pilot)
    typer.echo("\n".join(lines))
    return DONE if ready else GROUNDED


def show_action(action: Action) -> None:
    """Print what it says, if anything."""
    _say(_line_of(action))


def show_open(action: Action) -> None:
    """The same on an open network."""
    _say_open(_line_of(action))


def _say(line: str) -> None:
    """Nothing for an empty line."""
    if line:
        typer.echo(line)
        sys.stdout.flush()


def _say_open(line: str) -> None:
    _say(f"{OPEN_MARK} {line}" if line else "")


def _line_of(action: Action) -> str:
    """What is printed of it; empty: nothing."""
    match action:
        case Say():
            return f"  {action.text}"
        case PhaseChanged():
            return f"{action.t_s:9.1f} s  {action.before} -> {action.now}"
        case Decision():
            promise = f"  p_home {action.p_home:.3f}" if action.p_home is not None else ""
            return f"{action.t_s:9.1f} s  {action.kind}: {action.reason}{promise}"
        case Note() if action.text.startswith(SHOWN_NOTES):
            return f"  {action.text}"
        case _:
            return ""


def _show_check(action: Action) -> None:
    """Only what the check waits for: its findings come as one list at the end."""
    match action:
        case Say():
            typer.echo(f"waiting: {action.text}")
        case Note() if action.text.startswith(("autopilot: ", "not granted")):
            typer.echo(action.text)
        case _:
            return
    sys.stdout.flush()
