"""The rules by which a row is judged, each on a flight that keeps it and one that does not."""

from types import SimpleNamespace

import pytest

from sim_bridge.app.faults.verdict import (
    FlownFault,
    claims_no_delivery,
    comes_home,
    delivers,
    ends_in_order,
    fault_began,
    hands_off,
    is_taken,
    keeps_aside,
    promises_nothing_false,
    raises_nothing,
    stays_disarmed,
    stays_down,
    tells,
)


def flown(**changes) -> FlownFault:
    row = {"home": True, "delivered": True, "outcome": "SUC", "margin_wh": 3.0}
    row["decisions"] = [{"kind": "go", "p_home": changes.pop("promised", 0.995)}]
    craft = SimpleNamespace(
        vehicle=SimpleNamespace(is_crashed=changes.pop("crashed", False)),
        commands=changes.pop("commands", []),
        operator=SimpleNamespace(said=changes.pop("said", [])),
        companion=SimpleNamespace(exit_code=changes.pop("exit_code", 0)),
        record=SimpleNamespace(
            took_off_s=changes.pop("took_off_s", None), landed_s=changes.pop("landed_s", None)
        ),
        run_dir=changes.pop("run_dir", None),
    )
    stage = SimpleNamespace(
        craft=craft,
        began_s=changes.pop("began_s", 50.0),
        took_over_s=changes.pop("took_over_s", 60.0),
        armed=changes.pop("armed", False),
    )
    words = changes.pop("words", "")
    return FlownFault(row | changes, stage, words)


LOST = {"home": False, "outcome": "DEL", "margin_wh": -2.0}
BAD = {
    comes_home: LOST,
    delivers: {"delivered": False},
    claims_no_delivery: {"delivered": False, "said": [(60.0, "delivered: so says the gripper")]},
    fault_began: {"began_s": None},
    hands_off: {"commands": [(60.1, "COMMAND_LONG", 400)]},
    stays_disarmed: {"armed": True},
    promises_nothing_false: LOST,
    ends_in_order: {"exit_code": 1},
    stays_down: {"took_off_s": 23.0},
    raises_nothing: {"words": "x\nTraceback (most recent call last):\n  File"},
}


@pytest.mark.parametrize("rule", BAD, ids=lambda rule: rule.__name__)
def test_a_rule_holds_of_a_good_flight_and_breaks_on_a_bad_one(rule):
    assert rule(flown()) is None
    assert rule(flown(**BAD[rule]))


def test_a_torn_record_is_looked_for_in_the_run_folder(tmp_path):
    rule = keeps_aside("decisions.mcap.torn-1")
    assert rule(flown(run_dir=tmp_path))
    (tmp_path / "decisions.mcap.torn-1").touch()
    assert rule(flown(run_dir=tmp_path)) is None


def test_a_crash_at_home_is_not_home():
    assert "crashed" in (comes_home(flown(crashed=True)) or "")


def test_commands_before_the_take_over_do_not_count():
    assert hands_off(flown(commands=[(59.9, "COMMAND_LONG", 400)])) is None


def test_hands_off_is_not_shown_by_a_flight_that_nobody_took_over():
    assert hands_off(flown(took_over_s=None)) == "nobody took over"


def test_a_promise_under_99_percent_is_not_a_false_one():
    assert promises_nothing_false(flown(promised=0.9, **LOST)) is None


def finished(reason: str) -> list[dict[str, str | float]]:
    return [{"kind": "go", "p_home": 0.995}, {"kind": "finished", "reason": reason}]


def test_what_a_person_landed_is_no_broken_promise_where_companion_and_truth_say_so():
    taken = {"home": False, "outcome": "TAKEN"}
    own = flown(**taken, decisions=finished("TAKEN: 90 m from depot"))
    assert is_taken(own) is None
    assert promises_nothing_false(own) is None
    assert is_taken(flown(**taken, decisions=finished("FAIL: 90 m from depot")))
    assert is_taken(flown(**LOST))


def test_words_before_the_fault_and_too_late_are_not_heard():
    rule = tells("mission", within_s=2.0)
    assert rule(flown(said=[(49.0, "another mission aboard")]))
    assert rule(flown(said=[(53.0, "another mission aboard")]))
    assert rule(flown(said=[(51.0, "another mission aboard")])) is None


def test_a_flight_that_ends_before_it_can_be_found_need_not_tell():
    rule = tells("mission", unless_down_within_s=30.0)
    assert rule(flown(landed_s=79.0)) is None
    assert rule(flown(landed_s=81.0))
    assert rule(flown())
    assert tells("mission")(flown(landed_s=51.0))
