"""What autopilots report about themselves: mode names, arming checks, faults in recordings."""

import re

import numpy as np
import pytest
from pymavlink.mavutil import mode_mapping_acm

from companion.adapters.autopilots.ardupilot import ArduPilot
from companion.adapters.autopilots.px4 import Px4
from companion.adapters.logs.ulog_faults import fault_starts
from companion.analysis.replay.autopilot_faults import autopilot_faults
from companion.analysis.replay.recorded_flight import RecordedFlight
from companion.core.mission.events import EstimatorHealth, Mode, VehicleState
from companion.core.mission.preflight_checks import RouteProperties, unmet_requirement_issues
from companion.core.mission.preflight_checks import settings_to_correct as to_set

ROUTE = RouteProperties(
    *(20.0, 40.0, 300.0, 100.0, 17.0, 30.0, 3.0, 2.0, 0.7, 19.8, 21.0, 6, 5700.0), False
)
OBSOLETE = (8, 10)
"""Modes that ArduCopter no longer has."""


def test_arducopter_modes_have_the_names_of_pymavlink():
    names = {number: ArduPilot().decode_mode(number, 0)[1] for number in mode_mapping_acm}
    expected = {n: name for n, name in mode_mapping_acm.items() if n not in OBSOLETE}
    assert {n: names[n] for n in expected} == expected
    assert ArduPilot().decode_mode(99, 0) == (Mode.OTHER, "mode 99")


@pytest.mark.parametrize(
    ("main", "sub", "mode", "name"),
    [
        (4, 20, Mode.LAND, "AUTO.DESCEND"),
        (4, 12, Mode.OTHER, "AUTO.EXTERNAL2"),
        (4, 77, Mode.OTHER, "mode 4.77"),
        (3, 1, Mode.OTHER, "ORBIT"),
        (10, 0, Mode.OTHER, "TERMINATION"),
        (50, 3, Mode.OTHER, "mode 50.3"),
    ],
)
def test_px4_modes_are_named_by_what_they_do(main, sub, mode, name):
    assert Px4().decode_mode(sub << 24 | main << 16, 0) == (mode, name)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"ARMING_SKIPCHK": 0.0}, ""),
        ({"ARMING_SKIPCHK": -1.0}, "ARMING_SKIPCHK is -1, set 0"),
        ({"ARMING_SKIPCHK": 8.0}, "ARMING_SKIPCHK is 8, set 0"),
        ({"ARMING_CHECK": 1.0}, ""),
        ({"ARMING_CHECK": 0.0}, "ARMING_CHECK is 0, set 1"),
        ({"ARMING_CHECK": 72.0}, "ARMING_CHECK is 72, set 1"),
    ],
)
def test_arming_checks_that_are_off_are_reported(values, text):
    issues = unmet_requirement_issues(ArduPilot().parameter_requirements(ROUTE), values)
    found = [issue.words for issue in issues if issue.name.startswith("ARMING")]
    assert [one.rpartition(": ")[2] for one in found] == ([text] if text else [])


def test_a_power_check_that_is_off_on_px4_is_reported():
    for value, expected in ((894281.0, 1), (0.0, 0)):
        values = {"CBRK_SUPPLY_CHK": value}
        issues = unmet_requirement_issues(Px4().parameter_requirements(ROUTE), values)
        assert len([i for i in issues if i.name == "CBRK_SUPPLY_CHK"]) == expected


@pytest.mark.parametrize("profile", [ArduPilot(), Px4()])
def test_each_finding_names_its_parameters_with_their_values_and_those_to_set(profile):
    for requirement in profile.parameter_requirements(ROUTE):
        tried = (dict.fromkeys(requirement.names, x) for x in (0.0, 1.0, 2.0, 4.0, 1e5, 894281.0))
        unmet = [values for values in tried if requirement.is_met(values) is False]
        for values in unmet:
            (issue,) = unmet_requirement_issues([requirement], values)
            corrections = issue.words.removeprefix(f"{requirement.description}: ").split(", ")
            names = re.findall(r"(\w+) is \S+, set \S+", ", ".join(corrections))
            assert names, issue.words
            assert set(names) <= set(requirement.names)
            assert len(corrections) - 2 * len(names) == requirement.needs_reboot


def test_px4_forwarding_is_reported_by_instance_and_not_set_for_one_flight():
    values = {"MAV_0_CONFIG": 101.0, "MAV_0_FORWARD": 1.0, "MAV_1_CONFIG": 102.0,
              "MAV_1_FORWARD": 0.0, "MAV_2_CONFIG": 0.0, "MAV_2_FORWARD": 0.0}  # fmt: skip
    requirements = Px4().parameter_requirements(ROUTE)
    (issue,) = (i for i in unmet_requirement_issues(requirements, values) if "forward" in i.words)
    assert issue.words.endswith("companion: MAV_1_FORWARD is 0, set 1, reboot")
    assert "MAV_1_FORWARD" not in to_set(requirements, values)


def test_failsafes_and_estimator_faults_of_a_recording_are_listed_while_armed():
    def state(t_s: float, *, armed: bool, failsafe: bool) -> VehicleState:
        return VehicleState(t_s, Mode.MISSION, "AUTO", armed, failsafe)

    log = RecordedFlight(
        "test",
        (
            state(0.0, armed=False, failsafe=True),
            state(1.0, armed=True, failsafe=False),
            EstimatorHealth(2.0, position_ok=True),
            state(3.0, armed=True, failsafe=True),
            state(4.0, armed=True, failsafe=True),
            EstimatorHealth(5.0, position_ok=False),
        ),
        autopilot_faults=((4.5, "crash check, code 1"),),
    )
    assert [t_s for t_s, _ in autopilot_faults(log)] == [3.0, 4.5, 5.0]


def test_fault_flags_of_a_ulog_count_while_armed_and_once_each():
    t_s = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    topics = {
        "vehicle_status": [{"t_s": t_s, "arming_state": np.array([1, 2, 2, 2, 1])}],
        "failsafe_flags": [
            {
                "t_s": t_s + 0.1,
                "attitude_invalid": np.array([1, 0, 1, 1, 1]),
                "manual_control_signal_lost": np.array([1, 1, 1, 1, 1]),
            }
        ],
    }
    assert fault_starts(topics) == ((2.1, "failsafe_flags: attitude_invalid"),)
