"""Arming and disarming authority and the end of a flight: the pilot against a fake vehicle."""

import math

import msgspec
import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import (
    Arm,
    Decision,
    JumpTo,
    OperatorResponse,
    Order,
    ResponseStatus,
    SaveCheckpoint,
    SetParameters,
    VerifyMission,
)
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.events import Mode, VehicleLandedState
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import World, start, world


def arms(w: World) -> int:
    return sum(isinstance(action, Arm) for _, action in w.log)


def landed(w: World) -> bool:
    return any(isinstance(a, Decision) and a.kind == "landed" for _, a in w.log)


def disarmed_heartbeat(w: World) -> None:
    w.tell(ev.VehicleState(w.t_s, Mode.MISSION, "mission", armed=False))


# --- arming, once --------------------------------------------------------------------------------


class UndoneAtOnce(World):
    """Disarmed before a heartbeat shows it armed; the reply to ARM is lost as well."""

    def process_line(self, order: Order) -> None:
        if not isinstance(order, Arm):
            super().process_line(order)


class UndoneOnceAccepted(UndoneAtOnce):
    """As `UndoneAtOnce`, but the reply arrives."""

    def process_line(self, order: Order) -> None:
        if isinstance(order, Arm):
            self.answers.append(ev.OrderAccepted(self.t_s, "arm"))
        super().process_line(order)


class Deaf(World):
    """Refuses some ARM commands with a status text."""

    refusals = 2

    def process_line(self, order: Order) -> None:
        if isinstance(order, Arm) and self.refusals:
            self.refusals -= 1
            self.answers.append(ev.OrderRefused(self.t_s, "arm", "denied"))
        else:
            super().process_line(order)


def beside(kind: type[World]) -> World:
    made = world()
    w = kind(made.pilot, made.judge)
    start(w)
    return w


def test_safety_rule_1_an_arm_that_nobody_answered_and_nobody_saw_is_not_ordered_again():
    w = beside(UndoneAtOnce)
    done = w.to_the_end()
    assert arms(w) == 1
    assert done.outcome == "ABRT"
    assert "not repeated" in w.said


def test_safety_rule_1_accepted_and_never_seen_armed_it_was_disarmed_by_another_hand():
    w = beside(UndoneOnceAccepted)
    w.run(lambda w: arms(w) == 1)
    armed_s = w.t_s
    w.run(lambda w: w.pilot.phase is not Phase.ARM, 2.3)  # two heartbeats
    assert w.t_s - armed_s > 0.5  # a single heartbeat, at 2 Hz here, may be wrong
    assert "companion released control: disarmed by someone else" in w.said
    done = w.to_the_end()
    assert (done.outcome, arms(w)) == ("ABRT", 1)
    assert w.orders_after(armed_s) == []
    assert w.values["LOW_ACT"] == 2.0


def test_an_arm_that_the_autopilot_refused_is_ordered_again():
    w = beside(Deaf)
    assert w.to_the_end().outcome == "SUC"
    assert arms(w) == 3


def test_safety_rule_1_disarmed_before_take_off_it_lets_go_at_once_and_never_arms_again():
    w = world().until(Phase.CLIMB)
    w.armed, w.height, w.velocity = False, 0.0, (0.0, 0.0, 0.0)
    taken_s = w.t_s
    w.until(Phase.SUSPENDED, 0.6)  # by the next heartbeat
    assert "disarmed by someone else" in w.said
    done = w.to_the_end()
    assert (done.outcome, arms(w)) == ("ABRT", 1)
    questions = VerifyMission  # it is read until the heartbeat shows the override
    assert [o for o in w.orders_after(taken_s) if not isinstance(o, questions)] == []
    assert OperatorResponse(ResponseStatus.DENIED) in w.tell(ev.MissionAuthorised(w.t_s, "255/190"))


def test_safety_rule_1_what_another_hand_disarmed_is_not_armed_after_a_restart_either():
    w = world().until(Phase.CLIMB)
    w.armed, w.height = False, 0.0
    w.until(Phase.SUSPENDED, 0.6)
    kept = [a.content for _, a in w.log if isinstance(a, SaveCheckpoint)][-1]
    before = msgspec.structs.replace(msgspec.convert(kept, Checkpoint), flying=False)
    assert before.disarmed_by_another
    again = world(kept=before, options=PilotOptions(configure=True)).until(Phase.READY)
    assert OperatorResponse(ResponseStatus.DENIED) in again.tell(
        ev.MissionAuthorised(again.t_s, "255/190")
    )
    assert "not re-armed" in again.to_the_end().reason
    assert arms(again) == 0


def test_safety_rule_1_armed_after_it_gave_up_it_lets_go_and_sets_nothing():
    w = beside(UndoneAtOnce)
    w.run(lambda w: "not repeated" in w.said)
    w.answers.clear()  # the settings are not restored yet
    w.armed = True
    w.step(0.5)
    taken_s = w.t_s
    w.until(Phase.SUSPENDED, 1.0)
    assert w.orders_after(taken_s) == []


