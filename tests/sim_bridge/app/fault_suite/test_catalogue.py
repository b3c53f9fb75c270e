"""The rows of the suite: unique names, known phases, found by name and by number."""

from collections import Counter

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from sim_bridge.app.fault_suite.catalogue import CATALOGUE, select_cases, select_tight_cases
from sim_bridge.app.fault_suite.suite import list_tasks
from sim_bridge.app.faults.fault import PHASES
from sim_bridge.autopilot.kinds import AUTOPILOTS
from sim_bridge.main import app


def test_every_name_is_one_row_and_every_row_has_a_number_of_the_suite():
    assert max(Counter(case.name for case in CATALOGUE).values()) == 1
    assert all(1 <= case.number <= 98 for case in CATALOGUE)


def test_every_row_begins_in_known_phases_and_asks_something():
    for case in CATALOGUE:
        assert set(case.phases) <= set(PHASES), case.name
        assert set(case.autopilots) <= set(AUTOPILOTS), case.name
        assert case.phases, case.name
        assert case.rules, case.name


def test_rows_are_chosen_by_name_and_by_number():
    assert [case.name for case in select_cases(["arm-ack-lost"])] == ["arm-ack-lost"]
    assert {case.number for case in select_cases(["25", "arm-ack-lost"])} == {1, 25}
    assert select_cases([]) == list(CATALOGUE)


def test_a_name_that_no_row_has_is_refused_with_where_to_look():
    with pytest.raises(LeewayError, match=r"no-such-fault.*--list"):
        select_cases(["no-such-fault"])


def test_a_row_is_flown_only_in_phases_where_it_makes_sense(tmp_path):
    made = list_tasks(select_cases(["1", "7"]), AUTOPILOTS, PHASES, range(1, 3), tmp_path)
    assert {task.phase for task in made if task.fault == "arm-ack-lost"} == {"ready"}
    of_seven = {task.phase for task in made if task.fault == "false-disarmed"}
    assert of_seven == {"climb", "outbound", "drop", "return", "land"}
    assert len(made) == 2 * 2 * (1 + 5)


def test_the_list_names_every_row_and_flies_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    listed = CliRunner().invoke(app, ["faults", "--list"])
    assert listed.exit_code == 0
    assert all(case.name in listed.output for case in CATALOGUE)
    assert not list(tmp_path.iterdir())


def test_tight_flights_are_of_rows_that_the_model_does_not_know():
    fit = select_tight_cases(select_cases([]), named_explicitly=False)
    assert {case.number for case in fit} == set(range(21, 40))
    assert {case.group for case in fit} == {"energy", "air and sensors"}
    with pytest.raises(LeewayError, match=r"kill-switch: row 9, expected one of 21 to 39"):
        select_tight_cases(select_cases(["icing", "kill-switch"]), named_explicitly=True)
