"""A day with a truck: the real desk, killed at times, over a world that enforces the rules."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import sqlalchemy as sa

from companion.core.base.errors import LeewayError
from companion.fleet.messages import Command, Drive
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.settle import close_order_with_outcome
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.open_desk import open_truck_desk
from ground_station.app.desk.operator_commands import (
    cancel_order,
    change_order,
    take_out_of_service,
)
from ground_station.app.desk.replanner import NoPlan, Replanner, create_inline_planner
from ground_station.app.desk.truck_dispatcher import TruckDispatcher
from ground_station.core.dispatch.dispatch_rules import DispatchParams
from ground_station.core.fleet.fleet_link import CommandResponse
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.order_states import ParcelOutcome
from ground_station.core.schema.orders import AssignmentState, OrderState
from tests.ground_station.hand_made_day import PLAN, by_truck, sortie
from tests.ground_station.truck_world import World, WorldClock

HARBOUR = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
LIMIT_S = 3600.0
TURN_S = 4


CORE = "ground_station.core"


def fails(data: DayData, start: DayState, seed: int, trials: int | None) -> DayPlan:
    raise LeewayError("no plan today")


def ignores(*told: object) -> None:
    """Replaces a step of the desk that is omitted."""


class Killed(BaseException):
    """The desk process dies at this point."""


class MortalDatabase(Database):
    """Kills its desk just before or just after one of its transactions."""

    def __init__(self, url: str, **more: Any) -> None:
        self.dies_in: int | None = None
        self.after = False
        super().__init__(url, durable=False, **more)  # only this process is killed

    @contextmanager
    def write(self, *, durable: bool = True) -> Iterator[sa.Connection]:
        if self.dies_in is not None:
            self.dies_in -= 1
        dies = self.dies_in is not None and self.dies_in <= 0  # after a rollback: at the next one
        if dies and not self.after:
            raise Killed
        with super().write(durable=durable) as db:
            yield db
        if dies:
            raise Killed


class DayTold:
    """One day: a world, a store, and desks that may be killed."""

    def __init__(self, url: str, seed: int, loss: float = 0.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.world = World(["d1", "d2"], self.rng, loss)
        self.database = MortalDatabase(url)
        self.store = Store(self.database, self.world.clock.epoch_us)
        self.store.add_orders_unless_conflict(HARBOUR.orders)
        self.said: list[str] = []
        self.desk = self.start()
        self.deaths = 0

    def start(self) -> Desk:
        """Start the desk again with the same command."""
        self.world.join()
        replanner = Replanner(create_inline_planner(by_truck))
        desk = open_truck_desk(
            HARBOUR, PLAN, self.store, self.world, self.said.append, self.world.clock, replanner
        )
        desk.start_dispatching()
        return desk

    @property
    def dispatcher(self) -> TruckDispatcher:
        assert isinstance(self.desk.dispatcher, TruckDispatcher)
        return self.desk.dispatcher

    def run(self, kill_every: int | None = None) -> None:
        """Run until the desk is done, killing it about once per `kill_every` transactions."""
        while self.world.clock.t_s < LIMIT_S:
            if kill_every is not None and self.database.dies_in is None:
                self.database.dies_in = int(self.rng.integers(1, 2 * kill_every))
                self.database.after = bool(self.rng.random() < 0.5)
            for _ in range(TURN_S):
                self.world.step()
            try:
                self.desk.run_cycle(0.0)
            except Killed:
                self.deaths += 1
                self.database.dies_in = None
                for _ in range(int(self.rng.integers(1, 30))):
                    self.world.step()
                self.desk = self.start()
            assert not self.world.wrong, (self.world.wrong, self.said[-15:])
            if self.desk.is_done:
                return
        raise AssertionError((self.dispatcher.departure_blockers, self.said[-15:]))

    def states(self) -> dict[str, OrderState]:
        return {row.order.id: row.state for row in self.store.orders()}


@pytest.fixture
def day(tmp_path: Path) -> Iterator[type[DayTold]]:
    made: list[DayTold] = []

    def start(seed: int, loss: float = 0.0, url: str | None = None) -> DayTold:
        made.append(DayTold(url or f"sqlite:///{tmp_path}/desk{len(made)}.db", seed, loss))
        return made[-1]

    yield start
    for one in made:
        one.store.close()


@pytest.mark.sample
def test_a_planned_day_is_carried_out_and_ends_with_everybody_aboard(day):
    told = day(1)
    told.run()
    assert set(told.states().values()) == {OrderState.DELIVERED}
    assert sorted(told.world.delivered) == sorted(told.states())
    assert told.world.on_truck == {"d1", "d2"}
    assert told.world.driver.truck.stop == "depot-end"
    assert len(told.world.flown) == len(PLAN.sorties)
    assert [
        plan.revision for plan, _ in DayStore(told.database, lambda: 1).plans_with_reasons()
    ] == [0]


@pytest.mark.sample
@pytest.mark.drawn(keep=1, of="seed")
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("store_url", ["sqlite", "postgresql"], indirect=True)
@pytest.mark.parametrize("kill_every", [6, 10])
def test_killed_anywhere_with_lost_messages_no_order_is_lost_or_flown_twice(
    day, seed, store_url, kill_every
):
    told = day(seed, loss=0.2, url=store_url)
    told.run(kill_every=kill_every)
    assert told.deaths > 2
    assert set(told.states().values()) == {OrderState.DELIVERED}
    assert sorted(told.world.delivered) == sorted(told.states())
    assert told.world.on_truck == {"d1", "d2"}


def test_what_comes_back_or_is_refused_goes_by_the_truck(day):
    told = day(5)
    told.world.drones["d1"].mood = "turns"
    told.world.drones["d2"].mood = "refuses"
    told.run(kill_every=40)
    assert set(told.states().values()) == {OrderState.DELIVERED}
    assert len(DayStore(told.database, lambda: 1).plans_with_reasons()) > 1


@pytest.mark.sample
def test_a_drone_that_is_lost_costs_its_own_order_and_nothing_else(day):
    told = day(6)
    told.world.drones["d1"].mood = "lost"
    told.dispatcher.active.params = DispatchParams(overdue_after_s=900.0)
    told.run()
    plans = [why for _, why in DayStore(told.database, lambda: 1).plans_with_reasons()]
    late = [why for why in plans if "s late" in why]
    assert len(late) == 3, plans  # held up; d2 loaded; d1 given up: none without news
    states = told.states()
    assert states.pop("H-101") is OrderState.ASSIGNED  # its outcome is unknown
    assert set(states.values()) == {OrderState.DELIVERED}
    assert told.world.on_truck == {"d2"}


def test_a_drone_that_a_pilot_lands_elsewhere_holds_the_truck_up_nowhere(day):
    told = day(6)
    told.world.drones["d1"].mood = "landed by a pilot"
    told.run()
    states = told.states()
    assert states.pop("H-101") is OrderState.STUCK  # its parcel is with the pilot
    assert set(states.values()) == {OrderState.DELIVERED}
    assert told.world.on_truck == {"d2"}
    ends = {row.id: row.state for row in told.desk.store.assignments() if row.vehicle == "d1"}
    assert ends == {"H-101.1": AssignmentState.RETURNED}


@pytest.mark.sample
def test_a_drone_that_dies_as_its_launch_is_ordered_holds_the_truck_up_until_it_cannot_fly(day):
    told = day(6)
    told.world.drones["d1"].mood = "dies at its launch"
    told.dispatcher.active.params = DispatchParams(overdue_after_s=900.0)
    told.run()
    assert any("H-101.1: overdue" in words for words in told.said), told.said
    states = told.states()
    assert states.pop("H-101") is OrderState.ASSIGNED  # unknown whether it flew
    assert set(states.values()) == {OrderState.DELIVERED}
    assert told.world.on_truck == {"d2"}
    assert told.world.left_s[0] > 900.0, "the truck had promised it this stop"


def by_d1_again(data: DayData, start: DayState, seed: int, trials: int | None) -> DayPlan:
    """A planner that assigns H-101 to d1 again and all other orders to the truck."""
    plan = by_truck(data, start, seed, trials)
    here = next((stop for stop in plan.stops if "H-101" in stop.serves), None)
    if here is None:
        return plan
    here.serves.remove("H-101")
    again = sortie("H-101", "d1", here.id, here.id, here.arrive_s + 60.0)
    return msgspec.structs.replace(plan, sorties=[*plan.sorties, again])


def test_a_drone_that_the_driver_takes_in_before_it_answers_its_withdrawal_is_used_again(day):
    """It lost its link on its pad, was withdrawn and switched off, and still holds its mission."""
    told = day(6)
    told.dispatcher.active.replanner = Replanner(create_inline_planner(by_d1_again))
    told.world.drones["d1"].mood = "cut off"
    told.run()
    assert any("H-101.1: withdrawn: not ready" in words for words in told.said), told.said
    assert set(told.states().values()) == {OrderState.DELIVERED}
    assert told.world.on_truck == {"d1", "d2"}
    rows = {row.id: row for row in told.desk.store.assignments()}
    assert rows["H-101.1"].state is AssignmentState.WITHDRAWN
    assert "the driver has loaded it" in rows["H-101.1"].reason
    assert rows["H-101.2"].vehicle == "d1"
    assert "H-101.2" in told.world.flown, "it has forgotten the first one"


@pytest.mark.sample
def test_the_canary_a_desk_that_waits_for_its_answer_never_ends(day, monkeypatch):
    monkeypatch.setattr("ground_station.adapters.store.day_steps._complete_withdrawal", ignores)
    told = day(6)
    told.world.drones["d1"].mood = "cut off"
    with pytest.raises(AssertionError):
        told.run()
    assert told.states()["H-101"] is OrderState.ASSIGNED


@pytest.mark.sample
@pytest.mark.parametrize("mood", ["drops unseen", "holds on"])
def test_a_parcel_that_was_perhaps_dropped_is_looked_for_before_anybody_brings_it_again(day, mood):
    told = day(6)
    told.world.drones["d1"].mood = mood
    told.run()  # the world detects a second delivery
    assert set(told.states().values()) == {OrderState.DELIVERED}
    assert sorted(told.world.delivered) == sorted(told.states())
    again = [row for row in told.desk.store.assignments() if row.id.endswith(".2")]
    assert len(again) == (mood == "holds on")


@pytest.mark.sample
def test_a_truck_that_stays_too_long_has_the_homes_moved_to_it(day):
    told = day(8)
    told.world.slow_s = {"d2": 400.0}  # to recover it
    told.run()
    assert any("H-103.1: landing at stop-1 requested" in words for words in told.said), told.said
    assert any("H-103.1: landing at stop-1 confirmed" in words for words in told.said)
    assert set(told.states().values()) == {OrderState.DELIVERED}


@pytest.mark.sample
def test_a_truck_does_not_wait_where_a_drone_was_asked_to_land_and_did_not(day):
    """The flight ended before the drone accepted: the truck must not stay bound to the new stop."""
    told = day(8)
    told.world.slow_s = {"d2": 400.0}
    told.world.drones["d1"].mood = "too busy to move"
    told.run()
    assert any("H-103.1: landed, but not at stop-1" in words for words in told.said), told.said
    assert set(told.states().values()) == {OrderState.DELIVERED}
    assert told.world.on_truck == {"d1", "d2"}


@pytest.mark.sample
def test_who_refuses_another_home_is_not_asked_again_every_second(day):
    told = day(8)
    told.world.slow_s = {"d2": 400.0}
    told.world.drones["d1"].mood = "refuses to move"
    told.run()
    asked = [words for words in told.said if "H-103.1: landing at stop-1 requested" in words]
    assert 1 <= len(asked) <= 1 + 200.0 / DispatchParams().home_request_interval_s
    assert set(told.states().values()) == {OrderState.DELIVERED}


@dataclass
class SlowReplanner(Replanner):
    """A planner on a slow, busy computer."""

    clock: WorldClock = field(default_factory=WorldClock)
    asked_s: float = 0.0

    def start_planning(self, data: DayData, start: DayState) -> None:
        self.asked_s = self.clock.t_s
        Replanner.start_planning(self, data, start)

    def take_finished_plan(self) -> DayPlan | NoPlan | None:
        slow = self.clock.t_s - self.asked_s < 500.0
        return None if slow else Replanner.take_finished_plan(self)


@pytest.mark.sample
def test_a_late_truck_is_planned_anew_once_however_long_it_takes_and_keeps_its_promises(day):
    told = day(9)
    told.world.driver.late_s = 400.0
    told.dispatcher.active.replanner = SlowReplanner(
        create_inline_planner(by_truck), clock=told.world.clock
    )
    told.run()
    plans = [why for _, why in DayStore(told.database, lambda: 1).plans_with_reasons()]
    assert sum("s late" in why for why in plans) == 1, plans
    assert set(told.states().values()) == {OrderState.DELIVERED}


def test_wind_that_departs_from_the_forecast_is_planned_with_and_kept_through_a_restart(day):
    told = day(12)
    for drone in told.world.drones.values():
        drone.wind_ne_mps = (0.0, -14.0)
    told.run()
    kept = DayStore(told.database, lambda: 1)
    assert any(
        "standard deviations from the forecast" in why for _, why in kept.plans_with_reasons()
    )
    wind = kept.measured_wind_of_last_plan()
    assert wind is not None
    # From the east. One or two minutes do not outweigh a forecast with a 10 m/s error.
    assert wind.speed_mps == pytest.approx(14.0, abs=1.5)
    assert wind.from_deg == pytest.approx(90.0, abs=3.0)
    assert 1.0 < wind.std_mps < 4.0  # half an hour later; the forecast's own is 2
    told.desk = told.start()
    assert told.dispatcher.active.data.day.forecast == wind
    assert set(told.states().values()) == {OrderState.DELIVERED}


def test_an_order_named_after_the_wind_leaves_the_forecast_alone(day):
    told = day(12)
    forecast = told.dispatcher.active.data.day.forecast
    late = msgspec.structs.replace(HARBOUR.orders[0], id="wind-1")
    told.desk.store.add_orders_unless_conflict([late])
    told.run()
    assert any(
        "wind-1 is open" in why
        for _, why in DayStore(told.database, lambda: 1).plans_with_reasons()
    )
    assert DayStore(told.database, lambda: 1).measured_wind_of_last_plan() is None
    assert told.dispatcher.active.data.day.forecast == forecast


@pytest.mark.sample
def test_a_planner_that_fails_leaves_the_old_plan_in_force_and_the_day_ends(day):
    told = day(13)
    told.world.driver.late_s = 400.0
    told.dispatcher.active.replanner = Replanner(create_inline_planner(fails))
    told.run()
    assert any("continuing with plan" in words for words in told.said)
    assert len(DayStore(told.database, lambda: 1).plans_with_reasons()) == 1
    assert set(told.states().values()) == {OrderState.DELIVERED}


@pytest.mark.sample
def test_a_truck_that_has_not_heard_where_to_drive_gets_no_plan_without_that_stop(day, monkeypatch):
    """A desk that restarts at this moment finds the truck late at its old stop. A plan from there
    without the ordered stop would send the truck to a stop that no plan has.
    """
    told = day(1)
    send, deaf = told.world.send, True

    def lose(command: Command, wait_s: float) -> None:
        if deaf and isinstance(command.action, Drive) and command.action.stop == "depot-end":
            told.world.waiting.append(CommandResponse(command.id, None))
        else:
            send(command, wait_s)

    monkeypatch.setattr(told.world, "send", lose)
    while told.dispatcher.day.last_ordered_truck_stop() != "depot-end":
        told.world.step()
        told.desk.run_cycle(0.0)
    for _ in range(400):
        told.world.step()
    told.desk = told.start()
    for _ in range(20):
        told.world.step()
        told.desk.run_cycle(0.0)
    assert told.world.driver.truck.stop == "stop-2"
    deaf = False
    told.run()
    stops = [stop.id for stop in told.dispatcher.active.plan.stops]
    assert told.world.driver.truck.stop == stops[-1]
    assert "depot-end" in stops


def test_a_plan_without_a_stop_that_another_desk_has_promised_meanwhile_is_not_taken(day):
    told = day(1)
    while not told.dispatcher.day.sorties():
        told.world.step()
        told.desk.run_cycle(0.0)
    for row in told.dispatcher.day.sorties():
        left = [stop for stop in PLAN.stops if stop.id != row.promised_stop]
        without = msgspec.structs.replace(PLAN, revision=1, stops=left)
        assert not told.dispatcher.day.try_store_active_plan(without, "late")
    assert told.dispatcher.day.try_store_active_plan(
        msgspec.structs.replace(PLAN, revision=1), "late"
    )


@pytest.mark.sample
@pytest.mark.parametrize("off_s", [7200.0, -7200.0])
def test_safety_rule_3_a_desk_started_again_with_a_clock_that_is_off_keeps_its_promises(day, off_s):
    told = day(14)
    drone = told.world.drones["d2"]
    while not drone.in_air or told.desk.store.outbox():
        told.world.step()
        told.desk.run_cycle(0.0)
    drone.mood, drone.flies_s = "unheard", 500.0
    told.world.clock.off_s = off_s
    told.desk = told.start()
    told.run()
    assert set(told.states().values()) == {OrderState.DELIVERED}
    assert told.world.on_truck == {"d1", "d2"}
    assert told.world.clock.t_s < 2100.0  # it does not wait for the clock


@dataclass(slots=True)
class DyingReplanner(Replanner):
    """A planner process that dies without a response this many times."""

    clock: WorldClock = field(default_factory=WorldClock)
    deaths: int = 0
    asked_s: list[float] = field(default_factory=list)

    def start_planning(self, data: DayData, start: DayState) -> None:
        self.asked_s.append(self.clock.t_s)
        Replanner.start_planning(self, data, start)

    def take_finished_plan(self) -> DayPlan | NoPlan | None:
        made = Replanner.take_finished_plan(self)
        dead = len(self.asked_s) <= self.deaths
        return NoPlan("the planner's process died", can_retry=True) if dead else made


@pytest.mark.sample
@pytest.mark.parametrize("wrong", ["late", "wind"])
def test_a_planner_that_died_is_asked_again_a_minute_later_about_the_same(day, wrong):
    told = day(13)
    if wrong == "late":
        told.world.driver.late_s = 400.0
    for drone in told.world.drones.values():
        drone.wind_ne_mps = (0.0, -14.0 if wrong == "wind" else 0.0)
    dying = DyingReplanner(create_inline_planner(by_truck), clock=told.world.clock, deaths=2)
    told.dispatcher.active.replanner = dying
    told.run()
    why = [why for _, why in DayStore(told.database, lambda: 1).plans_with_reasons()][1]
    assert wrong in why
    first_s, second_s, third_s = dying.asked_s[:3]
    again_s = DispatchParams().replan_interval_s
    for between_s in (second_s - first_s, third_s - second_s):
        assert again_s <= between_s <= again_s + 4 * TURN_S
    asked = [words for words in told.said if words == f"replanning: {why}"]
    assert len(asked) == 3
    assert set(told.states().values()) == {OrderState.DELIVERED}


@pytest.mark.sample
def test_a_planner_that_always_dies_is_asked_three_times_and_the_old_plan_ends_the_day(day):
    told = day(13)
    told.world.driver.late_s = 400.0
    dying = DyingReplanner(create_inline_planner(by_truck), clock=told.world.clock, deaths=1000)
    told.dispatcher.active.replanner = dying
    told.run()
    assert len(dying.asked_s) == DispatchParams().max_replan_attempts
    assert sum("continuing with plan" in words for words in told.said) == 1
    assert len(DayStore(told.database, lambda: 1).plans_with_reasons()) == 1
    assert set(told.states().values()) == {OrderState.DELIVERED}


def test_the_canary_a_truck_that_ignores_promises_is_caught(day, monkeypatch):
    told = day(1)
    monkeypatch.setattr(
        f"{CORE}.schema.sortie_rows.SortieRow.binding_reason", lambda self, stop: None
    )
    monkeypatch.setattr(
        f"{CORE}.dispatch.dispatch_rules.DispatchRules.departure_blockers", lambda self, view: []
    )
    with pytest.raises(AssertionError, match="the truck leaves"):
        told.run()


@pytest.mark.sample
def test_where_nobody_is_at_home_a_person_decides_and_a_reopened_order_is_brought(day):
    told = day(10)
    told.world.quits = {"H-108"}
    told.run()
    states = told.states()
    assert states.pop("H-108") is OrderState.STUCK
    assert set(states.values()) == {OrderState.DELIVERED}
    told.world.quits = set()
    close_order_with_outcome(told.database, lambda: 1, "H-108", ParcelOutcome.BACK, "asked", "anna")
    told.run()
    assert told.states()["H-108"] is OrderState.DELIVERED


@pytest.mark.parametrize("order", ["H-101", "H-108"])  # on its pad, and later by the driver
def test_an_order_with_a_new_place_is_withdrawn_and_planned_again(day, order):
    told = day(14)
    while not any(row.put_on_pad for row in told.dispatcher.day.sorties()):
        told.world.step()
        told.desk.run_cycle(0.0)
    place = {"lat_deg": "55.4721", "lon_deg": "8.4512", "alt_amsl_m": "12"}
    change_order(told.store, told.world.clock.epoch_us, order, place, "anna")
    told.run()
    assert f"replanning: {order} was changed" in told.said
    flown = [row.id for row in told.store.assignments() if row.order_id == order]
    assert [row.partition(".")[0] for row in flown] == [order] * (2 if order == "H-101" else 1)
    assert flown[0] not in told.world.flown
    assert set(told.states().values()) == {OrderState.DELIVERED}
    assert told.world.wrong == []


@pytest.mark.parametrize("order", ["H-101", "H-105"])  # on its pad, and loaded by the driver
def test_an_order_cancelled_on_the_ground_is_not_delivered_and_the_day_goes_on(day, order):
    told = day(14)
    loaded = (AssignmentState.ORDERED, AssignmentState.UPLOADED)
    while not any(
        row.order_id == order and row.state in loaded for row in told.store.assignments()
    ):
        told.world.step()
        told.desk.run_cycle(0.0)
    cancel_order(told.store, told.world.clock.epoch_us, order, "anna", "customer asked")
    told.run()
    states = told.states()
    assert states.pop(order) is OrderState.CANCELLED
    assert set(states.values()) == {OrderState.DELIVERED}
    assert sorted(told.world.delivered) == sorted(states)
    (row,) = [row for row in told.store.assignments() if row.order_id == order]
    assert row.state is AssignmentState.WITHDRAWN
    assert row.id not in told.world.flown
    assert told.world.on_truck == {"d1", "d2"}


@pytest.mark.parametrize("is_on_pad", [False, True])
def test_the_plan_of_a_broken_drone_is_made_again_without_it(day, is_on_pad):
    told = day(14)
    while is_on_pad and not any(
        row.put_on_pad and row.vehicle == "d1" for row in told.dispatcher.day.sorties()
    ):
        told.world.step()
        told.desk.run_cycle(0.0)
    given = (told.store, told.world.clock.epoch_us, "d1", "motor", "anna", None)
    take_out_of_service(*given)
    told.run()
    assert "replanning: d1 is out of service (by a person)" in told.said
    assert set(told.states().values()) == {OrderState.DELIVERED}
    assert all(row.vehicle != "d1" for row in told.store.assignments() if row.delivered)
    assert told.world.on_truck == {"d1", "d2"}
    with pytest.raises(LeewayError, match="expected a drone, not the truck"):
        take_out_of_service(told.store, lambda: 1, "truck", "flat tyre", "anna", None)


def test_neither_drone_nor_driver_delivers_before_a_window(day, monkeypatch):
    begin_us, s = World(["d1"], np.random.default_rng(1)).clock.epoch_us(), 1_000_000
    opens_us = {"H-101": begin_us + 400 * s, "H-105": begin_us + 900 * s}
    late = {"H-108": begin_us + 60 * s}
    orders = [
        msgspec.structs.replace(
            order, earliest_us=opens_us.get(order.id), latest_us=late.get(order.id)
        )
        for order in HARBOUR.orders
    ]
    monkeypatch.setattr(f"{__name__}.HARBOUR", replace(HARBOUR, orders=orders))
    told = day(15)
    told.run()
    assert set(told.states().values()) == {OrderState.DELIVERED}
    (flight,) = [row for row in told.dispatcher.day.sorties() if row.sortie.order == "H-101"]
    half_flight_us = 100 * s  # the hand-made plan states no drop: half-way
    assert 0 <= (flight.launched_us or 0) + half_flight_us - opens_us["H-101"] <= 10 * s
    rows, _ = read_audit_rows_and_head(told.database)
    served = [row.entry for row in rows if "H-105" in row.entry.subject]
    assert 0 <= served[0].at_us - opens_us["H-105"] <= 10 * s
    assert [line for line in told.said if line.startswith("H-108: arrives ")] != []


def test_a_plan_of_another_day_is_refused_in_words(day):
    told = day(11)
    other = msgspec.structs.replace(PLAN, day="elsewhere")
    with pytest.raises(Exception, match="of day 'elsewhere', expected 'harbour'"):
        open_truck_desk(HARBOUR, other, told.store, told.world, print, told.world.clock)


def test_a_desk_goes_on_with_the_plan_that_another_desk_of_its_store_has_made(day):
    told = day(1)
    for _ in range(20):
        told.world.step()
        told.desk.run_cycle(0.0)
    another = DayStore(told.database, told.world.clock.epoch_us)
    assert another.try_store_active_plan(
        msgspec.structs.replace(PLAN, revision=1), "the other desk's"
    )
    for _ in range(10):
        told.world.step()
        told.desk.run_cycle(0.0)
    assert told.dispatcher.active.plan.revision == 1
    assert "plan 1 in force, made by another desk" in told.said
