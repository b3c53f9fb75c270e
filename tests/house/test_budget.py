"""The size budget holds, and its check fails where the project exceeds a figure or a limit."""

import subprocess
import sys
import tomllib
from pathlib import Path
from runpy import run_path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NAMES = tomllib.loads((ROOT / "budget.toml").read_text())["most"]
CHECK = run_path(str(ROOT / "deploy" / "check-budget"))
FILE = "companion/core/base/errors.py"
IMPORTS = "".join(f"import companion.m{k}\nfrom sim_bridge.m{k} import a\n" for k in range(10))


def test_an_exceeded_budget_fails(tmp_path):
    text = "".join(f"{name} = 1\n" for name in NAMES)
    (tmp_path / "less.toml").write_text(f"[most]\n{text}[oversized]\n")
    words = [sys.executable, "deploy/check-budget", str(tmp_path / "less.toml")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stdout.count("EXCEEDED") == len(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_one_more_than_one_figure_of_the_budget_fails(name):
    budget = dict.fromkeys(CHECK["sizes"]([]) | CHECK["commands"]([]), 7)
    assert CHECK["figures_exceeded"](budget, budget) == []
    assert CHECK["figures_exceeded"](budget, budget | {name: 8}) == [name]


def raised_with_other_files(repository: Path, base: str) -> list[str]:
    """Return the commits after the base that raise total_lines and change other files, too."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=repository, capture_output=True, check=False)
        assert done.returncode == 0, f"{done.stderr.decode()}: run `git fetch --unshallow`"
        return done.stdout.decode()

    def total(commit: str) -> int:
        return tomllib.loads(git("show", f"{commit}:budget.toml"))["most"]["total_lines"]

    changes = git("rev-list", "--no-merges", f"{base}..HEAD", "--", "budget.toml").split()
    return [
        commit
        for commit in changes
        if total(commit) > total(f"{commit}~")
        and git("show", "--format=", "--name-only", commit).split() != ["budget.toml"]
    ]


def test_a_commit_that_raises_the_total_changes_the_budget_only():
    """Where one did, move the base behind it in a commit that gives the reason."""
    assert raised_with_other_files(ROOT, "75273df2a69147fcef8b19b5e6f87ce474f1529c") == []


@pytest.mark.parametrize(
    ("total", "other", "is_found"), [(2, "b", True), (2, "a", False), (0, "b", False)]
)
def test_a_total_raised_along_with_other_files_is_found(tmp_path, total, other, is_found):
    git = ["git", "-c", "user.name=a", "-c", "user.email=a"]
    subprocess.run([*git, "init", "-q"], cwd=tmp_path, check=True)
    for lines, text in ((1, "a"), (total, other)):
        (tmp_path / "budget.toml").write_text(f"[most]\ntotal_lines = {lines}\n")
        (tmp_path / "other").write_text(text)
        for words in (["add", "."], ["commit", "-q", "-m", "a"]):
            subprocess.run([*git, *words], cwd=tmp_path, check=True)
    assert bool(raised_with_other_files(tmp_path, "HEAD~")) == is_found


@pytest.mark.parametrize(
    ("text", "listed", "broken"),
    [
        ("class A:\n" + "    a = 1\n" * 249, {}, []),
        ("class A:\n" + "    a = 1\n" * 250, {}, ["A class_lines: 251, at most 250"]),
        ("class A:\n" + "    def a(self): ...\n" * 20, {}, []),
        ("class A:\n" + "    def a(self): ...\n" * 21, {}, ["A methods: 21, at most 20"]),
        ("\n" * 400, {}, []),
        ("\n" * 401, {}, ["lines: 401, at most 400"]),
        ("import typer, numpy\n" + IMPORTS, {}, []),
        ("import companion.m\n" + IMPORTS, {}, ["imports: 21, at most 20"]),
        ("\n" * 410, {"lines": 410}, []),
        ("\n" * 411, {"lines": 410}, ["lines: 411, at most 410"]),
        ("\n" * 400, {"lines": 410}, ["lines: no longer oversized: delete the line"]),
    ],
)
def test_a_class_or_module_beyond_its_limit_fails(text, listed, broken):
    exceptions = {f"{FILE} {key}": size for key, size in listed.items()}
    found = CHECK["exceptions_broken"](exceptions, CHECK["oversized"]([(FILE, text)]))
    assert found == [f"{FILE} {words}" for words in broken]
