"""A wind station's CSV file that grows: its new rows, as `tail -f` has them.

Columns `time_utc, wind_speed_mps, wind_from_deg`, and `std_mps` where the station knows its own
error. The time is ISO 8601 with an offset from UTC, or seconds since 1970.
"""

import math
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from ground_station.core.fleet.station_message import StationWind

COLUMNS = ("time_utc", "wind_speed_mps", "wind_from_deg")
OPTIONAL = ("std_mps",)

TAIL_BYTES = 65_536
"""What is read of a file at once, and of one that is there already: older rows are no news."""

LONGEST_ROW = 1000


@dataclass(slots=True)
class StationFile:
    """One station's file. It may be absent, and come; be begun anew; or end in half a row."""

    station: str
    path: Path
    _at: int = 0
    _file: int | None = None
    _half: bytes = b""
    _columns: tuple[str, ...] | None = None
    _trouble: str = ""

    def read(self) -> tuple[list[StationWind], list[str]]:
        """New rows in order, and what is wrong: each kind once, until a row is right again."""
        winds: list[StationWind] = []
        wrong: list[str] = []
        try:
            lines = self._new_lines()
        except OSError as error:
            self._file, self._columns = None, None
            return [], self._said(error.strerror or "cannot be read")
        except LeewayError as error:
            self._file, self._columns = None, None
            return [], self._said(str(error))
        for line in lines:
            try:
                if line.strip():
                    winds.append(self._row(line))
                    self._trouble = ""
            except LeewayError as error:
                wrong += self._said(str(error))
        return winds, wrong

    def _said(self, words: str) -> list[str]:
        """Words of the same kind are not said again."""
        kind = words.partition(",")[0].partition("=")[0]
        if kind == self._trouble:
            return []
        self._trouble = kind
        return [f"station {self.station}: {self.path}: {words}"]

    def _new_lines(self) -> list[bytes]:
        """Whole rows since the last look; a file that is another or shorter begins anew."""
        number = self.path.stat().st_ino
        with self.path.open("rb") as file:
            size = file.seek(0, 2)
            fresh = self._columns is None or number != self._file or size < self._at
            if fresh and not self._begin(file, size):
                return []
            self._file = number
            file.seek(self._at)
            raw = file.read(TAIL_BYTES)
        self._at += len(raw)
        lines = (self._half + raw).split(b"\n")
        self._half = lines.pop()[-LONGEST_ROW:]
        return lines

    def _begin(self, file: BinaryIO, size: int) -> bool:
        """Read the header and find the newest rows; False: not even the header is there yet."""
        file.seek(0)
        header = file.readline(LONGEST_ROW)
        if not header.endswith(b"\n"):
            if len(header) == LONGEST_ROW:
                raise LeewayError(f"its first row is longer than {LONGEST_ROW} bytes")
            return False
        names = tuple(name.strip() for name in _text(header).lstrip("\ufeff").split(","))
        wrong = [name for name in COLUMNS if name not in names]
        wrong += [name for name in names if name not in COLUMNS + OPTIONAL]
        if wrong or len(set(names)) < len(names):
            expected = f"expected {', '.join(COLUMNS)} and perhaps {', '.join(OPTIONAL)}"
            raise LeewayError(f"its columns: {', '.join(map(safe_text, names))[:100]}; {expected}")
        self._columns, self._half, self._at = names, b"", file.tell()
        if size - self._at > TAIL_BYTES:
            file.seek(size - TAIL_BYTES)
            file.readline(LONGEST_ROW)
            self._at = file.tell()
        return True

    def _row(self, line: bytes) -> StationWind:
        assert self._columns is not None
        cells = [cell.strip() for cell in _text(line).split(",")]
        if len(cells) != len(self._columns):
            raise LeewayError(f"a row of {len(cells)} cells, expected {len(self._columns)}")
        row = dict(zip(self._columns, cells, strict=True))
        table: dict[str, object] = {
            "station": self.station,
            "epoch_us": round(1e6 * _time_s(row["time_utc"])),
            "speed_mps": _number("wind_speed_mps", row["wind_speed_mps"]),
            "from_deg": _number("wind_from_deg", row["wind_from_deg"]),
        }
        if row.get("std_mps"):
            table["std_mps"] = _number("std_mps", row["std_mps"])
        try:
            return msgspec.convert(table, StationWind)
        except (msgspec.ValidationError, LeewayError) as error:
            raise LeewayError(f"a row that is none, {error}") from error


def _text(raw: bytes) -> str:
    try:
        return raw.decode("utf-8").strip()
    except UnicodeDecodeError as error:
        raise LeewayError("a row that is not UTF-8") from error


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise LeewayError(f"{name} = {safe_text(text[:40])!r}, expected a number") from error


def _time_s(text: str) -> float:
    with suppress(ValueError):
        if math.isfinite(found := float(text)):
            return found
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        when = None
    if when is None or when.tzinfo is None:
        shown = safe_text(text[:40])
        raise LeewayError(f"time_utc = {shown!r}, expected as 2026-07-01T15:10:30Z, or seconds")
    return when.timestamp()
