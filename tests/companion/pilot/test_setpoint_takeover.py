"""Set-points near neighbours: the mission's items for them, the motion that is told, the judge."""

import numpy as np
import pytest

from companion.core.base.geo import Obstacle, ObstacleMap
from companion.core.mission.mission_items import ItemKind, Spot, build_dead_mans_mission
from companion.core.separation.separation_filter import SeparationFilter
from companion.core.separation.setpoint_motion import FLEET, Motion, wish_to
from companion.core.separation.track import Track
from companion.core.separation.traffic_tracks import NeighbourTracks
from companion.fleet.messages import Refused, decode_track, encode
from sim_bridge.app.crossing.judge import nearest_of, outcome_of


def mission(aside_s):
    spots = [Spot(55.0 + 0.001 * k, 8.0, 40.0) for k in range(6)]
    return build_dead_mans_mission(
        depot=Spot(55.0, 8.0, 0.0),
        outbound=spots[1:3],
        drop=spots[3],
        returning=[spots[3], spots[2], spots[0]],
        entries=[2, 1],
        rally=[(spots[4], spots[5])],
        settle_s=10.0,
        hold_s=6.0,
        weigh_s=5.0,
        delay_s=5.0,
        home_speed_mps=8.0,
        aside_s=aside_s,
    )


def test_every_place_on_the_way_has_set_points_that_lead_back_to_it():
    flown = mission(10.0)
    targets = {k for k, _ in flown.asides}
    assert targets == {
        *flown.outbound,
        *flown.rally[0],
        flown.deliver,
        *flown.returning,
        flown.land,
    }
    for target, first in flown.asides:
        limit, aside, on = flown.items[first : first + 3]
        assert (limit.kind, limit.value) == (ItemKind.ASIDE_LIMIT, 10.0)
        assert aside.kind is ItemKind.ASIDE
        assert (on.kind, on.value) == (ItemKind.JUMP, float(target))
        assert [flown.stands_for(first + k) for k in range(3)] == [target] * 3
        assert flown.is_aside(first + 1)
        assert not flown.is_aside(first + 2)


def test_nobody_comes_to_set_points_who_was_not_sent_there():
    """Walk the mission from every item as the autopilot does: no way leads into set-points."""
    flown = mission(10.0)
    aside = {first + k for _, first in flown.asides for k in (0, 1)}
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
    assert without.aside_of(without.land) is None


def test_the_wish_can_stop_at_its_place():
    """Braking from v takes v^2 / 2a: the wish never has more than its place is away."""
    for away_m in (0.5, 5.0, 20.0, 200.0):
        speed = np.linalg.norm(wish_to((0.0, 0.0, -40.0), (away_m, 0.0, -40.0), 8.0, FLEET))
        assert speed <= 8.0
        assert speed**2 / (2.0 * FLEET.accel_mps2) <= away_m


def test_what_is_told_between_ticks_is_uniformly_accelerated():
    motion = Motion.of(10.0, np.zeros(3), np.array([4.0, 0, 0]), np.array([5.0, 0, 0]), FLEET)
    pos, vel, accel = motion.at(10.1, FLEET)
    assert (pos[0], vel[0], accel[0]) == pytest.approx((0.425, 4.5, 5.0))  # v t + a t^2 / 2
    pos, vel, accel = motion.at(10.4, FLEET)  # a tick that came late: on as it ended
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
    raw = encode(good)
    assert decode_track(raw) == good
    for wrong in (
        raw.replace(b"55.0", b"155.0"),
        raw.replace(b'"vel_n_mps":1.0', b'"vel_n_mps":1e999'),
        raw.replace(b'"pos_std_m":2.0', b'"pos_std_m":-2.0'),
        raw[:-1],
        b" " * 2000,
    ):
        assert isinstance(decode_track(wrong), Refused)


def rows(*points):
    return np.array([(0.1 * k, *point, 1.0) for k, point in enumerate(points)])


def test_the_judge_sees_a_meeting_between_two_of_its_rows():
    """Two that swap places within a step meet half way; both ends are 8 m apart."""
    one = rows((0.0, 0.0, -40.0), (8.0, 0.0, -40.0))
    other = rows((8.0, 0.0, -40.0), (0.0, 0.0, -40.0))
    near = nearest_of({"a": one, "b": other})
    assert near is not None
    assert near.separations == pytest.approx(0.0, abs=1e-9)
    high = other - np.array([0.0, 0.0, 0.0, 5.5, 0.0])
    near = nearest_of({"a": one, "b": high})
    assert near is not None
    assert near.separations == pytest.approx(5.5 / 5.0)  # 4 m of height and a span of 1 m


def test_who_stands_on_the_ground_is_near_to_nobody():
    one, other = rows((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), rows((1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    other[:, 4] = 0.0
    assert nearest_of({"a": one, "b": other}) is None


@pytest.mark.parametrize(
    ("end", "released", "crashed", "outcome"),
    [
        ((1.0, 1.0), (60.0, 0.0, -15.0), False, "SUC"),
        ((1.0, 1.0), None, False, "ABRT"),
        ((60.0, 1.0), (60.0, 0.0, -15.0), False, "DEL"),
        ((1.0, 1.0), (30.0, 0.0, -15.0), False, "ABRT"),
        ((1.0, 1.0), None, True, "FAIL"),
    ],
)
def test_outcomes_are_what_truth_says(end, released, crashed, outcome):
    flown = rows((0.0, 0.0, -1.0), (50.0, 0.0, -40.0), (*end, 0.0))
    flown[-1, 4] = 0.0
    assert outcome_of(flown, (0.0, 0.0), (60.0, 0.0), released, crashed=crashed) == outcome


def test_near_neighbours_a_building_is_stopped_before_as_well():
    """A house 30 m ahead, 20 m deep and 50 m high; the wish is through it at 8 m/s."""
    house = Obstacle("house", ((30.0, -40.0), (50.0, -40.0), (50.0, 40.0), (30.0, 40.0)), 50.0)
    site = ObstacleMap((house,), clearance_m=15.0, clearance_up_m=8.0)
    points = np.array([[0.0, 0.0, -40.0], [40.0, 0.0, -40.0], [60.0, 0.0, -40.0], [0, 0, -60.0]])
    assert site.clearance_at(points) == pytest.approx([30.0, 0.0, 10.0, np.inf])

    nobody = NeighbourTracks(FLEET).at(0.0)
    pos, vel, wish = np.array([[0.0, 0.0, -40.0]]), np.zeros((1, 3)), np.array([[8.0, 0.0, 0.0]])
    for _ in range(150):
        then = SeparationFilter(FLEET).safe(
            pos, vel, wish, nobody, np.array([-40.0]), lambda points, _: site.clearance_at(points)
        )
        pos = pos + 0.5 * FLEET.tick_s * (vel + then.vel_ned_mps)
        vel = then.vel_ned_mps
        assert site.clearance_at(pos)[0] >= FLEET.obstacle_m
