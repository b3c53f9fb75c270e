"""Whole flights in both autopilots: a mission, and the dead man's mission (safety rule 2)."""

import math

import pytest

from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.kinds import AutopilotKind

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
BOTH = pytest.mark.parametrize("autopilot", [AP, PX4])
SETTINGS = {
    AP: {"AUTO_OPTIONS": 3, "GRIP_ENABLE": 1},
    PX4: {},
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


SET_HOME, GLOBAL = 179, 0


def begin(rig, items):
    """Upload and start a mission on the ground by the autopilot's own procedure."""
    rig.step(0.2)
    assert rig.upload(items) == 0
    assert rig.set_mode(Mode.AUTO) == 0
    assert rig.command(400, 1) == 0


def fly_on(rig, limit_s=400.0, watch=lambda: None):
    """Advance until disarmed, or to the limit."""
    for _ in range(round(limit_s / 0.5)):
        rig.step(0.5)
        watch()
        if not rig.ap.is_armed:
            return
    raise AssertionError(f"still armed: {rig.ap.mode} item {rig.ap.executor.index} {rig.ne_m}")


@pytest.mark.sample
@BOTH
def test_a_mission_from_takeoff_to_landing_with_a_jump(make_rig, autopilot):
    rig = make_rig(autopilot, SETTINGS[autopilot], payload_kg=0.5)
    shift = 1.0 if autopilot is AP else 0.0
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
    """A dead man's mission (docs/explanation/dead-mans-mission.md): item numbers as uploaded.

    Two outbound waypoints at 60 and 120 m east, the customer at 180 m, back by a lane 40 m north.
    """

    def __init__(self, rig, autopilot, *, goes_on=False):
        shift = 1.0 if autopilot is AP else 0.0
        home = {"command": SPEED, "frame": 2, "param1": 1.0, "param2": 6.0}

        def jump(to):
            return {"command": JUMP, "frame": 2, "param1": to + shift, "param2": 100.0}

        ret = 15
        # a LAND that an item with a position could follow jumps to the end, which has none
        self.items = [
            rig.place(TAKEOFF, 0, 0, 15),  # 0
            rig.place(LOITER_TIME, 0, 0, 15, param1=3.0),  # 1
            home,  # 2
            jump(ret + 3),  # 3: without a go command
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
            rig.place(LAND, 0, 0, 0),  # 19
            home if goes_on else jump(23),  # 20
            rig.place(WAYPOINT, 40, 120, 15),  # 21: rally
            rig.place(LAND, 40, 120, 0),  # 22
            home,  # 23: the end
        ]
        self.first = int(shift)

    def go(self, rig, to):
        """Jump onward, as a live companion does."""
        if rig.autopilot is AP:
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
def test_a_dead_mans_mission_that_nobody_lets_go_lands_at_the_depot(make_rig, autopilot):
    rig = make_rig(autopilot, SETTINGS[autopilot], payload_kg=0.5)
    mission = DeadMan(rig, autopilot)
    begin(rig, mission.items)
    seen, watch = farthest(rig)
    fly_on(rig, 200.0, watch)
    assert math.hypot(*rig.ne_m) < 3.0
    assert seen[0] < 5.0
    assert rig.vehicle.truth.parcel_aboard


@pytest.mark.sample
@BOTH
def test_a_dead_mans_mission_whose_companion_lives_delivers_and_comes_home(make_rig, autopilot):
    rig = make_rig(autopilot, SETTINGS[autopilot], payload_kg=0.5)
    mission = DeadMan(rig, autopilot)
    begin(rig, mission.items)
    assert rig.until(lambda: mission.at(rig) == 1, 60.0)
    mission.go(rig, 4)
    slowest = []
    for at, to, onward_m in ((4, 7, 45.0), (7, 10, 105.0)):
        assert rig.until(lambda e=onward_m: rig.ne_m[1] > e, 60.0)
        assert mission.at(rig) == at
        mission.go(rig, to)
        for _ in range(40):
            rig.step(0.1)
            slowest.append(rig.speed_mps)
    # straight on: PX4 continues at 5 m/s, ArduCopter brakes to 0.29 of its 10 m/s, or of less
    assert min(slowest) > (4.5 if autopilot is PX4 else 1.5)
    assert rig.until(lambda: rig.ne_m[1] > 172.0, 60.0)
    mission.go(rig, 13)
    fly_on(rig, 300.0)
    assert not rig.vehicle.truth.parcel_aboard
    assert math.hypot(*rig.ne_m) < 3.0


def watched(rig, step_s=0.1, limit_s=120.0):
    """Advance; return the times of landing and of the next lift-off or disarming."""
    assert rig.until(lambda: not rig.ap.state.is_landed, limit_s)
    while not rig.ap.state.is_landed:
        rig.step(step_s)
    landed_s = rig.ap.t_s
    while rig.ap.is_armed and rig.ap.state.is_landed and rig.ap.t_s - landed_s < 20.0:
        rig.step(step_s)
    return landed_s, rig.ap.t_s


def test_px4_takes_off_again_after_a_landing_that_the_mission_goes_on_from(make_rig):
    # flown on PX4 1.18 SIH: no disarming, off the ground again 0.9 s after it has landed
    rig = make_rig(PX4, SETTINGS[PX4], payload_kg=0.5)
    mission = DeadMan(rig, PX4, goes_on=True)
    begin(rig, mission.items)
    landed_s, off_s = watched(rig, 0.02)
    assert mission.at(rig) == 21
    assert rig.ap.is_armed
    assert off_s - landed_s == pytest.approx(0.9, abs=0.25)
    rig.step(4.0)
    assert rig.height_m > 2.0


@pytest.mark.sample
@BOTH
@pytest.mark.parametrize("order", [Mode.RTL, Mode.LAND])
def test_px4_leaves_rtl_and_land_as_it_disarms_and_arducopter_stays(make_rig, autopilot, order):
    # flown: PX4 1.18 SIH resumes its mission in the same second, ArduCopter 4.7 stays in RTL
    rig = make_rig(autopilot, SETTINGS[autopilot])
    begin(rig, [rig.place(TAKEOFF, 0, 0, 5), rig.place(WAYPOINT, 0, 60, 5)])
    assert rig.until(lambda: rig.ne_m[1] > 20.0, 60.0)
    assert rig.set_mode(order) == 0
    fly_on(rig)
    rig.step(1.0)
    assert rig.ap.mode is (order if autopilot is AP else Mode.AUTO)


@pytest.mark.sample
@BOTH
def test_an_rtl_right_after_set_home_leads_to_the_new_home(make_rig, autopilot):
    # flown on both: a stop 92 m from the launch pad, the return command in the same tick
    rig = make_rig(autopilot, SETTINGS[autopilot])
    begin(rig, [rig.place(TAKEOFF, 0, 0, 20), rig.place(WAYPOINT, 0, 150, 20)])
    assert rig.until(lambda: rig.ne_m[1] > 90.0, 60.0)
    home_amsl_m = rig.ap.state.frame.alt_amsl_m
    assert rig.send_command_int_and_wait_ack(SET_HOME, GLOBAL, 60.0, 30.0, home_amsl_m) == 0
    assert rig.set_mode(Mode.RTL) == 0
    fly_on(rig)
    assert math.dist(rig.ne_m, (60.0, 30.0)) < 3.0


@BOTH
def test_the_last_landing_disarms_at_once(make_rig, autopilot):
    # flown: ArduCopter 0.4 s after landed; PX4 0.1 s, and 0.02 to 0.04 s in its own log
    rig = make_rig(autopilot, SETTINGS[autopilot])
    begin(rig, [rig.place(TAKEOFF, 0, 0, 5), rig.place(LAND, 0, 0, 0)])
    landed_s, disarmed_s = watched(rig, 0.02)
    assert not rig.ap.is_armed
    assert disarmed_s - landed_s == pytest.approx(0.1 if autopilot is PX4 else 0.4, abs=0.11)


def test_px4_goes_round_a_landing_that_jumps_back_to_itself_and_stays_armed(make_rig):
    # flown on PX4 1.18 SIH: about 20 jumps a second until the repeats are used up, then on
    rig = make_rig(PX4, SETTINGS[PX4])
    begin(
        rig,
        [
            rig.place(TAKEOFF, 0, 0, 5),
            rig.place(LAND, 0, 0, 0),
            {"command": JUMP, "frame": 2, "param1": 1.0, "param2": 100.0},
            rig.place(WAYPOINT, 0, 0, 6),
        ],
    )
    rig.DT_S = 0.01
    landed_s, off_s = watched(rig, 0.01)
    assert rig.ap.executor.plan.jumps_done[2] == 100
    assert off_s - landed_s == pytest.approx(100 / 20.0 + 0.9, abs=0.4)
    assert rig.ap.is_armed
    assert rig.until(lambda: rig.height_m > 5.0, 30.0)


def test_px4_never_disarms_at_a_landing_that_it_may_not_go_on_from(make_rig):
    # mission_base.cpp, on_active: without autocontinue the mission is never finished
    rig = make_rig(PX4, SETTINGS[PX4])
    begin(rig, [rig.place(TAKEOFF, 0, 0, 5), rig.place(LAND, 0, 0, 0, autocontinue=0)])
    landed_s, later_s = watched(rig)
    assert later_s - landed_s == pytest.approx(20.0, abs=0.2)
    assert rig.ap.is_armed
    assert rig.ap.state.is_landed


def test_px4_that_was_in_another_mode_waits_its_two_seconds_before_it_disarms(make_rig):
    # Commander.cpp, handleAutoDisarm: COM_DISARM_LAND, its timer restarted in that mode's flight
    rig = make_rig(PX4, SETTINGS[PX4])
    begin(rig, [rig.place(TAKEOFF, 0, 0, 8), rig.place(LAND, 0, 0, 0)])
    assert rig.until(lambda: rig.height_m > 4.0, 30.0)
    rig.set_mode(Mode.HOLD)
    rig.step(1.0)
    rig.set_mode(Mode.AUTO)
    landed_s, disarmed_s = watched(rig)
    assert not rig.ap.is_armed
    assert disarmed_s - landed_s == pytest.approx(2.0, abs=0.3)


@BOTH
def test_headwind_near_the_limit_saturates_the_tilt_and_slows_the_flight(make_rig, autopilot):
    rig = make_rig(autopilot, {**SETTINGS[autopilot]}, wind_to_ne_mps=(-14.0, 0.0))
    rig.ap.params.set(*(("ANGLE_MAX", 1500) if autopilot is AP else ("MPC_TILTMAX_AIR", 15.0)))
    rig.take_off(10.0)
    rig.upload([rig.place(WAYPOINT, 300, 0, 10), rig.place(WAYPOINT, 400, 0, 10)])
    rig.set_mode(Mode.AUTO)
    rig.step(20.0)
    assert rig.vehicle.truth.vel_ned_mps[0] < 0.75 * rig.ap.current_cruise_speed_mps


def test_set_points_in_a_mission_end_by_themselves_as_arducopters_do(make_rig):
    """ArduCopter 4.7-dev, its own SITL: entered by a jump at speed it stays in AUTO and obeys; ten
    seconds (DO_GUIDED_LIMITS) after the last command to this item the mission continues with the
    next; set-points at another item change nothing."""
    rig = make_rig(AP, SETTINGS[AP], payload_kg=0.0)
    begin(
        rig,
        [
            rig.place(TAKEOFF, 0, 0, 15),
            rig.place(WAYPOINT, 200, 0, 15),
            {"command": 222, "frame": 2, "param1": 10.0},
            {"command": 92, "frame": 2, "param1": 1.0},
            {"command": JUMP, "frame": 2, "param1": 2.0, "param2": 9.0},
            rig.place(LAND, 0, 0, 0),
        ],
    )
    ap = rig.ap
    assert rig.until(lambda: ap.executor.index == 2 and rig.ne_m[0] > 30.0, 60.0)

    names = ("time_boot_ms", "x", "y", "z", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    unsaid = dict.fromkeys(names, 0)

    def fly(north_mps, east_mps, for_s):
        for _ in range(round(for_s / 0.2)):
            rig.send(
                "SET_POSITION_TARGET_LOCAL_NED",
                **unsaid,
                target_system=1,
                target_component=1,
                coordinate_frame=1,
                type_mask=0b110000000111,
                vx=north_mps,
                vy=east_mps,
            )
            rig.step(0.2)

    fly(0.0, 4.0, 1.0)
    assert abs(ap.state.vel_ned_mps[1]) < 0.5
    assert rig.command(224, 3.0) == 0
    fly(0.0, 4.0, 6.0)
    assert ap.mode is Mode.AUTO
    assert ap.state.vel_ned_mps[:2] == pytest.approx((0.0, 4.0), abs=0.6)
    assert rig.command(224, 3.0) == 0  # requested again: ten seconds more
    renewed_s = ap.t_s
    fly(0.0, 4.0, 8.0)
    assert ap.executor.index == 4  # the item of set-points
    assert rig.until(lambda: ap.executor.index == 2, 6.0)
    assert ap.t_s - renewed_s == pytest.approx(10.0, abs=0.3)
    east_m = rig.ne_m[1]
    rig.step(5.0)
    assert ap.state.vel_ned_mps[0] > 2.0
    assert rig.ne_m[1] < east_m + 10.0
