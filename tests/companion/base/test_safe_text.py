"""External text is harmless when shown on a terminal, in a log or in a spreadsheet."""

import csv
import io
import re
import typing
import unicodedata
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from rich.errors import MarkupError
from rich.table import Table

from companion.adapters.logs.text_log import TextLog, format_log_entry
from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import (
    MAX_WORD_LENGTH,
    check_name,
    escape_csv_formula,
    flatten_to_one_line,
    safe_text,
    to_indented_log_lines,
)
from companion.core.base.wire_message import WireMessage
from companion.core.separation.track import Track
from companion.fleet import messages
from companion.fleet.messages import (
    TEXT_FIELDS,
    Command,
    CommandStatus,
    EventKind,
    FleetEvent,
    Recall,
    Refused,
    Result,
    State,
    decode_message,
    encode_message,
)
from ground_station.app.views import terminal
from ground_station.app.views.day_content import DisplayRows
from ground_station.app.views.terminal import plain_console
from ground_station.app.views.watch_view import watch_view
from ground_station.core.fleet.fleet_status import FleetStatus

ATTACKS = (
    "[/x]",
    "[red]home[/red]",
    "[@click=app.bell]look[/]",
    "[link=https://evil.example]ok[/link]",
    "\x1b]0;all is well\x07",
    "\x1b[2J\x1b[H",
    "\x1b]52;c;cm0gLXJmIC8=\x07",
    "\x9b31m",
    "gate open\n12:00:00Z d1: delivered",
    "\u202edetrevni\u202c",
    "a\u200bb",
    "x" * 400,
    "e" + "\u0301" * 40,
    ":warning:",
    "\ud800",
)
hostile = st.one_of(
    st.sampled_from(ATTACKS),
    st.text(max_size=300),
    st.lists(st.sampled_from(["[", "]", "/", "x", "\\", "\x1b", " ", "@", "\n"]), max_size=60).map(
        "".join
    ),
)
SENT = hostile.filter(lambda text: "\ud800" not in text)
COLOURS = re.compile(r"\x1b\[[0-9;]*m")


