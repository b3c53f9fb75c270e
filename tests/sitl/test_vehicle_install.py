"""The vehicle's install: a flight with the companion of the built wheel loads no log analysis, no
desk and no simulator."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NEVER_LOADED = (
    *("ground_station", "sim_bridge", "scipy", "torch", "matplotlib", "rich"),
    *("companion.analysis", "companion.app.tools", "companion.adapters.logs.open_log"),
)
OF_THE_SIMULATOR = {"sim_bridge", "sim_bridge.adapters", "sim_bridge.adapters.lifeline"}
"""Simulator code in the companion's process before its `main`: ends it with its parent."""

SITE = """
import atexit, json, os, sys
def write():
    files = {{name: getattr(module, "__file__", None) for name, module in sys.modules.items()}}
    table = {{"argv": sys.argv, "modules": files}}
    with open(os.path.join({folder!r}, f"{{os.getpid()}}.json"), "w") as file:
        json.dump(table, file)
atexit.register(write)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Return the unpacked wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    words = ["-m", "pip", "-q", "wheel", "--no-deps", "-w", str(folder), str(ROOT)]
    subprocess.run([sys.executable, *words], check=True, capture_output=True)
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as archive:
        archive.extractall(folder / "content")
    return folder / "content"


def loaded_after_a_flight(wheel: Path, folder: Path) -> dict[str, str | None]:
    """Return the modules of the companion's process at its end, with their files."""
    (folder / "site").mkdir()
    site = SITE.format(folder=str(folder))
    (folder / "site" / "sitecustomize.py").write_text(site)
    environment = os.environ | {"PYTHONPATH": f"{folder / 'site'}:{wheel}"}
    words = ["-c", "from sim_bridge.main import main; main()", "fly", "--seed", "2"]
    subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, check=False, capture_output=True
    )
    tables = [json.loads(path.read_text()) for path in folder.glob("*.json")]
    return next(table["modules"] for table in tables if table["argv"][1] == "run")


def not_of_a_vehicle(modules: dict[str, str | None]) -> list[str]:
    return [
        name
        for name in sorted(modules.keys() - OF_THE_SIMULATOR)
        if any(name == one or name.startswith(f"{one}.") for one in NEVER_LOADED)
    ]


@pytest.mark.every_run
@pytest.mark.sample
def test_a_flight_loads_no_analysis_no_desk_and_no_simulator(wheel, tmp_path):
    modules = loaded_after_a_flight(wheel, tmp_path)
    of_the_wheel = [file for name, file in modules.items() if name.startswith("companion") and file]
    assert len(of_the_wheel) > 100
    assert all(file.startswith(str(wheel)) for file in of_the_wheel)
    assert not_of_a_vehicle(modules) == []


def test_a_module_of_analysis_would_be_seen():
    assert not_of_a_vehicle(
        {"companion.analysis.replay.flight_replay": None, "companion": None}
    ) == ["companion.analysis.replay.flight_replay"]
    assert not_of_a_vehicle(dict.fromkeys(OF_THE_SIMULATOR)) == []
    assert not_of_a_vehicle({"sim_bridge.truth": None, "scipy": None}) == [
        *("scipy", "sim_bridge.truth")
    ]
