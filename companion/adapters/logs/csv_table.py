"""A CSV file as columns of numbers, with the line of each row; errors are reported by line.

An empty cell is unknown (NaN). Columns that are not requested are ignored. The file may be
compressed with gzip.
"""

import csv
import gzip
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.logs.log_time import summarise_rows_as_issue
from companion.adapters.logs.log_units import Columns
from companion.analysis.replay.recorded_flight import LogIssue
from companion.core.base.errors import LeewayError

GZIP = b"\x1f\x8b"
MAX_MAGNITUDE = 1e20
"""Time in nanoseconds since 1970 is 1.7e18. Squares of larger values may overflow."""


def read_file_decompressing_gzip(path: Path) -> bytes:
    """Return a file's content, decompressed if it is gzip; LeewayError if that is damaged."""
    try:
        content = path.read_bytes()
        return gzip.decompress(content) if content.startswith(GZIP) else content
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise LeewayError(
            f"{path}: compressed file (gzip) is damaged or truncated ({error})"
        ) from error
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error


def read_column_names(path: Path) -> tuple[str, ...]:
    """Return the names of line 1; empty for an empty file."""
    return tuple(name.strip() for name in next(csv.reader(_read_text_lines(path)[:1]), []))


def _read_text_lines(path: Path) -> list[str]:
    text = read_file_decompressing_gzip(path).decode("utf-8-sig", errors="replace")
    return text.replace("\0", "").splitlines()


@dataclass(slots=True)
class CsvTable:
    """Numbers by column, NaN for unknown, and each row's line in the file."""

    columns: Columns
    lines: list[int]
    findings: list[LogIssue] = field(default_factory=list)

    @classmethod
    def read(
        cls, path: Path, required_columns: Sequence[str], columns_to_read: Sequence[str]
    ) -> "CsvTable":
        """Read the `columns_to_read` of a file; LeewayError if a required one is missing."""
        reader = csv.reader(_read_text_lines(path))
        header = [name.strip() for name in next(reader, [])]
        missing = [name for name in required_columns if name not in header]
        if missing:
            seen = ", ".join(header[:8]) or "nothing"
            raise LeewayError(
                f"{path}: line 1: columns {', '.join(required_columns)} expected, comma separated;"
                f" missing {', '.join(missing)}; found {seen}"
            )
        twice = sorted({name for name in columns_to_read if header.count(name) > 1})
        if twice:
            raise LeewayError(f"{path}: line 1: column {twice[0]} occurs twice")
        return cls._from_rows(header, columns_to_read, reader)

    @classmethod
    def _from_rows(
        cls, header: list[str], columns_to_read: Sequence[str], reader: Any
    ) -> "CsvTable":
        at = [(name, header.index(name)) for name in columns_to_read if name in header]
        cells: dict[str, list[float]] = {name: [] for name, _ in at}
        lines: list[int] = []
        torn: list[int] = []
        bad: dict[str, list[int]] = {}
        try:
            for row in reader:
                if not row:
                    continue
                if len(row) != len(header):
                    torn.append(reader.line_num)
                    continue
                lines.append(reader.line_num)
                for name, index in at:
                    value = _parse_finite_number(row[index])
                    if value is None:
                        bad.setdefault(name, []).append(reader.line_num)
                    cells[name].append(math.nan if value is None else value)
        except csv.Error as error:
            torn.append(reader.line_num)
            bad.setdefault(str(error), []).append(reader.line_num)
        table = cls({name: np.array(values) for name, values in cells.items()}, lines)
        if torn:
            description = f"a number of cells other than the header's {len(header)} (truncated?)"
            table.findings.append(
                summarise_rows_as_issue(torn, _line_text, description, "discarded")
            )
        for name, rows in bad.items():
            description = f"{name} is no finite number"
            table.findings.append(
                summarise_rows_as_issue(rows, _line_text, description, "treated as unknown")
            )
        return table

    def line_text(self, row_index: int) -> str:
        """Return the line of a row, for messages."""
        return _line_text(self.lines[row_index])

    def replace_out_of_limits_by_nan(
        self, limits_by_column: Mapping[str, tuple[float, float]]
    ) -> list[LogIssue]:
        """Set values outside their column's limits to unknown."""
        found: list[LogIssue] = []
        for name, (low, high) in limits_by_column.items():
            values = self.columns.get(name)
            if values is None:
                continue
            wrong = np.flatnonzero((values < low) | (values > high))
            if wrong.size:
                description = f"{name} = {values[wrong[0]]:g}, expected {low:g} to {high:g}"
                found.append(
                    summarise_rows_as_issue(
                        wrong.tolist(), self.line_text, description, "treated as unknown"
                    )
                )
                values[wrong] = np.nan
        return found


def _line_text(number: int) -> str:
    return f"line {number}"


def _parse_finite_number(cell: str) -> float | None:
    """Parse a finite number; NaN for an empty cell, `None` for anything else."""
    cell = cell.strip()
    if not cell:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if abs(value) <= MAX_MAGNITUDE else None  # NaN and infinities too
