"""Two flights decide as at the base commit; the comparison detects differences."""

import copy
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from tests.golden.compare import COMPANION, TextTable, compare_files, differences

ROOT = Path(__file__).resolve().parents[2]
NO_TEXTS = TextTable([])
ROW = {
    "flights": [
        {"outcome": "SUC", "margin_wh": 7.4, "run": "logs/a",
         "decisions": [{"t_s": 21.3, "kind": "read_back", "reason": "ours"}]}
    ]
}  # fmt: skip


@pytest.mark.every_run
@pytest.mark.sample
@pytest.mark.sitl
@pytest.mark.timeout(300)
def test_two_flights_decide_as_at_the_base_commit():
    base = Path(__file__).with_name("base.txt").read_text().strip()
    known = subprocess.run(["git", "cat-file", "-e", base], cwd=ROOT, check=False)
    assert known.returncode == 0, f"the history lacks {base}: run `git fetch --unshallow`"
    words = [sys.executable, "-m", "tests.golden", "--base", base, "--set", "two"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def changed(path, value):
    document = copy.deepcopy(ROW)
    table = document["flights"][0]
    for key in path[:-1]:
        table = table[key]
    table[path[-1]] = value
    return document


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (["margin_wh"], 7.4000001),
        (["outcome"], "DEL"),
        (["decisions", 0, "t_s"], 21.4),
        (["decisions", 0, "reason"], "another's"),
        (["decisions"], []),
        (["new"], None),
    ],
)
def test_whatever_differs_is_named(path, value):
    assert len(list(differences(ROW, changed(path, value), NO_TEXTS))) == 1


def test_folders_and_texts_of_the_table_do_not_differ():
    assert list(differences(ROW, changed(["run"], "logs/b"), NO_TEXTS)) == []
    table = TextTable([("^ours$", "our mission")])
    assert list(differences(ROW, changed(["decisions", 0, "reason"], "our mission"), table)) == []


def recorded(message: common.MAVLink_message, source: int = COMPANION) -> bytes:
    return bytes(8) + message.pack(common.MAVLink(None, srcSystem=1, srcComponent=source))


HEARTBEAT = recorded(common.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
OURS, OTHER, MAPPED = (
    recorded(common.MAVLink_statustext_message(4, text)) for text in (b"ours", b"x", b"our mission")
)
JUMPS = [common.MAVLink_mission_set_current_message(1, 1, item) for item in (3, 4)]
TO_3, TO_4 = map(recorded, JUMPS)


@pytest.mark.parametrize(
    ("base", "now", "difference"),
    [
        (TO_3 + TO_3, TO_3 + TO_4, "message 1: MISSION_SET_CURRENT"),
        (TO_3 + TO_4, TO_3, "2 messages, now 1"),
        (TO_3, OTHER, "message 0: MISSION_SET_CURRENT"),
        (OURS, OTHER, "message 0: STATUSTEXT"),
        (OURS, MAPPED, ""),
        (TO_3 + HEARTBEAT, HEARTBEAT + TO_3 + HEARTBEAT, ""),
        (*(recorded(jump, source=1) for jump in JUMPS), ""),
    ],
)
def test_a_command_that_differs_is_named(tmp_path, base, now, difference):
    (tmp_path / "base.tlog").write_bytes(base)
    (tmp_path / "now.tlog").write_bytes(now)
    table = TextTable([("^ours$", "our mission")])
    found = compare_files(tmp_path / "base.tlog", tmp_path / "now.tlog", table)
    assert len(found) == bool(difference)
    assert not found or found[0].startswith(difference)
