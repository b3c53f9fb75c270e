"""Long trials: cases drawn from a seed and run in parallel, limited in number and time.

A failed case is written to a file, from which it can be run again.
"""

import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import ItemLost, WorkerOptions, run_parallel
from sim_bridge.adapters.wall_clock import wall_s

Case = TypeVar("Case", bound=msgspec.Struct)
Work = TypeVar("Work")
Row = TypeVar("Row")


class TrialRow(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one case: whether it passed, reason of a failure, and metrics."""

    name: str
    passed: bool = msgspec.field(name="held")
    reason: str = msgspec.field(name="why")
    metrics: dict[str, Any] = msgspec.field(name="told")
    case: Any

    @classmethod
    def for_case(
        cls, case: Any, reason: str = "", metrics: dict[str, Any] | None = None
    ) -> "TrialRow":
        """Return the row of a case, which has failed if there is a reason."""
        passed = not reason
        return cls(name=case.name, passed=passed, reason=reason, metrics=metrics or {}, case=case)


def run_trial(
    cases: Iterable[Work],
    run_case: Callable[[Work], list[Row]],
    workers: WorkerOptions,
    rows_for_lost_case: Callable[[Work, str], list[Row]],
    print_line: Callable[[str], None] = lambda words: None,
) -> Iterator[Row]:
    """Run cases in parallel, started in their order.

    Yields rows as their cases end, so a long case delays no other row and Ctrl-C loses no result.
    `rows_for_lost_case` returns the rows of a case whose worker was killed twice.
    """
    for ended in run_parallel(cases, run_case, workers, print_line):
        if isinstance(ended, ItemLost):
            yield from rows_for_lost_case(ended.item, ended.reason)
        else:
            yield from ended.result


def run_in_own_folder(
    attempt: Callable[[Any, Path], TrialRow], run_root: Path, case: Any
) -> list[TrialRow]:
    """Run one case in a separate folder under `run_root`, which stays if the case fails."""
    return [attempt(case, run_root / case.name)]


def build_row_and_delete_passed_folder(
    case: Any, folder: Path, violations: Sequence[str], metrics: dict[str, Any]
) -> TrialRow:
    """Return the row of a case; remove the folder of a case that passed."""
    if not violations:
        shutil.rmtree(folder)
    return TrialRow.for_case(case, "; ".join(violations), metrics)


def failed_rows_for_lost_worker(case: Any, reason: str) -> list[TrialRow]:
    """Return a failed row for a case whose worker was lost."""
    return [TrialRow.for_case(case, reason)]


def cases_until_time_limit(cases: Iterable[Work], minutes: float | None) -> Iterator[Work]:
    """Yield these cases until `minutes` have passed; None: all."""
    end_s = None if minutes is None else wall_s() + 60.0 * minutes
    for case in cases:
        if end_s is not None and wall_s() >= end_s:
            return
        yield case


def write_case_file(folder: Path, row: TrialRow) -> Path:
    """Write a failed case, so that it can be run again; return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{row.name}.json"
    path.write_bytes(msgspec.json.format(msgspec.json.encode(row.case)) + b"\n")
    return path


def read_case_file(path: Path, case_type: type[Case]) -> Case:
    """Read a case from a file.

    Raises LeewayError if the file is unreadable or not a case of this type.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=case_type)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except msgspec.DecodeError as error:
        raise LeewayError(f"{path}: not a case of this trial: {error}") from error


def build_trial_result(trial: str, seed: int, rows: Sequence[TrialRow]) -> dict[str, Any]:
    """Return the document for `--json`, independent of the number of workers."""
    passed_count, ordered = sum(row.passed for row in rows), sorted(rows, key=_natural_sort_key)
    return {"trial": trial, "seed": seed, "rows": ordered, "held": passed_count, "of": len(rows)}


def _natural_sort_key(row: TrialRow) -> list[tuple[int, str]]:
    """Return a key that sorts names with their numbers in numerical order."""
    parts = re.split(r"(\d+)", row.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
