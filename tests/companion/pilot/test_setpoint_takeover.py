"""Set-points near neighbours: their mission items, the commanded motion, the evaluation."""

import numpy as np
import pytest

from companion.core.base.geo import Obstacle, ObstacleMap
from companion.core.mission.mission_items import (
    ItemKind,
    MissionPosition,
    build_return_by_default_mission,
)
from companion.core.separation.separation_filter import SeparationFilter
from companion.core.separation.setpoint_motion import (
    FLEET_SEPARATION,
    Motion,
    braking_velocity_to_point_ned_mps,
)
from companion.core.separation.track import Track
from companion.core.separation.traffic_tracks import NeighbourTracks
from companion.fleet.messages import Refused, decode_message, encode_message
from sim_bridge.app.crossing.judge import find_minimum_separation
from tests.sim_bridge.app.day.test_judge import track


def mission(aside_s):
    spots = [MissionPosition(55.0 + 0.001 * k, 8.0, 40.0) for k in range(6)]
    return build_return_by_default_mission(
        landing_position=MissionPosition(55.0, 8.0, 0.0),
        outbound=spots[1:3],
        drop_position=spots[3],
        returning=[spots[3], spots[2], spots[0]],
        return_entry_by_outbound=[2, 1],
        rally_overhead_and_ground=[(spots[4], spots[5])],
        settle_hover_s=10.0,
        customer_hold_s=6.0,
        loaded_hover_s=5.0,
        release_hover_s=5.0,
        home_speed_mps=8.0,
        setpoint_timeout_s=aside_s,
    )


def test_every_place_on_the_way_has_set_points_that_lead_back_to_it():
    flown = mission(10.0)
    targets = {k for k, _ in flown.setpoint_items}
    assert targets == {
        *flown.outbound,
        *flown.rally[0],
        flown.deliver,
        *flown.returning,
        flown.land,
    }
    for target, first in flown.setpoint_items:
        limit, aside, on = flown.items[first : first + 3]
        assert (limit.kind, limit.value) == (ItemKind.ASIDE_LIMIT, 10.0)
        assert aside.kind is ItemKind.ASIDE
        assert (on.kind, on.value) == (ItemKind.JUMP, float(target))
        assert [flown.resolve_setpoint_item_target(first + k) for k in range(3)] == [target] * 3
        assert flown.is_setpoint_item(first + 1)
        assert not flown.is_setpoint_item(first + 2)


def test_nobody_comes_to_set_points_who_was_not_sent_there():
    """Follow the mission from each item as the autopilot does: no path leads into set-points."""
    flown = mission(10.0)
    aside = {first + k for _, first in flown.setpoint_items for k in (0, 1)}
    for start in set(range(len(flown.items))) - aside:
        index, steps = start, 0
        while index < len(flown.items) and steps < 200:
            assert index not in aside, f"from {start} into {index}"
            item = flown.items[index]
            if item.kind is ItemKind.LAND:
                break
            index = int(item.value) if item.kind is ItemKind.JUMP else index + 1
            steps += 1


def test_a_mission_without_set_points_is_what_it_was():
    with_them, without = mission(10.0), mission(None)
    kept = [item.label for item in with_them.items if item.part.value != "set-points"]
    assert kept == [item.label for item in without.items]
    assert without.first_setpoint_item_of_target(without.land) is None


def test_the_wish_can_stop_at_its_place():
    """Braking from v takes v^2 / 2a, which must not exceed the distance to the goal."""
    for away_m in (0.5, 5.0, 20.0, 200.0):
        speed = np.linalg.norm(
            braking_velocity_to_point_ned_mps(
                (0.0, 0.0, -40.0), (away_m, 0.0, -40.0), 8.0, FLEET_SEPARATION
            )
        )
        assert speed <= 8.0
        assert speed**2 / (2.0 * FLEET_SEPARATION.accel_mps2) <= away_m


