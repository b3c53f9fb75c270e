"""An experiment's table as Markdown and CSV, and how means and intervals are written."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.safe_text import csv_cell


@dataclass(frozen=True)
class Sheet:
    """A titled table of texts with a note beneath."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""

    def markdown(self) -> str:
        lines = [f"# {self.title}", "", _line(self.head), _line(["---"] * len(self.head))]
        lines += [_line(row) for row in self.rows]
        return "\n".join([*lines, "", self.note, ""])

    def write(self, folder: Path, stem: str) -> list[Path]:
        """`stem`.md and `stem`.csv in `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        page, table = folder / f"{stem}.md", folder / f"{stem}.csv"
        page.write_text(self.markdown(), encoding="utf-8")
        with table.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows(
                [csv_cell(cell) for cell in row] for row in (self.head, *self.rows)
            )
        return [page, table]


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def mean_std(values: ArrayLike, digits: int = 1) -> str:
    """Mean and sample standard deviation, as the paper prints them."""
    values = np.asarray(values, dtype=float)
    spread = values.std(ddof=1) if len(values) > 1 else 0.0
    return f"{values.mean():.{digits}f} ± {spread:.{digits}f}"


def interval95(values: ArrayLike) -> tuple[float, float]:
    """95 % interval of the mean over independent graphs (normal approximation)."""
    values = np.asarray(values, dtype=float)
    half = 1.96 * values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0.0
    return float(values.mean() - half), float(values.mean() + half)


def interval95_text(values: ArrayLike, digits: int = 1) -> str:
    low, high = interval95(values)
    return f"{low:.{digits}f} to {high:.{digits}f}"
