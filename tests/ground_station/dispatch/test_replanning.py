"""Days that depart from their plan, replanned by the planner itself."""

from pathlib import Path

import numpy as np
import pytest

from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.open_desk import open_truck_desk
from ground_station.app.desk.replanner import Replanner, compute_plan, create_inline_planner
from ground_station.app.desk.truck_dispatcher import TruckDispatcher
from ground_station.core.dispatch.dispatch_rules import DispatchParams
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import initial_state
from ground_station.core.schema.orders import OrderState
from tests.ground_station.truck_world import World

pytestmark = pytest.mark.usefixtures("compiled_planner")

HARBOUR = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
TRIALS, SEED = 400, 3
LIMIT_S = 5400.0


@pytest.fixture(scope="module")
def plan() -> DayPlan:
    """The harbour's day by the default policy, with few trials."""
    return compute_plan(HARBOUR, initial_state(HARBOUR), SEED, TRIALS)


class Day:
    """The real desk with the real planner over the world of the desk's tests."""

    def __init__(self, folder: Path, plan: DayPlan) -> None:
        self.world = World(["d1", "d2"], np.random.default_rng(SEED))
        database = Database(f"sqlite:///{folder}/desk.db")
        self.store = Store(database, self.world.clock.epoch_us)
        self.store.add_orders_unless_conflict(HARBOUR.orders)
        self.plans = DayStore(database, self.world.clock.epoch_us)
        self.said: list[str] = []
        self.world.join()
        replanner = Replanner(create_inline_planner(), SEED, TRIALS)
        self.desk: Desk = open_truck_desk(
            HARBOUR, plan, self.store, self.world, self.said.append, self.world.clock, replanner
        )
        self.desk.start_dispatching()

    def run(self) -> None:
        while not self.desk.is_done:
            assert self.world.clock.t_s < LIMIT_S, self.said[-15:]
            for _ in range(4):
                self.world.step()
            self.desk.run_cycle(0.0)
            assert not self.world.wrong, (self.world.wrong, self.said[-15:])

    @property
    def dispatcher(self) -> TruckDispatcher:
        assert isinstance(self.desk.dispatcher, TruckDispatcher)
        return self.desk.dispatcher

    def differences(self) -> list[str]:
        return [why for made, why in self.plans.plans_with_reasons() if made.revision > 0]

    def undelivered(self) -> set[str]:
        rows = self.store.orders()
        return {row.order.id for row in rows if row.state is not OrderState.DELIVERED}


@pytest.fixture
def day(tmp_path: Path, plan: DayPlan):
    told = Day(tmp_path, plan)
    yield told
    told.store.close()


@pytest.mark.sample
def test_a_late_truck_is_planned_anew_and_every_promise_in_the_air_is_kept(day: Day):
    day.world.driver.late_s = 500.0
    day.run()
    assert any("s late" in why for why in day.differences()), day.said
    assert day.undelivered() == set()
    assert sorted(day.world.delivered) == sorted(order.id for order in HARBOUR.orders)
    assert day.world.on_truck == {"d1", "d2"}


@pytest.mark.sample
def test_what_a_lost_drone_was_to_bring_is_planned_for_the_others(day: Day):
    day.world.drones["d1"].mood = "lost"
    day.dispatcher.active.params = DispatchParams(overdue_after_s=600.0)
    day.run()
    assert any("d1 is out of service" in why for why in day.differences()), day.differences()
    aboard_when_lost = {row.order.id for row in day.store.orders()} - set(day.world.delivered)
    assert len(aboard_when_lost) == 1  # the order it carried: its outcome is unknown
    assert day.undelivered() == aboard_when_lost
    last, _ = day.plans.plans_with_reasons()[-1]
    assert {sortie.vehicle for sortie in last.sorties if sortie.launch_s > 600.0} <= {"d2"}


@pytest.mark.sample
def test_a_wind_that_is_not_the_forecasts_is_planned_with(day: Day):
    assert HARBOUR.day.forecast.speed_mps == 4.0
    for drone in day.world.drones.values():
        drone.wind_ne_mps = (9.0, 0.0)
    day.run()
    assert any("the wind is" in why for why in day.differences()), day.differences()
    assert sum("the wind is" in why for why in day.differences()) == 1  # it is the forecast now
    forecast = day.dispatcher.active.data.day.forecast
    assert forecast.speed_mps == pytest.approx(9.0, abs=1.0)
    assert forecast.from_deg == pytest.approx(180.0, abs=3.0)
    assert day.undelivered() == set()


@pytest.mark.sample
def test_the_canary_in_the_forecasts_own_wind_nothing_is_planned_anew_for_it(day: Day):
    north, east = HARBOUR.day.forecast.to_ne_mps
    for drone in day.world.drones.values():
        drone.wind_ne_mps = (north, east + 1.0)
    day.run()
    assert not [why for why in day.differences() if "wind" in why]


@pytest.mark.sample
def test_a_truck_that_stands_at_its_last_stop_is_not_late_however_long_it_stands(day: Day):
    day.run()
    reasons = day.differences()
    for _ in range(1000):
        day.world.step()
        day.desk.run_cycle(0.0)
    assert day.differences() == reasons
