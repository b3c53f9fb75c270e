"""A long trial: cases drawn from a seed, tried side by side, bounded in count and in time.

What does not hold is written out as a case that can be tried again.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import PieceLost, Workers, side_by_side
from sim_bridge.adapters.wall_clock import wall_s

Case = TypeVar("Case", bound=msgspec.Struct)
Work = TypeVar("Work")
Row = TypeVar("Row")


class TrialRow(msgspec.Struct, frozen=True, kw_only=True):
    """One case that was tried: whether all held, why not, and what it came to."""

    name: str
    held: bool
    why: str
    told: dict[str, Any]
    case: Any


@dataclass(frozen=True, slots=True)
class Bounds:
    """How long a trial may go on, and where: no case begins after `minutes`."""

    jobs: int
    minutes: float | None
    cluster: str | None = None
    """A Ray cluster instead of processes, as in `Workers`."""


def tried(
    todo: Iterable[Work],
    attempt: Callable[[Work], list[Row]],
    bounds: Bounds,
    lost: Callable[[Work, str], list[Row]],
    say: Callable[[str], None] = lambda words: None,
) -> Iterator[Row]:
    """Try cases side by side, begun in their order, until all are tried or the time is up.

    Rows come as their cases end: a long case holds up nobody, and after Ctrl-C nothing is missing
    that was done. `lost` gives the rows of a case whose worker was killed, and a second time again.
    """
    workers = Workers(bounds.jobs, bounds.cluster)
    for ended in side_by_side(in_time(todo, bounds), attempt, workers, say):
        if isinstance(ended, PieceLost):
            yield from lost(ended.piece, ended.why)
        else:
            yield from ended.result


def case_lost(case: Any, why: str) -> list[TrialRow]:
    """The row of a case with a name that no worker came back with: it has not held."""
    return [TrialRow(name=case.name, held=False, why=why, told={}, case=case)]


def in_time(todo: Iterable[Work], bounds: Bounds) -> Iterator[Work]:
    """These cases, until the time is up."""
    end_s = None if bounds.minutes is None else wall_s() + 60.0 * bounds.minutes
    for case in todo:
        if end_s is not None and wall_s() >= end_s:
            return
        yield case


def write_case(folder: Path, row: TrialRow) -> Path:
    """Write a case that did not hold, to be tried again; returns its file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{row.name}.json"
    path.write_bytes(msgspec.json.format(msgspec.json.encode(row.case)) + b"\n")
    return path


def read_case(path: Path, kind: type[Case]) -> Case:
    """Read a case back.

    Raises: LeewayError for a file that is none.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except msgspec.DecodeError as error:
        raise LeewayError(f"{path}: not a case of this trial: {error}") from error


def result(trial: str, seed: int, rows: Sequence[TrialRow]) -> dict[str, Any]:
    """What `--json` writes: the same whatever the number of workers."""
    held, ordered = sum(row.held for row in rows), sorted(rows, key=_natural)
    return {"trial": trial, "seed": seed, "rows": ordered, "held": held, "of": len(rows)}


def _natural(row: TrialRow) -> list[tuple[int, str]]:
    """By name, numbers in it by their size."""
    parts = re.split(r"(\d+)", row.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def write_result(path: Path, trial: str, seed: int, rows: Sequence[TrialRow]) -> None:
    """Write the result, whole or not at all."""
    fresh = path.with_name(path.name + ".new")
    text = msgspec.json.format(msgspec.json.encode(result(trial, seed, rows)))
    fresh.write_bytes(text + b"\n")
    fresh.replace(path)
