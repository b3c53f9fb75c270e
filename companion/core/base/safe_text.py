"""External text made harmless for terminals, logs, markup and tables.

Applied at the input, when a message, an autopilot's text or an order's note is decoded, and once
more at each output: a store may hold what an older version or another program wrote. Names have
patterns, and a name that does not match is rejected.
"""

import re
import unicodedata

from companion.core.base.errors import LeewayError

MAX_WORD_LENGTH = 120
"""Characters without a space: paths and digests are shorter; longer words would push a table's
other columns off the screen."""

MAX_NAME_LENGTH = 100
"""Maximum length of the name of a flight, a location or an obstacle."""

MAX_MARKS = 2
"""Accents per letter: languages in use need two; more of them cover the lines above."""

HIDDEN_CATEGORIES = frozenset(("Cc", "Cf", "Cs", "Co", "Cn"))
"""Unicode's controls (escape sequences), formats (bidi overrides, zero widths), surrogates, private
and unassigned characters."""

_TAG = re.compile(r"\[([a-z#/@][^\[\]]*)\]")
_TAG_START = re.compile(r"\[(?=[a-z#/@])")
"""Markup of a rich console: `[/x]`, `[red]`, `[@click=...]`; not `features[0]`."""

_OVERLONG_WORD = re.compile(rf"[^ ]{{{MAX_WORD_LENGTH + 1},}}")


def safe_text(text: str) -> str:
    """Return one line without controls, markup or overlong words; never longer than the input."""
    text = flatten_to_one_line(text)
    if "[" in text:
        text = _TAG_START.sub("(", _TAG.sub(r"(\1)", text))
    return _OVERLONG_WORD.sub(lambda word: word[0][: MAX_WORD_LENGTH - 1] + "…", text)


def harmless_lines(text: str) -> str:
    """Return the text with its line ends, each line without cursor movement: for outputs."""
    return "\n".join(map(flatten_to_one_line, text.split("\n")))


def flatten_to_one_line(text: str) -> str:
    """Return the text on one line, without cursor movement and changes of the reading direction."""
    if text.isascii() and text.isprintable():
        return text
    shown: list[str] = []
    marks = 0
    for char in text:
        kind = unicodedata.category(char)
        marks = marks + 1 if kind in ("Mn", "Me") else 0
        if marks > MAX_MARKS:
            continue
        shown.append(_visible_char(char, kind))
    return "".join(shown)


def _visible_char(char: str, unicode_category: str) -> str:
    if char.isspace():
        return " "
    return "\N{REPLACEMENT CHARACTER}" if unicode_category in HIDDEN_CATEGORIES else char


def to_indented_log_lines(text: str) -> str:
    """Return lines for a log; all but the first are indented, so that none looks like an entry."""
    return "\n    ".join(flatten_to_one_line(line) for line in text.splitlines())


def escape_csv_formula(text: str) -> str:
    """Return a cell that no spreadsheet evaluates: numbers stay, formulas get an apostrophe."""
    if text[:1] not in ("=", "+", "-", "@", "\t", "\r") or len(text) == 1 or _is_number(text):
        return text
    return f"'{text}"


def check_name(key: str, name: str) -> None:
    """Raise LeewayError with `key` unless a name is a single harmless line."""
    if len(name) > MAX_NAME_LENGTH or safe_text(name) != name:
        shown = safe_text(name[:MAX_NAME_LENGTH])
        expected = f"at most {MAX_NAME_LENGTH} characters of one line, no controls, no markup"
        raise LeewayError(f"{key} = {shown!r}: expected {expected}")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
