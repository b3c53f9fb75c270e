"""Wind reports of drones over zenoh, and a desk that holds a launch because of a front in them.

The desk's clock and the drones' reports run `FAST` times as fast as real time.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.adapters.clock import wall_s
from companion.app.flight.published_state import rounded_up_wind_cov_or_unset
from companion.fleet.messages import CommandStatus
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_link import ZenohLink
from ground_station.adapters.clock import WallClock
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.core.dispatch.hold_source import HoldSource
from ground_station.core.site_wind.wind_texts import format_site_wind
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port

DAY = read_day(Path(__file__).parents[2] / "params" / "days" / "harbour.toml")
FAST = 5.0
ALERT_S = 10.0
WARM_UP_S = 80.0
PATIENCE_S = 60.0
AT = {"t1": (0.0, -1500.0), "t2": (500.0, -600.0), "t3": (-400.0, 300.0), "d1": (0.0, 0.0)}
M_PER_DEG = 111_320.0


class FastClock(WallClock):
    """The desk's clock, `FAST` times as fast as real time."""

    def monotonic_s(self) -> float:
        return FAST * super().monotonic_s()


class Windy(Vehicle):
    """Hovers and reports an eastward wind of `mean_mps` with small gusts; `d1` stays landed."""

    mean_mps = 6.0

    def _run(self) -> None:
        name, rng = self.port.member.vehicle, np.random.default_rng(len(self.port.member.vehicle))
        north, east = AT[name]
        depot = DAY.day.depot
        place = {
            "lat_deg": depot.lat_deg + north / M_PER_DEG,
            "lon_deg": depot.lon_deg + east / M_PER_DEG / math.cos(math.radians(depot.lat_deg)),
        }
        while not self._stop.wait(1.0 / FAST):
            self.port.process_commands(self.carry_out)
            told: dict[str, Any] = {"armed": False, "assignment": "H-101.1", "height_rel_m": 0.0}
            if name != "d1":
                gust = rng.normal(0.0, 0.2, 2)
                cov = (
                    rounded_up_wind_cov_or_unset(0.3 * np.eye(2))
                    if self.port.member.link.do_all_clients_read_wind_cov()
                    else None
                )
                told = {
                    "armed": True, "height_rel_m": 50.0, "wind_to_n_mps": float(gust[0]),
                    "wind_to_e_mps": float(self.mean_mps + gust[1]),
                    "wind_cov_m2ps2": cov or msgspec.UNSET,
                }  # fmt: skip
            phase = "checks" if name == "d1" else "outbound"
            self.port.member.publish_state("m100", 1.0, phase, **place, **told)


@pytest.fixture
def site(tmp_path: Path) -> Iterator[tuple[Store, Any, dict[str, Windy], list[str]]]:
    port = free_port()
    ours = config_file(tmp_path / "desk.json5", listen=port)
    theirs = read_and_check_zenoh_config(config_file(tmp_path / "vehicle.json5", connect=port))
    store = Store(Database(f"sqlite:///{tmp_path}/desk.db"), lambda: 1)
    store.add_orders_unless_conflict(DAY.orders)
    id_ = store.assign_order("H-101", "d1", {"format": "flight/1"}, None, "desk")
    store.record_and_apply_response(f"{id_}:assign", CommandStatus.DONE, "", "d1")
    fleet, said = ZenohFleet(FLEET, ours), list[str]()
    params = DepotParams(assigns_orders=False, launch_gap_s=0.0)
    desk = open_depot_desk(DAY, store, fleet, said.append, params, clock=FastClock())
    desk.start_dispatching()

    def link_of(name: str) -> Callable[[str], ZenohLink]:
        return lambda life: ZenohLink(theirs, VehicleKeys(FLEET, name), life, lambda: None)

    drones = {name: Windy.on(name, tmp_path / name, link_of(name)) for name in AT}
    yield store, desk, drones, said  # type: ignore[misc]
    for drone in drones.values():
        drone.close()
    fleet.close()
    store.close()


@pytest.mark.sample
def test_a_front_that_one_drone_feels_holds_a_launch_within_ten_seconds(site):
    store, desk, drones, said = site
    limit_s = wall_s() + PATIENCE_S

    def turn(true: Callable[[], Any]) -> float:
        while not true():
            assert wall_s() < limit_s, said[-12:]
            desk.run_cycle(0.02)
        return desk.exchange.clock.monotonic_s()

    wind, status = desk.wind.wind, desk.exchange.status
    began_s = desk.exchange.clock.monotonic_s()
    turn(lambda: desk.exchange.clock.monotonic_s() - began_s > WARM_UP_S)
    states = [status.status_of(name).state for name in AT if name != "d1"]
    assert all(state is not None and state.wind_cov_m2ps2 for state in states)
    assert "by 3 drones" in format_site_wind(wind, desk.exchange.clock.monotonic_s())
    assert store.holds_in_force() == []
    drones["t1"].mean_mps = 16.0
    felt_s = turn(lambda: (status.status_of("t1").state.wind_to_e_mps or 0.0) > 12.0)
    held_s = turn(
        lambda: [h for h in store.holds_in_force() if h.by == HoldSource.FRONT and h.scope == "d1"]
    )
    print(f"held {held_s - felt_s:.1f} s after the first state that tells the front")
    assert held_s - felt_s <= ALERT_S
    assert any(words.startswith("FRONT") and "the depot in" in words for words in said)
