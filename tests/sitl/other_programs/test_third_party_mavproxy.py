"""MAVProxy, run as a user runs it, flies our simulated vehicles."""

import math
import os
import pty
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.app.cli.main import app
from sim_bridge.app.serve.server import Host
from sim_bridge.app.world.vehicle_host import Home, VehicleHost
from sim_bridge.autopilot.kinds import AutopilotKind
from tests.sitl.served import on_the_ground

MAVPROXY = Path(sys.executable).with_name("mavproxy.py")
pytestmark = [
    pytest.mark.third_party,
    pytest.mark.timeout(120),
    pytest.mark.skipif(not MAVPROXY.exists(), reason="MAVProxy is not installed (see Makefile)"),
]

HOME = Home()
SPEEDUP = 8.0
CRUISE_M = 15.0
LEG_M = 60.0
METRES_PER_DEG = 111_195.0  # mean Earth radius (IUGG) times one degree
TAKEOFF, WAYPOINT, LAND = 22, 16, 21
ABOUT_M = 3.0


class MavProxy:
    """mavproxy.py on a pseudo-terminal."""

    def __init__(self, master: str, folder: Path) -> None:
        self._terminal, inside = pty.openpty()
        command = [
            sys.executable,
            str(MAVPROXY),
            f"--master={master}",
            "--no-state",
            "--default-modules=arm,mode,wp,cmdlong,param",
            "--source-system=255",
        ]
        environment = {**os.environ, "TERM": "dumb", "HOME": str(folder), "MAVLINK20": "1"}
        self._process = subprocess.Popen(
            command, stdin=inside, stdout=inside, stderr=inside, cwd=folder, env=environment
        )
        os.close(inside)
        self.said = ""
        self._last_row = 0

    def say(self, line: str) -> None:
        os.write(self._terminal, f"{line}\n".encode())

    def listen(self, for_s: float) -> None:
        if select.select([self._terminal], [], [], for_s)[0]:
            self.said += os.read(self._terminal, 65536).decode(errors="replace")

    def expect(self, pattern: str, within_s: float = 20.0) -> None:
        """Read until `pattern` appears after the previous match."""
        deadline_s = time.monotonic() + within_s
        while not (found := re.compile(pattern).search(self.said, self._last_row)):
            left_s = deadline_s - time.monotonic()
            assert left_s > 0.0, f"MAVProxy never said {pattern!r}:\n{self.said}"
            self.listen(left_s)
        self._last_row = found.end()

    def wait_for(self, truth: Callable[[], bool], within_s: float, again: str = "") -> None:
        """Read until `truth()` holds; `again` is a line sent every 2 s until then."""
        deadline_s = time.monotonic() + within_s
        next_s = 0.0
        while not truth():
            now_s = time.monotonic()
            assert now_s < deadline_s, f"it never came true; MAVProxy said:\n{self.said}"
            if again and now_s >= next_s:
                self.say(again)
                next_s = now_s + 2.0
            self.listen(0.05)

    def close(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._terminal)


@contextmanager
def mavproxy(master: str, folder: Path) -> Iterator[MavProxy]:
    client = MavProxy(master, folder)
    try:
        yield client
    finally:
        client.close()


def waypoints_file(folder: Path, *, with_home: bool) -> Path:
    """Write a file as a ground station does: take-off, 60 m north, 60 m east of that, land."""
    north = LEG_M / METRES_PER_DEG
    east = north / math.cos(math.radians(HOME.lat_deg))
    places = [
        (TAKEOFF, 0.0, 0.0, CRUISE_M),
        (WAYPOINT, north, 0.0, CRUISE_M),
        (WAYPOINT, north, east, CRUISE_M),
        (LAND, north, east, 0.0),
    ]
    rows = [(WAYPOINT, 0, HOME.alt_amsl_m, 0.0, 0.0)] if with_home else []
    rows += [(command, 3, alt, dn, de) for command, dn, de, alt in places]
    lines = ["QGC WPL 110"]
    for seq, (command, frame, alt, dn, de) in enumerate(rows):
        lat, lon = HOME.lat_deg + dn, HOME.lon_deg + de
        lines.append(f"{seq}\t0\t{frame}\t{command}\t0\t0\t0\t0\t{lat:.8f}\t{lon:.8f}\t{alt}\t1")
    path = folder / "mission.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def flew_the_mission(served: VehicleHost, highest_m: float) -> None:
    north, east, _ = served.truth.pos_ned_m
    assert math.hypot(north - LEG_M, east - LEG_M) < ABOUT_M
    assert abs(highest_m - CRUISE_M) < ABOUT_M
    assert not served.truth.crashed


