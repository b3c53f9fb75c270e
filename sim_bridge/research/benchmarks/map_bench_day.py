"""A day for the live map's benchmark: the bundled town with any number of drones and orders.

Each of the first drones flies an order from a truck that drives from stop to stop: areas, routes,
plan, truck and sorties are there to be drawn, as on a day that people watch.
"""

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from companion.adapters.clock import epoch_us, wall_s
from companion.core.base.errors import LeewayError
from companion.core.base.place import Place
from companion.fleet.messages import Refused, State, decode_state, encode
from companion.fleet.polyline import Point, encoded
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.params import day_file
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.fleet_link import FleetInput, LivelinessChanged, StateReceived
from ground_station.core.fleet.truck_state import AT_STOP, DRIVING, TRUCK
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.orders import Order

GATHER_S = 0.05
AWAY_DEG = 0.05
"""Half the side of the square about the depot in which orders lie."""

STOPS = 20
DRIVE_S, STAY_S = 3600.0, 60.0
"""A long drive: the truck is under way for as long as anybody measures."""

CORNERS = 5
"""Waypoints of each way round something."""

LAPS_S = 600
"""After so many states a drone is at its customer."""


class MapBenchDay:
    """The day's data, the ways of its drones, and its store."""

    def __init__(self, folder: Path, drones: int, orders: int, rng: np.random.Generator) -> None:
        self.data: DayData = read_day(day_file("town"))
        depot = self.data.day.depot
        self._depot = np.array([depot.lat_deg, depot.lon_deg])
        places = self._depot + rng.uniform(-AWAY_DEG, AWAY_DEG, size=(orders, 2))
        self.customers: list[Point] = [(lat, lon) for lat, lon in places.tolist()]
        self.names = [f"d{k + 1}" for k in range(drones)]
        self.ways = [self._ways(k, rng) for k in range(drones)]
        self.store = Store(Database(f"sqlite:///{folder}/desk.db", durable=False), epoch_us)
        self._fill()

    def _ways(self, k: int, rng: np.random.Generator) -> tuple[list[Point], list[Point]]:
        """Out and home of a drone, each by some corners of its own."""
        customer = np.array(self.customers[k % len(self.customers)])
        share = np.linspace(0.0, 1.0, CORNERS + 2)[:, None]

        def bent() -> list[Point]:
            aside = rng.normal(scale=AWAY_DEG / 40.0, size=(CORNERS + 2, 2))
            aside[[0, -1]] = 0.0
            way = self._depot + share * (customer - self._depot) + aside
            return [(lat, lon) for lat, lon in way.tolist()]

        return bent(), bent()[::-1]

    def _fill(self) -> None:
        self.store.add_orders(
            [
                Order(id=f"o{k}", lat_deg=lat, lon_deg=lon, alt_amsl_m=12.0, mass_kg=0.5)
                for k, (lat, lon) in enumerate(self.customers)
            ]
        )
        day = DayStore(self.store.database, epoch_us)
        plan = self._plan()
        day.take_plan(plan, "bench")
        day.begin()
        pads = {stop.id: stop.place for stop in plan.stops}
        for sortie in plan.sorties:
            day.assign(sortie, pads, lambda _: {"format": "flight/1"}, None, "bench")
        day.truck_is("depot")
        day.truck_is(None)

    def _plan(self) -> DayPlan:
        turns = np.linspace(0.0, 2.0 * np.pi, STOPS, endpoint=False)
        ring = self._depot + 0.6 * AWAY_DEG * np.column_stack([np.cos(turns), np.sin(turns)])
        names = ["depot", *(f"stop-{k + 1}" for k in range(STOPS)), "depot-end"]
        at = [self._depot, *ring, self._depot]
        return DayPlan(
            format="day-plan/1", day="town", policy="bench", seed=0, trials=0,
            makespan_s=len(names) * (DRIVE_S + STAY_S),
            stops=[
                PlannedStop(
                    id=name,
                    place=Place(lat_deg=float(lat), lon_deg=float(lon), alt_amsl_m=12.0),
                    arrive_s=k * (DRIVE_S + STAY_S),
                    depart_s=k * (DRIVE_S + STAY_S) + STAY_S,
                )
                for k, (name, (lat, lon)) in enumerate(zip(names, at, strict=True))
            ],
            sorties=[
                PlannedSortie(
                    order=f"o{k}", vehicle=name, launch="depot", home="stop-1", launch_s=float(k),
                    land_s=k + 600.0, outbound_height_m=40.0, return_height_m=50.0, energy_wh=40.0,
                    sure_wh=50.0, usable_wh=90.0,
                )
                for k, name in enumerate(self.names[: len(self.customers)])
            ],
        )  # fmt: skip


