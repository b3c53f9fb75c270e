"""The verdict on a flight against cases calculated by hand."""

from dataclasses import dataclass

import numpy as np
import pytest

from sim_bridge.app.flight.judge import (
    centred_moving_mean,
    evaluate_flight,
)
from sim_bridge.app.world.truth_record import TruthRecord


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


def append(record: TruthRecord, sample: Sample, *, person: bool = False) -> None:
    """Append a sample over level ground."""
    record.append_sample_and_record_events(
        sample.t_s, sample, -sample.pos_ned_m[2], under_external_control=person
    )


def flown(
    *,
    end=(0.0, 0.0, 0.0),
    drop=(100.0, 0.0, -5.0),
    end_usable_wh=20.0,
    lands=True,
    drops=True,
    person=False,
    crashed=False,
) -> TruthRecord:
    record = TruthRecord(crashed=crashed)
    append(record, Sample(0.0, (0.0, 0.0, 0.0), False, True, 100.0))
    append(record, Sample(1.0, (0.0, 0.0, -3.0), True, True, 99.0))
    append(record, Sample(50.0, drop, True, not drops, 60.0))
    append(record, Sample(99.0, end, not lands, not drops, end_usable_wh), person=person)
    return record


def verdict_of(record: TruthRecord, reserve_wh=15.0):
    return evaluate_flight(
        record,
        landing_sites_ne_m=[(0.0, 0.0), (50.0, 50.0)],
        customer_ne_m=(100.0, 0.0),
        drop_height_m=6.0,
        reserve_wh=reserve_wh,
        wind_estimates=[],
    )


@pytest.mark.parametrize(
    ("case", "outcome"),
    [
        ({}, "SUC"),
        ({"end": (50.0, 50.0, 0.0)}, "SUC"),  # a declared rally point counts as home
        ({"end_usable_wh": 14.0}, "DEL"),  # below the reserve does not count as home
        ({"end": (30.0, 0.0, 0.0)}, "DEL"),
        ({"lands": False}, "DEL"),
        ({"drops": False}, "ABRT"),
        ({"drops": False, "end": (300.0, 0.0, 0.0)}, "FAIL"),
        ({"person": True, "end": (30.0, 0.0, 0.0)}, "TAKEN"),
        ({"person": True, "end": (300.0, 0.0, 0.0), "drops": False}, "TAKEN"),
        ({"person": True}, "SUC"),  # after landing at home a pilot override changes nothing
        ({"person": True, "drops": False}, "ABRT"),
        ({"person": True, "lands": False}, "DEL"),  # pilot override without a landing
        ({"drop": (130.0, 0.0, -5.0)}, "ABRT"),  # released in the wrong garden
        ({"drop": (100.0, 0.0, -30.0)}, "ABRT"),  # released at cruise height
        ({"crashed": True}, "DEL"),  # at home
        ({"crashed": True, "person": True, "end": (30.0, 0.0, 0.0)}, "DEL"),
    ],
)
def test_each_flight_ends_in_exactly_one_outcome(case, outcome):
    assert verdict_of(flown(**case)).outcome.code == outcome


def test_a_parcel_that_a_person_removes_is_not_released():
    record = TruthRecord()
    append(record, Sample(0.0, (0.0, 0.0, 0.0), False, True, 100.0))
    record.has_parcel = False
    append(record, Sample(1.0, (0.0, 0.0, 0.0), False, False, 100.0))
    assert (record.released_s, record.released_ned_m) == (None, None)


def test_margin_is_what_is_left_above_the_reserve():
    assert verdict_of(flown()).outcome.margin_wh == pytest.approx(5.0)


def test_a_vehicle_that_never_left_is_home_and_aborted():
    record = TruthRecord()
    for t in range(3):
        append(record, Sample(float(t), (0.0, 0.0, 0.0), False, True, 100.0))
    assert verdict_of(record).outcome.code == "ABRT"
    assert (
        verdict_of(record, reserve_wh=150.0).outcome.code == "ABRT"
    )  # even with the pack nearly empty
    assert verdict_of(record).flight_time_s == 0.0


def test_who_takes_off_again_is_judged_by_the_last_landing():
    record = flown(person=True, end=(30.0, 0.0, 0.0))
    append(record, Sample(120.0, (30.0, 0.0, -9.0), True, False, 19.0))
    append(record, Sample(150.0, (60.0, 0.0, 0.0), False, False, 18.0))
    assert verdict_of(record).outcome.code == "DEL"


def test_the_centred_mean_of_a_ramp_is_the_ramp_away_from_its_ends():
    t = np.arange(0.0, 60.0, 0.1)
    mean = centred_moving_mean(t, 3.0 * t, 10.0)
    inner = (t > 6.0) & (t < 53.0)
    np.testing.assert_allclose(mean[inner], 3.0 * t[inner], atol=1e-9)
