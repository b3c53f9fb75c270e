"""`sim-bridge` on the command line: what flies is in front, experiments behind `research`."""

import subprocess
import sys

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from sim_bridge.main import app
from sim_bridge.research.campaign.campaign import PLANNERS
from sim_bridge.research.cli.main import OLD_SPELLINGS

IN_FRONT = {
    "faults", "trials", "fly", "series", "day", "cross", "serve", "conform", "fly-plan", "research",
    "examples",
}  # fmt: skip
BEFORE = {
    "bench", "campaign", "table1", "table2", "lambda-sweep", "energy-speed", "speed-to-fly",
    "towns", "frontier", "paths", "promise", "avoid", "avoid-table", "avoid-curve", "export-avoid",
    "train-avoid",
}  # fmt: skip
"""Commands of `sim-bridge` before `research` was."""

HEAVY = (
    "numpy", "scipy", "networkx", "msgspec", "pymavlink", "mcap", "zenoh", "matplotlib", "numba",
    "sqlalchemy", "torch",
)  # fmt: skip


def test_help_shows_what_flies_and_research() -> None:
    shown = {name for name, command in vars(get_command(app))["commands"].items()}
    assert shown == IN_FRONT


def test_every_old_spelling_is_still_a_command() -> None:
    assert set(OLD_SPELLINGS) == BEFORE


@pytest.mark.parametrize("old", sorted(BEFORE))
def test_an_old_spelling_says_the_new_one_and_does_the_same(old: str) -> None:
    now = list(OLD_SPELLINGS[old])
    before = CliRunner().invoke(app, [old, "--help"])
    after = CliRunner().invoke(app, [*now, "--help"])
    assert (before.exit_code, before.stdout) == (after.exit_code, after.stdout) == (0, after.stdout)
    assert before.stderr == f"sim-bridge {old} is now sim-bridge {' '.join(now)}\n"
    assert after.stderr == ""


def test_an_unknown_command_is_refused_without_a_hint() -> None:
    done = CliRunner().invoke(app, ["train-compare"])
    assert done.exit_code == 2
    assert "No such command" in done.stderr
    assert "is now" not in done.stderr


@pytest.mark.parametrize(
    "asked", ["--help", "--version", "fly --help", "trials --help", "research --help"]
)
def test_help_loads_nothing_that_flies(asked: str) -> None:
    code = (
        "import sys\n"
        "from sim_bridge.main import app\n"
        f"app({asked.split()!r}, standalone_mode=False)\n"
        f"print(*(name for name in {HEAVY!r} if name in sys.modules), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.strip()) == (0, "")


def test_the_campaigns_help_names_every_planner() -> None:
    shown = CliRunner().invoke(app, ["research", "campaign", "--help"]).stdout
    assert all(name in shown for name in PLANNERS)


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("fly", "arducopter_sitl, default, faults, hills, px4_sih, recorded, truck_stop"),
        ("day", "faults, harbour, town, villages"),
    ],
)
def test_an_unknown_flight_or_day_is_answered_with_the_names(command: str, names: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sim_bridge.main", command, "nowhere"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        f"sim-bridge: nowhere: no such {'flight' if command == 'fly' else 'day'};"
        f" names: {names}; or give a file's path"
    ]
