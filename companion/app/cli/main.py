"""`companion`: flies a delivery beside an autopilot, checks beforehand that it can, and replays."""

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from companion.app.cli import calibrate, certify, export, fit_wind, monitor, replay, signing
from companion.core.base.errors import LeewayError, LinkClosedError
from companion.core.base.help_text import flow_help

EXIT_CODES = """Exit codes: 0 the mission ended (see result.json for how); 1 an error inside, the
mission aboard goes home; 2 a mistake in the input; 3 no take-off was possible, or the check found
something missing; 4 no autopilot on the link, or lost for good; 5 stopped by a signal; 6 the
link did not open (another program holds it, or its other end is not up yet): try again."""


class Commands(TyperGroup):
    """The companion's commands.

    A mistake in the input is one line on stderr and exit code 2; so is a link that does not open,
    with a code of its own: a service tries that again.
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


def _print_version(asked: bool) -> None:
    if not asked:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        typer.echo(f"companion {version('leeway-uas')}")
    except PackageNotFoundError:
        typer.echo("companion, from a checkout that is not installed")
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
    """Leeway's companion: brings a delivery drone home by its own return budget."""
    del version  # its callback has printed it


LinkUrl = Annotated[
    str,
    typer.Option(
        help="The autopilot: udpin:HOST:PORT (listen), udpout:HOST:PORT or tcp:HOST:PORT (call),"
        " serial:DEVICE:BAUD."
    ),
]
Mission = Annotated[
    Path,
    typer.Option(help="The flight: a flight/1 TOML file, or a name in params/flights (default)."),
]
AirframeName = Annotated[
    str | None,
    typer.Option(help="An airframe in params/airframes, or a .toml file; default: the flight's."),
]
WindProcess = Annotated[
    str | None,
    typer.Option(
        help="How wind changes at the site: a name in params/wind, or a .toml file from"
        " `companion fit-wind`; default: the flight's mission.wind_process."
    ),
]
Params = Annotated[
    Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
]
Key = Annotated[
    Path | None, typer.Option(help="MAVLink signing key: 32 bytes or 64 hex digits in a file.")
]
System = Annotated[
    int | None, typer.Option(help="MAVLink system id of the vehicle; default: the first heard.")
]
Here = Annotated[
    bool,
    typer.Option(
        "--here",
        help="Lay the flight's site about where the vehicle stands, instead of its depot.",
    ),
]
RunDir = Annotated[Path, typer.Option(help="Where log, checkpoint and result go.")]
SilenceLimit = Annotated[
    float, typer.Option(help="Give up after so many seconds without an autopilot.")
]
VehicleSettings = Annotated[
    Path | None,
    typer.Option(
        help="Folder that remembers, by vehicle, which settings a flight changed until they are"
        " put back; default: `settings` in a service's state directory, else in"
        " ~/.local/state/leeway."
    ),
]
MonitorFolder = Annotated[
    Path | None,
    typer.Option(
        "--monitor",
        help="Keep a monitor of the vehicle's service, in this folder; default:"
        " `monitor` in a service's state directory, else none is kept.",
    ),
]
Pack = Annotated[
    str,
    typer.Option(
        help="Name of the pack that is aboard: the monitor follows each by itself.",
    ),
]


MaxLossPerHour = Annotated[
    float | None,
    typer.Option(
        min=1e-6,
        max=1.0,
        help="Losses per flight hour that you accept (docs: return-budget); default: those of the"
        " flight's mission, else its max_loss alone.",
    ),
]


class GateSwitch(StrEnum):
    """Whether the return budget may turn the vehicle back."""

    ON = "on"
    OFF = "off"


class HoldChoice(StrEnum):
    """What becomes of a HOLD that nobody asked for and nobody answers."""

    ALARM = "alarm"
    RETURN = "return"
    LAND = "land"


