"""The command line of `sim-bridge conform`: does a vehicle behave as a real autopilot does?"""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import command_class_with_options
from sim_bridge.app.cli.options import run_options

app = typer.Typer(add_completion=False, no_args_is_help=True)


class ReferenceAutopilot(StrEnum):
    """Whose recorded answers to judge by."""

    px4 = "px4"
    ardupilot = "ardupilot"


@app.command(cls=command_class_with_options("json_out"))
def conform(
    link: Annotated[
        str | None,
        typer.Option(
            help="udpin:HOST:PORT listens, udpout:HOST:PORT and tcp:HOST:PORT call,"
            " serial:DEVICE[:BAUD] opens. ArduPilot's SITL: tcp:127.0.0.1:5760; PX4's SIH:"
            " udpin:127.0.0.1:14540; ours: what `sim-bridge serve` prints."
        ),
    ] = None,
    as_: Annotated[
        ReferenceAutopilot | None,
        typer.Option("--as", help="Judge by the recorded answers of the real one."),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Judge by this result in place of the recorded one.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(help="A family (mission), a name (mission/nan) or a pattern; repeatable."),
    ] = None,
    reboots: Annotated[
        bool, typer.Option("--reboots", help="Include reboots; the autopilot must restart itself.")
    ] = False,
    list_them: Annotated[bool, typer.Option("--list", help="Name the behaviours.")] = False,
    compare: Annotated[
        tuple[Path, Path] | None,
        typer.Option(help="Print the parity matrix of two results, the reference first."),
    ] = None,
    not_a_simulator: Annotated[
        bool, typer.Option("--not-a-simulator", help="Permit a --link that leaves this machine.")
    ] = False,
    yes_it_may_fly: Annotated[
        bool, typer.Option("--yes-it-may-fly", help="Permit the vehicle on that link to take off.")
    ] = False,
) -> None:
    """Test how a vehicle behaves: telemetry, missions, modes, set-points, acknowledgements.

    Takes a PX4 or ArduCopter multirotor on the ground, disarmed, with some 350 m of room, flies it
    at 20 m and puts everything back: missions cleared, parameters and message rates as they were,
    landed and disarmed, also after Ctrl-C. A --link that leaves this machine (127.0.0.1) needs
    --not-a-simulator and --yes-it-may-fly. All times are the vehicle's: simulators may run fast.

    With --as, each behaviour is judged: exit code 1 if one differs that differences.toml does not
    explain. 2: invalid input.

        sim-bridge conform --link tcp:127.0.0.1:5760 --json mine.json

        sim-bridge conform --link udpin:127.0.0.1:14540 --as px4 --only guided

        sim-bridge conform --compare tests/reference/px4.json mine.json
    """
    from sim_bridge.app.cli import conforming
    from sim_bridge.conform.errors import ConformError
    from sim_bridge.conform.link import is_on_loopback
    from sim_bridge.conform.suite import select_behaviours

    try:
        if compare is not None:
            conforming.print_parity_matrix(*compare, autopilot=as_)
        elif list_them:
            for one in select_behaviours(only or (), include_reboots=True):
                print(f"{one.name:36} {one.description} ... ({one.where.value})")
        elif link is None:
            raise ConformError("give --link URL, --compare A.json B.json or --list")
        elif not ((not_a_simulator and yes_it_may_fly) or is_on_loopback(link)):
            raise ConformError(
                f"--link {link} leaves this machine: the suite arms, flies and lands what is behind"
                " it; it is meant for simulators on this machine (127.0.0.1). To run it elsewhere"
                " give --not-a-simulator and --yes-it-may-fly"
            )
        else:
            selected = select_behaviours(only or (), include_reboots=reboots)
            verdict_reference = None
            if as_ is not None or reference is not None:
                verdict_reference = conforming.Reference(as_.value if as_ else "", reference)
            conforming.run_behaviours_and_print_verdicts(
                link, selected, verdict_reference, run_options().json_out
            )
    except ConformError as error:
        raise LeewayError(str(error)) from error
