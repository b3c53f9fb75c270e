"""The mission protocol of each autopilot (docs/reference/autopilots.md)."""

import math

import pytest

from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mission.executor import Phase as LegPhase
from sim_bridge.autopilot.mission.items import NO_COORDINATE

PAUSE_CONTINUE, REQUEST_MESSAGE = 193, 512

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
BOTH = pytest.mark.parametrize("autopilot", [AP, PX4])
WAYPOINT, LAND, TAKEOFF, JUMP, SPEED, DELAY, GRIPPER = 16, 21, 22, 177, 178, 93, 211
MISSION_FRAME = 2
ACCEPTED, ERROR, UNSUPPORTED_FRAME, UNSUPPORTED, NO_SPACE = 0, 1, 2, 3, 4
INVALID_SEQUENCE, DENIED = 13, 14


def simple(rig, height_m=20.0):
    """Take off, three waypoints, land."""
    return [
        rig.place(TAKEOFF, 0, 0, height_m),
        rig.place(WAYPOINT, 60, 0, height_m),
        rig.place(WAYPOINT, 120, 0, height_m),
        rig.place(WAYPOINT, 180, 0, height_m),
        rig.place(LAND, 180, 0, 0),
    ]


def started(rig):
    rig.step(0.2)
    return rig


@pytest.mark.parametrize(
    ("autopilot", "item", "result"),
    [
        (AP, {"command": 9999}, UNSUPPORTED),
        (AP, {"command": WAYPOINT, "frame": 1}, UNSUPPORTED_FRAME),
        (AP, {"command": WAYPOINT, "param1": math.nan}, 6),
        (AP, {"command": WAYPOINT, "x": 950_000_000}, 10),
        (AP, {"command": WAYPOINT, "y": 1_900_000_000}, 11),
        (AP, {"command": WAYPOINT, "z": 1e9}, 12),
        (AP, {"command": 113}, UNSUPPORTED),
        (PX4, {"command": 9999}, UNSUPPORTED),
        (PX4, {"command": WAYPOINT, "frame": 10}, UNSUPPORTED_FRAME),
        (PX4, {"command": SPEED, "frame": 6}, UNSUPPORTED),
        (PX4, {"command": JUMP, "frame": 3}, UNSUPPORTED),
        (PX4, {"command": 183, "frame": 2}, UNSUPPORTED),
        (PX4, {"command": 115, "frame": 2}, UNSUPPORTED),
    ],
)
def test_what_an_autopilot_cannot_fly_it_refuses_by_number(make_rig, autopilot, item, result):
    rig = started(make_rig(autopilot))
    assert rig.upload([item]) == result


@BOTH
def test_an_item_out_of_turn_does_not_end_an_upload(make_rig, autopilot):
    rig = started(make_rig(autopilot))
    items = simple(rig)
    if autopilot is AP:
        items = [{}, *items]
    rig.send("MISSION_COUNT", count=len(items))
    rig.send_item(0, items[0])
    rig.forget()
    rig.send_item(3, items[3])
    acks = [m.type for m in rig.hear() if m.msg_name == "MISSION_ACK"]
    assert acks == ([INVALID_SEQUENCE] if autopilot is AP else [])
    for seq in range(1, len(items)):
        rig.send_item(seq, items[seq])
    assert rig.last("MISSION_ACK").type == ACCEPTED


@BOTH
def test_an_item_that_got_lost_is_asked_for_again(make_rig, autopilot):
    rig = started(make_rig(autopilot))
    rig.send("MISSION_COUNT", count=3)
    rig.forget()
    rig.step(1.3)
    assert any("REQUEST" in m.msg_name and m.seq == 0 for m in rig.hear())


@BOTH
def test_an_upload_that_stops_is_given_up_and_can_begin_again(make_rig, autopilot):
    rig = started(make_rig(autopilot))
    rig.send("MISSION_COUNT", count=3)
    for _ in range(9):
        rig.gcs_heartbeat()
        rig.step(1.0)
    assert any("time" in text for text in rig.texts())
    assert rig.upload(simple(rig)) == ACCEPTED


@BOTH
def test_repeated_items_prolong_px4s_upload_and_not_ardupilots(make_rig, autopilot):
    """PX4 1.18, handle_mission_item_both; ArduPilot 4.6, handle_mission_item."""
    rig = started(make_rig(autopilot))
    rig.send("MISSION_COUNT", count=3)
    for _ in range(9):
        rig.send_item(0, simple(rig)[0])
        rig.gcs_heartbeat()
        rig.step(1.0)
    assert any("time" in text for text in rig.texts()) == (autopilot is AP)