def fly(client: MavProxy, served: VehicleHost) -> None:
    """Follow a started mission to its end on the ground, disarmed."""
    highest_m = 0.0

    def down_again() -> bool:
        nonlocal highest_m
        highest_m = max(highest_m, -served.truth.pos_ned_m[2])
        return highest_m > 5.0 and not served.truth.airborne and not served.autopilot.is_armed

    client.wait_for(down_again, within_s=40.0)
    flew_the_mission(served, highest_m)


@contextmanager
def served_to_mavproxy(
    kind: AutopilotKind, listens: str, calls: str, folder: Path
) -> Iterator[tuple[MavProxy, VehicleHost]]:
    """Serve a vehicle and run MAVProxy, which is connected to it."""
    served = on_the_ground(kind)
    with Host(SPEEDUP) as host:
        (url,) = host.add_vehicle(served, gcs_urls=[f"{listens}:127.0.0.1:0"])
        with host.serve_in_thread(), mavproxy(url.replace(listens, calls), folder) as client:
            client.expect("online system 1")
            yield client, served


def start_on_ardupilot(client: MavProxy, served: VehicleHost) -> None:
    client.say("mode guided")
    client.expect("Mode GUIDED")
    client.wait_for(lambda: served.autopilot.is_armed, 20.0, again="arm throttle")
    client.say(f"takeoff {CRUISE_M}")
    client.wait_for(lambda: served.truth.pos_ned_m[2] < -10.0, 20.0)
    client.say("mode auto")
    client.expect("Mode AUTO")


def start_on_px4(client: MavProxy, served: VehicleHost) -> None:
    client.say("long DO_SET_MODE 1 4 4")  # its `mode` command cannot set PX4's
    client.expect("Mode MISSION")
    client.wait_for(lambda: served.autopilot.is_armed, 20.0, again="arm throttle")


@pytest.mark.sample
def test_mavproxy_puts_an_exported_mission_with_fence_and_rally_aboard(
    tmp_path: Path,
) -> None:
    done = CliRunner().invoke(
        app,
        ["export", "default", "--format", "wpl", "--autopilot", "ardupilot",
         "--out", str(tmp_path / "harbour.waypoints")],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    rows = [len((tmp_path / f"harbour.{ending}").read_text().splitlines())
            for ending in ("waypoints", "fence.waypoints", "rally.waypoints")]  # fmt: skip
    kind = AutopilotKind.ARDUPILOT
    with served_to_mavproxy(kind, "tcpin", "tcp", tmp_path) as (client, served):
        store = served.autopilot.store
        client.say("module load fence")
        client.say("module load rally")
        for command, name, aboard, count in (
            ("wp", "harbour.waypoints", store.mission, rows[0] - 1),
            ("fence", "harbour.fence.waypoints", store.fence, rows[1] - 1),
            ("rally", "harbour.rally.waypoints", store.rally, rows[2] - 1),
        ):
            client.say(f"{command} load {name}")
            client.expect(f"Loaded {count} .* from {name}")
            client.wait_for(lambda to=aboard, n=count: len(to) == n, 20.0)


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize(
    ("kind", "listens", "calls", "start"),
    [
        (AutopilotKind.ARDUPILOT, "tcpin", "tcp", start_on_ardupilot),
        (AutopilotKind.PX4, "udpin", "udpout", start_on_px4),
    ],
)
def test_mavproxy_flies_a_mission(kind, listens, calls, start, tmp_path: Path) -> None:
    with_home = kind is AutopilotKind.ARDUPILOT
    mission = waypoints_file(tmp_path, with_home=with_home)
    with served_to_mavproxy(kind, listens, calls, tmp_path) as (client, served):
        client.say(f"wp load {mission.name}")
        client.expect(f"Loaded {4 + with_home} waypoints in")
        start(client, served)
        fly(client, served)
