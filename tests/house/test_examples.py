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
HTTP_TESTS = ROOT / "tests" / "ground_station" / "web" / "test_http_interface.py"

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
    mine = Path(__file__).read_text() + HTTP_TESTS.read_text()
    assert all(f'"{path.stem}.py"' in mine for path in SCRIPTS)


@pytest.mark.sample
def test_the_wind_is_found_in_a_log_of_closed_form(tmp_path: Path) -> None:
    said = output_of([str(EXAMPLES / "wind_from_a_log.py")], tmp_path)
    blown, estimated = (re.findall(r"[+-]\d+\.\d\d", line) for line in said.splitlines()[:2])
    for truth, found in zip(blown, estimated, strict=True):
        assert float(found) == pytest.approx(float(truth), abs=0.3)


@pytest.mark.sample
@pytest.mark.parametrize(
    ("script", "pattern"),
    [
        ("wind_from_arrays.py", r"to north [+-]0\.\d .*to east \+[12]\.\d"),
        ("can_it_return.py", r"10 +12 +0\.000[\s\S]*3 m/s: go,[\s\S]*14 m/s: no go,"),
        ("fly_and_plot.py", r"SUC, \+\d+\.\d Wh[\s\S]*least P\(home\) [01]\.\d+\nwrote flight.png"),
        ("plan_a_day.py", r"orders, back at the depot after \d+ min[\s\S]*drone .*: order "),
        ("own_planner.py", r"ber +SUC[\s\S]*downwind +SUC +[1-9]"),
        ("own_estimator.py", r"Leeway +0\.\d\d m/s[\s\S]*own_estimator:StillAir +[1-9]\.\d\d"),
    ],
)
def test_an_example_of_the_python_interface_prints_its_result(script, pattern, tmp_path) -> None:
    assert re.search(pattern, output_of([str(EXAMPLES / script)], tmp_path))


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
