"""`ground-station`: the dispatcher's commands, put together."""

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from companion.core.base.errors import LeewayError
from companion.core.base.help_text import reflow_command_help_in_place
from companion.core.base.safe_text import harmless_lines
from ground_station.app.cli import (
    audit,
    benchmark,
    cluster,
    dispatch,
    doctor,
    estimate,
    ground,
    handover,
    hold,
    live_map,
    pki,
    plan,
    ros2,
    router,
    store,
    token,
    truck,
    wind_station,
)
from ground_station.app.cli.orders import manifest, order, order_changes
from ground_station.app.options.desk_options import (
    DEFAULT_STORE,
    Date,
    FleetName,
    IdentityFolder,
    OpenNetwork,
    StoreFile,
    StoreUrl,
    UserName,
    ZenohFile,
)
from ground_station.app.options.program_options import (
    GroupWithOptions,
    reject_group_options_by_default,
)
from ground_station.app.options.settings_file import set_option_defaults_from_settings

DISTRIBUTIONS = ("leeway-uas", "leeway")
PROJECT_PACKAGES = ("companion", "ground_station")

app = typer.Typer(
    cls=GroupWithOptions,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Dispatcher's desk: plans, dispatches and monitors delivery drones.\n\n"
    "Options of several commands may be given before or after the command.",
)


def _installed_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    for name in DISTRIBUTIONS:
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return "not installed"


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"ground-station {_installed_version()}")
        raise typer.Exit


@app.callback()
def program_options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and end."
        ),
    ] = False,
    settings: Annotated[
        Path | None,
        typer.Option(
            "--settings",
            callback=set_option_defaults_from_settings,
            is_eager=True,
            metavar="FILE",
            help="Defaults of the options below, as TOML: store, store_file, user, identity, zenoh,"
            " fleet.",
            show_default="leeway-desk.toml in this folder, where it exists",
        ),
    ] = None,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: IdentityFolder = None,
    zenoh: ZenohFile = None,
    open_network: OpenNetwork = False,
    fleet: FleetName = None,
    date: Date = None,
) -> None:
    """Declare the options that several commands use; they may stand anywhere."""


app.add_typer(estimate.app)
app.add_typer(ground.app)
order_changes.add_commands(order.app)
app.add_typer(order.app, name="order")
app.add_typer(dispatch.app)
app.add_typer(doctor.app)
app.add_typer(manifest.app)
app.add_typer(pki.app, name="pki")
app.add_typer(router.app)
app.add_typer(hold.app)
app.add_typer(handover.app)
app.add_typer(audit.app)
app.add_typer(store.app, name="store")
app.add_typer(benchmark.benchmark, name="benchmark")
app.add_typer(cluster.app)
app.add_typer(plan.app)
app.add_typer(truck.app)
app.add_typer(wind_station.app)
app.add_typer(ros2.app)
app.add_typer(live_map.app)
app.add_typer(token.app)
reflow_command_help_in_place(app)
reject_group_options_by_default(app)


def main() -> None:
    """Entry point. A mistake in the input is one line on stderr and exit code 2."""
    try:
        app()
    except LeewayError as error:
        print(f"ground-station: {harmless_lines(str(error))}", file=sys.stderr)
        _exit_process(2)
    except ModuleNotFoundError as error:  # the vehicle's install has this script, not the desk
        if error.name is None or error.name.partition(".")[0] in PROJECT_PACKAGES:
            raise
        print(f"ground-station: {error}: run pip install 'leeway-uas[ground]'", file=sys.stderr)
        _exit_process(2)
    except SystemExit as end:
        _exit_process(end.code if isinstance(end.code, int) else int(end.code is not None))


def _exit_process(code: int) -> NoReturn:
    """Exit the process; zenoh requires its own exit if a command loaded it."""
    if "zenoh" in sys.modules:
        from companion.fleet.zenoh_link import flush_and_exit_process_immediately

        flush_and_exit_process_immediately(code)
    sys.exit(code)


if __name__ == "__main__":
    main()
