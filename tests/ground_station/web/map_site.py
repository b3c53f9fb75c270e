"""A day with a truck, its real desk and a map over the same store, on one clock of the test's own.

The map hears the world by a line of its own, as a second member of the network would.
"""

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.fleet.messages import Command, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.day_wind import site_wind_of
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.web.map_server import MapAnswers, MapServer
from ground_station.app.desk.open_desk import open_truck_desk
from ground_station.app.desk.replanner import InlineReplanner
from ground_station.app.map.fleet_ear import FleetEar
from ground_station.app.map.map_feed import MapFeed
from ground_station.app.map.map_view import MapView
from ground_station.core.fleet.desk_figures import CertificateFigures
from ground_station.core.fleet.fleet_link import FleetInput, LivelinessChanged, StateReceived
from ground_station.core.fleet.fleet_status import FleetStatus
from tests.ground_station.hand_made_day import PLAN, by_truck
from tests.ground_station.truck_world import World

HARBOUR = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


class MapEars:
    """The map's end of the world's network; `more`: what a member's state has besides."""

    def __init__(self, world: World) -> None:
        self.world, self.known = world, set[str]()
        self.more: dict[str, dict[str, Any]] = {}
        self.deaf = False
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
        return found + [StateReceived(self.state(name)) for name in sorted(there)]

    def state(self, name: str) -> State:
        """What this member says now."""
        (member,) = (member for member in self.world.everybody() if member.name == name)
        return msgspec.structs.replace(member.state(), **self.more.get(name, {}))

    def ask_states(self, wait_s: float) -> None:
        """They come anyhow."""

    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None:
        self.events_asked.append(vehicle)

    def neighbour_keys(self, fleet: str) -> dict[str, str]:
        del fleet
        return {}

    def tell_winds(self, winds: object) -> None:
        del winds

    def send(self, command: Command, wait_s: float) -> None:
        self.sent.append(command)

    def close(self) -> None:
        """Nothing is held."""


class MapSite:
    """World, desk, store, map and its server."""

    def __init__(self, folder: Path, *, port: int = 0) -> None:
        self.world = World(["d1", "d2"], np.random.default_rng(1))
        clock = self.world.clock
        self.url = f"sqlite:///{folder}/desk.db"
        self.store = Store(Database(self.url, durable=False), clock.epoch_us)
        self.day = DayStore(self.store.database, clock.epoch_us)
        self.store.add_orders(HARBOUR.orders)
        self.world.join()
        self.said: list[str] = []
        replanner = InlineReplanner(plan=by_truck)
        self.desk = open_truck_desk(
            HARBOUR, PLAN, self.store, self.world, self.said.append, clock, replanner
        )
        self.desk.begin()
        self.ears = MapEars(self.world)
        self.ends: CertificateFigures | None = None
        self.reader = Store(Database(self.url, create=False), clock.epoch_us)
        self.held = ExitStack()
        for end in (self.store.close, self.reader.close):
            self.held.callback(end)
        self.start_map(port)

    def start_map(
        self, port: int = 0, basemap: Path | None = None, *, outline: bool = False
    ) -> None:
        """A map that knows nothing of before, as the command that is started again."""
        clock = self.world.clock
        self.ears.known = set()
        wind = site_wind_of(HARBOUR)
        ear = FleetEar(self.ears, clock, FleetStatus(HARBOUR.airframes), wind)
        view = MapView("harbour", HARBOUR, basemap=basemap is not None, outline=outline)
        self.feed = MapFeed(view, ear, self.reader, clock, lambda: self.ends)
        self.server = MapServer("127.0.0.1", port)
        answers = MapAnswers(self.feed.stream, self.feed.history, self.feed.reach, basemap)
        self.server.serve(answers)
        self.held.callback(self.server.close)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server.port}"

    @property
    def picture(self) -> dict[str, Any]:
        """What was published last, as JSON has it."""
        frame = self.feed.stream.frame
        assert frame is not None
        return json.loads(json.dumps(frame.picture))

    def step(self, seconds: int = 1, *, desk: bool = True) -> None:
        """The day goes on; `desk` False: nobody minds it."""
        for _ in range(seconds):
            self.world.step()
            if desk:
                self.desk.turn(0.0)
            self.feed.turn()

    def until_flying(self, vehicle: str) -> None:
        """Go on until this drone is in the air."""
        while not self.world.drones[vehicle].in_air:
            assert self.world.clock.t_s < 2000.0, self.said[-5:]
            self.step()

    def close(self) -> None:
        self.held.close()
