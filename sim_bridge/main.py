"""`sim-bridge`: simulated vehicles that speak MAVLink as real autopilots do.

Composes the commands of `sim_bridge.app` with those of `sim_bridge.research`, which nothing that
flies imports.
"""

import signal
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from companion.core.base.errors import LeewayError
from companion.core.base.help_text import flow_help
from sim_bridge.adapters.errors import EndpointError
from sim_bridge.app.cli import conform, cross, day, examples, faults, fly, fly_plan, serve, trials
from sim_bridge.app.flight.stopping import LEAVES_AT_ONCE, stop_by_signal
from sim_bridge.research.cli import main as research
from sim_bridge.truth.errors import TruthError


class Commands(TyperGroup):
    """The simulator's commands; the old spelling of a research command still finds it."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args and args[0] in research.OLD_SPELLINGS:
            now = research.OLD_SPELLINGS[args[0]]
            words = " ".join(("sim-bridge", *now))
            typer.echo(f"sim-bridge {args[0]} is now {words}", err=True)
            args = [*now, *args[1:]]
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=Commands, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


def _print_version(asked: bool) -> None:
    if not asked:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        typer.echo(f"sim-bridge {version('leeway-uas')}")
    except PackageNotFoundError:
        typer.echo("sim-bridge, from a checkout that is not installed")
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
    """Software in the loop without hardware: simulated PX4 and ArduCopter vehicles in true wind,
    flown by real companions over MAVLink.
    """
    del version  # its callback has printed it


for part in (fly, day, examples, faults, cross, serve, conform, fly_plan):
    app.registered_commands += part.app.registered_commands
app.registered_groups += trials.group.registered_groups
app.add_typer(research.app, name="research")
flow_help(app)


def main() -> None:
    """Entry point: a mistake in the input is one line on stderr and exit code 2."""
    stop_by_signal(signal.SIGTERM)
    LEAVES_AT_ONCE.clear()  # this command's word: an earlier one's may have been in the process
    try:
        _run()
    except SystemExit as ended:
        if LEAVES_AT_ONCE.is_set():
            from companion.fleet.zenoh_link import leave_process

            leave_process(ended.code if isinstance(ended.code, int) else 0)
        raise


def _run() -> None:
    try:
        app()
    except KeyboardInterrupt:
        print("sim-bridge: stopped; run folders keep what was written", file=sys.stderr)
        sys.exit(130)
    except (LeewayError, TruthError, EndpointError) as error:
        print(f"sim-bridge: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
