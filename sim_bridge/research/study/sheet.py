"""Table of an experiment as Markdown and CSV, and formats of means and intervals."""

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.safe_text import escape_csv_formula

_NUMBER_WITH_PERCENT = re.compile(r"([-+]?[0-9.]+) ?%")


@dataclass(frozen=True)
class Figures:
    """A cell of several values: one text in Markdown, a column for each value in CSV.

    `values`: by the CSV column's heading, in which "{}" is the heading of the table's column.
    """

    text: str
    values: Mapping[str, str]

    def __str__(self) -> str:
        return self.text


Cell = str | Figures
Column = str | Callable[[Any], Cell]
"""A cell of a row: a format string such as "{0.mape:.1f}", or a function of the row."""


@dataclass(frozen=True)
class Sheet:
    """A titled table with a note below."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""

    @classmethod
    def from_objects(
        cls, title: str, rows: Iterable[Any], columns: Mapping[str, Column], note: str = ""
    ) -> "Sheet":
        """Build a table with a row per object and a column per heading."""
        cells = [
            [each.format(row) if isinstance(each, str) else each(row) for each in columns.values()]
            for row in rows
        ]
        return cls(title, tuple(columns), cells, note)

    def to_markdown(self) -> str:
        lines = [
            f"# {self.title}",
            "",
            _markdown_row(self.head),
            _markdown_row(["---"] * len(self.head)),
        ]
        lines += [_markdown_row([str(cell) for cell in row]) for row in self.rows]
        return "\n".join([*lines, "", self.note, ""])

    def write_markdown_and_csv(self, folder: Path, stem: str) -> list[Path]:
        """Write `stem`.md and `stem`.csv to `folder`; return both paths."""
        folder.mkdir(parents=True, exist_ok=True)
        page, table = folder / f"{stem}.md", folder / f"{stem}.csv"
        page.write_text(self.to_markdown(), encoding="utf-8")
        with table.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows(
                [escape_csv_formula(cell) for cell in row]
                for row in zip(*self._csv_columns(), strict=True)
            )
        return [page, table]

    def to_records(self) -> list[dict[str, float | str | None]]:
        """Return the rows of the CSV file for a JSON document; an unknown number is null."""
        head, *rows = zip(*self._csv_columns(), strict=True)
        return [dict(zip(head, map(_number_or_text, row), strict=True)) for row in rows]

    def _csv_columns(self) -> Iterator[list[str]]:
        """Yield columns of one value a cell, heading first; an unknown number is empty."""
        if not self.rows:
            yield from ([head] for head in self.head)
            return
        for head, cells in zip(self.head, zip(*self.rows, strict=True), strict=True):
            several = next((each.values for each in cells if isinstance(each, Figures)), None)
            if several is None:
                yield _csv_column(head, [str(each) for each in cells])
                continue
            for part in several:
                values = [each.values[part] if isinstance(each, Figures) else "" for each in cells]
                yield _csv_column(part.format(head), values)


def _number_or_text(cell: str) -> float | str | None:
    try:
        return float(cell) if cell else None
    except ValueError:
        return cell


def _csv_column(head: str, cells: Sequence[str]) -> list[str]:
    """Move percent signs from the cells to the heading; replace dashes by empty cells."""
    found = [_NUMBER_WITH_PERCENT.fullmatch(cell) for cell in cells]
    if any(found) and "%" not in head:
        head = f"{head}, %"
    return [
        head,
        *(
            match[1] if match else "" if cell == "-" else cell
            for cell, match in zip(cells, found, strict=True)
        ),
    ]


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def mean_and_std(values: ArrayLike, digits: int = 1) -> Figures:
    """Return mean and sample standard deviation, unknown of one value, in the paper's form."""
    values = np.asarray(values, dtype=float)
    if len(values) < 2:
        mean = format(float(values.mean()), f".{digits}f")
        return Figures(mean, {"{} mean": mean, "{} std": ""})
    spread = values.std(ddof=1)
    return plus_minus(float(values.mean()), float(spread), f".{digits}f", "std")


def plus_minus(mean: float, spread: float, spec: str, spread_name: str) -> Figures:
    """Return the figures "mean ± spread"."""
    parts = format(mean, spec), format(spread, spec)
    return Figures(" ± ".join(parts), {"{} mean": parts[0], f"{{}} {spread_name}": parts[1]})


def low_to_high(interval: tuple[float, float], spec: str) -> Figures:
    """Return the figures "low to high"."""
    low, high = (format(limit, spec) for limit in interval)
    return Figures(f"{low} to {high}", {"{} low": low, "{} high": high})


def separated(values: Mapping[str, str], separator: str) -> Figures:
    """Return values by their CSV headings, in Markdown in one cell."""
    return Figures(separator.join(values.values()), values)


def format_optional(value: float | None, spec: str, unknown: str = "") -> str:
    """Format the number of a cell, or return the text for an unknown one."""
    return unknown if value is None else format(value, spec)
