"""`ground-station`: the dispatcher's commands, put together."""

import sys
from typing import Annotated, NoReturn

import typer

from companion.core.base.errors import LeewayError
from companion.core.base.help_text import flow_help
from ground_station.app.cli import (
    audit,
    benchmark,
    cluster,
    dispatch,
    estimate,
    ground,
    hold,
    live_map,
    order,
    pki,
    plan,
    router,
    store,
    token,
    truck,
    wind_station,
)

DISTRIBUTIONS = ("leeway-uas", "leeway")
OURS = ("companion", "ground_station")

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="The dispatcher's desk. It plans with the energy model that the vehicles fly with.",
)


def _installed_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    for name in DISTRIBUTIONS:
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return "not installed"


def _print_version(wanted: bool) -> None:
    if wanted:
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
) -> None:
    """Options of the program itself."""


app.add_typer(estimate.app)
app.add_typer(ground.app)
app.add_typer(order.app, name="order")
app.add_typer(dispatch.app)
app.add_typer(pki.app, name="pki")
app.add_typer(router.app)
app.add_typer(hold.app)
app.add_typer(audit.app)
app.add_typer(store.app, name="store")
app.add_typer(benchmark.benchmark, name="benchmark")
app.add_typer(cluster.app)
app.add_typer(plan.app)
app.add_typer(truck.app)
app.add_typer(wind_station.app)
app.add_typer(live_map.app)
app.add_typer(token.app, name="token")
flow_help(app)


def main() -> None:
    """Entry point. A mistake in the input is one line on stderr and exit code 2."""
    try:
        app()
    except LeewayError as error:
        print(f"ground-station: {error}", file=sys.stderr)
        _leave(2)
    except ModuleNotFoundError as error:  # the vehicle's install has this script, not the desk
        if error.name is None or error.name.partition(".")[0] in OURS:
            raise
        print(f"ground-station: pip install 'leeway-uas[ground]' ({error})", file=sys.stderr)
        _leave(2)
    except SystemExit as end:
        _leave(end.code if isinstance(end.code, int) else int(end.code is not None))


def _leave(code: int) -> NoReturn:
    """End the process, as zenoh asks for where a command has loaded it."""
    if "zenoh" in sys.modules:
        from companion.fleet.zenoh_link import leave_process

        leave_process(code)
    sys.exit(code)


if __name__ == "__main__":
    main()