@app.command(name="run", epilog=EXIT_CODES)
def run_command(
    link: LinkUrl,
    mission: Annotated[
        Path | None,
        typer.Option(
            help="The flight: a flight/1 TOML file, or a name in params/flights (default); with"
            " --fleet the desk assigns one."
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
            help="MAVLink system whose orders count where nothing is signed, and only by the way"
            " that the autopilot was found on; may be repeated. Default: 255 (ground stations); the"
            " vehicle's own always counts.",
        ),
    ] = None,
    authorise: Annotated[
        bool,
        typer.Option(
            "--authorise", help="Authorise this mission: used once, never after a restart."
        ),
    ] = False,
    no_operator: Annotated[
        bool,
        typer.Option(
            "--no-operator",
            help="Take off although neither a ground station nor a desk reaches the companion.",
        ),
    ] = False,
    configure: Annotated[
        bool,
        typer.Option(
            "--configure",
            help="Set the autopilot parameters that the promise rests on, read them back, and put"
            " the old ones back after landing.",
        ),
    ] = False,
    here: Here = False,
    gate: Annotated[
        GateSwitch, typer.Option(help="off: never turns back; for comparison only.")
    ] = GateSwitch.ON,
    unanswered_hold: Annotated[
        HoldChoice,
        typer.Option(
            help="Where the autopilot holds because its mission was cleared or by a failsafe, and"
            " nobody answers the alarms: only go on with them, return to launch, or land"
            " (docs: safety-rules, rule 1)."
        ),
    ] = HoldChoice.ALARM,
    unanswered_after: Annotated[
        float, typer.Option(min=10.0, help="So many seconds after the first alarm.")
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
            help="For a simulated world that waits for the companion: the way is planned at once,"
            " so that every run decides the same.",
        ),
    ] = False,
    record_at_once: Annotated[
        bool,
        typer.Option(
            "--record-at-once",
            hidden=True,
            help="For a world that kills the companion: the flight waits for the disk, so that"
            " what is left of the record is the same in every run.",
        ),
    ] = False,
    fleet: Annotated[
        str | None,
        typer.Option(
            help="Serve the dispatcher's desk of this fleet over zenoh: without --mission fly what"
            " it assigns, one after another (docs: dispatch)."
        ),
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="This vehicle's name in the fleet, for example d1.")
    ] = None,
    zenoh: Annotated[
        Path | None,
        typer.Option(
            help="zenoh's configuration (JSON5); default: the identity's, else loopback only."
        ),
    ] = None,
    identity: Annotated[
        Path | None,
        typer.Option(
            help="This vehicle's folder of `ground-station pki`: then all messages are signed"
            " (docs: secure-a-fleet)."
        ),
    ] = None,
    open_network: Annotated[
        bool,
        typer.Option(
            "--open-network",
            help="Allow a network that lets strangers in: without TLS, or found by multicast.",
        ),
    ] = False,
    keep_apart: Annotated[
        bool,
        typer.Option(
            "--keep-apart",
            help="In a fleet: fly set-points near neighbours to keep separation, then go on with"
            " the mission (docs: avoidance). All vehicles of the fleet, and of its neighbours',"
            " should.",
        ),
    ] = False,
    policy: Annotated[
        str | None,
        typer.Option(
            help="With --keep-apart: the learned actor that wishes where to (params/policies, such"
            " as avoid, or a card's path); default: straight to the next item."
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(help="Accepted for scripts; the companion draws no random numbers.")
    ] = 0,
    max_loss_per_hour: MaxLossPerHour = None,
) -> None:
    """Fly the mission: plan, upload, wait for authorisation, deliver, come home.

    In a fleet: companion run --link serial:/dev/serial0:921600 --airframe m100 --fleet harbour
    --vehicle d1
    """
    del seed
    if keep_apart and fleet is None:
        raise LeewayError("--keep-apart: expected with --fleet and --vehicle: who is near?")
    if (fleet is None) != (vehicle is None):
        raise LeewayError("--fleet and --vehicle: expected both or neither")
    if mission is None and (fleet is None or airframe is None):
        raise LeewayError("--mission: expected a file, or --fleet, --vehicle and --airframe")
    if mission is None and authorise:
        raise LeewayError("--authorise: expected with --mission; the desk launches what it assigns")

    from companion.app.cli.flying import CommandLine, FleetLine, fly, fly_in_fleet
    from companion.core.pilot.context import PilotOptions, Unanswered

    pilot = PilotOptions(
        gate_on=gate is GateSwitch.ON,
        unanswered_hold=Unanswered(unanswered_hold.value),
        unanswered_hold_s=unanswered_after,
        configure=configure,
        authorise=authorise,
        here=here,
        keep_apart=keep_apart,
        name=vehicle or "",
        fleet=fleet or "",
        max_loss_per_hour=max_loss_per_hour,
        without_operator=no_operator,
    )
    asked = CommandLine(
        link, mission, airframe, wind_process, run_dir, params, signing_key, system, silence_limit
    ).options(pilot, policy=policy)
    asked = replace(asked, plan_at_once=lockstep, record_at_once=record_at_once)
    asked = replace(asked, settings_folder=settings_folder(vehicle_settings))
    asked = replace(asked, monitor_folder=folder_of_monitor(monitor_folder), pack=pack)
    if operator:
        asked = replace(asked, operators=tuple(operator))
    if fleet is None or vehicle is None:
        raise typer.Exit(fly(asked))

    from companion.fleet.zenoh_link import leave_process

    said = FleetLine(fleet, vehicle, zenoh, identity, open_network)
    leave_process(fly_in_fleet(said, asked, one_mission=mission is not None))


