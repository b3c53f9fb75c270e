"""Whole flights in both flavours: a mission, and the dead man's mission of ARCHITECTURE.md."""

import math

import pytest

from sim_bridge.autopilot.flavour import Flavour
from sim_bridge.autopilot.modes import Mode

AP, PX4 = Flavour.ARDUPILOT, Flavour.PX4
BOTH = pytest.mark.parametrize("flavour", [AP, PX4])
SETTINGS = {
    AP: {"AUTO_OPTIONS": 3, "GRIP_ENABLE": 1},
    PX4: {"PD_GRIPPER_EN": 1},
}
TAKEOFF, WAYPOINT, LOITER_TIME, LAND, JUMP, SPEED, DELAY, GRIPPER = (
    22,
    16,
    19,
    21,
    177,
    178,
    93,
    211,
)


def begin(rig, items):
    """Upload and start, the way that each autopilot starts a mission on the ground."""
    rig.step(0.2)
    assert rig.upload(items) == 0
    assert rig.set_mode(Mode.AUTO) == 0
    assert rig.command(400, 1) == 0


def fly_on(rig, limit_s=400.0, watch=lambda: None):
    """Until disarmed, or the limit."""
    for _ in range(round(limit_s / 0.5)):
        rig.step(0.5)
        watch()
        if not rig.ap.is_armed:
            return
    raise AssertionError(f"still armed: {rig.ap.mode} item {rig.ap.executor.index} {rig.ne_m}")


@BOTH
def test_a_mission_from_takeoff_to_landing_with_a_jump(make_rig, flavour):
    rig = make_rig(flavour, SETTINGS[flavour], payload_kg=0.5)
    shift = 1.0 if flavour is AP else 0.0
    begin(
        rig,
        [
            rig.place(TAKEOFF, 0, 0, 15),
            {"command": SPEED, "frame": 2, "param1": 1.0, "param2": 7.0},
            rig.place(WAYPOINT, 50, 0, 15),
            rig.place(WAYPOINT, 50, 50, 15),
            {"command": JUMP, "frame": 2, "param1": 2.0 + shift, "param2": 1.0},
            rig.place(WAYPOINT, 0, 50, 20),
            {"command": GRIPPER, "frame": 2, "param1": 1.0},
            {"command": DELAY, "frame": 2, "param1": 2.0},
            rig.place(LAND, 0, 0, 0),
        ],
    )
    fly_on(rig)
    truth = rig.vehicle.truth
    assert math.hypot(*rig.ne_m) < 3.0
    assert not truth.motors_failed
    assert not truth.parcel_aboard
    seqs = list(dict.fromkeys(m.seq for m in rig.all("MISSION_ITEM_REACHED")))
    corners = [2 + int(shift), 3 + int(shift), 5 + int(shift)]
    assert [seq for seq in seqs if seq in corners] == corners
    second = [m.seq for m in rig.all("MISSION_ITEM_REACHED") if m.seq == 3 + int(shift)]
    assert len(second) >= 2


class DeadMan:
    """The layout of ARCHITECTURE.md, "The mission aboard": item numbers as uploaded.

    Two outbound waypoints at 60 and 120 m east, the customer at 180 m, back by a lane 40 m north.
    """

    def __init__(self, rig, flavour, autocontinue=1):
        shift = 1.0 if flavour is AP else 0.0
        home = {"command": SPEED, "frame": 2, "param1": 1.0, "param2": 6.0}

        def jump(to):
            return {"command": JUMP, "frame": 2, "param1": to + shift, "param2": 100.0}

        def land(n, e):
            return rig.place(LAND, n, e, 0, autocontinue=autocontinue)

        ret = 15
        self.items = [
            rig.place(TAKEOFF, 0, 0, 15),  # 0
            rig.place(LOITER_TIME, 0, 0, 15, param1=3.0),  # 1
            home,  # 2
            jump(ret + 3),  # 3: nobody says go
            rig.place(WAYPOINT, 0, 60, 15),  # 4: out 0
            home,  # 5
            jump(ret + 2),  # 6
            rig.place(WAYPOINT, 0, 120, 15),  # 7: out 1
            home,  # 8
            jump(ret + 1),  # 9
            rig.place(WAYPOINT, 0, 180, 15),  # 10: target at cruise height
            home,  # 11
            jump(ret),  # 12
            rig.place(WAYPOINT, 0, 180, 6, param1=1.0),  # 13: drop height
            {"command": GRIPPER, "frame": 2, "param1": 1.0},  # 14
            rig.place(WAYPOINT, 0, 180, 15),  # 15: ret 0, climb-out
            rig.place(WAYPOINT, 40, 120, 15),  # 16: ret 1
            rig.place(WAYPOINT, 40, 60, 15),  # 17: ret 2
            rig.place(WAYPOINT, 0, 0, 15),  # 18: over the depot
            land(0, 0),  # 19
            rig.place(WAYPOINT, 40, 120, 15),  # 20: rally
            land(40, 120),  # 21
        ]
        self.first = int(shift)

    def go(self, rig, to):
        """What a companion that is alive does: jump onward."""
        if rig.flavour is AP:
            assert rig.command(224, to + self.first) == 0
        else:
            rig.send("MISSION_SET_CURRENT", seq=to)
        assert rig.ap.executor.index == to + self.first

    def at(self, rig):
        return rig.ap.executor.index - self.first


