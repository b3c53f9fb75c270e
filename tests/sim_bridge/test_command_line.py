"""`sim-bridge` on the command line: flight commands first, experiments under `research`."""

import subprocess
import sys

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from sim_bridge.main import app, current_spelling_by_deprecated
from sim_bridge.research.campaign.workbench import PLANNERS

IN_FRONT = {
    "faults", "trials", "fly", "day", "cross", "serve", "conform", "research",
    "examples",
}  # fmt: skip
PAPER = ("campaign", "promise", "avoid", "table1", "table2", "frontier")
"""Research commands whose old spelling is in published commands."""

HEAVY = (
    "numpy", "scipy", "networkx", "msgspec", "pymavlink", "mcap", "zenoh", "matplotlib", "numba",
    "sqlalchemy", "torch",
)  # fmt: skip


def test_help_shows_what_flies_and_research() -> None:
    shown = {name for name, command in vars(get_command(app))["commands"].items()}
    assert shown == IN_FRONT


def test_every_research_command_works_without_research() -> None:
    research = vars(get_command(app))["commands"]["research"].commands
    names = {name for name, command in research.items() if not hasattr(command, "commands")}
    assert names <= set(current_spelling_by_deprecated())
    assert set(PAPER) <= names
    assert all(now.split()[1] in research for now in current_spelling_by_deprecated().values())


@pytest.mark.parametrize("old", ["bench", "bench flight", "campaign", "real-flights"])
def test_an_old_spelling_says_the_new_one_and_does_the_same(old: str) -> None:
    now = current_spelling_by_deprecated()[old].split()
    before = CliRunner().invoke(app, [*old.split(), "--help"])
    after = CliRunner().invoke(app, [*now, "--help"])
    assert (before.exit_code, before.stdout) == (after.exit_code, after.stdout) == (0, after.stdout)
    assert before.stderr == f"sim-bridge {old} is now sim-bridge {' '.join(now)}\n"
    assert after.stderr == ""


@pytest.mark.parametrize(
    ("command", "refusal"),
    [
        ("trials logs --cluster local", "--cluster: `trials logs` does not use it"),
        ("trials soak --jobs 3", "--jobs: `trials soak` does not use it"),
        ("trials fuzz --hours 3 --depot", "--hours, --truck: `trials fuzz` does not use it"),
        ("fly --seeds 1:2 --seed 3 --vehicles 2", "--vehicles, --seed: not with --seeds"),
        ("fly --seeds 1:2 --autopilot mixed", "--autopilot mixed: not with --seeds"),
        ("fly --jobs 3", "--jobs: expected with --seeds"),
        ("serve --fly a.plan --out a.tlog --home 1,2,3", "--home: not with --fly"),
        ("serve --nose-held --out a.tlog", "--nose-held, --out: expected with --fly"),
        ("serve --fly a.plan", "--fly: expected --out FILE.tlog"),
    ],
)
def test_an_option_without_effect_is_refused(command: str, refusal: str) -> None:
    done = CliRunner().invoke(app, command.split())
    assert refusal in str(done.exception)


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