def test_safety_rule_1_disarmed_while_another_hand_has_it_it_is_not_armed_when_handed_back():
    w = world().until(Phase.ARM)
    w.tell(ev.VehicleState(w.t_s, Mode.OTHER, "STABILIZE", armed=True))
    assert w.pilot.phase is Phase.SUSPENDED
    w.armed, w.mode = False, Mode.HOLD
    w.run(lambda w: w.t_s > 30.0)
    w.tell(ev.ControlHandedBack(w.t_s, "255/190"))
    handed_s = w.t_s
    w.until(Phase.READY)
    assert OperatorResponse(ResponseStatus.DENIED) in w.tell(ev.MissionAuthorised(w.t_s, "255/190"))
    assert "not re-armed" in w.to_the_end().reason
    assert not any(isinstance(order, Arm) for order in w.orders_after(handed_s))


# --- landing detection ---------------------------------------------------------------------------


@pytest.mark.parametrize("phase", [Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER, Phase.RETURN])
def test_one_false_disarmed_heartbeat_and_a_second_of_silence_end_nothing(phase):
    w = world().until(phase)
    w.step()
    disarmed_heartbeat(w)
    for _ in range(11):
        w.t_s = round(w.t_s + 0.1, 3)
        w.tell(ev.Tick(w.t_s))
    assert not landed(w)
    assert w.pilot.phase is phase
    done = w.to_the_end()
    assert done.outcome == "SUC"
    in_air_s = next(t for t, a in w.log if isinstance(a, Decision) and a.kind == "landed")
    took_off_s = next(t for t, a in w.log if isinstance(a, Decision) and a.kind == "take_off")
    assert not [t for t, a in w.log if isinstance(a, SetParameters) and took_off_s < t < in_air_s]


def drop_out_of_the_air(w: World) -> None:
    """Stop the motors: the vehicle falls to the ground and stays there."""
    w.armed = False
    speed_mps = 0.0
    while w.height > 0.0:
        speed_mps += 9.8 * 0.1
        w.height = max(0.0, w.height - speed_mps * 0.1)
        w.fly = lambda dt_s, v=speed_mps: setattr(w, "velocity", (0.0, 0.0, v))
        w.step()
    w.fly = lambda dt_s: setattr(w, "velocity", (0.0, 0.0, 0.0))


@pytest.mark.parametrize("phase", [Phase.MEASURE, Phase.OUTBOUND, Phase.RETURN, Phase.LAND])
def test_safety_rule_1_disarmed_in_the_air_it_lets_go_says_where_and_sets_nothing(phase):
    w = world().until(phase)
    w.run(lambda w: w.height > 25.0)
    cut_s = w.t_s
    drop_out_of_the_air(w)
    assert w.pilot.phase is Phase.SUSPENDED
    assert "disarmed in flight, falling: 55.47" in w.said
    done = w.to_the_end()
    assert done.home is False
    assert done.outcome in ("FAIL", "DEL")
    assert w.orders_after(cut_s + 1.1) == []  # two heartbeats
    assert w.values["LOW_ACT"] == 2.0


@pytest.mark.parametrize("height_m", [2.0, 4.0, 9.0])
def test_safety_rule_1_disarmed_low_in_a_landing_it_lets_go_when_it_hears_of_it_on_the_ground(
    height_m,
):
    w = world().until(Phase.LAND)
    w.run(lambda w: w.height < height_m)
    w.mute = {ev.VehicleState}
    drop_out_of_the_air(w)
    w.step(0.3)
    w.mute = set()
    cut_s = w.t_s
    w.until(Phase.SUSPENDED, 1.1)
    assert "disarmed in flight, falling: 55.47" in w.said
    done = w.to_the_end()
    assert done.home is False
    assert w.orders_after(cut_s) == []


# --- landings by another operator ----------------------------------------------------------------


def flown_down_by(w: World, *, failsafe: bool = False) -> None:
    """Descend vertically and disarm under an operator's control or the autopilot's failsafe."""
    w.mute = {ev.VehicleState}

    def fly(dt_s: float) -> None:
        w.mode = Mode.OTHER
        w.velocity = (0.0, 0.0, 1.0 if w.height > 0.0 else 0.0)
        w.height = max(0.0, w.height - dt_s)
        w.armed = w.height > 0.0
        w.tell(ev.VehicleState(w.t_s, Mode.OTHER, "other", w.armed, failsafe=failsafe and w.armed))

    w.fly = fly


