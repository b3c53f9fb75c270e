"""Each rule of a day detects a violation in a synthetic row, and passes a correct one."""

import itertools
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from companion.core.pilot.transitions import Phase
from companion.fleet.messages import State
from ground_station.adapters.files.day_files import read_day
from ground_station.core.schema.order_states import OrderState
from sim_bridge.app.day.faults import DayWorldOptions
from sim_bridge.app.day.run import find_orders_with_wrong_desk_record
from sim_bridge.app.trials import day_case, days
from sim_bridge.app.trials.trial import TrialRow

HELD: dict[str, Any] = {
    "ended": True,
    "duration_s": 900.0,
    "lost": [],
    "flown_twice": [],
    "undelivered": [],
    "believed_otherwise": [],
    "promises_broken": [],
    "nearest": None,
    "flights": [],
    "commands_after_take_over": [],
    "ended_by_themselves": [],
    "store_faults": [],
}
NEAR = {"distance_m": 1.2, "vehicles": ("d1", "d2"), "t_s": 300.0}
FORGOTTEN = {"order": "o1", "feasible": True, "state": "assigned", "why": "assigned"}


def wrong(tmp_path, **changes) -> list[str]:
    return days.collect_day_violations(HELD | changes, days.DayMonitor(), tmp_path)


def test_a_day_in_which_all_holds_is_not_wrong(tmp_path):
    assert wrong(tmp_path) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ended": False}, "not over after 900 s"),
        ({"lost": ["d1 with o1"]}, "not home: d1 with o1"),
        ({"flown_twice": ["o1"]}, "twice: o1"),
        ({"undelivered": [FORGOTTEN]}, "lost: o1: assigned"),
        ({"believed_otherwise": ["o1"]}, "the store is wrong about o1"),
        ({"promises_broken": ["the truck left"]}, "the truck left"),
        ({"nearest": NEAR}, "d1 and d2 came to 1.2 m at 300 s"),
        ({"commands_after_take_over": ["d1: a jump"]}, "d1: a jump"),
        ({"ended_by_themselves": ["of d1"]}, "ended by itself: of d1"),
        ({"store_faults": ["audit: entry 7"]}, "the store is inconsistent: audit: entry 7"),
    ],
)
def test_a_day_in_which_one_thing_does_not_hold_says_which(tmp_path, changes, words):
    assert wrong(tmp_path, **changes) == [words]


def test_an_order_that_waits_for_a_person_or_was_never_feasible_is_not_lost(tmp_path):
    stuck = FORGOTTEN | {"state": "stuck", "why": "stuck three attempts"}
    never = FORGOTTEN | {"feasible": False}
    assert wrong(tmp_path, undelivered=[stuck, never]) == []


def test_an_exception_in_any_log_is_found(tmp_path):
    (tmp_path / "d1").mkdir()
    (tmp_path / "d1" / "companion.log").write_text("Traceback (most recent call last)\n")
    assert wrong(tmp_path) == ["an exception: d1/companion.log"]


def world(state: State) -> Any:
    """Return the parts of a day's world that the checks read: one drone in the air."""
    up = SimpleNamespace(t0_s=10.0, command_texts_after_takeover=[])
    drone = SimpleNamespace(name="d1", power_cycle=up, is_airborne=True)
    return SimpleNamespace(
        drones=[drone],
        bus=SimpleNamespace(states={"d1": state}),
        clock=SimpleNamespace(t_s=99.0),
    )


def state(left_wh: float, phase: Phase = Phase.OUTBOUND) -> State:
    return State(
        vehicle="d1", instance_id="l1", uptime_s=1.0, epoch_us=0, airframe="m100",
        max_payload_kg=1.0,
        phase=phase.value, log="a", last_seq=0, energy_left_wh=left_wh,
    )  # fmt: skip


def test_safety_rule_4_energy_that_rises_in_flight_stops_the_day():
    watch = days.DayMonitor()
    assert watch.check_rules_and_continue(world(state(80.0, Phase.ARM)))
    assert watch.check_rules_and_continue(world(state(90.0)))
    assert watch.check_rules_and_continue(world(state(89.0)))
    assert not watch.check_rules_and_continue(world(state(89.5)))
    assert watch.violation == "d1: energy left rose from 89.00 to 89.50 Wh at 99.0 s"


