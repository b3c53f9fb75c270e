"""Pack, draw and wind figures of a flight, from its telemetry."""

import json
import math

import numpy as np
import pytest

from companion.adapters.files.params import read_airframe, read_wind_process
from companion.core.base.errors import LeewayError
from companion.core.monitor.tally import FlightTally
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook

PACK = read_airframe("m100").battery
FLYING_A, STEP_S = 20.0, 0.5


def charge_v(charge_frac):
    return PACK.cells * float(np.interp(charge_frac, PACK.ocv_charge_frac, PACK.ocv_cell_v))


def flight(capacity, *, health=1.0, gap_s=0.0, stop=None, seconds=480.0):
    """Fly on a pack that obeys Ohm's law; `stop(tally)` may replace the tally at half time."""
    tally = FlightTally(PACK, health)
    mean_v = np.trapezoid(
        np.interp(np.linspace(0.0, 1.0, 20_001), PACK.ocv_charge_frac, PACK.ocv_cell_v),
        np.linspace(0.0, 1.0, 20_001),
    )
    full_as = 3600.0 * capacity * PACK.nominal_wh / (PACK.cells * float(mean_v))
    charge = 0.95

    def hear(t_s, current_a, *, at_rest):
        volts = charge_v(charge) - current_a * PACK.resistance_ohm
        tally.add_battery_sample(
            t_s, volts, current_a, disarmed_on_ground=at_rest, on_ground=at_rest
        )

    for second in range(20):
        hear(float(second), 0.0, at_rest=True)
    t_s = 20.0
    for step in range(int(seconds / STEP_S)):
        t_s += STEP_S
        charge -= FLYING_A * STEP_S / full_as
        hear(t_s, FLYING_A, at_rest=False)
        if stop is not None and step == 300:
            tally = stop(tally)
    # Until the expected voltage recovery of a pack is complete.
    for _ in range(200):
        t_s += 1.0
        hear(t_s + gap_s, 0.0, at_rest=True)
    return tally


@pytest.mark.parametrize("capacity", [1.0, 0.9, 0.8])
def test_the_charge_that_falls_tells_the_capacity_that_is_left(capacity):
    told = flight(capacity).flight_evidence().pack
    assert told is not None
    assert told.value == pytest.approx(-math.log(capacity), abs=0.01)
    assert 0.03 < told.std < 0.10


def test_a_capacity_that_is_stated_is_no_news():
    told = flight(0.8, health=0.8).flight_evidence().pack
    assert told is not None
    assert told.value == pytest.approx(0.0, abs=0.01)


def test_a_silence_in_which_nobody_knows_the_draw_tells_nothing_of_the_pack():
    assert flight(1.0, gap_s=10.0).flight_evidence().pack is None


def test_a_short_flight_tells_nothing_of_the_pack():
    assert flight(1.0, seconds=60.0).flight_evidence().pack is None


def test_a_vehicle_without_a_current_sensor_tells_nothing_of_its_pack():
    tally = FlightTally(PACK, 1.0)
    for second in range(100):
        standing = not 10 < second < 90
        tally.add_battery_sample(
            float(second), 24.0, None, disarmed_on_ground=standing, on_ground=standing
        )
    assert tally.flight_evidence().pack is None


def test_a_restart_in_the_air_goes_on_with_the_same_sums():
    def restarted(tally):
        fresh = FlightTally(PACK, 1.0)
        fresh.restore(json.loads(json.dumps(tally.snapshot())))
        return fresh

    assert flight(0.8, stop=restarted).flight_evidence() == flight(0.8).flight_evidence()


def test_a_checkpoint_that_is_none_is_refused():
    with pytest.raises(LeewayError, match="tally"):
        FlightTally(PACK, 1.0).restore({"measured_wh": math.nan})
    with pytest.raises(LeewayError, match="tally"):
        FlightTally(PACK, 1.0).restore({"measured_wh": "much"})


def test_the_draw_is_measured_over_modelled_energy_and_needs_enough_of_it():
    tally = FlightTally(PACK, 1.0)
    tally.add_power(0.2, 440.0, 400.0, 0.1)
    assert tally.flight_evidence().draw is None
    for _ in range(500):
        tally.add_power(0.2, 440.0, 400.0, 0.1)
    tally.add_power(1e6, 4000.0, 400.0, 5.0)  # with an outdated current
    told = tally.flight_evidence().draw
    assert told is not None
    assert told.value == pytest.approx(math.log(1.1), abs=1e-9)


def belief(t_s, north_mps):
    return WindBelief(t_s, np.array([north_mps, 0.0]), 0.04 * np.eye(2), ("tilt",), True)


@pytest.mark.parametrize(("jump_mps", "misses"), [(0.0, 0), (30.0, 1)])
def test_a_wind_outside_its_forecast_a_minute_later_is_a_miss(jump_mps, misses):
    tally, outlook = FlightTally(PACK, 1.0), WindOutlook(read_wind_process("coast"))
    for second in range(61):
        seen = belief(float(second), 5.0 + (jump_mps if second == 60 else 0.0))
        outlook.update_from_estimate(seen)
        tally.check_due_wind_forecast(seen, outlook)
    told = tally.flight_evidence()
    assert (told.wind_misses, told.wind_checks) == (misses, 1)
