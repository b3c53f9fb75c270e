"""Two flights decide as at the base commit; the comparison notices what differs."""

import copy
import subprocess
import sys
from pathlib import Path

import pytest

from tests.golden.compare import TextTable, differences

ROOT = Path(__file__).resolve().parents[2]
NO_TEXTS = TextTable([])
ROW = {
    "flights": [
        {"outcome": "SUC", "margin_wh": 7.4, "run": "logs/a",
         "decisions": [{"t_s": 21.3, "kind": "read_back", "reason": "ours"}]}
    ]
}  # fmt: skip


@pytest.mark.sitl
@pytest.mark.timeout(300)
def test_two_flights_decide_as_at_the_base_commit():
    base = Path(__file__).with_name("base.txt").read_text().strip()
    known = subprocess.run(["git", "cat-file", "-e", base], cwd=ROOT, check=False)
    if known.returncode:
        pytest.skip(f"no history here: {base} is missing")
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
