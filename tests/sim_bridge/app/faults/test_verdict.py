"""The rules by which a row is judged, each on a flight that keeps it and one that does not."""

import math
from types import SimpleNamespace

import pytest

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.verdict import (
    FaultRunResult,
    check_alert_sent,
    check_delivered,
    check_disarmed_at_end,
    check_energy_never_rises,
    check_fault_took_effect,
    check_file_exists_in_run_folder,
    check_landed_intact_by_pilot,
    check_no_commands_after_takeover,
    check_no_error_exit_code,
    check_no_exceptions,
    check_no_false_delivery,
    check_no_takeoff,
    check_returned_home,
    check_returned_if_p_home_was_high,
)
from sim_bridge.app.world.companion_link import CompanionLink
from sim_bridge.app.world.safety_rules import TakeOver, find_energy_rise_after_takeoff

RECORD = {"decisions": [{"t_s": 10.0, "kind": "take_off"}]}


def flown(**changes) -> FaultRunResult:
    row = {"home": True, "delivered": True, "outcome": "SUC", "margin_wh": 3.0}
    row["decisions"] = []
    promised, said = changes.pop("promised", 0.995), changes.pop("said", [])
    energy = [{"t_s": 9.0, "left_wh": 79.0}, *changes.pop("energy", [])]
    link = CompanionLink(SimpleNamespace(), 1, commands=changes.pop("commands", []))
    took_over_s = changes.pop("took_over_s", 60.0)
    link.takeover = None if took_over_s is None else TakeOver(known_s=took_over_s)
    craft = SimpleNamespace(
        vehicle=SimpleNamespace(is_crashed=changes.pop("crashed", False)),
        link=link,
        companion=SimpleNamespace(
            exit_code=changes.pop("exit_code", 0),
            read_result_json_or_empty=lambda: RECORD | {"energy": energy},
        ),
        record=SimpleNamespace(
            takeoff_s=changes.pop("took_off_s", None), landed_s=changes.pop("landed_s", None)
        ),
        run_dir=changes.pop("run_dir", None),
    )
    stage = SimpleNamespace(
        craft=craft,
        start_s=changes.pop("began_s", 50.0),
        is_armed=changes.pop("armed", False),
        missing_effects_text=changes.pop("missing", ""),
    )
    tracebacks = changes.pop("tracebacks", 0)
    return FaultRunResult(row | changes, stage, said, tracebacks, promised)


LOST = {"home": False, "outcome": "DEL", "margin_wh": -2.0}
BAD = {
    check_returned_home: LOST,
    check_delivered: {"delivered": False},
    check_no_false_delivery: {
        "delivered": False,
        "said": [(60.0, "delivered: so says the gripper")],
    },
    check_fault_took_effect: {"began_s": None},
    check_no_commands_after_takeover: {"commands": [(60.1, "COMMAND_LONG", 400)]},
    check_energy_never_rises: {
        "energy": [{"t_s": 10.0, "left_wh": 80.0}, {"t_s": 11.0, "left_wh": 80.1}]
    },
    check_disarmed_at_end: {"armed": True},
    check_returned_if_p_home_was_high: LOST,
    check_no_error_exit_code: {"exit_code": 1},
    check_no_takeoff: {"took_off_s": 23.0},
    check_no_exceptions: {"tracebacks": 1},
}


@pytest.mark.parametrize("rule", BAD, ids=lambda rule: rule.__name__)
def test_a_rule_holds_of_a_good_flight_and_breaks_on_a_bad_one(rule):
    assert not rule(flown())
    assert rule(flown(**BAD[rule]))


def test_a_fault_without_its_effect_is_named():
    text = check_fault_took_effect(flown(missing="home is 3 km away"))
    assert text == "the fault took no effect: home is 3 km away"


def test_a_torn_record_is_looked_for_in_the_run_folder(tmp_path):
    rule = check_file_exists_in_run_folder("decisions.mcap.torn-1")
    assert rule(flown(run_dir=tmp_path))
    (tmp_path / "decisions.mcap.torn-1").touch()
    assert rule(flown(run_dir=tmp_path)) is None


def test_a_crash_at_home_is_not_home():
    assert "crashed" in (check_returned_home(flown(crashed=True)) or "")


def test_commands_before_the_take_over_do_not_count():
    assert not check_no_commands_after_takeover(flown(commands=[(59.9, "COMMAND_LONG", 400)]))


def test_hands_off_is_not_shown_by_a_flight_that_nobody_took_over():
    assert check_no_commands_after_takeover(flown(took_over_s=None)) == "no takeover happened"


def test_a_promise_under_99_percent_is_not_a_false_one():
    assert check_returned_if_p_home_was_high(flown(promised=0.9, **LOST)) is None


def finished(reason: str) -> list[dict[str, str]]:
    return [{"kind": "finished", "reason": reason}]


def test_what_a_person_landed_is_no_broken_promise_where_companion_and_truth_say_so():
    taken = {"home": False, "outcome": "TAKEN"}
    own = flown(**taken, decisions=finished("TAKEN: 90 m from depot"))
    assert check_landed_intact_by_pilot(own) is None
    assert check_returned_if_p_home_was_high(own) is None
    assert check_landed_intact_by_pilot(flown(**taken, decisions=finished("FAIL: 90 m from depot")))
    assert check_landed_intact_by_pilot(flown(**LOST))


def test_words_before_the_fault_and_too_late_are_not_heard():
    rule = check_alert_sent(Alert.MISSION_CHANGED, within_s=2.0)
    assert rule(flown(said=[(49.0, "mission changed by another station: restoring")]))
    assert rule(flown(said=[(53.0, "mission changed by another station: restoring")]))
    assert rule(flown(said=[(51.0, "mission changed by another station: restoring")])) is None


def test_a_flight_that_ends_before_it_can_be_found_need_not_tell():
    rule = check_alert_sent(Alert.MISSION_CHANGED, exempt_if_landed_within_s=30.0)
    assert rule(flown(landed_s=79.0)) is None
    assert rule(flown(landed_s=81.0))
    assert rule(flown())
    assert check_alert_sent(Alert.MISSION_CHANGED)(flown(landed_s=51.0))


@pytest.mark.parametrize(
    ("left_wh", "rises"),
    [
        ((80.0, 79.0, 79.0), False),
        ((80.0, 79.0, 79.1), True),
        ((80.0, 70.0, 75.0), True),  # below the first, above the least
        ((80.0, None), True),
        ((80.0, math.nan), True),
    ],
)
def test_energy_may_rise_before_take_off_only(left_wh, rises):
    energy = [{"t_s": 20.0 + k, "left_wh": one} for k, one in enumerate(left_wh)]
    before = [{"t_s": 1.0, "left_wh": 10.0}, {"t_s": 2.0, "left_wh": 20.0}]
    take_off = [{"t_s": 10.0, "kind": "take_off"}]
    assert bool(find_energy_rise_after_takeoff(take_off, before + energy)) is rises
