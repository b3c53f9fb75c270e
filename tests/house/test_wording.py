"""The wording check passes, and fails for a repository whose texts are in a private language."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MODULE = str(Path("companion", "wind.py"))
GOOD = '''"""Return the wind."""\n\n\ndef wind_speed_mps() -> float:\n    return 1.0\n'''


def checked(folder: Path, files: dict[str, str]) -> subprocess.CompletedProcess:
    """Run the check in a new repository with these files."""
    (folder / "deploy").mkdir()
    for name in ("check-wording", "everyday-words.txt"):
        shutil.copy(ROOT / "deploy" / name, folder / "deploy" / name)
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    subprocess.run(["git", "add", "-A"], cwd=folder, check=True)
    words = [sys.executable, "deploy/check-wording"]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)


def test_field_terms_pass(tmp_path: Path):
    done = checked(tmp_path, {MODULE: GOOD})
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("folder", "name", "text"),
    [
        ("companion", "wind.py", GOOD.replace("wind_speed_mps", "told")),
        ("companion", "wind.py", GOOD.replace("Return the wind.", "What the wind is.")),
        ("companion", "wind.py", GOOD + "# Nobody heard it.\n"),
        ("companion", "wind.py", GOOD + 'ERROR = "nobody has heard it"\n'),
        ("docs", "wind.md", "Nobody says so.\n"),
        ("tests", "test_wind.py", '"""Somebody told it."""\n'),
    ],
    ids=["name", "docstring", "comment", "message", "document", "test"],
)
def test_the_canary_private_language_fails(tmp_path: Path, folder: str, name: str, text: str):
    assert checked(tmp_path, {MODULE: GOOD, f"{folder}/{name}": text}).returncode == 1
