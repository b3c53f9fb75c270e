"""A truck's day with a worsening forecast: replanned before launch windows close."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.forecast_files import ForecastRequest
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.open_desk import open_truck_desk
from ground_station.app.desk.replanner import Replanner, create_inline_planner
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.orders import AssignmentState, OrderState
from ground_station.core.weather.forecast_field import WindAt
from tests.ground_station.hand_made_day import PLAN, by_truck
from tests.ground_station.store.test_order_store import opened
from tests.ground_station.truck_world import World
from tests.ground_station.weather.open_meteo import START_S, answer, written

DAYS = Path(__file__).parents[3] / "params" / "days"
FIRST_MPS, LIMIT_MPS = 10.0, 14.0


def a_world() -> World:
    """Build a world whose wall clock starts at the beginning of the forecast."""
    world = World(["d1", "d2"], np.random.default_rng(3))
    world.clock.off_s = START_S - world.clock.epoch_us() / 1e6
    return world


class TruckDay:
    """The day with its hand-made plan, in a wind that rises by this much per hour."""

    def __init__(self, store: Store, world: World, path: Path, per_hour_mps: float) -> None:
        self.per_hour_mps = per_hour_mps
        written(path, answer(lambda hour, _: (FIRST_MPS + per_hour_mps * hour, 80.0)))
        data = read_day(DAYS / "harbour.toml", ForecastRequest(path, START_S, keep_forecast=True))
        day = msgspec.structs.replace(data.day, wind_limit_mps=LIMIT_MPS)
        self.data = replace(data, day=day)
        self.world = world
        self.store, self.said, self.asked = store, list[str](), list[DayData]()
        store.add_orders_unless_conflict(self.data.orders)

    def planner(self, data: DayData, start: DayState, seed: int, trials: int | None) -> DayPlan:
        self.asked.append(data)
        return by_truck(data, start, seed, trials)

    def run(self) -> None:
        self.world.join()
        desk = open_truck_desk(
            self.data, PLAN, self.store, self.world, self.said.append, self.world.clock,
            Replanner(create_inline_planner(self.planner)),
        )  # fmt: skip
        desk.start_dispatching()
        while self.world.clock.t_s < 3600.0:
            for _ in range(4):
                self.world.step()
            desk.run_cycle(0.0)
            assert not self.world.wrong, (self.world.wrong, self.said[-15:])
            if desk.is_done:
                return
        raise AssertionError(self.said[-15:])


@pytest.mark.sample
def test_sorties_that_the_forecast_closes_are_planned_anew_before_they_are_due(tmp_path):
    world = a_world()
    with opened(f"sqlite:///{tmp_path}/desk.db", world.clock.epoch_us) as store:
        day = TruckDay(store, world, tmp_path / "w.json", 40.0)
        day.run()
        words = "\n".join(day.said)
        assert "replanning: the forecast closes H-1" in words
        (asked, *_) = day.asked
        assert asked.forecast is not None
        # The planner's wind uses the day's clock: linear in time from its beginning.
        began_us = DayStore(store.database, day.world.clock.epoch_us).day_start_us()
        assert began_us is not None
        off_s = began_us / 1e6 - START_S
        for t_s in (0.0, 900.0):
            wind = asked.forecast.wind_at_day_time(t_s, 40.0)
            assert isinstance(wind, WindAt)
            expected = FIRST_MPS + 40.0 * (t_s + off_s) / 3600.0
            assert wind.speed_mps == pytest.approx(expected, abs=0.01)
        states = {row.order.id: row.state for row in store.orders()}
        assert set(states.values()) == {OrderState.DELIVERED}
        for row in DayStore(store.database, day.world.clock.epoch_us).sorties():
            if row.launched_us is not None:
                lands_s = row.launched_us / 1e6 - START_S + row.sortie.land_s - row.sortie.launch_s
                assert FIRST_MPS + 40.0 * lands_s / 3600.0 < LIMIT_MPS
        withdrawn = [r for r in store.assignments() if r.state is AssignmentState.WITHDRAWN]
        assert all("closed by the forecast" in row.reason for row in withdrawn)


@pytest.mark.sample
def test_the_canary_in_a_steady_forecast_the_plan_is_flown(tmp_path):
    world = a_world()
    with opened(f"sqlite:///{tmp_path}/desk.db", world.clock.epoch_us) as store:
        day = TruckDay(store, world, tmp_path / "w.json", 0.0)
        day.run()
        assert day.asked == []
        flown = [r for r in store.assignments() if r.vehicle != "truck" and r.delivered]
        assert len(flown) == len(PLAN.sorties)
