"""The verdict on a flight against cases worked out by hand."""

from dataclasses import dataclass

import numpy as np
import pytest

from sim_bridge.app.flight.judge import centred_mean, judge, outcome_of, wind_errors
from sim_bridge.app.flight.record import TruthRecord


@dataclass
class Sample:
    t_s: float
    pos_ned_m: tuple[float, float, float]
    airborne: bool
    parcel_aboard: bool
    usable_wh: float
    energy_used_wh: float = 0.0
    power_w: float = 400.0
    crashed: bool = False
    vel_ned_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wind_to_ned_mps: tuple[float, float, float] = (1.0, 2.0, 0.0)


def flown(
    *,
    end=(0.0, 0.0, 0.0),
    drop=(100.0, 0.0, -5.0),
    end_usable_wh=20.0,
    lands=True,
    drops=True,
    person=False,
) -> TruthRecord:
    record = TruthRecord()
    record.add(Sample(0.0, (0.0, 0.0, 0.0), False, True, 100.0), 0.0)
    record.add(Sample(1.0, (0.0, 0.0, -3.0), True, True, 99.0), 0.0)
    record.add(Sample(50.0, drop, True, not drops, 60.0), 0.0)
    last = Sample(99.0, end, not lands, not drops, end_usable_wh)
    record.add(last, 0.0, flown_by_person=person)
    return record


def verdict_of(record: TruthRecord, reserve_wh=15.0):
    return judge(
        record,
        homes_ne_m=[(0.0, 0.0), (50.0, 50.0)],
        customer_ne_m=(100.0, 0.0),
        drop_height_m=6.0,
        reserve_wh=reserve_wh,
        wind_estimates=[],
    )


@pytest.mark.parametrize(
    ("case", "outcome"),
    [
        ({}, "SUC"),
        ({"end": (50.0, 50.0, 0.0)}, "SUC"),  # a declared rally point is home
        ({"end_usable_wh": 14.0}, "DEL"),  # below the reserve is not home
        ({"end": (30.0, 0.0, 0.0)}, "DEL"),
        ({"lands": False}, "DEL"),
        ({"drops": False}, "ABRT"),
        ({"drops": False, "end": (300.0, 0.0, 0.0)}, "FAIL"),
        ({"person": True, "end": (30.0, 0.0, 0.0)}, "TAKEN"),
        ({"person": True, "end": (300.0, 0.0, 0.0), "drops": False}, "TAKEN"),
        ({"person": True}, "SUC"),  # at home a person changes nothing
        ({"person": True, "drops": False}, "ABRT"),
        ({"person": True, "lands": False}, "DEL"),  # taken over, and not down
        ({"drop": (130.0, 0.0, -5.0)}, "ABRT"),  # dropped in the wrong garden
        ({"drop": (100.0, 0.0, -30.0)}, "ABRT"),  # dropped from cruise height
    ],
)
def test_each_flight_ends_in_exactly_one_outcome(case, outcome):
    assert verdict_of(flown(**case)).outcome == outcome


def test_a_crash_at_home_is_not_home():
    record = flown()
    record.crashed = True
    assert verdict_of(record).outcome == "DEL"


def test_a_crash_in_a_persons_hands_is_a_loss():
    record = flown(person=True, end=(30.0, 0.0, 0.0))
    record.crashed = True
    assert verdict_of(record).outcome == "DEL"


def test_margin_is_what_is_left_above_the_reserve():
    assert verdict_of(flown()).margin_wh == pytest.approx(5.0)


def test_a_vehicle_that_never_left_is_home_and_aborted():
    record = TruthRecord()
    for t in range(3):
        record.add(Sample(float(t), (0.0, 0.0, 0.0), False, True, 100.0), 0.0)
    assert verdict_of(record).outcome == "ABRT"
    assert verdict_of(record, reserve_wh=150.0).outcome == "ABRT"  # however empty its pack is
    assert verdict_of(record).flight_time_s == 0.0


def test_who_takes_off_again_is_judged_by_the_last_landing():
    record = flown(person=True, end=(30.0, 0.0, 0.0))
    record.add(Sample(120.0, (30.0, 0.0, -9.0), True, False, 19.0), 0.0)
    record.add(Sample(150.0, (60.0, 0.0, 0.0), False, False, 18.0), 0.0)
    assert verdict_of(record).outcome == "DEL"


def test_the_four_outcomes_follow_the_definition():
    table = {(d, h): outcome_of(delivered=d, home=h) for d in (True, False) for h in (True, False)}
    assert table == {
        (True, True): "SUC",
        (True, False): "DEL",
        (False, False): "FAIL",
        (False, True): "ABRT",
    }


def test_the_centred_mean_of_a_ramp_is_the_ramp_away_from_its_ends():
    t = np.arange(0.0, 60.0, 0.1)
    mean = centred_mean(t, 3.0 * t, 10.0)
    inner = (t > 6.0) & (t < 53.0)
    np.testing.assert_allclose(mean[inner], 3.0 * t[inner], atol=1e-9)


def test_wind_errors_are_the_bias_that_was_put_in():
    t = np.arange(0.0, 100.0, 0.1)
    truth = {
        "t_s": t,
        "wind_to_n_mps": np.full_like(t, 3.0),
        "wind_to_e_mps": np.full_like(t, -4.0),
    }
    rows = [
        {
            "t_s": s,
            "to_n_mps": 3.3,
            "to_e_mps": -4.4,
            "nn_m2ps2": 0.25,
            "ne_m2ps2": 0.0,
            "ee_m2ps2": 0.25,
        }
        for s in np.arange(0.0, 90.0, 0.5)
    ]
    rmse, nees = wind_errors(truth, 10.0, 90.0, rows)
    assert rmse == pytest.approx(0.5)  # hypot(0.3, 0.4)
    assert nees == pytest.approx(1.0)  # 0.25 / 0.25
    assert wind_errors(truth, None, None, rows) == (None, None)
