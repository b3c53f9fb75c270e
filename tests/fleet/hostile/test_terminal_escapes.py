"""A member with a valid signature sends terminal escape sequences to a desk's log and to `watch`.
Both run as real processes over TLS, each on its own terminal.
"""

from contextlib import closing
from pathlib import Path

import pytest

from companion.fleet.command_log import CommandReply
from companion.fleet.messages import CommandStatus, EventKind
from tests.fleet.programs import program, short_day
from tests.fleet.secure_site import SecureSite

EVIL = "\x1b]0;owned\x07\x1b[31337mgone\x9b2J"
RAW = (b"\x1b]0;owned", b"\x07", b"\x1b[31337m", "\x9b".encode())
"""Window title, bell, a colour that this project does not use, and an 8-bit control character."""

NO_SAFE_TEXT = """
from companion.core.base import safe_text
for name in ("safe_text", "flatten_to_one_line", "harmless_lines"):
    assert hasattr(safe_text, name)
    setattr(safe_text, name, lambda text: text)
"""


def raw_in(words: bytes) -> list[bytes]:
    return [sequence for sequence in RAW if sequence in words]


DESKS = pytest.mark.parametrize(
    "guarded", [True, pytest.param(False, marks=pytest.mark.night)], ids=["desk", "desk's canary"]
)


@pytest.mark.sample
@DESKS
def test_a_members_words_reach_no_terminal_raw(tmp_path: Path, guarded: bool):
    """`watch` runs with its canary each time; the slower desk runs its canary at night only."""
    site = SecureSite(tmp_path / "pki")
    store = ("--store", f"sqlite:///{tmp_path}/desk.db")
    desk_options = (*store, "--identity", site.home("desk"), "--auto-launch")
    watch_options = ("watch", *store, "--identity", site.home("otto"), "--fleet", "harbour")
    before = "" if guarded else NO_SAFE_TEXT
    with (
        program("dispatch", short_day(tmp_path), *desk_options, before=before) as desk,
        closing(site.vehicle("d1", tmp_path / "d1")) as d1,
    ):
        desk.said("dispatching")
        d1.answer = CommandReply(CommandStatus.REFUSED, EVIL)
        d1.port.member.status_text = EVIL
        d1.port.record_event(EventKind.TEXT, EVIL)
        desk.said("owned")
        with (
            program(*watch_options) as watch,
            program(*watch_options, before=NO_SAFE_TEXT) as canary,
        ):
            for each in (watch, canary):
                each.said("owned")
                assert each.end() == 0
        assert desk.end() == 0
    assert (raw_in(desk.words) == []) is guarded
    assert raw_in(watch.words) == []
    assert raw_in(canary.words) != []


def test_what_is_looked_for_is_what_was_sent():
    assert raw_in(EVIL.encode()) == list(RAW)
    assert raw_in("\N{REPLACEMENT CHARACTER}]0;owned".encode()) == []
