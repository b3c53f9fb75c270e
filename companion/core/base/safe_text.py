"""Words from outside as text that can only be read: no terminal, log, markup or table obeys them.

Applied once, where words come in: at the decoding of a message, of an autopilot's text, of an
order's note. Names never need it: they have patterns, and what breaks a pattern is refused.
"""

import re
import unicodedata

from companion.core.base.errors import LeewayError

LONGEST_WORD = 120
"""Characters without a space: paths and digests of ours are shorter; more would push a table's
other columns off the screen.
"""

LONGEST_NAME = 100
"""Characters of what a flight, a place or an obstacle may be called."""

MOST_MARKS = 2
"""Accents on one letter: languages in use need two; towers of them cover the lines above."""

UNSEEN = frozenset(("Cc", "Cf", "Cs", "Co", "Cn"))
"""Unicode's controls (escape sequences), formats (bidi overrides, zero widths), surrogates, private
and unassigned characters."""

_TAG = re.compile(r"\[([a-z#/@][^\[\]]*)\]")
_TAG_OPENS = re.compile(r"\[(?=[a-z#/@])")
"""What a rich console takes for markup: `[/x]`, `[red]`, `[@click=...]`; not `features[0]`."""

_LONG = re.compile(rf"[^ ]{{{LONGEST_WORD + 1},}}")


def safe_text(text: str) -> str:
    """One line without controls, markup or overlong words; never longer than the text."""
    text = one_line(text)
    if "[" in text:
        text = _TAG_OPENS.sub("(", _TAG.sub(r"(\1)", text))
    return _LONG.sub(lambda word: word[0][: LONGEST_WORD - 1] + "…", text)


def one_line(text: str) -> str:
    """The text on one line; what moves a cursor or turns the direction of reading is replaced."""
    if text.isascii() and text.isprintable():
        return text
    shown: list[str] = []
    marks = 0
    for char in text:
        kind = unicodedata.category(char)
        marks = marks + 1 if kind in ("Mn", "Me") else 0
        if marks > MOST_MARKS:
            continue
        shown.append(_seen(char, kind))
    return "".join(shown)


def _seen(char: str, kind: str) -> str:
    if char.isspace():
        return " "
    return "\N{REPLACEMENT CHARACTER}" if kind in UNSEEN else char


def log_text(text: str) -> str:
    """Lines for a log: all but the first are indented, so that none passes for an entry."""
    return "\n    ".join(one_line(line) for line in text.splitlines())


def csv_cell(text: str) -> str:
    """A cell that no spreadsheet calculates: a number stays, a formula gets an apostrophe."""
    if text[:1] not in ("=", "+", "-", "@", "\t", "\r") or len(text) == 1 or _is_number(text):
        return text
    return f"'{text}"


def check_name(key: str, name: str) -> None:
    """Raise LeewayError naming `key` where a name is more than one line that can only be read."""
    if len(name) > LONGEST_NAME or safe_text(name) != name:
        shown = safe_text(name[:LONGEST_NAME])
        expected = f"at most {LONGEST_NAME} characters of one line, no controls, no markup"
        raise LeewayError(f"{key} = {shown!r}: expected {expected}")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