@BOTH
def test_a_repeated_last_item_is_accepted_again_by_px4_only(make_rig, autopilot):
    rig = started(make_rig(autopilot))
    items = simple(rig)
    assert rig.upload(items) == ACCEPTED
    rig.send_item(len(items) - (autopilot is PX4), items[-1])
    assert rig.last("MISSION_ACK").type == (ACCEPTED if autopilot is PX4 else ERROR)


@BOTH
def test_nothing_is_read_back_during_an_upload(make_rig, autopilot):
    rig = started(make_rig(autopilot))
    rig.send("MISSION_COUNT", count=3)
    rig.forget()
    rig.send("MISSION_REQUEST_LIST", mission_type=0)
    responses = [m.type for m in rig.hear() if m.msg_name in ("MISSION_ACK", "MISSION_COUNT")]
    assert responses == ([DENIED] if autopilot is AP else [])


@BOTH
def test_another_partner_cannot_break_into_an_upload(make_rig, autopilot):
    rig = started(make_rig(autopilot))
    rig.send("MISSION_COUNT", count=3)
    rig.forget()
    rig.send("MISSION_COUNT", sender=(1, 191), count=1)
    assert rig.last("MISSION_ACK").type == ERROR


@BOTH
def test_too_many_items_are_refused_at_once(make_rig, autopilot):
    rig = started(make_rig(autopilot))
    rig.send("MISSION_COUNT", count=60000)
    assert rig.last("MISSION_ACK").type == NO_SPACE


def test_ardupilot_jumps_by_command(airborne):
    rig = airborne(AP)
    rig.upload(simple(rig))
    rig.set_mode(Mode.AUTO)
    rig.step(1.0)
    assert rig.command(224, 4) == ACCEPTED
    assert rig.last("MISSION_CURRENT").seq == 4
    assert rig.command(224, 40) == 4  # FAILED


def test_px4_jumps_by_message_only(airborne):
    rig = airborne(PX4)
    rig.upload(simple(rig))
    rig.set_mode(Mode.AUTO)
    rig.step(1.0)
    assert rig.command(224, 3) == UNSUPPORTED
    rig.forget()
    rig.send("MISSION_SET_CURRENT", seq=3)
    assert rig.ap.executor.index == 3
    assert not rig.all("MISSION_CURRENT")  # flown: only that of the second confirms it
    assert rig.until(lambda: bool(rig.all("MISSION_CURRENT")), 1.1)
    assert [m.seq for m in rig.all("MISSION_CURRENT")] == [3]
    rig.gcs_heartbeat()
    rig.send("MISSION_SET_CURRENT", seq=30)
    assert "Not in list" in rig.texts()[-1]


def test_px4_set_current_on_a_jump_resolves_it_without_counting(airborne):
    rig = airborne(PX4)
    items = simple(rig)
    items.insert(2, {"command": JUMP, "frame": MISSION_FRAME, "param1": 4.0, "param2": 1.0})
    rig.upload(items)
    rig.set_mode(Mode.AUTO)
    rig.step(1.0)
    for _ in range(2):
        rig.send("MISSION_SET_CURRENT", seq=2)
        assert rig.ap.executor.index == 4


@BOTH
def test_straight_legs_are_flown_through_at_speed_and_corners_are_not(airborne, autopilot):
    rig = airborne(autopilot)
    items = simple(rig)[:3]
    items.append(rig.place(WAYPOINT, 120, 80, 20))
    rig.upload(items)
    rig.set_mode(Mode.AUTO)
    speeds = {}
    index = rig.ap.executor.index
    for _ in range(800):
        rig.step(0.1)
        if rig.ap.executor.index != index:
            index = rig.ap.executor.index
            speeds[index] = rig.speed_mps
        if rig.ap.executor.leg is None or index == len(items) - (autopilot is PX4):
            break
    straight, corner = (3, 4) if autopilot is AP else (2, 3)
    cruise = rig.ap.current_cruise_speed_mps
    assert speeds[straight] > 0.85 * cruise
    if autopilot is AP:
        assert speeds[corner] < 0.6 * cruise


