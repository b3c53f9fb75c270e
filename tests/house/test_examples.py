"""The examples run unchanged, print the documented output, and stay short."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from sim_bridge.research.reference.programs import main_module_of_program

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(EXAMPLES.rglob("*.py"))
SIM_BRIDGE = f"from {main_module_of_program('sim-bridge')} import main; main()"
MOST_LINES = 80

pytestmark = pytest.mark.timeout(180)


def output_of(arguments: list[str], folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_is_short_and_says_how_to_run_it(path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) <= MOST_LINES
    assert f"python {path.relative_to(ROOT)}" in (ast.get_docstring(ast.parse(text)) or "")


def test_every_script_is_run_here() -> None:
    mine = Path(__file__).read_text()
    assert all(f'"{path.stem}.py"' in mine for path in SCRIPTS)


@pytest.mark.sample
def test_the_wind_is_found_in_a_log_of_closed_form(tmp_path: Path) -> None:
    said = output_of([str(EXAMPLES / "replay_a_log.py")], tmp_path)
    blown, estimated = (re.findall(r"[+-]\d+\.\d\d", line) for line in said.splitlines()[:2])
    for truth, found in zip(blown, estimated, strict=True):
        assert float(found) == pytest.approx(float(truth), abs=0.3)


def test_the_gate_turns_back_with_less_energy_and_more_wind(tmp_path: Path) -> None:
    said = output_of([str(EXAMPLES / "gate_on_a_made_up_flight.py")], tmp_path)
    rows = [line.split(maxsplit=5) for line in said.splitlines()[1:]]
    answers = {(float(wind), float(left)): words for wind, left, *_, words in rows}
    assert answers[2.0, 75.0] == "fly on"
    assert answers[12.0, 58.0] == "turn back"
    assert len(set(answers.values())) == 2


@pytest.mark.sample
@pytest.mark.third_party
def test_mavsdk_lifts_and_lands_what_serve_stands_up(tmp_path: Path) -> None:
    said = output_of([str(EXAMPLES / "drive_serve_with_mavsdk.py")], tmp_path)
    assert re.search(r"at (9|1\d)\.\d m", said)
    assert "landed and disarmed" in said


@pytest.mark.sample
def test_a_scenario_of_ones_own_flies(tmp_path: Path) -> None:
    file = EXAMPLES / "own_scenario" / "flight.toml"
    (command,) = re.findall(r"# +sim-bridge (fly .*)", file.read_text())
    words = [str(ROOT / word) if word.endswith(".toml") else word for word in command.split()]
    output_of(["-c", SIM_BRIDGE, *words, "--json", "out.json", "--no-picture"], tmp_path)
    (row,) = json.loads((tmp_path / "out.json").read_text())["flights"]
    assert (row["outcome"], row["home"]) == ("SUC", True)
