"""`ground-station map` as a process next to a desk that is killed, over zenoh; Ctrl-C."""

import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

from companion.fleet.messages import EventKind
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from tests.fleet.zenoh_net import config_file, free_port
from tests.ground_station.desk.test_depot_dispatcher import Obedient
from tests.ground_station.desk.test_desk_processes import HARBOUR, start
from tests.ground_station.web.sse_client import SseClient, following

pytestmark = pytest.mark.timeout(240)
PATIENCE_S = 60.0


class Desk:
    """A desk's process, one drone and a map's process, on a network of this test's own."""

    def __init__(self, folder: Path, held: ExitStack) -> None:
        self.folder, self.held, self.port = folder, held, free_port()
        self.url = f"sqlite:///{folder}/desk.db"
        text = HARBOUR.read_text().replace('no_fly = "../sites/harbour.geojson"\n', "")
        (folder / "day.toml").write_text(text)
        header = "id,lat_deg,lon_deg,alt_amsl_m,mass_kg\n"
        (folder / "harbour_orders.csv").write_text(header + "H-1,55.4702,8.4460,13.0,0.4\n")
        meeting = free_port()
        self.desk_end = config_file(folder / "desk.json5", listen=meeting)
        self.other_end = config_file(folder / "other.json5", connect=meeting)

    def desk(self) -> "subprocess.Popen[str]":
        """Start the desk's command."""
        options = (f"--store={self.url}", f"--zenoh={self.desk_end}", "--auto-launch")
        return self._held(start(self.folder, "dispatch", "day.toml", *options))

    def map(self, *more: str) -> "subprocess.Popen[str]":
        """Start the map once a store exists."""
        until(lambda: (self.folder / "desk.db").exists())
        options = (f"--store={self.url}", f"--zenoh={self.other_end}", f"--port={self.port}", *more)
        return self._held(start(self.folder, "map", "--day=day.toml", *options))

    def drone(self) -> Obedient:
        """d1, which stays in the air once it is launched."""
        made = Obedient("d1", self.folder / "d1", self.other_end)
        self.held.callback(made.close)
        made.flies = False
        return made

    def _held(self, process: "subprocess.Popen[str]") -> "subprocess.Popen[str]":
        self.held.callback(process.wait)
        self.held.callback(process.kill)
        return process

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def answers(self) -> bool:
        """Return whether the map has a picture."""
        try:
            return httpx.get(f"{self.address}/picture.json").status_code == 200
        except httpx.HTTPError:
            return False


def until(true) -> None:
    limit_s = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < limit_s
        time.sleep(0.1)


def follow(client: SseClient, true) -> None:
    """Follow the stream until it shows this."""
    limit_s = time.monotonic() + PATIENCE_S
    while client.picture is None or not true(client.picture):
        assert time.monotonic() < limit_s, client.picture
        client.take()


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with ExitStack() as held:
        yield Desk(tmp_path, held)


@pytest.mark.sample
def desk_item(picture: dict) -> str:
    """Title of the item on the desk; empty: none."""
    items = picture.get("attention", [])
    return next((one["title"] for one in items if one["key"] == "desk"), "")


def test_beside_a_desk_it_shows_the_flight_and_goes_on_while_the_desk_is_killed(desk):
    dispatching = desk.desk()
    drone = desk.drone()
    showing = desk.map()
    until(desk.answers)
    with following(desk.address) as client:
        follow(client, lambda p: p["drones"].get("d1", {}).get("phase") == "outbound")
        store = Store(Database(desk.url, create=False), epoch_us)
        (row,) = store.assignments(in_force=True)
        assert client.picture["drones"]["d1"]["order"] == row.order_id == "H-1"
        assert client.picture["orders"]["H-1"]["state"] == "assigned"
        drone.port.record_event(EventKind.DECISION, "turn_back: the wind has turned", p_home=0.98)
        follow(client, lambda p: p["drones"]["d1"].get("why") == "Turns back: the wind has turned")

        dispatching.kill()
        dispatching.wait()
        killed_s = time.monotonic()
        follow(client, lambda p: "Desk not responding for" in desk_item(p))
        assert time.monotonic() - killed_s < 20.0
        drone.phase = "return"
        desk.desk()  # the network's router: all members connect to it
        follow(client, lambda p: not desk_item(p))
        follow(client, lambda p: p["drones"]["d1"]["phase"] == "return")
        drone.land()
        follow(client, lambda p: p["orders"]["H-1"]["state"] == "delivered")
        store.close()

        before = set(os.listdir(desk.folder))
        showing.send_signal(signal.SIGINT)  # with a client that is still reading
        assert showing.wait(PATIENCE_S) == 0, (desk.folder / "map.out").read_text()
    with socket.create_server(("127.0.0.1", desk.port)):
        pass  # the port is free again
    assert set(os.listdir(desk.folder)) == before
    said = (desk.folder / "map.out").read_text().splitlines()
    assert said[-1] == f"the map of harbour: {desk.address}/  Ctrl-C ends it"
    assert all(line.startswith("world outline missing") for line in said[:-1]), said


@pytest.mark.sample
def test_a_port_that_is_taken_is_said_before_the_store_is_opened(desk):
    with socket.create_server(("127.0.0.1", desk.port)):
        (desk.folder / "desk.db").touch()
        assert desk.map().wait(PATIENCE_S) == 2
    said = (desk.folder / "map.out").read_text()
    assert "Address already in use" in said
    assert "--port" in said