@BOTH
def test_a_hold_at_a_waypoint_lasts_as_long_as_it_says(airborne, autopilot):
    rig = airborne(autopilot)
    rig.upload([rig.place(WAYPOINT, 30, 0, 20, param1=5.0), rig.place(WAYPOINT, 60, 0, 20)])
    rig.set_mode(Mode.AUTO)
    first = 1 if autopilot is AP else 0
    arrived = None
    while rig.ap.executor.index == first:
        rig.step(0.1)
        if arrived is None and rig.ap.executor.leg.phase.name == "LOITER":
            arrived = rig.ap.t_s
    assert rig.ap.t_s - arrived == pytest.approx(5.0, abs=0.2)


@pytest.mark.parametrize(("speed_mps", "slowest_mps"), [(9.5, 2.9), (10.9, 3.1), (11.3, 3.3)])
def test_ardupilot_sent_on_before_it_is_there_brakes_and_begins_anew(
    make_rig, speed_mps, slowest_mps
):
    # flown on ArduCopter 4.7 SITL: these speeds, and about 3 s lost at each waypoint
    rig = make_rig(AP, {"WPNAV_SPEED": 100.0 * speed_mps})
    rig.take_off()
    rig.upload([rig.place(WAYPOINT, 200, 0, 20), rig.place(WAYPOINT, 500, 0, 20)])
    rig.set_mode(Mode.AUTO)
    assert rig.until(lambda: rig.ne_m[0] > 120.0, 60.0)
    north_m, began_s, slowest = rig.ne_m[0], rig.ap.t_s, math.inf
    assert rig.command(224, 2) == ACCEPTED
    for _ in range(100):
        rig.step(0.1)
        slowest = min(slowest, rig.speed_mps)
    assert slowest == pytest.approx(slowest_mps, abs=0.2)
    assert rig.speed_mps == pytest.approx(speed_mps, abs=0.5)
    lost_s = rig.ap.t_s - began_s - (rig.ne_m[0] - north_m) / speed_mps
    assert lost_s == pytest.approx(3.0, abs=0.75)


@BOTH
def test_reached_items_are_announced_in_order(airborne, autopilot):
    rig = airborne(autopilot)
    rig.upload([rig.place(WAYPOINT, 20, 0, 20), rig.place(WAYPOINT, 40, 0, 20)])
    rig.set_mode(Mode.AUTO)
    rig.step(20.0)
    first = 1 if autopilot is AP else 0
    seqs = list(dict.fromkeys(m.seq for m in rig.all("MISSION_ITEM_REACHED")))
    assert seqs == [first, first + 1]


def test_ardupilot_is_back_at_its_first_item_before_its_heartbeat_says_disarmed(airborne):
    # flown on ArduCopter 4.7 SITL: up to 0.8 s before
    rig = airborne(AP)
    rig.upload([rig.place(WAYPOINT, 5, 0, 10), rig.place(LAND, 5, 0, 0)])
    rig.command(511, 42, 100_000)
    rig.set_mode(Mode.AUTO)
    assert rig.until(lambda: rig.ap.executor.index == 2, 40.0)
    rig.forget()
    current_s = disarmed_s = None
    for _ in range(1000):
        rig.step(0.1)
        heard = {message.msg_name: message for message in rig.hear()}
        if current_s is None and "MISSION_CURRENT" in heard and heard["MISSION_CURRENT"].seq == 1:
            current_s = rig.ap.t_s
        if "HEARTBEAT" in heard and not heard["HEARTBEAT"].base_mode & 128:
            disarmed_s = rig.ap.t_s
            break
    assert current_s is not None
    assert disarmed_s is not None
    assert 0.0 <= disarmed_s - current_s <= 1.0


def test_px4_repeats_mission_item_reached_ten_times(airborne):
    rig = airborne(PX4)
    rig.upload([rig.place(WAYPOINT, 20, 0, 20)])
    rig.set_mode(Mode.AUTO)
    rig.step(25.0)
    assert len(rig.all("MISSION_ITEM_REACHED")) == 11


@pytest.mark.sample
@BOTH
def test_a_jump_is_taken_as_often_as_it_says(airborne, autopilot):
    rig = airborne(autopilot)
    shift = 1.0 if autopilot is AP else 0.0
    rig.upload(
        [
            rig.place(WAYPOINT, 20, 0, 20),
            rig.place(WAYPOINT, 40, 0, 20),
            {"command": JUMP, "frame": MISSION_FRAME, "param1": shift, "param2": 2.0},
            rig.place(WAYPOINT, 40, 20, 20),
        ]
    )
    rig.set_mode(Mode.AUTO)
    rig.step(90.0)
    seqs = []
    for message in rig.all("MISSION_ITEM_REACHED"):
        if not seqs or seqs[-1] != message.seq:
            seqs.append(message.seq)
    a, b, c = (1, 2, 4) if autopilot is AP else (0, 1, 3)
    assert seqs == [a, b, a, b, a, b, c]


