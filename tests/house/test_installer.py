"""deploy/install, as far as it can be tested here; `make install-check` uses a clean system."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

DEPLOY = Path(__file__).parents[2] / "deploy"
SCRIPTS = sorted(p for p in DEPLOY.iterdir() if p.is_file() and p.read_bytes().startswith(b"#!"))
SHELL_SCRIPTS = [p for p in SCRIPTS if b"bash" in p.read_bytes().split(b"\n")[0]]


def install(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([DEPLOY / "install", *words], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_scripts_can_be_started(script: Path):
    assert os.access(script, os.X_OK)


@pytest.mark.parametrize("script", SHELL_SCRIPTS, ids=lambda path: path.name)
def test_bash_can_read_a_script_to_its_end(script: Path):
    done = subprocess.run(["bash", "-n", str(script)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_each_unit_of_a_role_is_shipped_and_named_by_the_installer():
    """A missing unit that the installer copies would otherwise fail only on the vehicle."""
    text = (DEPLOY / "install").read_text()
    named = [
        word
        for line in text.splitlines()
        if line.strip().startswith("unit leeway-")
        for word in [line.split()[1]]
    ]
    assert len(named) == 6
    for name in named:
        assert (DEPLOY / f"{name}.service").is_file(), name
        assert name in text.split("UNIT_NAMES=", 1)[1].splitlines()[0], name


def test_help_names_every_role_and_needs_no_root():
    done = install("--help")
    assert done.returncode == 0
    for role in ("companion", "fleet", "desk", "map", "router", "truck"):
        assert f"\n  {role} " in done.stdout


def test_an_unknown_role_is_refused_before_anything_is_touched():
    done = install("pilot")
    assert done.returncode == 2
    assert "install: pilot: not known; see --help" in done.stderr


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv (util-linux) is not installed")
@pytest.mark.skipif(os.getuid() != 0, reason="needs root, to run it without")
def test_without_root_it_says_so_and_does_nothing():
    command = ["setpriv", "--reuid=65534", "--clear-groups", "bash", "-s", "--", "companion"]
    done = subprocess.run(
        command, input=(DEPLOY / "install").read_text(), capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "needs root" in done.stderr
