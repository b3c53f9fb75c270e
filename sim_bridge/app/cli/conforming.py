"""What `sim-bridge conform` does; imported when it runs, not for `--help`."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import typer
from rich.console import Console
from rich.status import Status

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
from sim_bridge.conform.suite import BehaviourRecord, Observer, VehicleIdentity, identify, run_suite

_FLIES = (
    "the suite arms, flies and lands what is behind it; it is meant for simulators on this"
    " machine (127.0.0.1). To run it elsewhere give --not-a-simulator and --yes-it-may-fly"
)


class _View:
    """One line for each behaviour as it ends; the one under way on the last line."""

    def __init__(self, console: Console, total: int, reference: "Reference | None") -> None:
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


class Reference:
    """Recorded answers to judge by: an autopilot's own, or those of a file."""

    def __init__(self, autopilot: str, path: Path | None) -> None:
        folder = reference_folder() if path is None else path.parent
        self.result = read_result(path or folder / f"{autopilot}.json")
        self.reasons = read_differences(folder, autopilot)

    def word(self, row: BehaviourRecord) -> str:
        """The verdict on one row, as a mark in front of its line."""
        answer = as_result(self.result.vehicle, [row]).answers[row.behaviour.name]
        reference = self.result.answers.get(row.behaviour.name)
        verdict = judge(row.behaviour, answer, reference, self.reasons)
        if verdict in (Parity.SAME, Parity.NO_REFERENCE):
            return "= " if verdict is Parity.SAME else "? "
        expected = None if reference is None else reference.value
        return f"{verdict.value.upper()} from {expected!r}: "


def refuse_far(link: str, *, told: bool, told_twice: bool) -> None:
    """ConformError for a link that leaves this machine, unless both switches were given."""
    if not is_on_loopback(link) and not (told and told_twice):
        raise ConformError(f"--link {link} leaves this machine: {_FLIES}")


def print_names(behaviours: list[Behaviour]) -> None:
    """One line for each behaviour."""
    for behaviour in behaviours:
        print(f"{behaviour.name:36} {behaviour.says} ... ({behaviour.where.value})")


def compare_results(a: Path, b: Path, autopilot: str | None) -> None:
    """Print the parity matrix of two results, the reference first."""
    left, right = read_result(a), read_result(b)
    reasons = read_differences(reference_folder(), autopilot or left.vehicle.autopilot)
    names = (f"{a.stem} ({_name(left.vehicle)})", f"{b.stem} ({_name(right.vehicle)})")
    print(matrix(left, right, reasons, names), end="")
    print(tally(judge_all(right, left, reasons).values()), file=sys.stderr)


def conform_vehicle(
    url: str, behaviours: list[Behaviour], reference: Reference | None, json_out: Path | None
) -> None:
    """Run the behaviours on the vehicle at `url`; exit code 1 where one differs unexplained."""
    console = Console(stderr=True, soft_wrap=True)
    client = Client(open_link(url))
    try:
        with _View(console, len(behaviours), reference) as view:
            result = ask(client, behaviours, view, may_force=is_on_loopback(url))
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