def test_what_is_told_between_ticks_is_uniformly_accelerated():
    motion = Motion.from_initial_and_final_velocity(
        10.0, np.zeros(3), np.array([4.0, 0, 0]), np.array([5.0, 0, 0]), FLEET_SEPARATION
    )
    pos, vel, accel = motion.pos_vel_accel_at(10.1, FLEET_SEPARATION)
    assert (pos[0], vel[0], accel[0]) == pytest.approx((0.425, 4.5, 5.0))  # v t + a t^2 / 2
    pos, vel, accel = motion.pos_vel_accel_at(
        10.4, FLEET_SEPARATION
    )  # a late tick: constant velocity after the end
    assert (pos[0], vel[0], accel[0]) == pytest.approx((0.9 + 1.0, 5.0, 0.0))


def test_a_track_that_lies_about_numbers_is_refused():
    good = Track(
        vehicle="d1",
        gnss_s=1.8e9,
        lat_deg=55.0,
        lon_deg=8.0,
        alt_amsl_m=50.0,
        vel_n_mps=1.0,
        vel_e_mps=0.0,
        vel_d_mps=0.0,
        pos_std_m=2.0,
        alt_std_m=0.7,
        vel_std_mps=0.1,
    )
    raw = encode_message(good)
    assert decode_message(Track, raw) == good
    for wrong in (
        raw.replace(b"55.0", b"155.0"),
        raw.replace(b'"vel_n_mps":1.0', b'"vel_n_mps":1e999'),
        raw.replace(b'"pos_std_m":2.0', b'"pos_std_m":-2.0'),
        raw[:-1],
        b" " * 2000,
    ):
        assert isinstance(decode_message(Track, wrong), Refused)


def test_the_judge_sees_a_meeting_between_two_of_its_rows():
    """Two that swap positions within a step meet half way; both ends are 8 m apart."""
    t_s, ends = np.array([0.0, 0.2]), np.array([(0.0, 0.0, -40.0), (8.0, 0.0, -40.0)])
    one, other = track(t_s, ends), track(t_s, ends[::-1])
    near = find_minimum_separation([one, other])
    assert near is not None
    assert near.separations == pytest.approx(0.0, abs=1e-9)
    near = find_minimum_separation([one, track(t_s, ends[::-1] - [0.0, 0.0, 5.5])])
    assert near is not None
    assert near.separations == pytest.approx(5.5 / 5.0)  # 4 m of height and a span of 1 m


def test_who_stands_on_the_ground_is_near_to_nobody():
    t_s = np.array([0.0, 0.2])
    one, other = track(t_s, np.zeros((2, 3))), track(t_s, np.ones((2, 3)), airborne=np.zeros(2))
    assert find_minimum_separation([one, other]) is None


def test_near_neighbours_a_building_is_stopped_before_as_well():
    """A house 30 m ahead, 20 m deep and 50 m high; the requested velocity of 8 m/s crosses it."""
    house = Obstacle("house", ((30.0, -40.0), (50.0, -40.0), (50.0, 40.0), (30.0, 40.0)), 50.0)
    site = ObstacleMap((house,), clearance_m=15.0, clearance_up_m=8.0)
    points = np.array([[0.0, 0.0, -40.0], [40.0, 0.0, -40.0], [60.0, 0.0, -40.0], [0, 0, -60.0]])
    assert site.distance_to_nearest_outline_m(points) == pytest.approx([30.0, 0.0, 10.0, np.inf])

    nobody = NeighbourTracks(FLEET_SEPARATION).to_separation_filter_input(0.0)
    pos, vel, wish = np.array([[0.0, 0.0, -40.0]]), np.zeros((1, 3)), np.array([[8.0, 0.0, 0.0]])
    for _ in range(150):
        then = SeparationFilter(FLEET_SEPARATION).nearest_safe_velocities(
            pos,
            vel,
            wish,
            nobody,
            np.array([-40.0]),
            lambda points, _: site.distance_to_nearest_outline_m(points),
        )
        pos = pos + 0.5 * FLEET_SEPARATION.tick_s * (vel + then.vel_ned_mps)
        vel = then.vel_ned_mps
        assert site.distance_to_nearest_outline_m(pos)[0] >= FLEET_SEPARATION.obstacle_m
