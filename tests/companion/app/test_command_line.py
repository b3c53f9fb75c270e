"""`companion` on the command line: quick to say what it can do, clear about mistakes."""

import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.adapters.files.params import flight_path, params_dir
from companion.app.cli.main import app
from companion.core.base.errors import LeewayError

HEAVY = ("numpy", "scipy", "networkx", "msgspec", "pymavlink", "mcap", "zenoh", "matplotlib")


@pytest.mark.parametrize("asked", [["--help"], ["--version"], ["run", "--help"]])
def test_help_loads_nothing_that_flies(asked: list[str]) -> None:
    code = (
        "import sys\n"
        "from companion.app.cli.main import app\n"
        f"app({asked!r}, standalone_mode=False)\n"
        f"print(*(name for name in {HEAVY!r} if name in sys.modules), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == ""
    assert done.returncode == 0


def test_the_version_is_one_line() -> None:
    done = CliRunner().invoke(app, ["--version"])
    assert done.exit_code == 0
    assert done.output.startswith("companion")
    assert len(done.output.splitlines()) == 1


def test_bundled_flights_have_names() -> None:
    folder = params_dir() / "flights"
    for name in ("default", "recorded", "truck_stop"):
        assert flight_path(name) == folder / f"{name}.toml"


def test_a_path_is_taken_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert flight_path("my/flight.toml") == Path("my/flight.toml")
    assert flight_path("default.toml") == Path("default.toml")  # its absence is the reader's to say
    monkeypatch.chdir(tmp_path)
    (tmp_path / "default").write_text("")
    assert flight_path("default") == Path("default")


def test_an_unknown_name_is_answered_with_the_names() -> None:
    with pytest.raises(LeewayError, match=r"^defualt: .*default, faults, recorded, .*path$"):
        flight_path("defualt")


@pytest.mark.parametrize("command", ["run", "check"])
def test_an_unknown_flight_is_one_line_and_exit_code_2(command: str) -> None:
    done = CliRunner().invoke(app, [command, "--link", "tcp:127.0.0.1:9", "--mission", "nowhere"])
    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1
    assert "default, faults, recorded, truck_stop" in done.stderr
