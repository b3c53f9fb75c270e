"""The size budget: held, and its check fails where it is exceeded."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BUDGET = ROOT / "budget.toml"


def checked(file: Path) -> subprocess.CompletedProcess:
    words = [sys.executable, "deploy/check-budget", str(file)]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", ["total_lines", "words", "options"])
def test_one_more_than_the_budget_fails(tmp_path, name):
    lines = BUDGET.read_text().splitlines()
    less = [f"{name} = 1" if line.startswith(f"{name} ") else line for line in lines]
    (tmp_path / "less.toml").write_text("\n".join(less))
    done = checked(tmp_path / "less.toml")
    assert done.returncode == 1
    exceeded = [line.split()[0] for line in done.stdout.splitlines() if line.endswith("EXCEEDED")]
    assert name in exceeded
