"""A depot desk in a separate process, for tests that kill it: URL, identity, launch gap.

Its clock runs `SPEED` times as fast as that of the machine.
"""

import dataclasses
import sys
from pathlib import Path

import msgspec

from companion.fleet.membership import JoinOptions
from ground_station.adapters.clock import WallClock
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.desk import exchange
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.open_desk import open_depot_desk
from tests.fleet.zenoh_net import FLEET

SPEED = 5.0
DRONES = ("d1", "d2", "d3")
DAY = Path(__file__).parents[3] / "params" / "days" / "harbour.toml"


class FastClock(WallClock):
    """The time of this test."""

    def monotonic_s(self) -> float:
        return SPEED * super().monotonic_s()


def main(url: str, identity: str, gap_s: float) -> None:
    exchange.RESPONSE_TIMEOUT_S /= SPEED
    clock = FastClock()
    fleet = ZenohFleet(FLEET, None, JoinOptions(Path(identity)))
    store = Store(Database(url), clock.epoch_us)
    params = DepotParams(launch_gap_s=gap_s)
    data = read_day(DAY)
    drones = [msgspec.structs.replace(data.day.drones[0], id=name) for name in DRONES]
    data = dataclasses.replace(data, day=msgspec.structs.replace(data.day, drones=drones))
    desk = open_depot_desk(
        data, store, fleet, lambda line: print(line, flush=True), params, clock=clock
    )
    desk.start_dispatching()
    while True:
        desk.run_cycle(0.02)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]))
