"""The longest flight against what a hover and the pack's label allow."""

import pytest

from companion.adapters.files.params import read_airframe
from companion.core.vehicle.endurance import max_flight_duration_s
from companion.core.vehicle.power import multirotor_power_w


@pytest.mark.parametrize("name", ["m100", "octo8"])
def test_the_longest_flight_is_longer_than_a_hover_on_the_label_and_shorter_than_twice_that(name):
    airframe = read_airframe(name)
    hover_w = float(multirotor_power_w(airframe, airframe.flying_mass_kg(0.0), 0.0, 0.0, 1.225))
    hover_s = 3600.0 * airframe.battery.nominal_wh / hover_w
    assert hover_s < max_flight_duration_s(airframe) < 2.0 * hover_s
