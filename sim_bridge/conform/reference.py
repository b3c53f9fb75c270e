"""Results as JSON, reference results of real autopilots, and the comparison of two results.

A result is `{"format": "conformance/1", "vehicle": {...}, "behaviours": {name: {"value": ...}}}`; a
behaviour that could not be observed has a `problem` instead of a value. The references are results
of real autopilots; `differences.toml` in the same folder explains known differences.
"""

import json
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from sim_bridge.conform.behaviour import Behaviour, Observation
from sim_bridge.conform.errors import ConformError
from sim_bridge.conform.suite import BY_NAME, CATALOGUE, VehicleIdentity

_FORMAT = "conformance/1"
_PACKAGE = Path(__file__).resolve().parent.parent


@dataclass(frozen=True, slots=True)
class ConformanceResult:
    """One run of the suite."""

    vehicle: VehicleIdentity
    results: Mapping[str, Observation]


class Parity(Enum):
    """Comparison of a result with the reference."""

    SAME = "same"
    DIFFERENT = "different"
    EXPLAINED = "explained"
    NOT_OBSERVED = "not seen"
    NO_REFERENCE = "no reference"


def write_result(path: Path, result: ConformanceResult) -> None:
    """Write a result; empty fields are left out."""
    behaviours = {
        name: {key: value for key, value in asdict(recorded).items() if value not in (None, "")}
        for name, recorded in result.results.items()
    }
    table = {"format": _FORMAT, "vehicle": asdict(result.vehicle), "behaviours": behaviours}
    path.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n")


def read_result(path: Path) -> ConformanceResult:
    """Read a file of `write_result`; raises ConformError for any other content."""
    try:
        table: dict[str, Any] = json.loads(path.read_text())
        if table["format"] != _FORMAT:
            raise ConformError(f"{path}: format {table['format']}, expected {_FORMAT}")
        results = {name: Observation(**entry) for name, entry in table["behaviours"].items()}
        return ConformanceResult(VehicleIdentity(**table["vehicle"]), results)
    except FileNotFoundError:
        raise ConformError(f"{path}: no such file") from None
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ConformError(f"{path}: not a result of this suite ({error})") from error


def reference_folder() -> Path:
    """Return the folder of the reference results: the repository's tests, or the package's copy."""
    for folder in (_PACKAGE.parent / "tests" / "reference", _PACKAGE / "_reference"):
        if folder.is_dir():
            return folder
    raise ConformError("the references are missing: name one with --reference")


def read_known_difference_reasons(folder: Path, autopilot: str) -> Mapping[str, str]:
    """Read the known differences of the simulated autopilot from the real one, with reasons."""
    path = folder / "differences.toml"
    if not path.is_file():
        return {}
    table = tomllib.loads(path.read_text()).get(autopilot, {})
    unknown = table.keys() - BY_NAME.keys()
    if unknown:
        raise ConformError(f"{path}: {autopilot}: no such behaviour: {', '.join(sorted(unknown))}")
    return table


def compare_behaviour(
    behaviour: Behaviour,
    recorded: Observation | None,
    reference: Observation | None,
    explanations: Mapping[str, str],
) -> Parity:
    """Compare one result with the reference; a known difference counts as explained."""
    if reference is None or reference.value is None:
        return Parity.NO_REFERENCE
    value = None if recorded is None else recorded.value
    if value is not None and behaviour.is_same(value, reference.value):
        return Parity.SAME
    if behaviour.name in explanations:
        return Parity.EXPLAINED
    return Parity.NOT_OBSERVED if value is None else Parity.DIFFERENT


def compare_results(
    result: ConformanceResult, reference: ConformanceResult, explanations: Mapping[str, str]
) -> dict[str, Parity]:
    """Compare all results, in the catalogue's order."""
    return {
        b.name: compare_behaviour(
            b, result.results[b.name], reference.results.get(b.name), explanations
        )
        for b in CATALOGUE
        if b.name in result.results
    }


def _format_recorded_value(behaviour: Behaviour, recorded: Observation | None) -> str:
    if recorded is None:
        return "not run"
    if recorded.value is None:
        return "not seen"
    is_flag = isinstance(recorded.value, bool)
    value = ("yes" if recorded.value else "no") if is_flag else recorded.value
    return f"{value} {behaviour.unit}".strip()


def format_parity_matrix(
    first_result: ConformanceResult,
    second_result: ConformanceResult,
    explanations: Mapping[str, str],
    column_names: tuple[str, str],
) -> str:
    """Format a parity matrix in Markdown: one row for each behaviour in either result."""
    rows: list[tuple[str, ...]] = []
    notes: list[str] = []
    for behaviour in CATALOGUE:
        pair = [one.results.get(behaviour.name) for one in (first_result, second_result)]
        if pair == [None, None]:
            continue
        verdict = compare_behaviour(behaviour, pair[1], pair[0], explanations)
        word = {Parity.SAME: "=", Parity.NO_REFERENCE: "?"}.get(verdict, verdict.value)
        values = (_format_recorded_value(behaviour, one) for one in pair)
        rows.append((behaviour.description, *values, word))
        if verdict is Parity.EXPLAINED:
            notes.append(f"- {behaviour.description}: {explanations[behaviour.name]}")
    escaped = str.maketrans({"|": "\\|", "\n": " ", "\t": " "})
    lines = [
        f"| behaviour | {column_names[0]} | {column_names[1]} | |",
        "| --- | --- | --- | --- |",
    ]
    lines += ["| " + " | ".join(cell.translate(escaped) for cell in row) + " |" for row in rows]
    if notes:
        lines += ["", "Known differences:", "", *notes]
    return "\n".join(lines) + "\n"


def format_verdict_counts(verdicts: Iterable[Parity]) -> str:
    """Format the count of each verdict."""
    verdict_list = list(verdicts)
    return ", ".join(f"{verdict_list.count(v)} {v.value}" for v in Parity if v in verdict_list)
