"""A day's neighbours and their known keys are sent to each vehicle with its flight."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.adapters.files.params import params_dir
from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import MAX_NEIGHBOUR_FLEETS, Flight, NeighbourFleet
from companion.fleet.messages import Assign, State
from ground_station.adapters.files.day_files import read_day
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.open_desk import open_depot_desk, open_truck_desk
from ground_station.core.dispatch.flight_tables import (
    depot_delivery_flight_table,
    flight_from_planned_sortie,
    with_neighbour_keys,
)
from ground_station.core.fleet.fleet_link import LivelinessChanged, StateReceived
from tests.ground_station.desk.test_truck_dispatcher import HARBOUR, PLAN
from tests.ground_station.desk_parts import HandClock, Wire, a_state
from tests.ground_station.store.test_order_store import opened
from tests.ground_station.truck_world import World

KEY = "ab" * 32
PIER = {"pier": {"d1": KEY}}
TOLD = [{"fleet": "pier", "keys": {"d1": KEY}}]
BESIDE = replace(HARBOUR, day=msgspec.structs.replace(HARBOUR.day, neighbours=["pier"]))


class Known(Wire):
    """A network whose desk has the keys of a neighbour's vehicles."""

    def neighbour_keys(self, fleet: str) -> dict[str, str]:
        return PIER[fleet]


class KnownWorld(World):
    """The same, with a truck."""

    def neighbour_keys(self, fleet: str) -> dict[str, str]:
        return PIER[fleet]


def d1_on_its_pad() -> State:
    depot = BESIDE.day.depot
    place = {"lat_deg": depot.lat_deg, "lon_deg": depot.lon_deg}
    return a_state(uptime_s=1.0, armed=False, voltage_v=26.0, **place)


def test_a_desk_of_the_depot_tells_its_neighbours_and_their_keys_with_each_flight(tmp_path: Path):
    wire = Known()
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        store.add_orders_unless_conflict(BESIDE.orders)
        desk = open_depot_desk(
            BESIDE, store, wire, lambda words: None, DepotParams(), clock=HandClock(100.0)
        )
        wire.heard += [
            LivelinessChanged("d1", "a", has_joined=True),
            StateReceived(d1_on_its_pad()),
        ]
        for _ in range(3):
            desk.run_cycle(0.0)
    flights = [c.action.flight for c in wire.sent if isinstance(c.action, Assign)]
    assert [flight["neighbours"] for flight in flights] == [TOLD]
    assert msgspec.convert(flights[0], Flight).neighbours == [
        NeighbourFleet(fleet="pier", keys={"d1": KEY})
    ]


def test_a_desk_with_a_truck_does_too(tmp_path: Path):
    world = KnownWorld(["d1", "d2"], np.random.default_rng(1), 0.0)
    with opened(f"sqlite:///{tmp_path}/desk.db") as store:
        store.add_orders_unless_conflict(BESIDE.orders)
        desk = open_truck_desk(BESIDE, PLAN, store, world, lambda words: None, world.clock)
        world.join()
        desk.start_dispatching()
        flown: list[Assign] = []
        while not flown:
            assert world.clock.t_s < 1200.0
            world.step()
            desk.run_cycle(0.0)
            flown = [drone.flight for drone in world.drones.values() if drone.flight is not None]
    assert flown[0].flight["neighbours"] == TOLD


def test_a_day_without_neighbours_gives_the_same_flights_as_before_there_were_any():
    day, order = HARBOUR.day, HARBOUR.orders[0]
    table = depot_delivery_flight_table(day, day.drones[0], order)
    assert "neighbours" not in with_neighbour_keys(table, PIER.__getitem__)
    assert flight_from_planned_sortie(HARBOUR, PLAN, PLAN.sorties[0]).neighbours == []
    assert flight_from_planned_sortie(BESIDE, PLAN, PLAN.sorties[0]).neighbours == [
        NeighbourFleet(fleet="pier")
    ]


@pytest.mark.parametrize(
    ("names", "why"),
    [
        ('["harbour"]', "harbour is this day's own fleet"),
        ('["pier", "pier"]', "pier more than once"),
        ('["Pier"]', "neighbours"),
        (str([f"f{k}" for k in range(MAX_NEIGHBOUR_FLEETS + 1)]).replace("'", '"'), "at most 64"),
    ],
)
def test_neighbours_that_cannot_be_are_refused(tmp_path: Path, names: str, why: str):
    text = (params_dir() / "days" / "harbour.toml").read_text()
    path = tmp_path / "harbour.toml"
    path.write_text(text.replace('fleet = "harbour"', f'fleet = "harbour"\nneighbours = {names}'))
    with pytest.raises(LeewayError, match=why):
        read_day(path)
