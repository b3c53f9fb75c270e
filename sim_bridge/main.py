"""`sim-bridge`: simulated vehicles that speak MAVLink as real autopilots do.

Composes the commands of `sim_bridge.app` with those of `sim_bridge.research`, which nothing that
flies imports.
"""

import signal
import sys
import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from companion.core.base.errors import LeewayError
from companion.core.base.help_text import reflow_command_help_in_place
from ground_station.app.options.program_options import (
    GroupWithOptions,
    reject_group_options_by_default,
)
from sim_bridge.adapters.errors import EndpointError
from sim_bridge.app.cli import conform, cross, day, examples, faults, fly, serve, trials
from sim_bridge.app.cli.options import (
    CaseOption,
    ClusterOption,
    JobsOption,
    JsonOption,
    MinutesOption,
    OutOption,
    RunFolderOption,
    SeedOption,
)
from sim_bridge.app.flight.stopping import FORCE_EXIT, exit_on_signal
from sim_bridge.research.cli import main as research
from sim_bridge.truth.errors import TruthError


class Commands(GroupWithOptions):
    """The simulator's commands, and their old spellings."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands:
            args = replace_deprecated_spelling(args)
        return super().parse_args(ctx, args)


def replace_deprecated_spelling(args: list[str]) -> list[str]:
    """Replace an old spelling at the start of a command line, and print the current one."""
    old = current_spelling_by_deprecated()
    for count in (2, 1):
        words = " ".join(args[:count])
        if words in old:
            typer.echo(f"sim-bridge {words} is now sim-bridge {old[words]}", err=True)
            return [*old[words].split(), *args[count:]]
    return args


def current_spelling_by_deprecated() -> dict[str, str]:
    """Return the current spelling of each old one (deprecated.toml)."""
    text = Path(__file__).with_name("deprecated.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)["sim-bridge"]


app = typer.Typer(
    cls=Commands, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


def _print_version_and_exit(requested: bool) -> None:
    if not requested:
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
            "--version",
            callback=_print_version_and_exit,
            is_eager=True,
            help="Print the version and exit.",
        ),
    ] = False,
    seed: SeedOption = None,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    minutes: MinutesOption = None,
    json_out: JsonOption = None,
    out: OutOption = None,
    runs: RunFolderOption = None,
    case: CaseOption = None,
) -> None:
    """Software in the loop without hardware: simulated PX4 and ArduCopter vehicles in simulated
    wind, flown by real companions over MAVLink.
    """


for part in (fly, day, examples, faults, cross, serve, conform, trials):
    app.registered_commands += part.app.registered_commands
app.add_typer(research.app, name="research")
reflow_command_help_in_place(app)
reject_group_options_by_default(app)


def main() -> None:
    """Entry point: a mistake in the input is one line on stderr and exit code 2."""
    exit_on_signal(signal.SIGTERM)
    FORCE_EXIT.clear()  # this command's word: an earlier one's may have been in the process
    try:
        _run_app()
    except SystemExit as ended:
        if FORCE_EXIT.is_set():
            from companion.fleet.zenoh_link import flush_and_exit_process_immediately

            flush_and_exit_process_immediately(ended.code if isinstance(ended.code, int) else 0)
        raise


def _run_app() -> None:
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
