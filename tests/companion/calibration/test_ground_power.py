"""Power at rest: selection of the logs and the avionics power identified from them."""

import numpy as np
import pytest

from companion.analysis.calibration.ground_power import (
    StandingPower,
    describe_ground_tests,
    lowest_current_tests,
    mean_standing_power,
    motors_off_power_of_flightless_log,
)
from companion.analysis.calibration.records import FlightRecord

HOVER_W, VOLT = 475.0, 25.0


def record(name="g", watts=10.0, seconds=60.0, speed=0.0):
    n = round(seconds / 0.2)
    rng = np.random.default_rng(1)
    velocity = rng.normal(0.0, 0.02, (n, 3))
    velocity[:, 0] += speed
    still = np.zeros(n)
    return FlightRecord(
        name=name,
        t_s=0.2 * np.arange(n),
        vel_ned_mps=velocity,
        roll_rad=still,
        pitch_rad=still,
        yaw_rad=still,
        voltage_v=still + VOLT,
        current_a=still + watts / VOLT,
        payload_kg=still,
        density_kgpm3=1.2,
    )


def reading(name, watts, std_w=0.1):
    return StandingPower(name, watts, std_w, VOLT, watts / VOLT)


@pytest.mark.parametrize(
    ("change", "stands"),
    [({}, True), ({"watts": 30.0}, True), ({"watts": -4.0}, True),
     ({"watts": HOVER_W}, False), ({"speed": 2.0}, False), ({"seconds": 10.0}, False)],
)  # fmt: skip
def test_a_log_that_stands_is_told_from_one_that_flies_or_is_too_short(change, stands):
    found = motors_off_power_of_flightless_log(record(**change), HOVER_W)
    assert (found is not None) == stands
    if found is not None:
        assert found.power_w == pytest.approx(change.get("watts", 10.0))


def test_what_the_sensor_cannot_tell_is_left_as_believed():
    assert mean_standing_power([reading("a", 15.0)]).is_avionics_measurable
    mixed = mean_standing_power([reading("a", 15.0), reading("b", -4.0)])
    assert not mixed.is_avionics_measurable
    assert mixed.least_a == pytest.approx(-4.0 / VOLT)
    assert mean_standing_power([]) is None


def test_the_scatter_between_logs_widens_what_each_of_them_says():
    found = mean_standing_power([reading("a", 10.0), reading("b", 14.0), reading("c", 18.0)])
    assert found.power_w == pytest.approx(14.0)
    assert found.std_w == pytest.approx(4.0 / np.sqrt(3.0))


def test_only_the_least_drawing_tests_are_of_avionics_and_the_others_are_told_beside_them():
    tests = [reading("off", 10.0), reading("too", 11.0), reading("idles", 50.0)]
    assert [one.name for one in lowest_current_tests(tests, 0.2)] == ["off", "too"]
    said = describe_ground_tests(tests, 0.2)
    assert said[0] == "off: on the ground: 0.40 A, 10.0 W"
    assert said[2] == "idles: on the ground: 2.00 A, 50.0 W, 39.5 W more than the least"
