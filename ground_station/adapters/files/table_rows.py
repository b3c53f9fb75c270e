"""Rows of a text table as spreadsheets write it: encoding, separator and decimal comma detected."""

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.errors import LeewayError

ENCODINGS = {"utf-8-sig": "", "cp1252": "Windows-1252"}
SEPARATORS = {",": "", ";": "semicolons", "\t": "tabs", "|": "vertical bars"}
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
SPREADSHEET_MARK = b"PK\x03\x04"
DECIMAL_COMMA = re.compile(r"\s*([+-]?\d+),(\d+)\s*\Z")


@dataclass(frozen=True, slots=True)
class TextTable:
    """Rows of a table, each with its first line number, the header first."""

    rows: list[tuple[int, list[str]]]
    dialect: str
    """How the file differs from UTF-8 with commas, for the user; `""` if it does not."""


def read_text_table(path: Path) -> TextTable:
    """Read a CSV file of any of these dialects. Rows without a value are skipped, and empty cells
    after the last heading.

    Raises LeewayError: unreadable, not text, a quote that is not closed.
    """
    text, encoding = _decode(path)
    first_line = next((line for line in text.splitlines() if line.strip()), "")
    unquoted = re.sub(r'"[^"]*"', "", first_line)
    separator = max(SEPARATORS, key=unquoted.count)
    rows = list(_iterate_rows(path, text, separator))
    if separator != ",":
        rows = [
            (line, [DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in cells]) for line, cells in rows
        ]
    columns = len(rows[0][1]) if rows else 0
    while columns and not rows[0][1][columns - 1].strip():
        columns -= 1
    trimmed = [
        (line, cells[:columns] if not any(map(str.strip, cells[columns:])) else cells)
        for line, cells in rows
    ]
    words = SEPARATORS[separator]
    separated = f"separated by {words}, decimal commas as points" if words else ""
    return TextTable(trimmed, ", ".join(filter(None, (encoding, separated))))


def _iterate_rows(path: Path, text: str, separator: str) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(io.StringIO(text), strict=True, delimiter=separator)
    line = 1
    try:
        for cells in reader:
            row, line = line, reader.line_num + 1
            if any(cell.strip() for cell in cells):
                yield row, cells
    except csv.Error as error:
        raise LeewayError(f"{path}: line {reader.line_num}: {error}") from error


def _decode(path: Path) -> tuple[str, str]:
    """Return the text, and the encoding's name where it is not UTF-8."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    if raw.startswith(SPREADSHEET_MARK):
        raise LeewayError(f"{path}: a spreadsheet (.xlsx, .ods): expected CSV; export it as CSV")
    if raw.startswith(UTF16_MARKS):
        return raw.decode("utf-16", errors="replace"), "UTF-16"
    if b"\0" not in raw:
        for encoding, name in ENCODINGS.items():
            try:
                return raw.decode(encoding), name
            except UnicodeDecodeError:
                continue
    raise LeewayError(f"{path}: expected text in UTF-8, UTF-16 or Windows-1252")
