"""A member whose signature is right sends a terminal's escape sequences: to a desk's log and to a
`watch`, both as a person starts them, over TLS, each at a terminal of its own.
"""

from contextlib import closing
from pathlib import Path

from companion.adapters.files.params import params_dir
from companion.fleet.command_log import Verdict
from companion.fleet.messages import Answered, EventKind
from tests.fleet.programs import program
from tests.fleet.secure_site import SecureSite
from tests.fleet.test_attacks import GUARD

EVIL = "\x1b]0;owned\x07\x1b[31337mgone\x9b2J"
RAW = (b"\x1b]0;owned", b"\x07", b"\x1b[31337m", "\x9b".encode())
"""A window's title, a bell, a colour that no program of ours uses, a control of eight bits."""

NO_SAFE_TEXT = """
from companion.core.base import safe_text
safe_text.safe_text = lambda text: text
safe_text.one_line = lambda text: text
"""


DAYS = params_dir() / "days"


def short_day(folder: Path) -> Path:
    """Harbour's, with one order: a desk looks at each before it begins."""
    header, first, *_ = (DAYS / "harbour_orders.csv").read_text().splitlines()
    (folder / "harbour_orders.csv").write_text(f"{header}\n{first}\n")
    text = (DAYS / "harbour.toml").read_text()
    day = folder / "harbour.toml"
    day.write_text(text.replace("../sites", str(params_dir() / "sites")))
    return day


def raw_in(words: bytes) -> list[bytes]:
    return [sequence for sequence in RAW if sequence in words]


@GUARD
def test_a_members_words_reach_no_terminal_raw(tmp_path: Path, guarded: bool):
    site = SecureSite(tmp_path / "pki")
    before = "" if guarded else NO_SAFE_TEXT
    store = ("--store", f"sqlite:///{tmp_path}/desk.db")
    desk_options = (*store, "--identity", site.home("desk"), "--auto-launch")
    watch_options = (*store, "--identity", site.home("otto"), "--fleet", "harbour")
    with (
        program("dispatch", short_day(tmp_path), *desk_options, before=before) as desk,
        closing(site.vehicle("d1", tmp_path / "d1")) as d1,
    ):
        desk.said("dispatching")
        d1.answer = Verdict(Answered.REFUSED, EVIL)
        d1.port.member.remark = EVIL
        d1.port.tell(EventKind.SAID, EVIL)
        desk.said("owned")
        with program("watch", *watch_options, before=before) as watch:
            watch.said("owned")
            assert watch.end() == 0
        assert desk.end() == 0
    found = {"desk": raw_in(desk.words), "watch": raw_in(watch.words)}
    if guarded:
        assert found == {"desk": [], "watch": []}
    else:
        assert all(found.values()), found


def test_what_is_looked_for_is_what_was_sent():
    assert raw_in(EVIL.encode()) == list(RAW)
    assert raw_in("\N{REPLACEMENT CHARACTER}]0;owned".encode()) == []
