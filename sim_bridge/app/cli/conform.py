"""`sim-bridge conform`: what a vehicle does, and whether it does as a real autopilot does."""

import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Protocol

import typer
from rich.console import Console
from rich.status import Status

from companion.core.base.errors import LeewayError
from sim_bridge.conform.behaviour import Behaviour
from sim_bridge.conform.client import Client
from sim_bridge.conform.errors import CannotSee, ConformError
from sim_bridge.conform.link import is_on_loopback, open_link
from sim_bridge.conform.reference import (
    ConformanceResult,
    Parity,
    as_result,
    judge,
    judge_all,
    matrix,
    read_differences,
    read_result,
    reference_folder,
    tally,
    write_result,
)
from sim_bridge.conform.subject import Subject
from sim_bridge.conform.suite import (
    BehaviourRecord,
    Observer,
    VehicleIdentity,
    identify,
    run_suite,
    select,
)

app = typer.Typer(add_completion=False, no_args_is_help=True)

_FLIES = (
    "the suite arms, flies and lands what is behind it; it is meant for simulators on this"
    " machine (127.0.0.1). To run it elsewhere give --not-a-simulator and --yes-it-may-fly"
)


class As(StrEnum):
    """Whose recorded answers to judge by."""

    px4 = "px4"
    ardupilot = "ardupilot"


class _View:
    """One line for each behaviour as it ends; the one under way on the last line."""

    def __init__(self, console: Console, total: int, reference: "_Reference | None") -> None:
        self._console = console
        self._total = total
        self._reference = reference
        self._number = 0
        self._status = Status("", console=console)

    def __enter__(self) -> "_View":
        self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._status.stop()

    def begins(self, behaviour: Behaviour) -> None:
        """Show what is looked at."""
        self._number += 1
        self._status.update(f"{self._number} of {self._total}: {behaviour.name}")

    def ended(self, row: BehaviourRecord) -> None:
        """Print what was seen, and the verdict where there is one."""
        verdict = "" if self._reference is None else self._reference.word(row)
        seen = row.problem and f"not seen: {row.problem}"
        value = seen or f"{row.value} {row.behaviour.unit}".strip()
        note = f"  ({row.note})" if row.note else ""
        line = f"{verdict}{row.behaviour.name}: {row.behaviour.says} {value}{note}"
        self._console.print(line, highlight=False, markup=False)

    def says(self, words: str) -> None:
        """Show a state."""
        self._status.update(words)


class _Reference:
    """Recorded answers to judge by."""

    def __init__(self, flavour: str, path: Path | None) -> None:
        folder = reference_folder() if path is None else path.parent
        self.result = read_result(path or folder / f"{flavour}.json")
        self.reasons = read_differences(folder, flavour)

    def word(self, row: BehaviourRecord) -> str:
        """The verdict on one row, as a mark in front of its line."""
        answer = as_result(self.result.vehicle, [row]).answers[row.behaviour.name]
        reference = self.result.answers.get(row.behaviour.name)
        verdict = judge(row.behaviour, answer, reference, self.reasons)
        if verdict in (Parity.SAME, Parity.NO_REFERENCE):
            return "= " if verdict is Parity.SAME else "? "
        expected = None if reference is None else reference.value
        return f"{verdict.value.upper()} from {expected!r}: "


