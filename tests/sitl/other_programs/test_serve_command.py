"""`sim-bridge serve` as a process: reachable by pymavlink on every endpoint, ended by a signal."""

import signal
import socket
import subprocess
import sys

import pytest
from pymavlink import mavutil

pytestmark = pytest.mark.sitl

ENTRY = "from sim_bridge.main import main; main()"
PATIENCE_S = 120.0  # for a loaded machine


def free_ports(count: int, kind: socket.SocketKind) -> list[int]:
    made = [socket.socket(socket.AF_INET, kind) for _ in range(count)]
    for one in made:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in made]
    for one in made:
        one.close()
    return ports


@pytest.mark.sample
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_served_vehicle_is_heard_on_every_way_and_ended_by_a_signal(number):
    onboard, ground = free_ports(2, socket.SOCK_DGRAM)
    (tcp,) = free_ports(1, socket.SOCK_STREAM)
    ears = {
        port: mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}") for port in (onboard, ground)
    }
    arguments = [
        *(sys.executable, "-c", ENTRY, "serve", "--autopilot=ardupilot", "--speedup=5"),
        *(f"--onboard-port={onboard}", f"--ground-port={ground}", f"--tcp-port={tcp}"),
        *("--wind-speed-mps=4", "--wind-from-deg=200"),
    ]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as process:
        try:
            for ear in ears.values():
                beat = ear.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENCE_S)
                assert (beat.autopilot, beat.get_srcSystem()) == (3, 1)
            line = mavutil.mavlink_connection(f"tcp:127.0.0.1:{tcp}")
            assert line.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENCE_S).type == 2
            line.close()
            process.send_signal(number)
            said, _ = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
            for ear in ears.values():
                ear.close()
    assert process.returncode == (0 if number == signal.SIGINT else 128 + number)
    for port in (onboard, ground, tcp):
        assert str(port) in said
    assert ("stopped after" in said) == (number == signal.SIGINT)


@pytest.mark.sample
@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (["--autopilot=betaflight"], "expected px4, ardupilot or mixed"),
        (["--battery=full"], "expected power_module or sih_timer"),
        (["--battery=sih_timer", "--autopilot=ardupilot"], "expected --autopilot px4"),
    ],
)
def test_a_mistake_in_the_options_is_said_in_one_line(wrong, expected):
    serve = [sys.executable, "-c", ENTRY, "serve", *wrong]
    ended = subprocess.run(serve, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert expected in ended.stderr
