"""`ground-station` as users start it: its version, and days by name."""

import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version

import pytest

CODE = "from ground_station.app.cli.main import main; main()"

HEAVY = (
    "numpy", "scipy", "networkx", "msgspec", "shapely", "zenoh", "matplotlib", "numba",
    "sqlalchemy", "httpx", "h11",
)  # fmt: skip


def run(*arguments: str) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, "-c", CODE, *arguments],
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


def installed_version() -> str:
    try:
        return version("leeway-uas")
    except PackageNotFoundError:
        return version("leeway")


def test_the_version_is_that_of_the_installed_distribution():
    assert run("--version") == (0, f"ground-station {installed_version()}\n", "")


@pytest.mark.sample
def test_the_orders_of_a_bundled_day_are_taken_by_its_name(tmp_path):
    code, out, errors = run("order", "import", "harbour", "--store", f"sqlite:///{tmp_path}/d.db")
    assert (code, errors) == (0, "")
    assert "8 orders imported" in out


@pytest.mark.sample
@pytest.mark.parametrize(
    ("asked", "not_even"),
    [
        ("--version", ("rich",)),
        ("--help", ()),
        ("order --help", ()),
        ("plan --help", ()),
        ("dispatch --help", ()),
    ],
)
def test_help_loads_nothing_that_plans_or_flies(asked: str, not_even: tuple[str, ...]) -> None:
    assert loaded(asked, HEAVY + not_even) == ""


@pytest.mark.sample
def test_a_list_of_orders_loads_no_planner_and_no_network(tmp_path) -> None:
    url = f"sqlite:///{tmp_path}/d.db"
    run("order", "import", "harbour", "--store", url)
    asked = f"order list --store {url}"
    assert loaded(asked, ("numba", "scipy.stats", "networkx", "zenoh", "httpx")) == ""


def loaded(asked: str, names: tuple[str, ...]) -> str:
    """Return which of the modules a command has loaded."""
    code = (
        "import sys\n"
        "from ground_station.app.cli.main import app\n"
        f"app({asked.split()!r}, standalone_mode=False)\n"
        f"print(*(name for name in {names!r} if name in sys.modules), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stderr.strip()


@pytest.mark.sample
@pytest.mark.parametrize("missing", ["sqlalchemy", "numba"])
def test_without_the_ground_extra_a_command_says_what_to_install(missing: str, tmp_path) -> None:
    asked = {
        "sqlalchemy": ["order", "list", "--store", f"sqlite:///{tmp_path}/d.db"],
        "numba": ["plan", "town"],
    }[missing]
    code = f"""
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name == {missing!r}:
            raise ModuleNotFoundError("No module named " + repr(name), name=name)
sys.meta_path.insert(0, Absent())
{CODE}
"""
    done = subprocess.run(
        [sys.executable, "-c", code, *asked], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        f"ground-station: No module named '{missing}': run pip install 'leeway-uas[ground]'\n"
    )


def test_orders_of_a_spreadsheet_are_checked_against_their_day_and_reported_as_json(tmp_path):
    table, report = tmp_path / "more.csv", tmp_path / "report.json"
    url = f"sqlite:///{tmp_path}/d.db"
    options = ("--day", "harbour", "--json", str(report), "--store", url)
    table.write_text("order no;position;weight (kg)\nA-1;55,468 8,44;0,4\n")
    code, out, errors = run("order", "import", str(table), *options)
    assert (code, "1 orders imported" in out) == (0, True), errors
    files = json.loads(report.read_text())["files"]
    assert files[0]["used"] == 1
    assert "read as separated by semicolons" in files[0]["notes"]
    table.write_text("order no;position;weight (kg)\nA-2;8,44 55,468;0,4\n")
    assert run("order", "import", str(table), *options)[0] == 2
    (refused,) = json.loads(report.read_text())["refused"]
    assert (refused["row"], refused["column"]) == (2, "lat_deg")
    assert "swapped?" in refused["text"]
