"""`companion`: flies deliveries through an autopilot, checks the vehicle, replays logs."""

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from companion.app.cli import calibrate, certify, export, fit_wind, monitor, replay, signing
from companion.app.cli.options import (
    AirframeName,
    Here,
    Init,
    Key,
    LinkUrl,
    MaxLossPerHour,
    Mission,
    MonitorFolder,
    Pack,
    Params,
    RunDir,
    SilenceLimit,
    System,
    VehicleSettings,
    WindProcess,
)
from companion.core.base.errors import LeewayError, LinkClosedError
from companion.core.base.help_text import reflow_command_help_in_place

EXIT_CODES = """Exit codes: 0 the mission ended (result.json states how); 1 internal error, the
vehicle goes on without it; 2 invalid input; 3 take-off not possible; 4 no autopilot on
the link, or link lost; 5 stopped by a signal; 6 the link did not open (in use by another program,
or the other end is not running): retry."""

CHECK_EXIT_CODES = """Exit codes: 0 ready; 1 internal error; 2 invalid input; 3 not ready, or not
checked because the vehicle is armed or another controller has it; 4 no autopilot on the link, or
link lost; 5 stopped by a signal; 6 the link did not open: retry."""


class Commands(TyperGroup):
    """Command group of the companion.

    Invalid input is reported as one line on stderr with exit code 2. A link that does not open
    has exit code 6, so that a service can retry.
    """

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except LeewayError as error:
            from companion.app.flight.run import LINK_CLOSED, USAGE

            typer.echo(f"companion: {error}", err=True)
            code = LINK_CLOSED if isinstance(error, LinkClosedError) else USAGE
            raise typer.Exit(code) from error


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _print_version(requested: bool) -> None:
    if not requested:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        typer.echo(f"companion {version('leeway-uas')}")
    except PackageNotFoundError:
        typer.echo("companion: running from a checkout, not installed")
    raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Leeway's onboard companion: returns delivery drones within their energy budget.

    P(home): probability of landing at home with the reserve. Gate: turns back at a low P(home).
    """
    del version  # handled by its callback


class GateSwitch(StrEnum):
    """Whether the return budget may turn the vehicle back."""

    ON = "on"
    OFF = "off"


class HoldChoice(StrEnum):
    """Response to an unrequested HOLD that the operator does not acknowledge."""

    ALARM = "alarm"
    RETURN = "return"
    LAND = "land"


@app.command(name="run", epilog=EXIT_CODES)
def run_command(
    link: LinkUrl,
    mission: Annotated[
        Path | None,
        typer.Option(
            help="Flight: a flight/1 TOML file, or a name in params/flights, such as `default`."
            " Required, unless the desk assigns missions (--fleet, --vehicle, --airframe)."
        ),
    ] = None,
    airframe: AirframeName = None,
    wind_process: WindProcess = None,
    run_dir: RunDir = Path("logs/companion"),
    params: Params = None,
    signing_key: Key = None,
    system: System = None,
    operator: Annotated[
        list[int] | None,
        typer.Option(
            min=1,
            max=255,
            help="MAVLink system id whose commands are accepted without signing, on the"
            " autopilot's channel only; repeatable. Default: 255 (ground stations); the vehicle's"
            " own id is always accepted.",
        ),
    ] = None,
    authorise: Annotated[
        bool,
        typer.Option(
            "--authorise",
            help="Authorise this mission once; not valid after a restart. Default: an operator"
            " authorises it (MAVLink MISSION_START), or the desk.",
        ),
    ] = False,
    no_operator: Annotated[
        bool,
        typer.Option(
            "--no-operator",
            help="Permit take-off without contact to a ground station or desk; does not authorise.",
        ),
    ] = False,
    configure: Annotated[
        bool,
        typer.Option(
            "--configure",
            help="Set the autopilot parameters that P(home) depends on, verify them, and restore"
            " the original values after landing.",
        ),
    ] = False,
    here: Here = False,
    gate: Annotated[
        GateSwitch, typer.Option(help="off: the gate never turns back; for comparison only.")
    ] = GateSwitch.ON,
    unanswered_hold: Annotated[
        HoldChoice,
        typer.Option(
            help="Action if the autopilot holds after a failsafe or a cleared mission and the"
            " operator does not respond: repeat the alarm, return to launch, or land"
            " (docs: safety-rules, rule 1)."
        ),
    ] = HoldChoice.ALARM,
    unanswered_after: Annotated[
        float, typer.Option(min=10.0, help="Delay of that action after the first alarm, s.")
    ] = 30.0,
    silence_limit: SilenceLimit = 300.0,
    vehicle_settings: VehicleSettings = None,
    monitor_folder: MonitorFolder = None,
    pack: Pack = "unnamed",
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep",
            hidden=True,
            help="For a simulator that waits for the companion: plans synchronously, so that"
            " decisions are reproducible.",
        ),
    ] = False,
    record_at_once: Annotated[
        bool,
        typer.Option(
            "--record-at-once",
            hidden=True,
            help="For a simulator that kills the companion: writes the record synchronously, so"
            " that its remainder is reproducible.",
        ),
    ] = False,
    fleet: Annotated[
        str | None,
        typer.Option(
            help="Connect to this fleet's desk (`ground-station dispatch`) over zenoh; without"
            " --mission, fly the missions that it assigns (docs: dispatch)."
        ),
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Name of this vehicle in the fleet, for example d1.")
    ] = None,
    zenoh: Annotated[
        Path | None,
        typer.Option(
            help="zenoh configuration (JSON5); default: the identity's, else loopback only."
        ),
    ] = None,
    identity: Annotated[
        Path | None,
        typer.Option(
            help="Folder of this vehicle from `ground-station pki`; signs all messages"
            " (docs: secure-a-fleet)."
        ),
    ] = None,
    open_network: Annotated[
        bool,
        typer.Option(
            "--open-network",
            help="Permit a network without TLS or with multicast discovery, which anyone can join.",
        ),
    ] = False,
    keep_apart: Annotated[
        bool,
        typer.Option(
            "--keep-apart",
            help="Keep separation from other vehicles by set-points, then resume the mission"
            " (docs: avoidance). Use it on all vehicles of the fleet and of neighbouring fleets.",
        ),
    ] = False,
    policy: Annotated[
        str | None,
        typer.Option(
            help="With --keep-apart: learned policy that proposes velocities (a name in"
            " params/policies, or a card's path); default: straight to the next mission item."
        ),
    ] = None,
    max_loss_per_hour: MaxLossPerHour = None,
) -> None:
    """Fly a mission: plan, upload, wait for authorisation, deliver, return.

    In a fleet: companion run --link serial:/dev/serial0:921600 --airframe m100 --fleet harbour
    --vehicle d1
    """
    if keep_apart and fleet is None:
        raise LeewayError("--keep-apart: expected --fleet and --vehicle, which provide traffic")
    if (fleet is None) != (vehicle is None):
        raise LeewayError("--fleet and --vehicle: expected both or neither")
    if mission is None and (fleet is None or airframe is None):
        raise LeewayError("--mission: expected a file, or --fleet, --vehicle and --airframe")
    if mission is None and authorise:
        raise LeewayError(
            "--authorise: expected --mission; the desk authorises missions that it assigns"
        )

    from companion.app.cli import flying
    from companion.core.pilot.context import PilotOptions, UnansweredHoldAction

    pilot = PilotOptions(
        gate_enabled=gate is GateSwitch.ON,
        unanswered_hold_action=UnansweredHoldAction(unanswered_hold.value),
        unanswered_hold_s=unanswered_after,
        configure=configure,
        authorise=authorise,
        centre_on_vehicle=here,
        separation_enabled=keep_apart,
        name=vehicle or "",
        fleet=fleet or "",
        max_loss_per_hour=max_loss_per_hour,
        without_operator=no_operator,
    )
    requested = flying.run_options(
        link=link,
        mission=mission,
        airframe=airframe,
        wind_process=wind_process,
        run_dir=run_dir,
        params=params,
        signing_key=signing_key,
        system_id=system,
        silence_limit_s=silence_limit,
        settings_folder=vehicle_settings,
        monitor_folder=monitor_folder,
        pack=pack,
        policy=policy,
        plan_synchronously=lockstep,
        record_synchronously=record_at_once,
        pilot=pilot,
    )
    if operator:
        requested = replace(requested, operators=tuple(operator))
    if fleet is None or vehicle is None:
        raise typer.Exit(flying.fly_and_return_exit_code(requested))

    from companion.app.flight.fleet_run import FleetOptions
    from companion.fleet.membership import JoinOptions
    from companion.fleet.zenoh_link import flush_and_exit_process_immediately

    options = FleetOptions(fleet, vehicle, zenoh, JoinOptions(identity, open_network))
    flush_and_exit_process_immediately(
        flying.fly_in_fleet_and_return_exit_code(
            options, requested, one_mission=mission is not None
        )
    )


@app.command(epilog=CHECK_EXIT_CODES)
def check(
    mission: Mission,
    link: LinkUrl = "",
    init: Init = None,
    airframe: AirframeName = None,
    wind_process: WindProcess = None,
    run_dir: RunDir = Path("logs/companion-check"),
    params: Params = None,
    signing_key: Key = None,
    system: System = None,
    here: Here = False,
    silence_limit: SilenceLimit = 60.0,
    vehicle_settings: VehicleSettings = None,
    monitor_folder: MonitorFolder = None,
    pack: Pack = "unnamed",
) -> None:
    """Check the vehicle for a mission without changing the autopilot.

    First flight file: companion check --init autopilot --mission my.toml --link udpin:0.0.0.0:14540
    """
    from companion.app.cli import flying
    from companion.core.pilot.context import PilotOptions

    if init is not None:
        code = flying.init_and_exit_code_unless_checkable(
            init, link, mission, airframe, signing_key, system, silence_limit
        )
        if code is not None:
            raise typer.Exit(code)
    elif not link:
        raise LeewayError("--link: expected, except with --init and a plan")
    requested = flying.run_options(
        link=link,
        mission=mission,
        airframe=airframe,
        wind_process=wind_process,
        run_dir=run_dir,
        params=params,
        signing_key=signing_key,
        system_id=system,
        silence_limit_s=silence_limit,
        settings_folder=vehicle_settings,
        monitor_folder=monitor_folder,
        pack=pack,
        pilot=PilotOptions(check_only=True, centre_on_vehicle=here),
    )
    raise typer.Exit(flying.check_vehicle_and_return_exit_code(requested))


@app.command(epilog="Exit codes: 0 restored; 3 not restored; 4 no autopilot; 2, 6 as for run.")
def restore(
    link: LinkUrl,
    vehicle_settings: VehicleSettings = None,
    signing_key: Key = None,
    system: System = None,
    silence_limit: SilenceLimit = 20.0,
) -> None:
    """Restore autopilot settings that an interrupted flight left changed.

    The vehicle must be disarmed. Example: companion restore --link serial:/dev/serial0:921600
    """
    from companion.app.cli.flying import restore_settings_and_return_exit_code as restore_now

    raise typer.Exit(restore_now(link, vehicle_settings, signing_key, system, silence_limit))


for part in (replay.app, export.app, fit_wind.app, calibrate.app, certify.app, monitor.app):
    app.registered_commands += part.registered_commands
app.add_typer(signing.app, name="signing")
reflow_command_help_in_place(app)


def main() -> None:
    """Entry point of the console script."""
    app()


if __name__ == "__main__":
    main()