@app.command(epilog=EXIT_CODES)
def check(
    link: LinkUrl,
    mission: Mission,
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
    """Say in words what is missing or off for this mission; changes nothing on the autopilot."""
    from companion.app.cli.flying import CommandLine
    from companion.app.cli.flying import check as check_now
    from companion.core.pilot.context import PilotOptions

    asked = CommandLine(
        link, mission, airframe, wind_process, run_dir, params, signing_key, system, silence_limit
    ).options(PilotOptions(check_only=True, here=here))
    asked = replace(asked, settings_folder=settings_folder(vehicle_settings))
    asked = replace(asked, monitor_folder=folder_of_monitor(monitor_folder), pack=pack)
    raise typer.Exit(check_now(asked))


@app.command(epilog="Exit codes: 0 it has its own settings; 3 it has not; 4 no autopilot; 2, 6.")
def restore(
    link: LinkUrl,
    vehicle_settings: VehicleSettings = None,
    signing_key: Key = None,
    system: System = None,
    silence_limit: SilenceLimit = 20.0,
) -> None:
    """Give the vehicle the settings back that a flight which was cut off had changed.

    Example: companion restore --link serial:/dev/serial0:921600. Nothing is set while it is armed.
    """
    from companion.app.cli.flying import put_settings_back

    folder = settings_folder(vehicle_settings)
    raise typer.Exit(put_settings_back(link, folder, signing_key, system, silence_limit))


def settings_folder(named: Path | None) -> Path:
    """Where changed settings are remembered."""
    from companion.adapters.files.vehicle_settings import default_folder

    return named or default_folder()


def folder_of_monitor(named: Path | None) -> Path | None:
    """Where the monitor keeps its records; None: there is none."""
    from companion.adapters.files.monitor_file import default_monitor_folder

    return named or default_monitor_folder()


for part in (replay.app, export.app, fit_wind.app, calibrate.app, certify.app):
    app.registered_commands += part.registered_commands
app.add_typer(signing.app, name="signing")
app.add_typer(monitor.app, name="monitor")


@app.command()
def transitions(
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Draw instead of list.")] = False,
) -> None:
    """Print the mission's transition table."""
    from companion.core.pilot.transitions import as_markdown, as_mermaid

    typer.echo(as_mermaid() if mermaid else as_markdown())


flow_help(app)


def main() -> None:
    """Entry point of the console script."""
    app()


if __name__ == "__main__":
    main()
