"""Rows of a table of text, or of a spreadsheet (.xlsx, .xls, .ods) with python-calamine.

The content identifies the format; encoding and separator of text are detected.
"""

import contextlib
import csv
import importlib
import io
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError

ENCODINGS = {"utf-8-sig": "", "cp1252": "Windows-1252"}
SEPARATORS = {",": "", ";": "semicolons", "\t": "tabs", "|": "vertical bars"}
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
SPREADSHEET_MARKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""Start of a ZIP archive (.xlsx, .ods) and of a compound file (.xls)."""
SEPARATOR_LINE = re.compile(r"sep=(.)\r?\n", re.IGNORECASE)
"""First line that Excel reads and does not show."""
MAX_ROWS_ABOVE_HEADER = 20
DECIMAL_COMMA = re.compile(r"\s*([+-]?\d+),(\d+)\s*\Z")


@dataclass(frozen=True, slots=True)
class TextTable:
    """Rows of a table, each with its first line number, the header first."""

    rows: list[tuple[int, list[str]]]
    encoding: str
    """Its name where it is not UTF-8."""
    separator: str
    """Empty: cells of a spreadsheet."""
    skipped_rows: list[tuple[int, list[str]]]
    """Titles and the like above the header."""

    @property
    def dialect(self) -> str:
        """How the file differs from UTF-8 with commas, for the user; `""` if it does not."""
        words = SEPARATORS.get(self.separator)
        return ", ".join(filter(None, (self.encoding, words and f"separated by {words}")))

    def with_decimal_point(self, number: str) -> str:
        """Return a number's text; only where no comma separates cells a comma is its point."""
        return number if self.separator == "," else DECIMAL_COMMA.sub(r"\1.\2", number)


def read_text_table(
    path: Path, is_header: Callable[[list[str]], bool] = lambda cells: True
) -> TextTable:
    """Read a CSV file of any of these dialects, or a spreadsheet. Rows without a value are skipped,
    and empty cells after the last heading. The header is the first of the upper rows that
    `is_header` accepts; if it accepts none, the first.

    Raises LeewayError: unreadable, not text, a quote that is not closed, a damaged spreadsheet.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    if raw.startswith(SPREADSHEET_MARKS):
        rows, encoding = _read_spreadsheet(path)
        separator = ""
    else:
        text, encoding = _decode(path, raw)
        line, separator = 1, ""
        if stated := SEPARATOR_LINE.match(text):
            line, separator, text = 2, stated[1], text[stated.end() :]
        else:
            separator = _separator_of_first_line_with_one(text)
        rows = list(_iterate_rows(path, text, separator, line))
    upper_rows = enumerate(cells for _, cells in rows[: MAX_ROWS_ABOVE_HEADER + 1])
    header = next((index for index, cells in upper_rows if is_header(cells)), 0)
    skipped_rows, rows = rows[:header], rows[header:]
    columns = len(rows[0][1]) if rows else 0
    while columns and not rows[0][1][columns - 1].strip():
        columns -= 1
    trimmed = [
        (line, cells[:columns] if not any(map(str.strip, cells[columns:])) else cells)
        for line, cells in rows
    ]
    return TextTable(trimmed, encoding, separator, skipped_rows)


def _separator_of_first_line_with_one(text: str) -> str:
    """Return the most frequent separator outside quotes of a title, or of the header below it."""
    for line in io.StringIO(text):
        unquoted = re.sub(r'"[^"]*"', "", line)
        separator = max(SEPARATORS, key=unquoted.count)
        if separator in unquoted:
            return separator
    return ","


def _read_spreadsheet(path: Path) -> tuple[list[tuple[int, list[str]]], str]:
    """Return the rows of the first sheet with content, and its description."""
    try:
        calamine: Any = importlib.import_module("python_calamine")  # only for a spreadsheet
    except ImportError as error:
        remedy = "pip install 'leeway-uas[ground]', or export it as CSV"
        raise LeewayError(f"{path}: spreadsheet: python-calamine is not installed: {remedy}") from (
            error
        )
    try:
        book = calamine.CalamineWorkbook.from_path(path)
        names = book.sheet_names
        for name in names:
            table = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            rows = [(n, [_spreadsheet_cell(x) for x in row]) for n, row in enumerate(table, 1)]
            rows = [(n, cells) for n, cells in rows if any(map(str.strip, cells))]
            if rows:
                others = f" of {len(names)} sheets, the first with content" if names[1:] else ""
                return rows, f"spreadsheet, sheet {name}{others}"
    except calamine.CalamineError as error:
        words = "expected a spreadsheet (.xlsx, .xls, .ods) without password"
        raise LeewayError(f"{path}: damaged or of another kind: {words} ({error})") from error
    raise LeewayError(f"{path}: all sheets are empty, expected rows of orders")


def _spreadsheet_cell(value: Any) -> str:
    """Return a cell as text; a whole number without decimal point, as the sheet shows it."""
    is_whole = isinstance(value, float) and value.is_integer()
    return f"{value:.0f}" if is_whole else str(value)


def _iterate_rows(
    path: Path, text: str, separator: str, first_line: int
) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(io.StringIO(text), strict=True, delimiter=separator)
    line = first_line
    try:
        for cells in reader:
            row, line = line, reader.line_num + first_line
            if any(cell.strip() for cell in cells):
                yield row, cells
    except csv.Error as error:
        row = reader.line_num + first_line - 1
        words = "expected closed quotes, each quote within a cell doubled"
        raise LeewayError(f"{path}: line {row}: {error}: {words}") from error


def _decode(path: Path, raw: bytes) -> tuple[str, str]:
    """Return the text, and the encoding's name where it is not UTF-8."""
    is_utf16 = raw.startswith(UTF16_MARKS)
    for encoding, name in ({"utf-16": "UTF-16"} if is_utf16 else ENCODINGS).items():
        with contextlib.suppress(UnicodeDecodeError):
            text = raw.decode(encoding)
            if "\0" not in text:
                return text if "\n" in text else text.replace("\r", "\n"), name
    raise LeewayError(f"{path}: expected text in UTF-8, UTF-16 or Windows-1252")
