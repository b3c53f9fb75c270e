"""`ground-station dispatch --metrics`: where the figures are served, and where they are not."""

import socket
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.app.cli import metrics as metrics_module
from ground_station.app.cli.dispatch import app
from ground_station.app.cli.metrics import hold_port, metrics_address
from tests.fleet.zenoh_net import free_port


@pytest.mark.parametrize(
    ("asked", "held"),
    [
        ("9464", ("127.0.0.1", 9464)),
        ("127.0.0.1:9464", ("127.0.0.1", 9464)),
        ("127.1.2.3:9464", ("127.1.2.3", 9464)),
        ("localhost:9464", ("localhost", 9464)),
        ("[::1]:9464", ("::1", 9464)),
    ],
)
def test_a_port_alone_or_an_address_of_loopback_is_this_machines(asked, held):
    assert metrics_address(asked, open_metrics=False) == held


OUTSIDE = ("0.0.0.0:9464", "[::]:9464", "192.168.1.5:9464", "desk.harbour.example:9464")


@pytest.mark.parametrize("asked", OUTSIDE)
def test_an_address_that_others_reach_is_refused_unless_a_person_says_so(asked):
    with pytest.raises(LeewayError, match=r"whoever reaches it reads .* or --open-metrics"):
        metrics_address(asked, open_metrics=False)
    host, port = metrics_address(asked, open_metrics=True)
    assert (host, port) == (asked.rpartition(":")[0].strip("[]"), 9464)


def test_canary_without_that_check_strangers_would_reach_it(monkeypatch):
    monkeypatch.setattr(metrics_module, "is_loopback", lambda host: True)
    assert metrics_address("0.0.0.0:9464", open_metrics=False) == ("0.0.0.0", 9464)


@pytest.mark.parametrize(
    "asked", ["", "x", "0", "65536", "999999", ":9464", "a:b", "1:2:3", "host 1:9464", "::1:9464"]
)
def test_what_is_no_address_is_an_error_that_says_what_is(asked):
    with pytest.raises(LeewayError, match=r"expected PORT or HOST:PORT"):
        metrics_address(asked, open_metrics=True)


def test_without_the_option_no_port_is_held():
    with hold_port(None, open_metrics=False) as server:
        assert server is None


def test_the_port_is_held_from_the_beginning_and_given_back():
    port = free_port()
    with (
        hold_port(str(port), open_metrics=False),
        pytest.raises(LeewayError, match="Address already in use"),
        hold_port(str(port), open_metrics=False),
    ):
        pass
    with socket.socket() as other:
        other.bind(("127.0.0.1", port))


def test_a_desk_whose_port_is_taken_says_where_and_writes_nothing(tmp_path: Path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        arguments = ["dispatch", "harbour", "--metrics", str(port)]
        done = CliRunner().invoke(app, [*arguments, "--store", f"sqlite:///{tmp_path}/desk.db"])
    assert isinstance(done.exception, LeewayError)  # `main` makes one line and exit code 2 of it
    words = f"--metrics 127.0.0.1:{port}: Address already in use: expected a free port"
    assert str(done.exception).startswith(words)
    assert list(tmp_path.iterdir()) == []
