"""Position reports after steps that no vehicle flies are suspended until known to be right."""

import math

import pytest

from companion.core.mission.events import GnssFix, Position
from companion.core.pilot.telemetry.position_watch import PositionWatch

LAT_DEG, LON_DEG, M_PER_DEG = 55.47, 8.45, 111_195.0
SPEED_MPS, STEP_S, INTERVAL_S = 15.0, 10.0, 0.1


def accepted(north_off_m, height_off_m=lambda t_s: 0.0, gnss_off_m=None, until_s=40.0):
    """Return for each time whether the report is accepted, on a flight to the north that climbs."""
    watch, found = PositionWatch(), {}
    for k in range(round(until_s / INTERVAL_S)):
        t_s = k * INTERVAL_S
        place = SPEED_MPS * t_s
        at_deg = LAT_DEG + (place + north_off_m(t_s)) / M_PER_DEG
        height_m = 40.0 + 3.0 * t_s + height_off_m(t_s)
        report = Position(t_s, at_deg, LON_DEG, height_m, height_m, SPEED_MPS, 0.0, -3.0)
        gnss = None
        if gnss_off_m is not None:  # 0.2 s late
            late_deg = LAT_DEG + (place - 0.2 * SPEED_MPS + gnss_off_m(t_s)) / M_PER_DEG
            gnss = GnssFix(t_s, True, 12, 40.0 + 3.0 * t_s, None, (late_deg, LON_DEG))
        found[round(t_s, 1)] = watch.accepts_report(report, gnss)
    return found, watch


def during(size_m, for_s):
    return lambda t_s: size_m if STEP_S <= t_s < STEP_S + for_s else 0.0


NONE = during(0.0, 0.0)


@pytest.mark.parametrize("gnss", [NONE, None])
@pytest.mark.parametrize(("north_m", "height_m"), [(30.0, 0.0), (-300.0, 0.0), (0.0, -15.0)])
def test_a_step_suspends_reports_until_the_step_back(north_m, height_m, gnss):
    found, watch = accepted(during(north_m, 4.0), during(height_m, 4.0), gnss)
    assert all(found[t_s] is not (STEP_S <= t_s < STEP_S + 4.0) for t_s in found)
    assert watch.step_count == 2


@pytest.mark.parametrize(
    ("gnss", "is_accepted"),
    [(during(80.0, math.inf), True), (NONE, False), (None, True)],
    ids=["the receiver agrees", "the receiver contradicts", "no receiver's position"],
)
def test_a_lasting_step_is_accepted_unless_the_receiver_contradicts(gnss, is_accepted):
    found, watch = accepted(during(80.0, math.inf), gnss_off_m=gnss)
    assert not any(found[t_s] for t_s in found if STEP_S <= t_s <= STEP_S + 4.9)
    assert all(found[t_s] is is_accepted for t_s in found if t_s > STEP_S + 5.2)
    assert watch.reason == ("" if is_accepted else "position stepped by 80 m")


def test_flight_and_small_corrections_are_no_steps():
    found, watch = accepted(lambda t_s: 4.0 * (t_s // 3 % 2), lambda t_s: -3.0 * (t_s // 5 % 2))
    assert all(found.values())
    assert watch.step_count == 0