def farthest(rig):
    seen = [0.0]

    def watch():
        seen[0] = max(seen[0], rig.ne_m[1])

    return seen, watch


@BOTH
def test_a_dead_mans_mission_that_nobody_lets_go_lands_at_the_depot(make_rig, flavour):
    rig = make_rig(flavour, SETTINGS[flavour], payload_kg=0.5)
    mission = DeadMan(rig, flavour, autocontinue=0)
    begin(rig, mission.items)
    seen, watch = farthest(rig)
    fly_on(rig, 200.0, watch)
    assert math.hypot(*rig.ne_m) < 3.0
    assert seen[0] < 5.0
    assert rig.vehicle.truth.parcel_aboard


@BOTH
def test_a_dead_mans_mission_turns_home_after_the_last_waypoint_that_was_allowed(make_rig, flavour):
    rig = make_rig(flavour, SETTINGS[flavour], payload_kg=0.5)
    mission = DeadMan(rig, flavour, autocontinue=0)
    begin(rig, mission.items)
    assert rig.until(lambda: mission.at(rig) == 1, 60.0)
    mission.go(rig, 4)
    seen, watch = farthest(rig)
    fly_on(rig, 300.0, watch)
    assert 50.0 < seen[0] < 70.0
    assert math.hypot(*rig.ne_m) < 3.0
    assert rig.vehicle.truth.parcel_aboard


@BOTH
def test_a_dead_mans_mission_whose_companion_lives_delivers_and_comes_home(make_rig, flavour):
    rig = make_rig(flavour, SETTINGS[flavour], payload_kg=0.5)
    mission = DeadMan(rig, flavour, autocontinue=0)
    begin(rig, mission.items)
    assert rig.until(lambda: mission.at(rig) == 1, 60.0)
    mission.go(rig, 4)
    slowest = []
    for at, to, onward_m in ((4, 7, 45.0), (7, 10, 105.0)):
        assert rig.until(lambda e=onward_m: rig.ne_m[1] > e, 60.0)
        assert mission.at(rig) == at
        mission.go(rig, to)
        for _ in range(15):
            rig.step(0.1)
            slowest.append(rig.speed_mps)
    assert min(slowest) > 3.5  # straight ahead: no stop
    assert rig.until(lambda: rig.ne_m[1] > 172.0, 60.0)
    mission.go(rig, 13)
    fly_on(rig, 300.0)
    assert not rig.vehicle.truth.parcel_aboard
    assert math.hypot(*rig.ne_m) < 3.0


@BOTH
def test_a_closed_gate_is_one_jump_to_the_way_home(make_rig, flavour):
    rig = make_rig(flavour, SETTINGS[flavour], payload_kg=0.5)
    mission = DeadMan(rig, flavour, autocontinue=0)
    begin(rig, mission.items)
    assert rig.until(lambda: mission.at(rig) == 1, 60.0)
    mission.go(rig, 7)
    assert rig.until(lambda: rig.ne_m[1] > 80.0, 60.0)
    mission.go(rig, 17)
    seen, watch = farthest(rig)
    fly_on(rig, 300.0, watch)
    assert seen[0] < 115.0  # 80 m and the way that 10 m/s take to turn round
    assert math.hypot(*rig.ne_m) < 3.0


def test_px4_takes_off_again_after_a_landing_that_the_mission_goes_on_from(make_rig):
    # mission_base.cpp, on_active: LAND done and autocontinue set, the next item is begun
    rig = make_rig(PX4, SETTINGS[PX4], payload_kg=0.5)
    mission = DeadMan(rig, PX4, autocontinue=1)
    begin(rig, mission.items)
    assert rig.until(lambda: mission.at(rig) == 20, 120.0)
    rig.step(4.0)
    assert rig.height_m > 2.0


def test_ardupilot_stays_down_after_landing_whatever_follows(make_rig):
    # mode_auto.cpp, verify_land: landing disarms, disarming resets the mission
    rig = make_rig(AP, SETTINGS[AP], payload_kg=0.5)
    mission = DeadMan(rig, AP, autocontinue=1)
    begin(rig, mission.items)
    fly_on(rig, 200.0)
    rig.step(5.0)
    assert rig.height_m < 0.2


@BOTH
def test_headwind_near_the_limit_saturates_the_tilt_and_slows_the_flight(make_rig, flavour):
    rig = make_rig(flavour, {**SETTINGS[flavour]}, wind_to_ne_mps=(-14.0, 0.0))
    rig.ap.params.set(*(("ANGLE_MAX", 1500) if flavour is AP else ("MPC_TILTMAX_AIR", 15.0)))
    rig.take_off(10.0)
    rig.upload([rig.place(WAYPOINT, 300, 0, 10), rig.place(WAYPOINT, 400, 0, 10)])
    rig.set_mode(Mode.AUTO)
    rig.step(20.0)
    assert rig.vehicle.truth.vel_ned_mps[0] < 0.75 * rig.ap.cruise_mps()
