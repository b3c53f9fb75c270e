"""The fleet's wind onboard: used while consistent with the own wind, else ignored, to the bit.

The wind here is synthetic: a mean, an eddy that all share, and gusts of each.
"""

import numpy as np
import pytest

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.field_estimator import FieldEstimator
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.fleet_wind import CONSISTENT_S, OWN, SILENT_S, FleetWind
from companion.core.wind_field.fronts import WindChange
from companion.core.wind_field.wind_reports import MemberWindReport
from tests.companion.wind_field.made_front import made_front

COAST = read_wind_process("coast")
OTHERS = {
    "d2": (400.0, 100.0),
    "d3": (-500.0, 300.0),
    "d4": (200.0, -600.0),
    "d5": (-300.0, -400.0),
}
COV = (0.25, 0.0, 0.25)
END_S = 600.0


class Site:
    """Own wind and others' reported every 10 s; `told` may be altered to simulate false reports."""

    def __init__(self, seed: int = 3) -> None:
        self.rng = np.random.default_rng(seed)
        self.fleet = FleetWind(FieldProcess(COAST))
        self.t_s = 0.0
        self.eddy = np.zeros(2)

    def detections(self) -> tuple[float, float]:
        gust = self.eddy + self.rng.normal(0.0, 0.5, 2)
        return -7.0 + float(gust[0]), 1.0 + float(gust[1])

    def step(self, lie=lambda name, t_s, wind: wind, hears: bool = True) -> None:
        self.t_s += 10.0
        self.eddy = 0.95 * self.eddy + self.rng.normal(0.0, 0.3, 2)
        self.fleet.add_own_estimate(
            MemberWindReport(OWN, self.t_s, (0.0, 0.0), 40.0, self.detections(), COV)
        )
        winds = {name: self.detections() for name in OTHERS}
        told = [
            MemberWindReport(
                name, self.t_s - 2.0, OTHERS[name], 40.0, lie(name, self.t_s, wind), COV
            )
            for name, wind in winds.items()
        ]
        if hears:
            self.fleet.add_reports_and_front_of_desk(told, None, self.t_s)

    def until(self, t_s: float, **how) -> None:
        while self.t_s < t_s:
            self.step(**how)

    @property
    def is_used(self) -> bool:
        return self.fleet.joint_field_or_none(self.t_s) is not None


def test_honest_others_are_used_and_narrow_what_is_foreseen() -> None:
    site, lonely = Site(), Site()
    site.until(END_S)
    lonely.until(END_S, hears=False)
    assert lonely.fleet.joint_field_or_none(lonely.t_s) is None
    assert lonely.fleet.unused_reason == ""
    shared = site.fleet.joint_field_or_none(site.t_s)
    assert shared is not None
    assert set(shared.accepted_members) == {OWN, *OTHERS}
    one = FieldEstimator(FieldProcess(COAST))
    for k in range(60):
        one.add_report_or_rejection_reason(
            MemberWindReport("a", 10.0 * k, (0.0, 0.0), 40.0, (-7.0 + 0.01 * k, 1.0), COV), 10.0 * k
        )
    own_cov = (
        one.prune_learn_and_estimate_field(590.0)
        .forecast_at_points(mean_of_five_minutes(590.0), 300.0)
        .north_cov_m2ps2
    )
    all_cov = shared.forecast_at_points(mean_of_five_minutes(site.t_s), 300.0).north_cov_m2ps2
    assert float(all_cov[0, 0]) < 0.9 * float(own_cov[0, 0])


def mean_of_five_minutes(now_s: float) -> FieldPoints:
    return FieldPoints(np.zeros((1, 2)), np.array([40.0]), np.array([now_s + 150.0]))


def all_lie(name, t_s, wind):
    return (wind[0] + 4.0, wind[1] + 3.0) if t_s > 300.0 else wind


def test_a_desk_that_lies_is_not_used_and_not_again_before_a_minute_of_agreement() -> None:
    site = Site()
    site.until(300.0)
    assert site.is_used, "canary"
    site.until(350.0, lie=all_lie)
    assert not site.is_used
    assert site.fleet.unused_reason == "contradicts own wind"
    site.until(END_S, lie=all_lie)
    assert not site.is_used
    ended_s = site.t_s
    while not site.is_used:
        site.step()
        assert site.t_s < ended_s + 1800.0
    assert site.t_s - ended_s >= CONSISTENT_S


def test_a_mute_desk_is_not_used_any_more() -> None:
    site = Site()
    site.until(300.0)
    silent_from_s = site.t_s
    while site.is_used:
        site.step(hears=False)
    assert SILENT_S < site.t_s - silent_from_s <= SILENT_S + 10.0
    assert site.fleet.unused_reason == "silent"
    site.step()
    assert site.is_used, "who tells again is used again"


def test_a_frozen_desk_is_not_used_any_more() -> None:
    site = Site()
    site.until(300.0)
    frozen = {name: site.detections() for name in OTHERS}
    site.until(380.0, lie=lambda name, t_s, wind: frozen[name])
    assert set(site.fleet.rejected) == set(OTHERS)
    assert all("the same wind" in why for why in site.fleet.rejected.values())
    site.until(1300.0, lie=lambda name, t_s, wind: frozen[name])
    assert not site.is_used
    assert site.fleet.unused_reason == "no other member accepted"


def test_with_too_little_of_ones_own_wind_nobody_is_used() -> None:
    site = Site()
    site.step()
    site.step()
    assert not site.is_used
    assert "too few" in site.fleet.unused_reason
    site.until(60.0)
    assert site.is_used


def test_a_clock_that_goes_back_begins_anew() -> None:
    site = Site()
    site.until(300.0)
    site.t_s = 0.0
    site.step()
    assert not site.is_used
    site.until(60.0)
    assert site.is_used


def test_nobody_can_tell_in_the_vehicles_own_name() -> None:
    site = Site()
    site.until(300.0)
    own = MemberWindReport(OWN, site.t_s + 10.0, (0.0, 0.0), 40.0, (20.0, 0.0), COV)
    site.fleet.add_reports_and_front_of_desk([own], None, site.t_s + 10.0)
    site.until(END_S)
    shared = site.fleet.joint_field_or_none(site.t_s)
    assert shared is not None
    here = FieldPoints(np.zeros((1, 2)), np.array([40.0]), np.array([site.t_s]))
    assert shared.forecast_at_points(here).mean_to_ne_mps[0, 0] < -4.0


@pytest.mark.parametrize("waits_s", [0.0, 120.0, 500.0])
def test_a_front_is_forgotten_once_it_is_overdue(waits_s: float) -> None:
    fleet = FleetWind(FieldProcess(COAST))
    felt = WindChange("d2", 100.0, (0.0, -1000.0), (0.0, 8.0), (0.0, 14.0), 60.0)
    front = made_front(100.0, felt)
    fleet.add_reports_and_front_of_desk([], front, 100.0)
    due_s, std_s = front.arrival_time_and_std_s((0.0, 0.0))
    assert due_s == pytest.approx(100.0 + 1000.0 / 10.5, abs=1.0)  # 0.75 of 14 m/s
    now_s = 100.0 + waits_s
    assert (fleet.expected_front_after_dropping_expired(now_s, (0.0, 0.0)) is front) == (
        now_s <= due_s + 2.0 * std_s
    )
