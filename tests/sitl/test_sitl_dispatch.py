"""From an order to its delivery: desk, companion and simulated vehicle as processes, over zenoh
(TLS, every message signed) and MAVLink; companion and desk are killed and restarted meanwhile.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from companion.fleet.messages import EventKind
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.core.schema.orders import OrderState
from tests.fleet.secure_site import SecureSite

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(400)]

ROOT = Path(__file__).parents[2]
PATIENCE_S = 300.0
SPEEDUP = 5.0
FLEET = "harbour"


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(type=kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Day:
    """The processes of one day, and the store that they leave."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mavlink = free_port(socket.SOCK_DGRAM)
        self.url = f"sqlite:///{folder}/desk.db"
        self._running: list[subprocess.Popen[bytes]] = []
        self.site = SecureSite(folder / "pki")
        text = (ROOT / "params" / "days" / "harbour.toml").read_text()
        sites = ROOT / "params" / "sites"
        (folder / "day.toml").write_text(text.replace("../sites", str(sites)))
        orders = "id,lat_deg,lon_deg,alt_amsl_m,mass_kg\nH-1,55.4702,8.4460,13.0,0.4\n"
        (folder / "harbour_orders.csv").write_text(orders)

    def start(self, program: str, *arguments: str) -> subprocess.Popen[bytes]:
        module = "sim_bridge.main" if program == "sim_bridge" else f"{program}.app.cli.main"
        code = f"from {module} import main; main()"
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        with (self.folder / f"{program}.out").open("ab") as out:
            process = subprocess.Popen(
                [sys.executable, "-c", code, *arguments],
                stdout=out,
                stderr=subprocess.STDOUT,
                cwd=self.folder,
                env=environment,
            )
        self._running.append(process)
        return process

    def vehicle(self) -> subprocess.Popen[bytes]:
        return self.start(
            "sim_bridge", "serve", "--autopilot=ardupilot", "--payload-kg=0.4",
            "--wind-speed-mps=4", "--wind-from-deg=80", f"--speedup={SPEEDUP}",
            f"--onboard-port={self.mavlink}", "--ground-port=0", "--tcp-port=0",
        )  # fmt: skip

    def companion(self) -> subprocess.Popen[bytes]:
        return self.start(
            "companion", "run", f"--link=udpin:127.0.0.1:{self.mavlink}", "--airframe=m100",
            f"--fleet={FLEET}", "--vehicle=d1", f"--identity={self.site.home('d1')}", "--configure",
            "--run-dir=d1",
        )  # fmt: skip

    def desk(self) -> subprocess.Popen[bytes]:
        return self.start(
            "ground_station", "dispatch", "day.toml", f"--store={self.url}",
            f"--identity={self.site.home('desk')}", "--until-done", "--auto-launch",
        )  # fmt: skip

    def phases(self) -> list[str]:
        """Return the phases that the vehicle entered, by its own log."""
        path = self.folder / "d1" / "events.jsonl"
        lines = path.read_bytes().splitlines() if path.exists() else []
        events = [json.loads(line) for line in lines if line.endswith(b"}")]
        told = [e["text"] for e in events if e["kind"] == EventKind.PHASE.value]
        return [text.split(" -> ")[1].partition(":")[0] for text in told]

    def delivery_is_kept(self) -> bool:
        """Return True if the checkpoint on disk, written with a short delay, has it."""
        (path,) = (self.folder / "d1").glob("assignment-*/checkpoint.json")
        return bool(json.loads(json.loads(path.read_bytes())["content"])["delivered"])

    def until(self, true: Callable[[], bool]) -> None:
        limit_s = time.monotonic() + PATIENCE_S
        while not true():
            assert time.monotonic() < limit_s, self.last_words()
            time.sleep(0.1)

    def last_words(self) -> str:
        return "\n".join(p.read_text()[-1500:] for p in sorted(self.folder.glob("*.out")))

    def close(self) -> None:
        for process in self._running:
            process.kill()
            process.wait()


@pytest.fixture
def day(tmp_path: Path) -> Iterator[Day]:
    made = Day(tmp_path)
    yield made
    made.close()


@pytest.mark.night
def test_an_order_is_delivered_once_though_companion_and_desk_are_killed_on_the_way(day: Day):
    day.vehicle()
    companion, desk = day.companion(), day.desk()
    day.until(lambda: "outbound" in day.phases())
    desk.send_signal(signal.SIGKILL)
    day.until(lambda: "return" in day.phases() and day.delivery_is_kept())
    companion.send_signal(signal.SIGKILL)
    companion.wait()
    companion = day.companion()
    day.until(lambda: "done" in day.phases())
    desk = day.desk()
    day.until(lambda: desk.poll() is not None)
    assert desk.returncode == 0, day.last_words()
    store = Store(Database(day.url), lambda: 1)
    (order,), events = store.orders(), store.events()
    store.close()
    assert order.state is OrderState.DELIVERED, order.reason
    outcomes = [e.outcome for e in events if e.kind is EventKind.OUTCOME]
    assert outcomes == ["SUC"]
    assert day.phases().count("arm") == 1
    companion.send_signal(signal.SIGTERM)
    assert companion.wait(timeout=60.0) == 5
