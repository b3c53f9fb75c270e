"""Waypoint height: PX4 accepts a waypoint only within NAV_MC_ALT_RAD of its height.

From PX4's source (mission_block.cpp, is_mission_item_reached; PositionSmoothing.cpp, which controls
height and track separately since pull request 27607 and passed a waypoint before 27733 and 28374;
PX4 issue 27730), and observed on SIH at 83c4f4e580: docs/reference/autopilots.md.
"""

import math

import pytest

from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.kinds import AutopilotKind

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
WAYPOINT, LOITER_TIME, LAND, TAKEOFF = 16, 19, 21, 22
CRUISE_MPS, SINK_MPS = 10.0, 1.5
PACES = {
    PX4: {"MPC_XY_CRUISE": CRUISE_MPS, "MPC_Z_V_AUTO_DN": SINK_MPS},
    AP: {"WPNAV_SPEED": 100.0 * CRUISE_MPS, "WPNAV_SPEED_DN": 100.0 * SINK_MPS},
}


def sinking(airborne, autopilot, sink_m, **settings):
    """Fly 60 m level at 10 m/s, 80 m with a descent of `sink_m`, then level, then land."""
    rig = airborne(autopilot, {**PACES[autopilot], **settings}, height_m=40.0)
    low_m = 40.0 - sink_m
    rig.upload(
        [
            rig.place(WAYPOINT, 60, 0, 40),
            rig.place(WAYPOINT, 140, 0, low_m),
            rig.place(WAYPOINT, 220, 0, low_m),
            rig.place(WAYPOINT, 300, 0, low_m),
            rig.place(LAND, 300, 0, 0),
        ]
    )
    rig.set_mode(Mode.AUTO)
    return rig


def test_px4_does_not_slow_for_a_slope_and_arducopter_does(airborne):
    heights_m = {}
    for autopilot in (PX4, AP):
        rig = sinking(airborne, autopilot, 20.0)
        assert rig.until(lambda rig=rig: rig.ne_m[0] > 110.0, 60.0)
        heights_m[autopilot] = rig.height_m
        if autopilot is PX4:
            assert rig.speed_mps > 0.9 * CRUISE_MPS
        else:
            assert rig.speed_mps < 0.8 * CRUISE_MPS
    # half way the line is at 30 m; 5 s at 1.5 m/s are 7.5 m, less the start of the descent
    assert heights_m[AP] < heights_m[PX4] < 40.0
    assert heights_m[PX4] == pytest.approx(40.0 - 0.5 * 20.0, abs=5.0)


@pytest.mark.sample
def test_px4_that_passes_a_waypoint_out_of_height_flies_on_in_its_mission(airborne):
    # flown on SIH: past a waypoint 4 m too high, and 2 km on
    rig = sinking(airborne, PX4, 20.0)
    assert rig.until(lambda: rig.ne_m[0] > 900.0, 240.0)
    assert rig.ap.executor.index == 1
    assert rig.ap.mode is Mode.AUTO
    rig.command(512, 42)
    assert rig.last("MISSION_CURRENT").seq == 1
    assert abs(rig.ne_m[1]) < 5.0
    assert rig.height_m == pytest.approx(20.0, abs=1.0)  # by now it is within the height tolerance
    assert rig.speed_mps > 2.0
    rig.send("MISSION_SET_CURRENT", seq=2)  # only the current item is wrong
    assert rig.until(lambda: rig.ap.executor.index == 4, 200.0)


def test_px4_that_is_slow_enough_comes_back_to_the_waypoint_and_takes_it(airborne):
    rig = sinking(airborne, PX4, 38.0, MPC_XY_CRUISE=4.0)
    furthest_m = 0.0
    while rig.ap.executor.index < 2:
        rig.step(0.2)
        furthest_m = max(furthest_m, rig.ne_m[0])
    assert 141.0 < furthest_m < 150.0  # beyond the waypoint, but within its radius
    assert rig.until(lambda: rig.ap.state.is_landed, 300.0)
    assert rig.ne_m == pytest.approx((300.0, 0.0), abs=3.0)


def test_px4_hovers_at_a_waypoint_where_it_stops_until_it_is_in_height(airborne):
    rig = airborne(PX4, PACES[PX4], height_m=40.0)
    rig.upload([rig.place(WAYPOINT, 40, 0, 20, param1=3.0), rig.place(WAYPOINT, 80, 0, 20)])
    rig.set_mode(Mode.AUTO)
    assert rig.until(lambda: math.dist(rig.ne_m, (40.0, 0.0)) < 2.0, 30.0)
    assert rig.height_m > 25.0
    while not rig.all("MISSION_ITEM_REACHED"):
        assert math.dist(rig.ne_m, (40.0, 0.0)) < 5.0
        rig.step(0.1)
    assert rig.height_m == pytest.approx(20.0, abs=1.0)


@pytest.mark.parametrize("allowed_m", [0.8, 3.0, 10.0])
def test_px4_counts_a_hold_from_where_the_height_is_near_enough(airborne, allowed_m):
    """The release of the parcel after the hold depends on this."""
    rig = airborne(PX4, {**PACES[PX4], "NAV_MC_ALT_RAD": allowed_m}, height_m=40.0)
    rig.upload(
        [rig.place(WAYPOINT, 0, 0, 20, param1=5.0, param2=2.0), rig.place(WAYPOINT, 80, 0, 20)]
    )
    rig.set_mode(Mode.AUTO)
    assert rig.until(lambda: rig.ap.executor.index == 1, 60.0)
    sunk_m = SINK_MPS * 5.0  # in the five seconds of the hold, at most
    assert rig.height_m - 20.0 == pytest.approx(max(allowed_m - sunk_m, 0.0), abs=1.0)


@pytest.mark.parametrize("allowed_m", [0.8, 3.0])
def test_px4_calls_a_take_off_done_that_far_below_its_height(make_rig, allowed_m):
    rig = make_rig(PX4, {"NAV_MC_ALT_RAD": allowed_m})
    rig.step(0.2)
    rig.gcs_heartbeat()
    rig.upload([rig.place(TAKEOFF, 0, 0, 20), rig.place(LOITER_TIME, 0, 0, 20, param1=20.0)])
    rig.set_mode(Mode.AUTO)
    assert rig.command(400, 1) == 0
    assert rig.until(lambda: rig.ap.executor.index == 1, 60.0)
    assert 20.0 - rig.height_m == pytest.approx(allowed_m, abs=0.6)
    rig.step(10.0)
    assert rig.height_m == pytest.approx(20.0, abs=0.7)
