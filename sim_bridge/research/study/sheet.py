"""Table of an experiment as Markdown and CSV, and formats of means and intervals."""

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.safe_text import escape_csv_formula
from sim_bridge.research.study.intervals import mean_interval95

Column = str | Callable[[Any], str]
"""A cell of a row: a format string such as "{0.mape:.1f}", or a function of the row."""


@dataclass(frozen=True)
class Sheet:
    """A titled table of text cells with a note below."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
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
        lines += [_markdown_row(row) for row in self.rows]
        return "\n".join([*lines, "", self.note, ""])

    def write_markdown_and_csv(self, folder: Path, stem: str) -> list[Path]:
        """Write `stem`.md and `stem`.csv to `folder`; return both paths."""
        folder.mkdir(parents=True, exist_ok=True)
        page, table = folder / f"{stem}.md", folder / f"{stem}.csv"
        page.write_text(self.to_markdown(), encoding="utf-8")
        with table.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows(
                [escape_csv_formula(cell) for cell in row] for row in (self.head, *self.rows)
            )
        return [page, table]


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def format_mean_std(values: ArrayLike, digits: int = 1) -> str:
    """Format mean and sample standard deviation as in the paper."""
    values = np.asarray(values, dtype=float)
    spread = values.std(ddof=1) if len(values) > 1 else 0.0
    return f"{values.mean():.{digits}f} ± {spread:.{digits}f}"


def format_interval95(values: ArrayLike, digits: int = 1) -> str:
    low, high = mean_interval95(values)
    return f"{low:.{digits}f} to {high:.{digits}f}"


def format_optional(value: float | None, spec: str, unknown: str = "") -> str:
    """Format the number of a cell, or return the text for an unknown one."""
    return unknown if value is None else format(value, spec)
