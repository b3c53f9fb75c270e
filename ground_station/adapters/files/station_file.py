"""Follows a wind station's growing CSV file and returns its new rows, like `tail -f`.

Columns `time_utc, wind_speed_mps, wind_from_deg`, and optionally `std_mps`, the station's error,
separated as in the header. Decimal commas are read where no comma separates cells.
The time is ISO 8601 with an offset from UTC, or seconds since 1970.
"""

from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

import msgspec

from companion.core.base.clock_limits import MAX_UNIX_S
from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from ground_station.adapters.files.table_rows import DECIMAL_COMMA, SEPARATORS
from ground_station.core.fleet.station_message import StationWind

COLUMNS = ("time_utc", "wind_speed_mps", "wind_from_deg")
OPTIONAL_COLUMNS = ("std_mps",)

TAIL_BYTES = 65_536
"""Bytes per read, and the tail that is read of an existing file: older rows are outdated."""

MAX_ROW_BYTES = 1000


@dataclass(slots=True)
class StationFile:
    """File of one station. It may appear late, be replaced, or end in a partial row."""

    station: str
    path: Path
    _offset: int = 0
    _inode: int | None = None
    _partial_row: bytes = b""
    _columns: tuple[str, ...] | None = None
    _separator: str = ","
    _last_problem: str = ""

    def read_new_winds_and_problems(self) -> tuple[list[StationWind], list[str]]:
        """Return new rows in order, and problems: each kind once, until a row is valid again."""
        winds: list[StationWind] = []
        wrong: list[str] = []
        try:
            lines = self._read_new_complete_lines()
        except OSError as error:
            self._inode, self._columns = None, None
            return [], self._problem_unless_repeated(error.strerror or "cannot be read")
        except LeewayError as error:
            self._inode, self._columns = None, None
            return [], self._problem_unless_repeated(str(error))
        for line in lines:
            try:
                if line.strip():
                    winds.append(self._parse_row(line))
                    self._last_problem = ""
            except LeewayError as error:
                wrong += self._problem_unless_repeated(str(error))
        return winds, wrong

    def _problem_unless_repeated(self, problem_text: str) -> list[str]:
        """Return a problem, unless the same kind was the last one reported."""
        kind = problem_text.partition(",")[0].partition("=")[0]
        if kind == self._last_problem:
            return []
        self._last_problem = kind
        return [f"station {self.station}: {self.path}: {problem_text}"]

    def _read_new_complete_lines(self) -> list[bytes]:
        """Return complete rows since the last read; restart if the file was replaced or cut."""
        number = self.path.stat().st_ino
        with self.path.open("rb") as file:
            size = file.seek(0, 2)
            is_restarted = self._columns is None or number != self._inode or size < self._offset
            if is_restarted and not self._read_header_and_locate_latest_rows(file, size):
                return []
            self._inode = number
            file.seek(self._offset)
            raw = file.read(TAIL_BYTES)
        self._offset += len(raw)
        lines = (self._partial_row + raw).split(b"\n")
        self._partial_row = lines.pop()[-MAX_ROW_BYTES:]
        return lines

    def _read_header_and_locate_latest_rows(self, file: BinaryIO, file_size_bytes: int) -> bool:
        """Read the header and seek to the latest rows; False if the header is incomplete."""
        file.seek(0)
        header = file.readline(MAX_ROW_BYTES)
        if not header.endswith(b"\n"):
            if len(header) == MAX_ROW_BYTES:
                raise LeewayError(f"header longer than {MAX_ROW_BYTES} bytes")
            return False
        text = _decode_utf8_row(header).lstrip("\ufeff")
        self._separator = max(SEPARATORS, key=text.count)
        names = tuple(name.strip() for name in text.split(self._separator))
        wrong = [name for name in COLUMNS if name not in names]
        wrong += [name for name in names if name not in COLUMNS + OPTIONAL_COLUMNS]
        if wrong or len(set(names)) < len(names):
            expected = f"expected {', '.join(COLUMNS)} and optionally {', '.join(OPTIONAL_COLUMNS)}"
            raise LeewayError(f"columns {', '.join(map(safe_text, names))[:100]}; {expected}")
        self._columns, self._partial_row, self._offset = names, b"", file.tell()
        if file_size_bytes - self._offset > TAIL_BYTES:
            file.seek(file_size_bytes - TAIL_BYTES)
            file.readline(MAX_ROW_BYTES)
            self._offset = file.tell()
        return True

    def _parse_row(self, line: bytes) -> StationWind:
        assert self._columns is not None
        cells = [cell.strip() for cell in _decode_utf8_row(line).split(self._separator)]
        if self._separator != ",":
            cells = [DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in cells]
        if len(cells) != len(self._columns):
            raise LeewayError(f"row of {len(cells)} cells, expected {len(self._columns)}")
        row = dict(zip(self._columns, cells, strict=True))
        table: dict[str, object] = {
            "station": self.station,
            "epoch_us": round(1e6 * _parse_time_unix_s(row["time_utc"])),
            "speed_mps": _parse_number("wind_speed_mps", row["wind_speed_mps"]),
            "from_deg": _parse_number("wind_from_deg", row["wind_from_deg"]),
        }
        if row.get("std_mps"):
            table["std_mps"] = _parse_number("std_mps", row["std_mps"])
        try:
            return msgspec.convert(table, StationWind)
        except (msgspec.ValidationError, LeewayError) as error:
            raise LeewayError(f"invalid row, {error}") from error


def _decode_utf8_row(raw: bytes) -> str:
    try:
        return raw.decode("utf-8").strip()
    except UnicodeDecodeError as error:
        raise LeewayError("row is not UTF-8") from error


def _parse_number(column_name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise LeewayError(f"{column_name} = {safe_text(text[:40])!r}, expected a number") from error


def _parse_time_unix_s(text: str) -> float:
    with suppress(ValueError):
        if abs(found := float(text)) < MAX_UNIX_S:
            return found
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        when = None
    if when is None or when.tzinfo is None:
        shown = safe_text(text[:40])
        raise LeewayError(f"time_utc = {shown!r}, expected as 2026-07-01T15:10:30Z, or seconds")
    return when.timestamp()
