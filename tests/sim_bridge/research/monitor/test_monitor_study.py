"""The study follows services with the companion's own bets, and its worlds are what they say."""

import math

import numpy as np
import pytest

from companion.core.monitor.figures import FlightFigures, LogRatio
from companion.core.monitor.promises import DRAW, DRAW_STD, DRAW_TEST, threshold
from companion.core.monitor.service import after_flight, begun_anew, log_e
from sim_bridge.research.monitor.following import believed_after, follow
from sim_bridge.research.monitor.gate import judge
from sim_bridge.research.monitor.worlds import Season, World

RISEN = Season(flights=60, per_day=10, change=20, by=math.log(1.15))
WORLD = World("test", 0.0, 0.015, 0.024)


def followed(services, season=RISEN, world=WORLD):
    rng = np.random.default_rng(5)
    return follow(DRAW_TEST, DRAW_STD, threshold(DRAW), world, season, services, rng)


def test_many_services_at_once_are_followed_as_one_companion_follows_its_own():
    seen = followed(3)
    for vehicle in range(3):
        service = begun_anew("m", lost=False)
        for flight in range(RISEN.flights):
            told = FlightFigures(LogRatio(float(seen.values[flight, vehicle]), DRAW_STD))
            when_s = 86400.0 * (flight // 10) + 600.0 * (flight % 10)
            service = after_flight(service, told, "A", str(flight), when_s)
            expected = float(seen.log_e[flight, vehicle])
            assert log_e(service.draw, DRAW) == pytest.approx(expected, abs=1e-9)
        assert service.draw.alarm_flight == seen.alarm[vehicle] + 1


def test_the_flights_of_a_day_share_their_day_and_days_do_not():
    values = followed(4000, Season(flights=40, per_day=10)).values
    same = np.corrcoef(values[0], values[9])[0, 1]
    other = np.corrcoef(values[0], values[10])[0, 1]
    # 1.5 %^2 of 1.5 %^2 + 2.4 %^2; the standard error of a correlation of 4000 is 0.016.
    assert same == pytest.approx(0.015**2 / (0.015**2 + 0.024**2), abs=0.06)
    assert other == pytest.approx(0.0, abs=0.06)


def test_nothing_is_believed_before_the_alarm_and_the_rise_after_it():
    seen = followed(200)
    mean, std = believed_after(DRAW_TEST, DRAW_STD, seen, RISEN)
    before = np.arange(RISEN.flights)[:, None] <= seen.alarm
    assert not mean[before].any()
    assert mean[-1][np.isfinite(seen.alarm)].mean() == pytest.approx(math.log(1.15), abs=0.02)
    assert std[-1].min() >= DRAW_TEST.day_std


def test_a_gate_that_knows_the_draw_keeps_its_loss_and_one_that_does_not_breaks_it():
    rng = np.random.default_rng(7)
    draw = math.log(1.15) + 0.028 * rng.standard_normal(20_000)
    whole, none = np.ones_like(draw), np.zeros_like(draw)
    knows = judge(draw, none, (none + math.log(1.15), none + 0.02, whole), 0.01, rng)
    not_ = judge(draw, none, (none, none, whole), 0.01, rng)
    assert knows.share <= 0.01 < not_.share
