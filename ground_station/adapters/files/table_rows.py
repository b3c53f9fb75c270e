"""Rows of a text table as spreadsheets write it: the encoding and the separator are detected."""

import contextlib
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
    encoding: str
    """Its name where it is not UTF-8."""
    separator: str

    @property
    def dialect(self) -> str:
        """How the file differs from UTF-8 with commas, for the user; `""` if it does not."""
        words = SEPARATORS[self.separator]
        return ", ".join(filter(None, (self.encoding, words and f"separated by {words}")))

    def with_decimal_point(self, number: str) -> str:
        """Return a number's text; only where no comma separates cells a comma is its point."""
        return number if self.separator == "," else DECIMAL_COMMA.sub(r"\1.\2", number)


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
    columns = len(rows[0][1]) if rows else 0
    while columns and not rows[0][1][columns - 1].strip():
        columns -= 1
    trimmed = [
        (line, cells[:columns] if not any(map(str.strip, cells[columns:])) else cells)
        for line, cells in rows
    ]
    return TextTable(trimmed, encoding, separator)


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
    is_utf16 = raw.startswith(UTF16_MARKS)
    for encoding, name in ({"utf-16": "UTF-16"} if is_utf16 else ENCODINGS).items():
        with contextlib.suppress(UnicodeDecodeError):
            text = raw.decode(encoding)
            if "\0" not in text:
                return text, name
    raise LeewayError(f"{path}: expected text in UTF-8, UTF-16 or Windows-1252")
