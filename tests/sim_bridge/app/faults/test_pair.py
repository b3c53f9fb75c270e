"""Pairs of faults: which rows fit together, what a pair requires, and its draw."""

from types import SimpleNamespace

import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.app.fault_suite.catalogue import CATALOGUE, find_case, select_cases
from sim_bridge.app.faults import pair
from sim_bridge.app.faults.fault import FLEET_GROUP, PHASES
from sim_bridge.app.faults.verdict import (
    check_disarmed_at_end,
    check_returned_home,
    check_returned_if_p_home_was_high,
)
from sim_bridge.app.flight.stage import FaultContext
from sim_bridge.app.world.flight_phase import FlightPhase
from sim_bridge.autopilot.kinds import AUTOPILOTS


@pytest.mark.parametrize(
    ("name", "home", "disarmed"),
    [
        ("pack-cold+front", True, False),
        ("front+kill-switch", False, False),
        ("arm-ack-lost+upload-cut", False, True),
    ],
)
def test_a_pair_requires_home_only_if_both_rows_do(name, home, disarmed):
    rules = find_case(name).rules
    assert (check_returned_home in rules) is home
    assert (check_returned_if_p_home_was_high in rules) is home
    assert (check_disarmed_at_end in rules) is disarmed
    assert pair.check_no_late_commands in rules


def test_a_pair_is_chosen_by_name_and_begins_in_phases_of_its_first_fault():
    (chosen,) = select_cases(["pack-cold+front"])
    assert chosen.phases == (FlightPhase.READY,)
    assert chosen.untold == {"vehicle": {"temperature_c": -10.0}}
    with pytest.raises(LeewayError, match="no-such"):
        select_cases(["front+no-such"])


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("front", "front"),
        ("pack-cold", "pack-aged"),  # both change the flight file
        ("replayed-frames", "front"),  # signed
        ("plan-worker-hangs", "front"),  # never flies
        ("desk-killed", "front"),
    ],
)
def test_rows_that_cannot_share_a_flight_are_not_combined(first, second):
    assert not pair.can_combine(find_case(first), find_case(second))


def test_each_seed_draws_one_pair_that_fits_its_autopilot_and_phase(tmp_path):
    tasks = [
        pair.draw_pair_task(CATALOGUE, AUTOPILOTS, PHASES, seed, tmp_path) for seed in range(200)
    ]
    assert tasks[7] == pair.draw_pair_task(CATALOGUE, AUTOPILOTS, PHASES, 7, tmp_path)
    assert len({task.fault for task in tasks}) > 190
    for task in tasks:
        case = find_case(task.fault)
        assert case.group == pair.PAIR_GROUP != FLEET_GROUP
        assert task.phase in case.phases
        assert task.autopilot in case.autopilots
    with pytest.raises(LeewayError, match="no two"):
        pair.draw_pair_task([find_case("front")], AUTOPILOTS, PHASES, 1, tmp_path)


def test_both_faults_run_and_the_second_begins_with_the_first_or_soon_after():
    delays_s = [second_delay_s(seed) for seed in range(12)]
    assert 0.0 in delays_s
    assert max(delays_s) > 1.0
    assert max(delays_s) <= pair.MAX_DELAY_S + 0.2


def second_delay_s(seed: int) -> float:
    def procedure(stage):
        yield from stage.wait_for_phase_and_record_fault_start()
        stage.expect_effect("an effect", lambda: stage.t_s > stage.start_s)
        yield

    first, second = (
        SimpleNamespace(
            procedure=procedure, phases=(FlightPhase.DROP,), rules=(check_returned_home,)
        )
        for _ in range(2)
    )
    craft = SimpleNamespace(
        operator=None,
        true_flight_phase=FlightPhase.DROP,
        vehicle=SimpleNamespace(is_airborne=True),
    )
    stage = FaultContext(
        FlightPhase.DROP,
        np.random.default_rng(seed),
        lambda: True,
        craft_and_lockstep=(craft, None),
    )
    stage.remaining_steps = pair.run_both_procedures(first, second)(stage)
    for step in range(200):
        stage.continue_procedure(0.1 * step)
    assert pair.had_two_faults(stage)
    return round(stage.second.start_s - stage.start_s, 1)


def test_home_is_not_required_where_nobody_can_undo_another_mission():
    names = {case.name for case in CATALOGUE}
    assert {*pair.MISSION_CHANGING_CASES, *pair.ABSENT_COMPANION_CASES} <= names
    upload, silence = find_case("foreign-upload"), find_case("silence-for-good")
    for first, second in ((upload, silence), (silence, upload)):
        assert check_returned_home not in pair.combine_cases(first, second).rules
    short = find_case("silence-1-s")
    assert check_returned_home in pair.combine_cases(upload, short).rules
