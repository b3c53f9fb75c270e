"""A day with a truck, its real desk and a map over the same store, on one test clock.

The map has its own connection to the world, as a second network member.
"""

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.core.base.desk_heartbeat import DeskHeartbeat
from companion.fleet.messages import Command, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.day_wind import create_site_wind
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.web.map_server import MapDataSources, MapServer
from ground_station.app.desk.open_desk import open_truck_desk
from ground_station.app.desk.replanner import Replanner, create_inline_planner
from ground_station.app.map.fleet_receiver import FleetListener
from ground_station.app.map.map_feed import MapPublisher
from ground_station.app.map.map_view import MapView
from ground_station.core.fleet.certificate_ends import CertificateExpiry
from ground_station.core.fleet.fleet_link import (
    DeskHeartbeatReceived,
    FleetInput,
    LivelinessChanged,
    StateReceived,
)
from ground_station.core.fleet.fleet_status import FleetStatus
from tests.ground_station.hand_made_day import PLAN, by_truck
from tests.ground_station.truck_world import World

HARBOUR = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


class MapEars:
    """The map's end of the world's network; `more`: extra fields of a member's state."""

    def __init__(self, world: World) -> None:
        self.world, self.known = world, set[str]()
        self.more: dict[str, dict[str, Any]] = {}
        self.deaf, self.heartbeats = False, True
        self.sent: list[Command] = []
        self.events_asked: list[str] = []

    def receive(self, wait_s: float) -> list[FleetInput]:
        del wait_s
        if self.deaf:
            return []
        there = {member.name for member in self.world.members()}
        found: list[FleetInput] = [
            LivelinessChanged(name, name, name in there) for name in there ^ self.known
        ]
        self.known = there
        if self.heartbeats:
            found.append(DeskHeartbeatReceived(self.heartbeat()))
        return found + [StateReceived(self.state(name)) for name in sorted(there)]

    def heartbeat(self) -> DeskHeartbeat:
        """Return the heartbeat of the world's desk."""
        clock = self.world.clock
        return DeskHeartbeat(
            desk="desk", instance_id="1", uptime_s=clock.t_s, epoch_us=clock.epoch_us()
        )

    def state(self, name: str) -> State:
        """Return the member's current state."""
        (member,) = (member for member in self.world.everybody() if member.name == name)
        return msgspec.structs.replace(member.state(), **self.more.get(name, {}))

    def request_states(self, wait_s: float) -> None:
        """Does nothing: states always arrive."""

    def request_events(self, vehicle: str, after: int, wait_s: float) -> None:
        self.events_asked.append(vehicle)

    def neighbour_keys(self, fleet: str) -> dict[str, str]:
        del fleet
        return {}

    def publish(self, message: object) -> None:
        del message

    def send(self, command: Command, wait_s: float) -> None:
        self.sent.append(command)

    def close(self) -> None:
        """Nothing to release."""


class MapSite:
    """World, desk, store, map and its server."""

    def __init__(self, folder: Path, *, port: int = 0) -> None:
        self.world = World(["d1", "d2"], np.random.default_rng(1))
        clock = self.world.clock
        self.url = f"sqlite:///{folder}/desk.db"
        self.store = Store(Database(self.url, durable=False), clock.epoch_us)
        self.day = DayStore(self.store.database, clock.epoch_us)
        self.store.add_orders_unless_conflict(HARBOUR.orders)
        self.world.join()
        self.said: list[str] = []
        replanner = Replanner(create_inline_planner(by_truck))
        self.desk = open_truck_desk(
            HARBOUR, PLAN, self.store, self.world, self.said.append, clock, replanner
        )
        self.desk.start_dispatching()
        self.fleet_link = MapEars(self.world)
        self.ends: CertificateExpiry | None = None
        self.reader = Store(Database(self.url, create=False), clock.epoch_us)
        self.held = ExitStack()
        for end in (self.store.close, self.reader.close):
            self.held.callback(end)
        self.start_map(port)

    def start_map(
        self, port: int = 0, basemap: Path | None = None, *, outline: bool = False
    ) -> None:
        """Start a map without earlier data, as after a restart of the command."""
        clock = self.world.clock
        self.fleet_link.known = set()
        wind = create_site_wind(HARBOUR)
        ear = FleetListener(self.fleet_link, clock, FleetStatus(HARBOUR.airframes), wind)
        view = MapView("harbour", HARBOUR, basemap=basemap is not None, outline=outline)
        self.decode_bytes = MapPublisher(view, ear, self.reader, clock, lambda: self.ends)
        self.server = MapServer("127.0.0.1", port)
        answers = MapDataSources(
            self.decode_bytes.stream,
            self.decode_bytes.margin_history_of,
            self.decode_bytes.reachable_area_boundary,
            basemap,
            order=self.decode_bytes.order_record_of,
        )
        self.server.start_serving(answers)
        self.held.callback(self.server.close)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server.port}"

    @property
    def picture(self) -> dict[str, Any]:
        """Return the last published picture as JSON data."""
        frame = self.decode_bytes.stream.latest_frame
        assert frame is not None
        return json.loads(json.dumps(frame.picture))

    def step(self, seconds: int = 1, *, desk: bool = True) -> None:
        """Advance the day; `desk` False: without the desk."""
        for _ in range(seconds):
            self.world.step()
            if desk:
                self.desk.run_cycle(0.0)
            self.decode_bytes.listen_and_publish_due_picture()

    def until_flying(self, vehicle: str) -> None:
        """Go on until this drone is in the air."""
        while not self.world.drones[vehicle].in_air:
            assert self.world.clock.t_s < 2000.0, self.said[-5:]
            self.step()

    def close(self) -> None:
        self.held.close()
