"""The study tracks services with the companion's monitor; its worlds match their description."""

import math

import numpy as np
import pytest

from companion.core.monitor.flight_evidence import FlightEvidence, LogRatio
from companion.core.monitor.promises import DRAW, DRAW_STD, DRAW_TEST, alarm_log_e_threshold
from companion.core.monitor.service import (
    log_e_value,
    new_service_record,
    service_record_with_flight,
)
from sim_bridge.research.monitor.services import (
    ServicePlan,
    World,
    count_losses,
    shift_estimates_after_alarm,
    simulate_shift_alarms,
)

RISEN = ServicePlan(flights=60, per_day=10, change=20, change_size=math.log(1.15))
WORLD = World("test", 0.0, 0.015, 0.024)


def followed(services, season=RISEN, world=WORLD):
    rng = np.random.default_rng(5)
    return simulate_shift_alarms(
        DRAW_TEST, DRAW_STD, alarm_log_e_threshold(DRAW), world, season, services, rng
    )


def test_many_services_at_once_are_followed_as_one_companion_follows_its_own():
    seen = followed(3)
    for vehicle in range(3):
        service = new_service_record("m", earlier_evidence_lost=False)
        for flight in range(RISEN.flights):
            told = FlightEvidence(LogRatio(float(seen.values[flight, vehicle]), DRAW_STD))
            when_s = 86400.0 * (flight // 10) + 600.0 * (flight % 10)
            service = service_record_with_flight(service, told, "A", str(flight), when_s)
            expected = float(seen.log_e[flight, vehicle])
            assert log_e_value(service.draw, DRAW) == pytest.approx(expected, abs=1e-9)
        assert service.draw.alarm_flight == seen.alarm[vehicle] + 1


def test_the_flights_of_a_day_share_their_day_and_days_do_not():
    values = followed(4000, ServicePlan(flights=40, per_day=10)).values
    same = np.corrcoef(values[0], values[9])[0, 1]
    other = np.corrcoef(values[0], values[10])[0, 1]
    # 1.5 %^2 of 1.5 %^2 + 2.4 %^2; the standard error of a correlation of 4000 is 0.016.
    assert same == pytest.approx(0.015**2 / (0.015**2 + 0.024**2), abs=0.06)
    assert other == pytest.approx(0.0, abs=0.06)


def test_nothing_is_believed_before_the_alarm_and_the_rise_after_it():
    seen = followed(200)
    mean, std = shift_estimates_after_alarm(DRAW_TEST, DRAW_STD, seen, RISEN)
    before = np.arange(RISEN.flights)[:, None] <= seen.alarm
    assert not mean[before].any()
    assert mean[-1][np.isfinite(seen.alarm)].mean() == pytest.approx(math.log(1.15), abs=0.02)
    assert std[-1].min() >= DRAW_TEST.day_std


def test_a_gate_that_knows_the_draw_keeps_its_loss_and_one_that_does_not_breaks_it():
    rng = np.random.default_rng(7)
    draw = math.log(1.15) + 0.028 * rng.standard_normal(20_000)
    whole, none = np.ones_like(draw), np.zeros_like(draw)
    knows = count_losses(draw, none, (none + math.log(1.15), none + 0.02, whole), 0.01, rng)
    not_ = count_losses(draw, none, (none, none, whole), 0.01, rng)
    assert knows.share <= 0.01 < not_.share
