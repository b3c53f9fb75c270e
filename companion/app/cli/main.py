"""`companion`: flies a delivery beside an autopilot, checks beforehand that it can, and replays."""

import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console

from companion.adapters.files.params import read_flight, read_wind_process
from companion.app.cli import calibrate as calibrate_cli
from companion.app.cli.check_report import report
from companion.app.cli.replay import EPILOG as REPLAY_EPILOG
from companion.app.cli.replay import replay_command
from companion.app.flight.run import DONE, GROUNDED, NO_LINK, USAGE, RunOptions, run
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Action, Decision, Note, PhaseChanged, Say
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.transitions import Phase, as_markdown, as_mermaid

EXIT_CODES = """Exit codes: 0 the mission ended (see result.json for how); 1 an error inside, the
mission aboard goes home; 2 a mistake in the input; 3 no take-off was possible, or the check found
something missing; 4 no autopilot on the link, or lost for good; 5 stopped by a signal."""

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Leeway's companion: brings a delivery drone home by its own return budget.",
)

LinkUrl = Annotated[
    str,
    typer.Option(
        help="The autopilot: udpin:HOST:PORT (listen), udpout:HOST:PORT or tcp:HOST:PORT (call),"
        " serial:DEVICE:BAUD."
    ),
]
Mission = Annotated[Path, typer.Option(help="The flight, a flight/1 TOML file.")]
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


@dataclass(frozen=True, slots=True)
class _Where:
    """What `run` and `check` are both told: which vehicle, which flight, which folders."""

    link: str
    mission: Path | None
    airframe: str | None
    wind_process: str | None
    run_dir: Path
    params: Path | None
    signing_key: Path | None
    system: int | None
    silence_limit_s: float

    def options(self, pilot: PilotOptions) -> RunOptions:
        """With the airframe from the flight file where none was named."""
        try:
            airframe = self.airframe
            if airframe is None and self.mission is not None:
                airframe = read_flight(self.mission).vehicle.airframe
        except LeewayError as error:
            _mistake(error)
            raise
        return RunOptions(
            link=self.link,
            airframe=airframe or "",
            wind_process=self.wind_process,
            mission=self.mission or Path(),
            run_dir=self.run_dir,
            params=self.params,
            signing_key=self.signing_key,
            system_id=self.system,
            silence_limit_s=self.silence_limit_s,
            pilot=pilot,
        )


class Gate(StrEnum):
    """Whether the return budget may turn the vehicle back."""

    ON = "on"
    OFF = "off"


@app.command(name="run", epilog=EXIT_CODES)
def run_command(
    link: LinkUrl,
    mission: Annotated[
        Path | None,
        typer.Option(help="The flight, a flight/1 TOML file; with --fleet the desk assigns one."),
    ] = None,
    airframe: AirframeName = None,
    wind_process: WindProcess = None,
    run_dir: RunDir = Path("logs/companion"),
    params: Params = None,
    signing_key: Key = None,
    system: System = None,
    authorise: Annotated[
        bool,
        typer.Option(
            "--authorise", help="Authorise this mission: used once, never after a restart."
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
        Gate, typer.Option(help="off: never turns back; for comparison only.")
    ] = Gate.ON,
    silence_limit: SilenceLimit = 300.0,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep",
            help="The autopilot is simulated and waits for us: wait for slow work in turn, so that"
            " the same seed gives the same decisions. Never beside a real vehicle.",
        ),
    ] = False,
    fleet: Annotated[
        str | None,
        typer.Option(
            help="Serve the dispatcher's desk of this fleet over zenoh: without --mission fly what"
            " it assigns, one after another (docs/dispatch.md)."
        ),
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="This vehicle's name in the fleet, for example d1.")
    ] = None,
    zenoh: Annotated[
        Path | None,
        typer.Option(help="zenoh's configuration (JSON5); default: a peer, found by multicast."),
    ] = None,
    keep_apart: Annotated[
        bool,
        typer.Option(
            "--keep-apart",
            help="In a fleet: fly set-points near neighbours so that nobody comes near anybody, and"
            " hand back to the mission (docs/avoidance.md). All vehicles of the fleet should.",
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
) -> None:
    """Fly the mission: plan, upload, wait for authorisation, deliver, come home.

    In a fleet: companion run --link serial:/dev/serial0:921600 --airframe m100 --fleet harbour
    --vehicle d1
    """
    del seed
    pilot = PilotOptions(
        gate_on=gate is Gate.ON,
        configure=configure,
        authorise=authorise,
        here=here,
        keep_apart=keep_apart,
        name=vehicle or "",
    )
    if keep_apart and fleet is None:
        _mistake(LeewayError("--keep-apart: expected with --fleet and --vehicle: who is near?"))
    if (fleet is None) != (vehicle is None):
        _mistake(LeewayError("--fleet and --vehicle: expected both or neither"))
    if mission is None and (fleet is None or airframe is None):
        _mistake(LeewayError("--mission: expected a file, or --fleet, --vehicle and --airframe"))
    if mission is None and authorise:
        _mistake(
            LeewayError("--authorise: expected with --mission; the desk launches what it assigns")
        )
    where = _Where(
        link, mission, airframe, wind_process, run_dir, params, signing_key, system, silence_limit
    )
    options = replace(where.options(pilot), lockstep=lockstep, policy=policy)
    if fleet is not None and vehicle is not None:
        _run_in_fleet(fleet, vehicle, zenoh, options, mission)
    code, _ = _run(options, _show)
    raise typer.Exit(code)


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
) -> None:
    """Say in words what is missing or off for this mission; changes nothing on the autopilot."""
    where = _Where(
        link, mission, airframe, wind_process, run_dir, params, signing_key, system, silence_limit
    )
    code, pilot = _run(where.options(PilotOptions(check_only=True, here=here)), _show_check)
    if pilot.phase is not Phase.GROUNDED:
        typer.echo("no answer from an autopilot" if code == NO_LINK else "the check was cut short")
        raise typer.Exit(code)
    lines, ready = report(pilot)
    typer.echo("\n".join(lines))
    raise typer.Exit(DONE if ready else GROUNDED)