@app.command()
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
        As | None,
        typer.Option("--as", help="Judge by the recorded answers of the real one."),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Judge by this result in place of the recorded one.")
    ] = None,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write what was seen here as JSON.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(help="A family (mission), a name (mission/nan) or a pattern; repeatable."),
    ] = None,
    reboots: Annotated[
        bool, typer.Option("--reboots", help="Also what needs the autopilot to reboot by itself.")
    ] = False,
    list_them: Annotated[bool, typer.Option("--list", help="Name the behaviours.")] = False,
    compare: Annotated[
        tuple[Path, Path] | None,
        typer.Option(help="Print the parity matrix of two results, the reference first."),
    ] = None,
    not_a_simulator: Annotated[
        bool, typer.Option("--not-a-simulator", help="The link does not stay on this machine.")
    ] = False,
    yes_it_may_fly: Annotated[
        bool, typer.Option("--yes-it-may-fly", help="And what is there may take off.")
    ] = False,
) -> None:
    """Ask a vehicle how it behaves: telemetry, missions, modes, set-points, acknowledgements.

    Takes a PX4 or ArduCopter multirotor on the ground, disarmed, with some 350 m of room, flies it
    at 20 m and puts everything back: missions cleared, parameters and message rates as they were,
    landed and disarmed, also after Ctrl-C. All times are the vehicle's, so simulators may run fast.

    With --as, each behaviour is judged: exit code 1 if one differs that differences.toml does not
    explain. 2 is a mistake in what was asked.

        sim-bridge conform --link tcp:127.0.0.1:5760 --json mine.json

        sim-bridge conform --link udpin:127.0.0.1:14540 --as px4 --only guided

        sim-bridge conform --compare tests/reference/px4.json mine.json
    """
    try:
        if compare is not None:
            _compare(*compare, flavour=as_)
        elif list_them:
            _list(select(only or (), reboots=True))
        elif link is None:
            raise ConformError("give --link URL, --compare A.json B.json or --list")
        else:
            _refuse_far(link, told=not_a_simulator, told_twice=yes_it_may_fly)
            chosen = select(only or (), reboots=reboots)
            judge_by = None
            if as_ is not None or reference is not None:
                judge_by = _Reference(as_.value if as_ else "", reference)
            _run(link, chosen, judge_by, json_out, may_force=is_on_loopback(link))
    except ConformError as error:
        raise LeewayError(str(error)) from error


def _refuse_far(link: str, *, told: bool, told_twice: bool) -> None:
    if not is_on_loopback(link) and not (told and told_twice):
        raise ConformError(f"--link {link} leaves this machine: {_FLIES}")


def _list(behaviours: list[Behaviour]) -> None:
    for behaviour in behaviours:
        print(f"{behaviour.name:36} {behaviour.says} ... ({behaviour.where.value})")


def _compare(a: Path, b: Path, flavour: As | None) -> None:
    left, right = read_result(a), read_result(b)
    reasons = read_differences(reference_folder(), (flavour or left.vehicle.autopilot))
    names = (f"{a.stem} ({_name(left.vehicle)})", f"{b.stem} ({_name(right.vehicle)})")
    print(matrix(left, right, reasons, names), end="")
    print(tally(judge_all(right, left, reasons).values()), file=sys.stderr)


def _run(
    url: str,
    behaviours: list[Behaviour],
    reference: _Reference | None,
    json_out: Path | None,
    *,
    may_force: bool,
) -> None:
    console = Console(stderr=True, soft_wrap=True)
    client = Client(open_link(url))
    try:
        with _View(console, len(behaviours), reference) as view:
            result = ask(client, behaviours, view, may_force=may_force)
    finally:
        client.close()
    if json_out is not None:
        write_result(json_out, result)
    if reference is None:
        console.print(f"{len(result.answers)} behaviours of {_name(result.vehicle)}")
        return
    verdicts = judge_all(result, reference.result, reference.reasons).values()
    console.print(f"{tally(verdicts)}; judged by {_name(reference.result.vehicle)}")
    if Parity.DIFFERENT in verdicts or Parity.NOT_SEEN in verdicts:
        raise typer.Exit(1)


def _name(vehicle: VehicleIdentity) -> str:
    return f"{vehicle.autopilot} {vehicle.firmware} {vehicle.hash}".strip()


class View(Observer, Protocol):
    """Whoever watches, and is told what is under way besides."""

    def says(self, words: str) -> None: ...


def ask(
    client: Client, behaviours: Sequence[Behaviour], view: View, *, may_force: bool
) -> ConformanceResult:
    """Run the behaviours and leave the vehicle as it was found, whatever happens."""
    view.says("waiting for a HEARTBEAT")
    try:
        subject = Subject(client, may_force=may_force)
        vehicle = identify(subject)
    except CannotSee as error:
        raise ConformError(str(error)) from error
    try:
        rows = run_suite(subject, behaviours, view)
    finally:
        view.says("landing, clearing, putting back (Ctrl-C again leaves it as it is)")
        try:
            subject.clean_up()
        except CannotSee as error:
            print(f"sim-bridge: NOT left as found: {error}", file=sys.stderr)
    return as_result(vehicle, rows)
