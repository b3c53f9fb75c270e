"""`ground-station` as people start it: its version, and days by name."""

import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version

CODE = "from ground_station.app.cli.main import main; main()"


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


def test_the_orders_of_a_bundled_day_are_taken_by_its_name(tmp_path):
    code, out, errors = run("order", "import", "harbour", "--store", f"sqlite:///{tmp_path}/d.db")
    assert (code, errors) == (0, "")
    assert "8 orders taken" in out


def test_a_day_that_is_not_bundled_is_one_line_and_exit_code_2():
    code, out, errors = run("cluster", "nowhere")
    assert (code, out) == (2, "")
    words = "ground-station: day 'nowhere': expected a file, or one of harbour, town\n"
    assert errors == words
