"""The replay of a simulated day against its ground truth, with wrong clocks, a dead desk, a dead
companion and a drone without contact.
"""

import math
from pathlib import Path
from typing import Any

import pytest

from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.past_store import PastStore
from ground_station.app.map.map_view import MapView
from ground_station.app.map.replay.past_folder import find_replay_files
from ground_station.app.map.replay.replay_feed import ReplayDataSource

pytestmark = pytest.mark.timeout(240)

SEED = 1
OFF_S = {"d1": 3600.0, "d2": -47.0}
"""Of the companions' clocks against the desk's."""

WITHIN_S = 1.0
NOISE_M = 4.0
"""Of a satellite position without corrections (the simulator's own: 1 m and a slow bias)."""


class Watcher:
    """Sets clocks and faults, and keeps the world with its truth."""

    world: Any = None
    is_cut = is_killed = False

    def goes_on(self, world: Any) -> bool:
        self.world, t_s = world, world.clock.t_s
        d1, d2 = world.drones
        for drone in world.drones:
            drone.wall_clock_offset_s = OFF_S[drone.name]
        if not self.is_cut and d1.is_airborne and d1.time_since_takeoff_s(t_s) > 20.0:
            self.is_cut = True
            world.bus.cut_member("d1", 25.0)
        if not self.is_killed and d2.is_airborne and d2.time_since_takeoff_s(t_s) > 30.0:
            self.is_killed = True
            d2.kill_companion_and_schedule_restart(t_s)
            world.faults.due["desk_kills"].append((t_s, 0.0))
        return True


def test_a_replay_shows_each_flight_where_it_was_within_a_second(tmp_path: Path):
    enable_compile_cache_and_check_if_known()
    from sim_bridge.app.day.desk import SteppedDesk, store_url
    from sim_bridge.app.day.faults import DayWorldOptions
    from sim_bridge.app.day.run import DayOptions, fly_day_and_write_result
    from sim_bridge.app.faults.day.small_day import build_fixed_plan, read_bundled_day

    folder, watcher, built = tmp_path / "day", Watcher(), []

    def take_seat(day: Any, where: Path) -> Any:
        built.append(day)
        return SteppedDesk.start_truck_desk(day, build_fixed_plan(day.data), where, SEED, 50)

    data = read_bundled_day()
    options = DayOptions(
        name="replay", data=data, world_options=DayWorldOptions(), seed=SEED, folder=folder,
        limit_s=600.0,
    )  # fmt: skip
    row = fly_day_and_write_result(options, take_seat, watcher.goes_on)
    assert (row["vehicles_lost"], row["delivered"], watcher.is_killed) == (0, 2, True)
    database = Database(store_url(folder), create=False)
    try:
        view = MapView(data.day.fleet, data)
        past = ReplayDataSource(view, PastStore(database), find_replay_files(str(folder)).records)
    finally:
        database.close()
    begin_us = watcher.world.clock.epoch_us() - round(1e6 * watcher.world.clock.t_s)
    looked = 0
    for drone in watcher.world.drones:
        for cycle in drone.all_power_cycles:
            truth = [one for one in cycle.record.rows if _is_in_flight(cycle.record, one[0])]
            for one in truth[:: max(1, len(truth) // 60)]:
                at_us = begin_us + round(1e6 * one[0])
                shown = past.picture_at(at_us)["drones"][drone.name]
                north, east, _ = built[0].frame.to_ned(*map(math.radians, shown["at"]), 0.0)
                near = [r[1:3] for r in cycle.record.rows if abs(r[0] - one[0]) <= WITHIN_S]
                off_m = min(math.dist((north, east), place) for place in near)
                assert off_m <= NOISE_M, (drone.name, one[0])
                assert shown["armed"], (drone.name, one[0])
                looked += 1
    assert looked > 50


def _is_in_flight(record: Any, t_s: float) -> bool:
    landed_s = math.inf if record.landed_s is None else record.landed_s
    return record.takeoff_s is not None and record.takeoff_s + 2.0 < t_s < landed_s - 2.0