class BenchLink:
    """Every drone, and the truck, says its state once a second, all of them evenly over it."""

    def __init__(self, day: MapBenchDay, rng: np.random.Generator) -> None:
        self._day, self._rng = day, rng
        self._members = [*day.names, TRUCK]
        self._began_s, self._said = wall_s(), 0
        self._joined, self._pause = False, threading.Event()

    def receive(self, wait_s: float) -> list[FleetInput]:
        """What is due; waits this long for it at most."""
        self._pause.wait(min(wait_s, GATHER_S))
        found: list[FleetInput] = [] if self._joined else list(self._lives())
        self._joined = True
        due = int((wall_s() - self._began_s) * len(self._members))
        found += [StateReceived(self._state(n)) for n in range(self._said, due)]
        self._said = due
        return found

    def ask_states(self, wait_s: float) -> None:
        """They come anyhow."""

    def _lives(self) -> Iterator[FleetInput]:
        yield from (LivelinessChanged(name, f"l-{name}", True) for name in self._members)

    def _state(self, number: int) -> State:
        turn, k = divmod(number, len(self._members))
        state = self._truck(turn) if self._members[k] == TRUCK else self._drone(turn, k)
        told = decode_state(encode(state))
        if isinstance(told, Refused):
            raise LeewayError(told.reason)
        return told

    def _drone(self, turn: int, k: int) -> State:
        out, home = self._day.ways[k]
        north, east, speed = self._rng.normal(size=3).tolist()
        lat, lon = _along(out, min(1.0, (turn + 200 * k / len(self._members)) / LAPS_S))
        return State(
            vehicle=self._day.names[k], life=f"l-{self._day.names[k]}", uptime_s=float(turn),
            epoch_us=epoch_us(), airframe="m100", max_payload_kg=1.0, phase="outbound", log="l",
            last_seq=0, armed=True, assignment=f"o{k}.1", order=f"o{k}", lat_deg=lat, lon_deg=lon,
            height_rel_m=40.0, ground_speed_mps=9.0 + abs(speed), energy_left_wh=60.0 - 0.1 * turn,
            margin_wh=20.0 - 0.01 * turn, p_home=0.999, p_home_now=0.9999, p_success=0.99,
            wind_to_n_mps=north, wind_to_e_mps=4.0 + east, text="going",
            way_out=encoded(out), way_home=encoded(home),
        )  # fmt: skip

    def _truck(self, turn: int) -> State:
        return State(
            vehicle=TRUCK, life=f"l-{TRUCK}", uptime_s=float(turn), epoch_us=epoch_us(),
            airframe=TRUCK, max_payload_kg=0.0, phase=DRIVING if turn else AT_STOP, log="l",
            last_seq=0, stop="stop-1" if turn else "depot",
        )  # fmt: skip


def _along(way: list[Point], share: float) -> Point:
    """The place at this share of a way's legs."""
    whole, rest = divmod(share * (len(way) - 1), 1.0)
    start, end = way[int(whole)], way[min(int(whole) + 1, len(way) - 1)]
    return start[0] + rest * (end[0] - start[0]), start[1] + rest * (end[1] - start[1])