def is_harmless(text: str) -> bool:
    kinds = {unicodedata.category(char) for char in text}
    return not kinds & {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


@pytest.mark.sample
@given(hostile)
def test_safe_text_is_harmless_not_longer_and_the_same_when_taken_twice(text: str):
    safe = safe_text(text)
    assert is_harmless(safe)
    assert len(safe) <= len(text)
    assert safe_text(safe) == safe
    assert max(map(len, safe.split(" "))) <= MAX_WORD_LENGTH


@pytest.mark.sample
@settings(max_examples=60, deadline=None)
@given(hostile)
def test_no_console_takes_safe_text_for_markup(text: str):
    """Also a console with rich's default settings."""
    out = io.StringIO()
    table = Table("says", title=safe_text(text))
    table.add_row(safe_text(text))
    Console(file=out, width=500, emoji=False, color_system=None).print(table)
    assert is_harmless(out.getvalue().replace("\n", ""))


def test_canary_a_console_obeys_words_that_were_not_made_safe():
    with pytest.raises(MarkupError):
        Console(file=io.StringIO()).print("[/x]")


@pytest.mark.parametrize(
    "words",
    [
        "obstacles.features[0]: the polygon crosses itself",
        "phase: outbound -> return: gate closed, +5.8 Wh",
        "Würde für Jörg, 北京, Ελλάδα, नमस्ते",
    ],
)
def test_words_of_ours_and_of_other_languages_stay_as_they_are(words: str):
    assert safe_text(words) == words


# --- decoding of messages ------------------------------------------------------------------------


def state_of(text: str) -> bytes:
    table = {
        "v": 2, "vehicle": "d1", "life": "l1", "uptime_s": 1.0, "epoch_us": 0, "airframe": "m100",
        "max_payload_kg": 1.0, "phase": "standby", "log": "l1", "last_seq": 0, "text": text[:500],
    }  # fmt: skip
    return msgspec.json.encode(table)


def watched(raw: bytes) -> str:
    """Return a state as displayed on a dispatcher's colour terminal."""
    out = io.StringIO()
    console = plain_console(out, 120)
    state = decode_message(State, raw)
    assert isinstance(state, State), state
    status = FleetStatus()
    status.record_state_and_new_doubts(state, 0.0, 0)
    console.print(watch_view(status, DisplayRows(), 0.0))
    return out.getvalue()


@settings(max_examples=40, deadline=None)
@given(SENT)
def test_what_a_vehicle_says_is_shown_by_watch_and_neither_obeyed_nor_fatal(text: str):
    assert is_harmless(COLOURS.sub("", watched(state_of(text))).replace("\n", ""))


def test_canary_undecoded_words_reach_the_terminal_as_escape_sequences(monkeypatch):
    raw = state_of("\x1b]0;all is well\x07")
    assert "\x1b" not in watched(raw)
    monkeypatch.setattr(messages, "safe_text", lambda text: text)
    assert "\x1b" not in watched(raw), "removed once more at the output"
    monkeypatch.setattr(terminal, "harmless_lines", lambda text: text)
    assert "\x1b]0;all is well" in watched(raw)


@given(SENT)
def test_every_word_of_every_message_is_safe_when_it_is_decoded(text: str):
    event = FleetEvent(
        vehicle="d1", log="l", seq=1, epoch_us=0, kind=EventKind.TEXT, text=text[:500]
    )
    told = decode_message(FleetEvent, encode_message(event))
    assert isinstance(told, FleetEvent)
    assert told.text == safe_text(text[:500])
    result = Result(
        id="c", vehicle="d1", instance_id="l", status=CommandStatus.DONE, reason=text[:500]
    )
    assert messages.decode_message(Result, encode_message(result)) == msgspec.structs.replace(
        result, reason=safe_text(text[:500])
    )
    command = Command(
        id="c", vehicle="d1", instance_id="l", as_of_s=0.0, by=text[:60] or "x", action=Recall()
    )
    asked = messages.decode_message(Command, encode_message(command))
    assert isinstance(asked, Command)
    assert is_harmless(asked.by)


@given(SENT)
def test_a_refusal_quotes_what_was_sent_and_is_safe_too(text: str):
    refused = decode_message(State, msgspec.json.encode({"v": 1, text: 1}))
    assert isinstance(refused, Refused)
    assert is_harmless(refused.reason)


@pytest.mark.parametrize("kind", [State, FleetEvent, Command, Result, Track])
def test_every_text_of_a_message_is_a_name_with_a_pattern_or_one_of_its_words(
    kind: type[WireMessage],
):
    hints = typing.get_type_hints(kind, include_extras=True)
    loose = [name for name, hint in hints.items() if _is_loose_text(hint)]
    assert loose == list(TEXT_FIELDS.get(kind, ()))


def _is_loose_text(hint: Any) -> bool:
    if typing.get_origin(hint) is typing.Annotated:
        base, *metas = typing.get_args(hint)
        return base is str and not any(meta.pattern for meta in metas)
    return hint is str


# --- logs, files, spreadsheets -------------------------------------------------------------------


@given(hostile)
def test_no_words_make_an_entry_of_a_log(text: str):
    shown = to_indented_log_lines(text)
    assert all(line.startswith("    ") for line in shown.split("\n")[1:])
    assert is_harmless(shown.replace("\n", ""))


def test_a_forged_entry_stands_indented_under_the_one_that_carries_it(tmp_path: Path):
    log = TextLog(tmp_path / "log")
    log.write(format_log_entry(1.0, "first\n2026-01-01 00:00:00      2.00  delivered"))
    log.close()
    entries = [x for x in (tmp_path / "log").read_text().splitlines() if not x.startswith(" ")]
    assert len(entries) == 1


@given(SENT)
def test_no_cell_of_a_table_is_a_formula(text: str):
    out = io.StringIO(newline="")
    csv.writer(out).writerow([escape_csv_formula(text), "next"])
    (row,) = list(csv.reader(io.StringIO(out.getvalue(), newline=""), strict=True))
    first = row[0]
    assert row[1] == "next"
    assert first[:1] not in ("=", "+", "-", "@") or len(first) == 1 or _is_a_number(first)


def _is_a_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def test_canary_a_formula_stays_one_without_the_apostrophe():
    assert escape_csv_formula("=HYPERLINK(A1)") == "'=HYPERLINK(A1)"
    assert escape_csv_formula("-5.3") == "-5.3"


@pytest.mark.parametrize("name", ["a\nb", "\x1b[2J", "[/x]", "x" * 101, "\u202eabc"])
def test_a_name_that_would_do_more_than_be_read_is_refused(name: str):
    with pytest.raises(LeewayError, match="name = "):
        check_name("name", name)
    assert flatten_to_one_line(name).isprintable() or "\u202e" not in flatten_to_one_line(name)