app.command(name="replay", epilog=REPLAY_EPILOG)(replay_command)


@app.command(name="fit-wind")
def fit_wind_command(
    logs: Annotated[
        list[Path], typer.Argument(help="Recordings: CSV of t_s, wind_speed_mps, wind_from_deg.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Write the process here, a wind-process/1 TOML file.")
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="The process's name; default: that of the file written.")
    ] = None,
    parts: Annotated[
        int, typer.Option(min=2, max=3, help="Ornstein-Uhlenbeck processes on each axis.")
    ] = 3,
    beside: Annotated[
        list[str] | None,
        typer.Option(help="Also judge this process (a name in params/wind, or a file) as it is."),
    ] = None,
    params: Params = None,
) -> None:
    """Fit how wind changes to recordings, and judge it on wind that was held out.

    Example: companion fit-wind site.csv --out params/wind/site.toml, then fly with
    --wind-process site. Samples that cannot be right are left out and named by line.
    """
    from companion.app.tools.fit_wind import fit_wind, read_recordings, show, write_process

    console = Console(stderr=True)
    try:
        label = name or (out.stem if out is not None else "fitted")
        others = tuple(read_wind_process(other, params) for other in beside or [])
        if out is not None and not out.parent.is_dir():
            raise LeewayError(f"{out.parent}: no such folder")
        recordings = read_recordings(logs, lambda words: typer.echo(words, err=True))
        found = fit_wind(recordings, label, parts, others, console)
        show(found, Console())
        if out is not None:
            words = ["companion", "fit-wind", *(p.name for p in logs), "--parts", str(parts)]
            words += [part for other in beside or [] for part in ("--beside", Path(other).name)]
            words += ["--name", label, "--out", out.name]
            write_process(found, logs, shlex.join(words), out)
            typer.echo(f"wrote {out}", err=True)
    except LeewayError as error:
        _mistake(error)


@app.command()
def transitions(
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Draw instead of list.")] = False,
) -> None:
    """Print the mission's transition table."""
    typer.echo(as_mermaid() if mermaid else as_markdown())


def _run_in_fleet(
    name: str, vehicle: str, zenoh: Path | None, options: RunOptions, mission: Path | None
) -> NoReturn:
    """Serve a desk, until the process ends; only who does so loads zenoh."""
    from companion.app.flight.fleet_run import FleetOptions, fly_one, serve
    from companion.fleet.zenoh_link import leave_process

    fleet = FleetOptions(name, vehicle, zenoh)
    try:
        if mission is not None:
            code = fly_one(fleet, options, _show)
        else:
            code = serve(fleet, options, say=typer.echo, on_action=_show)
    except LeewayError as error:
        _mistake(error)
    leave_process(code)


def _run(options: RunOptions, show: Callable[[Action], None]) -> tuple[int, Pilot]:
    try:
        return run(options, on_action=show)
    except LeewayError as error:
        _mistake(error)


def _mistake(error: LeewayError) -> NoReturn:
    typer.echo(f"companion: {error}", err=True)
    raise typer.Exit(USAGE) from error


def _show(action: Action) -> None:
    match action:
        case Say():
            typer.echo(f"  {action.text}")
        case PhaseChanged():
            typer.echo(f"{action.t_s:9.1f} s  {action.before} -> {action.now}")
        case Decision():
            promise = f"  p_home {action.p_home:.3f}" if action.p_home is not None else ""
            typer.echo(f"{action.t_s:9.1f} s  {action.kind}: {action.reason}{promise}")
        case Note() if action.text.startswith(("pre-flight", "not granted")):
            typer.echo(f"  {action.text}")
        case _:
            return
    sys.stdout.flush()


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


app.registered_commands += calibrate_cli.app.registered_commands


def main() -> None:
    """Entry point of the console script."""
    app()
