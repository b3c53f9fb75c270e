"""Results as JSON, the recorded answers of real autopilots, and how two results compare.

A result is `{"format": "conformance/1", "vehicle": {...}, "behaviours": {name: {"value": ...}}}`;
a behaviour that could not be seen has a `problem` instead of a value. The references are results
of real autopilots; `differences.toml` beside them says where ours differ, and why.
"""

import json
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from sim_bridge.conform.behaviour import Behaviour, Value
from sim_bridge.conform.errors import ConformError
from sim_bridge.conform.suite import BY_NAME, CATALOGUE, BehaviourRecord, VehicleIdentity

_FORMAT = "conformance/1"
_PACKAGE = Path(__file__).resolve().parent.parent


@dataclass(frozen=True, slots=True)
class Answer:
    """What a result holds for one behaviour."""

    value: Value | None = None
    note: str = ""
    problem: str = ""


@dataclass(frozen=True, slots=True)
class ConformanceResult:
    """One run of the suite."""

    vehicle: VehicleIdentity
    answers: Mapping[str, Answer]


class Parity(Enum):
    """How an answer compares with the reference's."""

    SAME = "same"
    DIFFERENT = "different"
    EXPLAINED = "explained"
    NOT_SEEN = "not seen"
    NO_REFERENCE = "no reference"


def as_result(vehicle: VehicleIdentity, rows: Iterable[BehaviourRecord]) -> ConformanceResult:
    """The records of a run as a result."""
    return ConformanceResult(
        vehicle, {row.behaviour.name: Answer(row.value, row.note, row.problem) for row in rows}
    )


def write_result(path: Path, result: ConformanceResult) -> None:
    """Write a result; empty fields are left out."""
    behaviours = {
        name: {key: value for key, value in asdict(answer).items() if value not in (None, "")}
        for name, answer in result.answers.items()
    }
    table = {"format": _FORMAT, "vehicle": asdict(result.vehicle), "behaviours": behaviours}
    path.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n")


def read_result(path: Path) -> ConformanceResult:
    """Read what `write_result` wrote; anything else is a ConformError."""
    try:
        table: dict[str, Any] = json.loads(path.read_text())
        if table["format"] != _FORMAT:
            raise ConformError(f"{path}: format {table['format']}, expected {_FORMAT}")
        answers = {name: Answer(**entry) for name, entry in table["behaviours"].items()}
        return ConformanceResult(VehicleIdentity(**table["vehicle"]), answers)
    except FileNotFoundError:
        raise ConformError(f"{path}: no such file") from None
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ConformError(f"{path}: not a result of this suite ({error})") from error


def reference_folder() -> Path:
    """Where the real autopilots' answers are: the repository's tests, or the package's copy."""
    for folder in (_PACKAGE.parent / "tests" / "reference", _PACKAGE / "_reference"):
        if folder.is_dir():
            return folder
    raise ConformError("the references are missing: name one with --reference")


def read_differences(folder: Path, autopilot: str) -> Mapping[str, str]:
    """Behaviours in which our simulated autopilot differs from the real one, with the reasons."""
    path = folder / "differences.toml"
    if not path.is_file():
        return {}
    table = tomllib.loads(path.read_text()).get(autopilot, {})
    unknown = table.keys() - BY_NAME.keys()
    if unknown:
        raise ConformError(f"{path}: {autopilot}: no such behaviour: {', '.join(sorted(unknown))}")
    return table


def judge(
    behaviour: Behaviour,
    answer: Answer | None,
    reference: Answer | None,
    reasons: Mapping[str, str],
) -> Parity:
    """Compare one answer with the reference's; a known difference counts as explained."""
    if reference is None or reference.value is None:
        return Parity.NO_REFERENCE
    if answer is not None and answer.value is not None:
        if behaviour.is_same(answer.value, reference.value):
            return Parity.SAME
        return Parity.EXPLAINED if behaviour.name in reasons else Parity.DIFFERENT
    return Parity.EXPLAINED if behaviour.name in reasons else Parity.NOT_SEEN


def judge_all(
    result: ConformanceResult, reference: ConformanceResult, reasons: Mapping[str, str]
) -> dict[str, Parity]:
    """All answers of a result, in the catalogue's order."""
    return {
        b.name: judge(b, result.answers[b.name], reference.answers.get(b.name), reasons)
        for b in CATALOGUE
        if b.name in result.answers
    }


def _shown(behaviour: Behaviour, answer: Answer | None) -> str:
    if answer is None:
        return "not run"
    if answer.value is None:
        return "not seen"
    value = ("yes" if answer.value else "no") if isinstance(answer.value, bool) else answer.value
    return f"{value} {behaviour.unit}".strip()


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ").replace("\t", " ")


def matrix(
    a: ConformanceResult, b: ConformanceResult, reasons: Mapping[str, str], names: tuple[str, str]
) -> str:
    """A parity matrix in Markdown: one row for each behaviour that either was asked about."""
    lines = [
        f"| behaviour | {names[0]} | {names[1]} | |",
        "| --- | --- | --- | --- |",
    ]
    notes: list[str] = []
    for behaviour in CATALOGUE:
        left, right = a.answers.get(behaviour.name), b.answers.get(behaviour.name)
        if left is None and right is None:
            continue
        verdict = judge(behaviour, right, left, reasons)
        word = {Parity.SAME: "=", Parity.NO_REFERENCE: "?"}.get(verdict, verdict.value)
        lines.append(
            f"| {_cell(behaviour.says)} | {_cell(_shown(behaviour, left))} |"
            f" {_cell(_shown(behaviour, right))} | {word} |"
        )
        if verdict is Parity.EXPLAINED:
            notes.append(f"- {behaviour.says}: {reasons[behaviour.name]}")
    if notes:
        lines += ["", "Known differences:", "", *notes]
    return "\n".join(lines) + "\n"


def tally(verdicts: Iterable[Parity]) -> str:
    """How many of each verdict, as text."""
    listed = list(verdicts)
    return ", ".join(f"{listed.count(v)} {v.value}" for v in Parity if v in listed)
