"""Winds that drones tell over real zenoh, and the desk that holds a launch for a front in them.

The desk's clock runs `FAST` times as fast as the wall's, and drones tell as often.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.adapters.clock import wall_s
from companion.app.flight.state_told import wind_cov
from companion.fleet.messages import Answered
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_config
from companion.fleet.zenoh_link import ZenohLink
from ground_station.adapters.clock import WallClock
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.core.dispatch.wind_holds import HELD_BY
from ground_station.core.site_wind.wind_words import field_words
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port

DAY = read_day(Path(__file__).parents[2] / "params" / "days" / "harbour.toml")
FAST = 5.0
ALERT_S = 10.0
WARM_UP_S = 80.0
PATIENCE_S = 60.0
AT = {"t1": (0.0, -1500.0), "t2": (500.0, -600.0), "t3": (-400.0, 300.0), "d1": (0.0, 0.0)}
M_PER_DEG = 111_320.0


class FastClock(WallClock):
    """The desk's."""

    def monotonic_s(self) -> float:
        return FAST * super().monotonic_s()


class Windy(Vehicle):
    """Hovers, and tells a wind to the east of `mean_mps` with small gusts; `d1` stands."""

    mean_mps = 6.0

    def _run(self) -> None:
        name, rng = self.port.vehicle, np.random.default_rng(len(self.port.vehicle))
        north, east = AT[name]
        depot = DAY.day.depot
        place = {
            "lat_deg": depot.lat_deg + north / M_PER_DEG,
            "lon_deg": depot.lon_deg + east / M_PER_DEG / math.cos(math.radians(depot.lat_deg)),
        }
        while not self._stop.wait(1.0 / FAST):
            self.port.turn(self.carry_out)
            told: dict[str, Any] = {"armed": False, "assignment": "H-101.1", "height_rel_m": 0.0}
            if name != "d1":
                gust = rng.normal(0.0, 0.2, 2)
                cov = wind_cov(0.3 * np.eye(2)) if self.port.link.wind_cov_is_read() else None
                told = {
                    "armed": True, "height_rel_m": 50.0, "wind_to_n_mps": float(gust[0]),
                    "wind_to_e_mps": float(self.mean_mps + gust[1]),
                    "wind_cov_m2ps2": cov or msgspec.UNSET,
                }  # fmt: skip
            phase = "checks" if name == "d1" else "outbound"
            self.port.member.publish("m100", 1.0, phase, **place, **told)


@pytest.fixture
def site(tmp_path: Path) -> Iterator[tuple[Store, Any, dict[str, Windy], list[str]]]:
    port = free_port()
    ours = config_file(tmp_path / "desk.json5", listen=port)
    theirs = read_config(config_file(tmp_path / "vehicle.json5", connect=port))
    store = Store(Database(f"sqlite:///{tmp_path}/desk.db"), lambda: 1)
    store.add_orders(DAY.orders)
    id_ = store.assign("H-101", "d1", {"format": "flight/1"}, None, "desk")
    store.answered(f"{id_}:assign", Answered.DONE, "", "d1")
    fleet, said = ZenohFleet(FLEET, ours), list[str]()
    params = DepotParams(assigns=False, launch_gap_s=0.0)
    desk = open_depot_desk(DAY, store, fleet, said.append, params, clock=FastClock())
    desk.begin()

    def link_of(name: str) -> Callable[[str], ZenohLink]:
        return lambda life: ZenohLink(theirs, VehicleKeys(FLEET, name), life, lambda: None)

    drones = {name: Windy.on(name, tmp_path / name, link_of(name)) for name in AT}
    yield store, desk, drones, said  # type: ignore[misc]
    for drone in drones.values():
        drone.close()
    fleet.close()
    store.close()


def test_a_front_that_one_drone_feels_holds_a_launch_within_ten_seconds(site):
    store, desk, drones, said = site
    limit_s = wall_s() + PATIENCE_S

    def turn(true: Callable[[], Any]) -> float:
        while not true():
            assert wall_s() < limit_s, said[-12:]
            desk.turn(0.02)
        return desk.exchange.clock.monotonic_s()

    wind, status = desk.wind.wind, desk.exchange.status
    began_s = desk.exchange.clock.monotonic_s()
    turn(lambda: desk.exchange.clock.monotonic_s() - began_s > WARM_UP_S)
    states = [status.of(name).state for name in AT if name != "d1"]
    assert all(state is not None and state.wind_cov_m2ps2 for state in states)
    assert "by 3 drones" in field_words(wind, desk.exchange.clock.monotonic_s())
    assert store.holds() == []
    drones["t1"].mean_mps = 16.0
    felt_s = turn(lambda: (status.of("t1").state.wind_to_e_mps or 0.0) > 12.0)
    held_s = turn(lambda: [h for h in store.holds() if h.by == HELD_BY and h.scope == "d1"])
    print(f"held {held_s - felt_s:.1f} s after the first state that tells the front")
    assert held_s - felt_s <= ALERT_S
    assert any(words.startswith("FRONT") and "the depot in" in words for words in said)
