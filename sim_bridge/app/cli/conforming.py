"""What `sim-bridge conform` does; imported when it runs, not for `--help`."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import typer
from rich.console import Console
from rich.status import Status

from sim_bridge.conform.behaviour import Behaviour, Observation
from sim_bridge.conform.client import Client
from sim_bridge.conform.errors import ConformError, ObservationError
from sim_bridge.conform.link import is_on_loopback, open_link
from sim_bridge.conform.reference import (
    ConformanceResult,
    Parity,
    compare_behaviour,
    compare_results,
    format_parity_matrix,
    format_verdict_counts,
    read_known_difference_reasons,
    read_result,
    reference_folder,
    write_result,
)
from sim_bridge.conform.subject import Subject
from sim_bridge.conform.suite import (
    Observer,
    VehicleIdentity,
    request_vehicle_identity,
    run_suite,
)


class _ProgressView(Status):
    """One line for each behaviour as it ends; the one under way on the last line."""

    def __init__(self, console: Console, total: int, reference: "Reference | None") -> None:
        super().__init__("", console=console)
        self._total = total
        self._reference = reference
        self._number = 0

    def on_behaviour_start(self, behaviour: Behaviour) -> None:
        """Show what is looked at."""
        self._number += 1
        self.update(f"{self._number} of {self._total}: {behaviour.name}")

    def on_behaviour_end(self, behaviour: Behaviour, seen: Observation) -> None:
        """Print what was seen, and the verdict where there is one."""
        verdict = "" if self._reference is None else self._reference.verdict_prefix(behaviour, seen)
        problem_text = seen.problem and f"not seen: {seen.problem}"
        value = problem_text or f"{seen.value} {behaviour.unit}".strip()
        note = f"  ({seen.note})" if seen.note else ""
        line = f"{verdict}{behaviour.name}: {behaviour.description} {value}{note}"
        self.console.print(line, highlight=False, markup=False)


class Reference:
    """Recorded answers to judge by: an autopilot's own, or those of a file."""

    def __init__(self, autopilot: str, path: Path | None) -> None:
        folder = reference_folder() if path is None else path.parent
        self.result = read_result(path or folder / f"{autopilot}.json")
        self.differences = read_known_difference_reasons(folder, autopilot)

    def verdict_prefix(self, behaviour: Behaviour, seen: Observation) -> str:
        """The verdict on one behaviour, as a mark in front of its line."""
        reference = self.result.results.get(behaviour.name)
        verdict = compare_behaviour(behaviour, seen, reference, self.differences)
        if verdict in (Parity.SAME, Parity.NO_REFERENCE):
            return "= " if verdict is Parity.SAME else "? "
        expected = None if reference is None else reference.value
        return f"{verdict.value.upper()} from {expected!r}: "


def print_parity_matrix(a: Path, b: Path, autopilot: str | None) -> None:
    """Print the parity matrix of two results, the reference first."""
    left, right = read_result(a), read_result(b)
    differences = read_known_difference_reasons(
        reference_folder(), autopilot or left.vehicle.autopilot
    )
    names = (
        f"{a.stem} ({_vehicle_label(left.vehicle)})",
        f"{b.stem} ({_vehicle_label(right.vehicle)})",
    )
    print(format_parity_matrix(left, right, differences, names), end="")
    print(
        format_verdict_counts(compare_results(right, left, differences).values()), file=sys.stderr
    )


def run_behaviours_and_print_verdicts(
    url: str, behaviours: list[Behaviour], reference: Reference | None, json_out: Path | None
) -> None:
    """Run the behaviours on the vehicle at `url`; exit code 1 where one differs unexplained."""
    console = Console(stderr=True, soft_wrap=True)
    vehicle_link = open_link(url)
    try:
        with (view := _ProgressView(console, len(behaviours), reference)):
            result = run_behaviours_and_restore_vehicle(
                Client(vehicle_link), behaviours, view, allow_force_disarm=is_on_loopback(url)
            )
    finally:
        vehicle_link.close()
    if json_out is not None:
        write_result(json_out, result)
    if reference is None:
        console.print(f"{len(result.results)} behaviours of {_vehicle_label(result.vehicle)}")
        return
    verdicts = compare_results(result, reference.result, reference.differences).values()
    console.print(
        f"{format_verdict_counts(verdicts)}; judged by {_vehicle_label(reference.result.vehicle)}"
    )
    if Parity.DIFFERENT in verdicts or Parity.NOT_OBSERVED in verdicts:
        raise typer.Exit(1)


def _vehicle_label(vehicle: VehicleIdentity) -> str:
    return f"{vehicle.autopilot} {vehicle.firmware} {vehicle.hash}".strip()


class StatusObserver(Observer, Protocol):
    """Whoever watches, and is told what is under way besides."""

    def update(self, status: str) -> None: ...


def run_behaviours_and_restore_vehicle(
    client: Client,
    behaviours: Sequence[Behaviour],
    view: StatusObserver,
    *,
    allow_force_disarm: bool,
) -> ConformanceResult:
    """Run the behaviours and leave the vehicle as it was found, whatever happens."""
    view.update("waiting for a HEARTBEAT")
    try:
        subject = Subject(client, allow_force_disarm=allow_force_disarm)
        vehicle = request_vehicle_identity(subject)
    except ObservationError as error:
        raise ConformError(str(error)) from error
    try:
        results = run_suite(subject, behaviours, view)
    finally:
        view.update("landing, clearing, putting back (Ctrl-C again leaves it as it is)")
        try:
            subject.restore_initial_state()
        except ObservationError as error:
            print(f"sim-bridge: NOT left as found: {error}", file=sys.stderr)
    return ConformanceResult(vehicle, results)
