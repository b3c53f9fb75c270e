"""The `companion` command line: fast help, clear error messages."""

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.adapters.autopilots import link
from companion.adapters.files.params import flight_file_path, params_dir
from companion.app.cli.main import app
from companion.app.flight.run import LINK_CLOSED

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
    for name in ("arducopter_sitl", "default", "px4_sih", "recorded", "truck_stop"):
        assert flight_file_path(name) == folder / f"{name}.toml"


def test_a_path_is_taken_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert flight_file_path("my/flight.toml") == Path("my/flight.toml")
    assert flight_file_path("default.toml") == Path(
        "default.toml"
    )  # the reader reports a missing file
    monkeypatch.chdir(tmp_path)
    (tmp_path / "default").write_text("")
    assert flight_file_path("default") == Path("default")


@pytest.mark.parametrize("command", ["run", "check"])
def test_an_unknown_flight_is_one_line_and_exit_code_2(command: str) -> None:
    done = CliRunner().invoke(app, [command, "--link", "tcp:127.0.0.1:9", "--mission", "nowhere"])
    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1
    assert "default, faults, hills, px4_sih, recorded, truck_stop" in done.stderr


@contextmanager
def udp_port_held() -> Iterator[str]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        yield f"udpin:127.0.0.1:{holder.getsockname()[1]}"


@contextmanager
def server_not_up_yet() -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    yield f"tcp:127.0.0.1:{port}"


@contextmanager
def serial_port_held() -> Iterator[str]:
    master, slave = os.openpty()
    holder = link.open_link(url := f"serial:{os.ttyname(slave)}:57600")
    try:
        yield url
    finally:
        holder.close()
        os.close(slave)
        os.close(master)


@pytest.mark.sample
@pytest.mark.parametrize("closed", [udp_port_held, server_not_up_yet, serial_port_held])
@pytest.mark.parametrize("command", ["run", "check"])
def test_a_link_that_does_not_open_now_ends_with_a_code_that_a_service_tries_again(
    command: str, closed: Callable[[], AbstractContextManager[str]], tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(link, "CONNECT_TIMEOUT_S", 0.0)
    with closed() as url:
        words = [command, "--link", url, "--mission", "default", "--run-dir", str(tmp_path / "run")]
        done = CliRunner().invoke(app, words)
    assert done.exit_code == LINK_CLOSED
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("companion: link ")


DEPLOY = Path(__file__).parents[3] / "deploy"


@pytest.mark.parametrize("unit", ["leeway-companion.service", "leeway-companion-fleet.service"])
def test_the_services_try_a_link_that_did_not_open_again(unit: str) -> None:
    lines = (DEPLOY / unit).read_text().splitlines()
    settings = dict(line.split("=", 1) for line in lines if "=" in line and line[0] != "#")
    assert settings["Restart"] == "on-failure"
    for key in ("RestartPreventExitStatus", "SuccessExitStatus"):
        assert str(LINK_CLOSED) not in settings[key].split()
    assert "2" in settings["RestartPreventExitStatus"].split()