@pytest.mark.parametrize("phase", [Phase.OUTBOUND, Phase.RETURN])
def test_landed_elsewhere_by_a_person_it_is_taken_and_neither_lost_nor_home(phase):
    w = world().until(phase)
    w.run(lambda w: w.north > 60.0)
    flown_down_by(w)
    done = w.to_the_end()
    assert (done.outcome, done.home) == ("TAKEN", False)
    assert done.delivered is (phase is Phase.RETURN)


def test_landed_elsewhere_by_a_failsafe_it_is_lost():
    w = world().until(Phase.OUTBOUND)
    w.run(lambda w: w.north > 60.0)
    flown_down_by(w, failsafe=True)
    done = w.to_the_end()
    assert (done.outcome, done.home) == ("FAIL", False)


def test_landed_at_home_by_a_person_with_the_parcel_delivered_it_is_a_success():
    w = world().until(Phase.RETURN)
    w.run(lambda w: abs(w.north) < 5.0)
    flown_down_by(w)
    done = w.to_the_end()
    assert (done.outcome, done.home) == ("SUC", True)


def high(w: World) -> None:
    w.height = 12.0


def moving(w: World) -> None:
    w.velocity = (4.0, 0.0, 0.0)


def in_air(w: World) -> None:
    w.tell(ev.GroundState(w.t_s, VehicleLandedState.IN_AIR))


@pytest.mark.parametrize("differs", [high, moving, in_air])
def test_landed_is_what_landed_state_height_and_speed_agree_on(differs):
    w = world().until(Phase.LAND)
    w.run(lambda w: w.height < 1.0)
    w.armed, w.fly = False, lambda dt_s: None
    w.velocity, w.height = (0.0, 0.0, 0.0), 0.0
    w.mute = {ev.GroundState}
    differs(w)
    for _ in range(60):
        w.step()
        if differs is in_air:
            in_air(w)
    assert not landed(w)
    w.velocity, w.height = (0.0, 0.0, 0.0), 0.0
    w.tell(ev.GroundState(w.t_s, VehicleLandedState.ON_GROUND))
    w.run(landed, 1.2)


def test_on_ground_of_unknown_height_it_is_down_after_a_time_that_no_fall_takes():
    w = world().until(Phase.LAND)
    w.run(lambda w: w.height < 1.0)
    w.armed, w.fly, w.velocity, w.height = False, lambda dt_s: None, (0.0, 0.0, 0.0), 12.0
    w.mute = {ev.GroundState}
    began_s = w.t_s
    w.run(landed, 30.0)
    assert w.t_s - began_s > math.sqrt(2.0 * 120.0 / 9.8)


# --- reports that are older than an order --------------------------------------------------------


def turned_home_by_itself(leg: int) -> World:
    """Return home from this leg's end: without a GNSS fix the mission was not continued."""
    w = world().until(Phase.OUTBOUND)
    w.run(lambda w: w.item.outbound_leg == leg and w.progress.pending_jump_item_index is None)
    w.gnss = False
    return w.until(Phase.RETURN)


def goes_on_again(w: World) -> bool:
    return "onward_again" in w.kinds


def test_a_report_from_before_the_jump_does_not_undo_going_on():
    # UDP reorders, and PX4 reports its item at 1 Hz: "gate open again: continuing" was undone.
    w = turned_home_by_itself(0)
    homeward = w.index
    w.gnss = True
    w.run(goes_on_again)
    w.until(Phase.OUTBOUND, 2.0)
    for _ in range(2):
        w.tell(ev.MissionProgress(w.t_s, homeward, len(w.items)))
        w.tell(ev.Tick(w.t_s))
    assert w.pilot.phase is Phase.OUTBOUND
    assert w.to_the_end().outcome == "SUC"
    assert w.kinds.count("onward_again") == 1


def test_a_report_from_before_the_jump_does_not_confirm_it():
    w = turned_home_by_itself(2)
    outward = w.pilot.flight_plan.mission.outbound[-1]
    w.gnss, w.obeys_jumps = True, False  # the order is lost
    w.tell(ev.MissionProgress(w.t_s, outward, len(w.items)))
    w.run(goes_on_again, 1.0)
    ordered_s = w.t_s
    w.tell(ev.MissionProgress(w.t_s, outward, len(w.items)))
    assert w.progress.pending_jump_item_index == outward, "still waited for"
    w.obeys_jumps = True
    assert w.to_the_end().outcome == "SUC"
    again = [t for t, a in w.log if isinstance(a, JumpTo) and t > ordered_s]
    assert again, "and asked for again"


def test_after_a_second_the_way_home_is_believed_again():
    w = turned_home_by_itself(0)
    homeward = w.index
    w.gnss = True
    w.run(goes_on_again)
    w.until(Phase.OUTBOUND, 2.0)
    for _ in range(12):
        w.index = homeward
        w.step()
        if w.pilot.phase is Phase.RETURN:
            return
    raise AssertionError("it did not see that the mission turned home")