def test_ardupilot_repeats_minus_one_for_ever_and_px4_65535_times(make_rig):
    rig = started(make_rig(PX4))
    items = [rig.place(WAYPOINT, 20, 0, 20), {"command": JUMP, "frame": 2, "param2": -1.0}]
    rig.upload(items)
    assert rig.download()[1].param2 == 65535.0
    rig = started(make_rig(AP))
    items[1]["param1"] = 1.0
    rig.upload(items)
    assert rig.download()[2].param2 == -1.0
    assert rig.ap.executor.plan.item_index_after_jumps(2, count_jumps=True) == 1


@BOTH
def test_a_mission_that_only_jumps_ends_instead_of_hanging(make_rig, autopilot):
    rig = started(make_rig(autopilot))
    shift = 1.0 if autopilot is AP else 0.0
    jump = {"command": JUMP, "frame": MISSION_FRAME, "param2": 5000.0}
    rig.upload([{**jump, "param1": shift + 1.0}, {**jump, "param1": shift}])
    assert rig.ap.executor.plan.item_index_after_jumps(int(shift), count_jumps=False) is None


@BOTH
def test_a_delay_holds_and_a_speed_change_lasts(airborne, autopilot):
    rig = airborne(autopilot)
    rig.upload(
        [
            rig.place(WAYPOINT, 20, 0, 20),
            {"command": DELAY, "frame": MISSION_FRAME, "param1": 4.0},
            {"command": SPEED, "frame": MISSION_FRAME, "param1": 1.0, "param2": 3.0},
            rig.place(WAYPOINT, 80, 0, 20),
        ]
    )
    rig.set_mode(Mode.AUTO)
    shift = 1 if autopilot is AP else 0
    assert rig.until(lambda: rig.ap.executor.index == 1 + shift, 30.0)
    began = rig.ap.t_s
    assert rig.until(lambda: rig.ap.executor.index == 3 + shift, 30.0)
    assert rig.ap.t_s - began == pytest.approx(4.0, abs=0.5)
    rig.step(6.0)
    assert rig.speed_mps == pytest.approx(3.0, abs=0.5)


@BOTH
def test_a_gripper_item_opens_the_gripper(airborne, autopilot):
    setting = {"GRIP_ENABLE": 1} if autopilot is AP else {}
    rig = airborne(autopilot, setting)
    assert rig.vehicle.truth.parcel_aboard
    rig.upload(
        [
            rig.place(WAYPOINT, 5, 0, 20),
            {"command": GRIPPER, "frame": MISSION_FRAME, "param1": 1.0, "param2": 0.0},
            rig.place(WAYPOINT, 30, 0, 20),
        ]
    )
    rig.set_mode(Mode.AUTO)
    rig.step(12.0)
    assert not rig.vehicle.truth.parcel_aboard


@pytest.mark.parametrize(("kind", "timeout_s"), [(0, 0.0), (-1, 0.0), (0, 5.0)])
def test_px4_waits_its_command_timeout_for_a_gripper_and_goes_on(airborne, kind, timeout_s):
    # flown on PX4 1.18: it continues at once; mission_block.cpp: MIS_COMMAND_TOUT, 0 by default
    rig = airborne(PX4, {"PD_GRIPPER_TYPE": kind, "MIS_COMMAND_TOUT": timeout_s})
    rig.upload(
        [
            rig.place(WAYPOINT, 5, 0, 20),
            {"command": GRIPPER, "frame": MISSION_FRAME, "param1": 1.0, "param2": 0.0},
            rig.place(WAYPOINT, 30, 0, 20),
        ]
    )
    rig.set_mode(Mode.AUTO)
    assert rig.until(lambda: rig.ap.executor.index >= 1, 30.0)
    began = rig.ap.t_s
    assert rig.until(lambda: rig.ap.executor.index == 2, 30.0)
    assert rig.ap.t_s - began == pytest.approx(timeout_s, abs=0.4)
    assert rig.vehicle.truth.parcel_aboard is (kind < 0)


