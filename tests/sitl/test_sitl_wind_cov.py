"""WIND_COV of the companion: only its own valid estimate, only where the autopilot has none."""

import math

import numpy as np
import pytest
from pymavlink import mavutil

pytestmark = pytest.mark.sitl

OWN_WIND = {"px4": {"EKF2_DRAG_CTRL": 1.0}, "ardupilot": {"EK3_DRAG_BCOEF_X": 25.0}}


def stream(flown):
    """Return the companion's WIND_COV and NAMED_VALUE_FLOAT of the recorded stream."""
    log = mavutil.mavlink_connection(str(flown.run_dir / "stream.tlog"))
    found = []
    while (message := log.recv_match(type=["WIND_COV", "NAMED_VALUE_FLOAT"])) is not None:
        if message.get_srcComponent() == 191:
            found.append(message)
    log.close()
    return found


@pytest.mark.sample
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_the_valid_estimate_is_sent_once_a_second_in_flight(fly_case, autopilot_kind):
    flown = fly_case(autopilot_kind)
    messages = stream(flown)
    sent = [m for m in messages if m.get_type() == "WIND_COV"]
    times_s = np.array([m.time_usec / 1e6 for m in sent])
    named = [m for m in messages if m.get_type() == "NAMED_VALUE_FLOAT"]
    valid_s = [m.time_boot_ms / 1e3 for m in named if m.name == "LW_WINDN"]
    flight_s = flown.row["flight_time_s"]
    assert 0.8 * flight_s - 15.0 < len(sent) <= flight_s + 1.0
    assert np.diff(times_s).min() >= 1.0 - 0.11  # the stamp is that of a tick
    assert times_s[0] >= valid_s[0] - 2.0
    assert times_s[-1] - times_s[0] <= flight_s
    # The wind comes from 70 degrees at 5 m/s (10 m): the air moves to 250 degrees.
    wind = np.mean([(m.wind_x, m.wind_y) for m in sent], axis=0)
    to_rad = math.radians(250.0)
    along = wind @ (math.cos(to_rad), math.sin(to_rad))
    assert 4.0 < along < 8.0
    assert abs(wind @ (-math.sin(to_rad), math.cos(to_rad))) < 1.5
    assert all(0.0 < m.horiz_accuracy < 5.0 for m in sent)
    assert all(10.0 < m.wind_alt < 60.0 for m in sent)
    assert all(math.isnan(m.wind_z) and math.isnan(m.var_horiz) for m in sent)


@pytest.mark.sample
@pytest.mark.parametrize("autopilot_kind", ["px4", "ardupilot"])
def test_none_is_sent_where_the_autopilot_has_a_wind_of_its_own(fly_case, autopilot_kind):
    flown = fly_case(autopilot_kind, settings=OWN_WIND[autopilot_kind])
    kinds = {m.get_type() for m in stream(flown)}
    assert kinds == {"NAMED_VALUE_FLOAT"}
    assert flown.row["home"]
