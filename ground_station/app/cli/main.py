"""`ground-station`: the dispatcher's commands, put together."""

import sys
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

DISTRIBUTIONS = ("leeway-uas", "leeway")

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="The dispatcher's desk. It plans with the energy model that the vehicles fly with.",
)


def _installed_version() -> str:
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


def main() -> None:
    """Entry point. A mistake in the input is one line on stderr and exit code 2."""
    try:
        from ground_station.adapters.zenoh_fleet import leave_process
        from ground_station.app.cli import cluster, dispatch, estimate, order, plan, truck
        from ground_station.app.cli.benchmark import benchmark
    except ImportError as error:  # the vehicle's install has this script, but not the desk
        print(f"ground-station: pip install 'leeway-uas[ground]' ({error})", file=sys.stderr)
        sys.exit(2)
    app.add_typer(estimate.app)
    app.add_typer(order.app, name="order")
    app.add_typer(dispatch.app)
    app.add_typer(benchmark, name="benchmark")
    app.add_typer(cluster.app)
    app.add_typer(plan.app)
    app.add_typer(truck.app)
    try:
        app()
    except LeewayError as error:
        print(f"ground-station: {error}", file=sys.stderr)
        leave_process(2)
    except SystemExit as end:
        leave_process(end.code if isinstance(end.code, int) else int(end.code is not None))


if __name__ == "__main__":
    main()