def test_px4_takes_missing_coordinates_and_heights_for_here(airborne):
    rig = airborne(PX4)
    item = {"command": WAYPOINT, "frame": 6, "x": NO_COORDINATE, "y": NO_COORDINATE, "z": math.nan}
    rig.upload([rig.place(WAYPOINT, 0, 0, 20), item])
    rig.set_mode(Mode.AUTO)
    rig.step(5.0)
    assert math.hypot(*rig.ne_m) < 4.0
    assert rig.height_m == pytest.approx(20.0, abs=2.5)


@BOTH
def test_loiter_unlimited_stays(airborne, autopilot):
    rig = airborne(autopilot)
    rig.upload([rig.place(17, 25, 0, 20), rig.place(WAYPOINT, 80, 0, 20)])
    rig.set_mode(Mode.AUTO)
    rig.step(40.0)
    assert math.dist(rig.ne_m, (25, 0)) < 4.0


def test_px4_will_not_fly_a_mission_that_begins_far_away(make_rig):
    rig = started(make_rig(PX4))
    rig.gcs_heartbeat()
    assert rig.upload([rig.place(WAYPOINT, 20_000, 0, 20)]) == ACCEPTED
    assert any("far away" in text for text in rig.texts())
    rig.set_mode(Mode.AUTO)
    assert rig.command(400, 1) != ACCEPTED


def test_items_of_the_old_float_kind_are_understood(make_rig):
    rig = started(make_rig(PX4))
    rig.send("MISSION_COUNT", count=1)
    fields = dict.fromkeys(("param1", "param2", "param3", "param4"), 0.0)
    rig.send(
        "MISSION_ITEM",
        seq=0,
        frame=3,
        command=WAYPOINT,
        current=0,
        autocontinue=1,
        **fields,
        x=55.4705,
        y=8.4507,
        z=20.0,
    )
    assert rig.last("MISSION_ACK").type == ACCEPTED
    (item,) = rig.download()
    assert (item.x, item.y) == pytest.approx((554_705_000, 84_507_000), abs=40)  # float32


def test_ardupilot_pauses_in_auto_on_the_way_only_and_ends_without_a_further_item(airborne):
    """Measured on 4.6.2: 3 active, 4 paused in AUTO, 5 complete."""
    rig = airborne(AP)
    rig.upload(simple(rig))
    assert rig.set_mode(Mode.AUTO) == 0

    def state() -> int:
        rig.command(REQUEST_MESSAGE, 42.0)
        return rig.last("MISSION_CURRENT").mission_state

    rig.step(3.0)
    assert state() == 3
    assert rig.command(PAUSE_CONTINUE, 0.0) == 0
    rig.step(8.0)
    assert state() == 4
    assert rig.ap.mode is Mode.AUTO
    assert rig.speed_mps < 1.0
    assert rig.command(PAUSE_CONTINUE, 1.0) == 0
    assert state() == 3
    rig.ap.executor.leg.phase = LegPhase.LOITER
    assert rig.command(PAUSE_CONTINUE, 0.0) == 4
    rig.set_mode(Mode.LOITER)
    assert state() == 2, "AP_Mission is stopped, not paused"


@pytest.mark.parametrize(("reset", "moves"), [(0.0, False), (1.0, True)])
def test_ardupilot_jumps_from_a_completed_mission_only_with_a_reset(airborne, reset, moves):
    """Measured on 4.6.2: the item is current, and the vehicle stays."""
    rig = airborne(AP)
    rig.upload([rig.place(WAYPOINT, 60, 0, 20), rig.place(WAYPOINT, 5, 0, 20)])
    assert rig.set_mode(Mode.AUTO) == 0
    assert rig.command(224, 2.0) == 0
    rig.step(20.0)
    rig.command(REQUEST_MESSAGE, 42.0)
    assert rig.last("MISSION_CURRENT").mission_state == 5
    assert rig.command(224, 1.0, reset) == 0
    rig.step(15.0)
    assert (rig.ne_m[0] > 30.0) is moves


@pytest.mark.parametrize(("autopilot", "moves"), [(PX4, True), (AP, False)])
def test_only_px4_moves_its_home_to_where_it_landed(make_rig, autopilot, moves):
    rig = make_rig(autopilot)
    rig.step(45.0)
    north, east, down = rig.ap.state.home_ned_m
    rig.ap.state.home_ned_m = (north + 50.0, east, down)
    rig.step(1.0)
    assert (abs(rig.ap.state.home_ned_m[0] - north) < 3.0) is moves
