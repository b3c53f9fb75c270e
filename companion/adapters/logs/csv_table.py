"""A CSV file as columns of numbers, with the line of each row; what is wrong is said by line.

An empty cell is unknown (NaN). Columns that nobody asks for are left alone. The file may be packed
by gzip.
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

from companion.adapters.logs.log_time import told
from companion.adapters.logs.log_units import Columns
from companion.core.base.errors import LeewayError
from companion.core.replay.recorded_flight import LogFinding

GZIP = b"\x1f\x8b"
LARGEST = 1e20
"""Time in nanoseconds since 1970 is 1.7e18. The square of what is larger overflows some day."""


def plain_bytes(path: Path) -> bytes:
    """A file's content, unpacked where it is packed by gzip; LeewayError where that is damaged."""
    try:
        content = path.read_bytes()
        return gzip.decompress(content) if content.startswith(GZIP) else content
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise LeewayError(
            f"{path}: this is packed (gzip): unpack it: damaged or cut off ({error})"
        ) from error
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error


def column_names(path: Path) -> tuple[str, ...]:
    """The names of line 1; none of an empty file."""
    return tuple(name.strip() for name in next(csv.reader(_lines(path)[:1]), []))


def _lines(path: Path) -> list[str]:
    text = plain_bytes(path).decode("utf-8-sig", errors="replace")
    return text.replace("\0", "").splitlines()


@dataclass(slots=True)
class CsvTable:
    """Numbers by column, NaN where unknown, and the line in the file of each row."""

    columns: Columns
    lines: list[int]
    findings: list[LogFinding] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path, required: Sequence[str], known: Sequence[str]) -> "CsvTable":
        """Take the `known` columns of a file; LeewayError where a required one is missing."""
        reader = csv.reader(_lines(path))
        header = [name.strip() for name in next(reader, [])]
        missing = [name for name in required if name not in header]
        if missing:
            seen = ", ".join(header[:8]) or "nothing"
            raise LeewayError(
                f"{path}: line 1: columns {', '.join(required)} expected, comma separated;"
                f" missing {', '.join(missing)}; found {seen}"
            )
        twice = sorted({name for name in known if header.count(name) > 1})
        if twice:
            raise LeewayError(f"{path}: line 1: column {twice[0]} stands there twice")
        return cls._filled(header, known, reader)

    @classmethod
    def _filled(cls, header: list[str], known: Sequence[str], reader: Any) -> "CsvTable":
        at = [(name, header.index(name)) for name in known if name in header]
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
                    value = _number(row[index])
                    if value is None:
                        bad.setdefault(name, []).append(reader.line_num)
                    cells[name].append(math.nan if value is None else value)
        except csv.Error as error:
            torn.append(reader.line_num)
            bad.setdefault(str(error), []).append(reader.line_num)
        table = cls({name: np.array(values) for name, values in cells.items()}, lines)
        if torn:
            what = f"a number of cells other than the header's {len(header)} (cut off?)"
            table.findings.append(told(torn, _line, what, "left out"))
        for name, rows in bad.items():
            what = f"{name} is no finite number"
            table.findings.append(told(rows, _line, what, "taken as unknown"))
        return table

    def where(self, row: int) -> str:
        """Where in the file a row stands."""
        return _line(self.lines[row])

    def check_limits(self, limits: Mapping[str, tuple[float, float]]) -> list[LogFinding]:
        """Make values unknown that cannot be what their column's name says."""
        found: list[LogFinding] = []
        for name, (low, high) in limits.items():
            values = self.columns.get(name)
            if values is None:
                continue
            wrong = np.flatnonzero((values < low) | (values > high))
            if wrong.size:
                what = f"{name} = {values[wrong[0]]:g}, expected {low:g} to {high:g}"
                found.append(told(wrong.tolist(), self.where, what, "taken as unknown"))
                values[wrong] = np.nan
        return found


def _line(number: int) -> str:
    return f"line {number}"


def _number(cell: str) -> float | None:
    """A finite number, NaN for an empty cell, `None` for anything else."""
    cell = cell.strip()
    if not cell:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if abs(value) <= LARGEST else None  # NaN and infinities too
