"""`companion`: flies a delivery beside an autopilot, and checks beforehand that it can."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from companion.app.run import GROUNDED, USAGE, RunOptions, run
from companion.core.actions import Action, Decision, Note, PhaseChanged, Say
from companion.core.before_flight import live_findings
from companion.core.errors import LeewayError
from companion.core.pilot import Pilot, PilotOptions
from companion.core.transitions import as_markdown, as_mermaid

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
Params = Annotated[
    Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
]
Key = Annotated[
    Path | None, typer.Option(help="MAVLink signing key: 32 bytes or 64 hex digits in a file.")
]
System = Annotated[
    int | None, typer.Option(help="MAVLink system id of the vehicle; default: the first heard.")
]
RunDir = Annotated[Path, typer.Option(help="Where log, checkpoint and result go.")]


class Gate(StrEnum):
    """Whether the return budget may turn the vehicle back."""

    ON = "on"
    OFF = "off"


@app.command(name="run", epilog=EXIT_CODES)
def run_command(
    link: LinkUrl,
    mission: Mission,
    airframe: AirframeName = None,
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
    gate: Annotated[
        Gate, typer.Option(help="off: never turns back; for comparison only.")
    ] = Gate.ON,
    silence_limit: Annotated[
        float, typer.Option(help="Give up after so many seconds without an autopilot.")
    ] = 300.0,
    seed: Annotated[
        int, typer.Option(help="Accepted for scripts; the companion draws no random numbers.")
    ] = 0,
) -> None:
    """Fly the mission: plan, upload, wait for authorisation, deliver, come home."""
    del seed
    options = _options(
        RunOptions(
            link=link,
            airframe=airframe or "",
            mission=mission,
            run_dir=run_dir,
            params=params,
            signing_key=signing_key,
            system_id=system,
            silence_limit_s=silence_limit,
            pilot=PilotOptions(gate_on=gate is Gate.ON, configure=configure, authorise=authorise),
        )
    )
    code, _ = _run(options)
    raise typer.Exit(code)


@app.command(epilog=EXIT_CODES)
def check(
    link: LinkUrl,
    mission: Mission,
    airframe: AirframeName = None,
    run_dir: RunDir = Path("logs/companion-check"),
    params: Params = None,
    signing_key: Key = None,
    system: System = None,
    silence_limit: Annotated[
        float, typer.Option(help="Give up after so many seconds without an autopilot.")
    ] = 60.0,
) -> None:
    """Say in words what is missing or off for this mission; changes nothing on the autopilot."""
    options = _options(
        RunOptions(
            link=link,
            airframe=airframe or "",
            mission=mission,
            run_dir=run_dir,
            params=params,
            signing_key=signing_key,
            system_id=system,
            silence_limit_s=silence_limit,
            pilot=PilotOptions(check_only=True),
        )
    )
    code, pilot = _run(options)
    if pilot.phase.name != "GROUNDED":
        typer.echo("no answer from an autopilot" if code == 4 else "the check was cut short")
        raise typer.Exit(code)
    raise typer.Exit(_tell(pilot))


@app.command()
def transitions(
    mermaid: Annotated[bool, typer.Option("--mermaid", help="Draw instead of list.")] = False,
) -> None:
    """Print the mission's transition table."""
    typer.echo(as_mermaid() if mermaid else as_markdown())


def _options(options: RunOptions) -> RunOptions:
    """Take the airframe from the flight file where none was named."""
    if options.airframe:
        return options
    from dataclasses import replace

    from companion.adapters.files import read_flight

    try:
        return replace(options, airframe=read_flight(options.mission).vehicle.airframe)
    except LeewayError as error:
        _mistake(error)
        raise


def _run(options: RunOptions) -> tuple[int, Pilot]:
    try:
        return run(options, on_action=_show)
    except LeewayError as error:
        _mistake(error)
        raise


def _mistake(error: LeewayError) -> None:
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
        case Note() if "pre-flight" in action.text:
            typer.echo(f"  {action.text}")
        case _:
            return
    sys.stdout.flush()


def _tell(pilot: Pilot) -> int:
    """Print the pre-flight; 0 when nothing is missing."""
    ground = pilot.ground
    if ground.giving_up:
        typer.echo(f"MISSING  {ground.giving_up}")
        return GROUNDED
    findings = live_findings(pilot)
    for finding in findings:
        word = "WAITING" if finding.waits else "MISSING" if finding.blocks else "off    "
        typer.echo(f"{word}  {finding.words}")
    energy = pilot.judge.energy
    if energy is not None:
        typer.echo(
            f"ok       battery: {energy.mean_wh:.0f} Wh usable, one sigma {energy.std_wh:.0f} Wh"
            f" ({energy.source})"
        )
    if pilot.flown is not None:
        plan = pilot.flown.plan
        typer.echo(
            f"ok       route: {len(plan.outbound_ned_m)} waypoints out,"
            f" {len(plan.return_ned_m)} back, {plan.energy_wh:.0f} Wh in calm air as believed"
        )
    blocked = any(finding.blocks for finding in findings)
    typer.echo("NOT READY" if blocked else "READY")
    return GROUNDED if blocked else 0


def main() -> None:
    """Entry point of the console script."""
    app()