def test_the_same_seed_draws_the_same_day_of_orders_that_its_site_has():
    assert day_case.draw_case(1, 7) == day_case.draw_case(1, 7) != day_case.draw_case(2, 7)
    for number in range(20):
        case = day_case.draw_case(5, number)
        known = {order.id for order in read_day(day_case.bundled_day_path(case.site)).orders}
        assert 1 <= len(case.autopilots) <= day_case.MAX_VEHICLES
        assert set(case.orders) <= known
        data = day_case.build_day_data(case)
        assert {order.id for order in data.orders} == set(case.orders)
        assert len(data.day.drones) == len(case.autopilots)


OLD_CASE = """{"seed": 1, "site": "harbour", "autopilots": ["px4"], "orders": ["H-102"],
 "drones_only": true, "forecast_mps": 3.0, "forecast_from_deg": 80.0, "front_mps": 0.0,
 "charge_frac": 0.97, "temperature_c": 15.0, "loss": 0.0, "network_cuts": 1,
 "companion_kills": 0, "ground_kills": 0, "take_overs": 0, "truck_late_s": 0.0, "searches": 50}"""


def test_a_case_of_before_there_were_depots_and_other_stores_is_the_same_day_still():
    case = msgspec.json.decode(OLD_CASE, type=day_case.DayCase)
    assert (case.truck, case.store, case.store_outages, case.member_cuts) == (True, "sqlite", 0, 0)
    assert case.world_options == DayWorldOptions(network_cuts=1, autopilots=("px4",))
    windy = msgspec.structs.replace(case, front_mps=3.0)
    assert windy.world_options.passing_front_mps == 3.0


def test_each_day_is_flown_on_each_store_and_with_all_faults_none_is_missing():
    draw = days.DayCaseGenerator(
        3, day_case.STORE_KINDS, truck=False, all_faults=True, max_vehicles=2
    )
    first, again, second = itertools.islice(draw.generate_endless_cases(), 3)
    assert (first.store, again.store, second.store) == ("sqlite", "postgresql", "sqlite")
    assert msgspec.structs.replace(first, store="postgresql") == again
    assert second.seed == first.seed + 1
    for case in (first, second):
        assert not case.truck
        assert len(case.autopilots) <= 2
        assert min(case.ground_kills, case.companion_kills, case.store_outages) >= 1
        assert case.network_cuts >= 1
        assert case.least_cut_s > 60.0


def test_days_of_villages_are_drawn_with_a_truck_and_change_no_other_day():
    cases = [day_case.draw_case(5, number) for number in range(40)]
    far = [case for case in cases if case.site == day_case.FAR_SITE]
    assert 2 <= len(far) <= 12
    assert all(case.truck for case in far)
    forced = [day_case.draw_case(5, number, has_truck=False) for number in range(40)]
    assert day_case.FAR_SITE not in {case.site for case in forced}
    for case, depot in zip(cases, forced, strict=True):
        assert case.autopilots == depot.autopilots
        assert case.member_cuts == depot.member_cuts


def test_both_days_with_a_truck_and_days_without_are_drawn():
    cases = itertools.islice(days.DayCaseGenerator(1).generate_endless_cases(), 9)
    assert {case.truck for case in cases} == {True, False}


def test_the_store_is_wrong_where_it_says_that_another_one_brought_an_order():
    orders = ["o1"]
    told: Any = {"o1": SimpleNamespace(state=OrderState.DELIVERED)}
    open_: Any = {"o1": SimpleNamespace(state=OrderState.OPEN)}
    assert find_orders_with_wrong_desk_record(orders, {"o1": "d1"}, told, {"o1": "d1"}) == []
    assert find_orders_with_wrong_desk_record(orders, {"o1": "d1"}, told, {"o1": "d2"}) == ["o1"]
    assert find_orders_with_wrong_desk_record(orders, {}, told, {"o1": "d1"}) == ["o1"]
    assert find_orders_with_wrong_desk_record(orders, {"o1": "d1"}, open_, {}) == ["o1"]
    stated_by_a_person = find_orders_with_wrong_desk_record(orders, {"o1": "d1"}, told, {})
    assert stated_by_a_person == []


def test_a_trial_ends_once_its_vehicle_hours_are_flown():
    case = day_case.draw_case(1, 0)
    row = TrialRow(name="a", passed=True, reason="", metrics={"vehicle_h": 0.5}, case=case)
    assert len(list(days.rows_until_vehicle_hours([row] * 9, 1.2))) == 3
    assert len(list(days.rows_until_vehicle_hours([row] * 9, None))) == 9
