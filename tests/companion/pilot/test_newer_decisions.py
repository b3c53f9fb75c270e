"""Safety rules 1 and 2: no retry overrides an operator's later decision, no motion before the
mission is verified, and the last resort is ordered until it is flown (fake vehicle)."""

from dataclasses import dataclass, field, replace

import msgspec
import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import (
    AlertReport,
    Arm,
    Disarm,
    JumpTo,
    OperatorResponse,
    Order,
    ResponseStatus,
    SaveCheckpoint,
    SetMode,
    UploadMission,
)
from companion.core.mission.alerts import Severity
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.events import Mode
from companion.core.mission.mission_items import MissionItem
from companion.core.pilot.authority import OrderedMode
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.telemetry.position_watch import PositionWatch
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import World, start, world

OPERATOR = "255/190"


@dataclass
class Recorded(World):
    """Records the onboard mission at each mode or arm order, and may refuse modes."""

    aboard: list[tuple[Order, tuple[MissionItem, ...]]] = field(default_factory=list)
    refuses: bool = False
    ignores: bool = False

    def process_line(self, order: Order) -> None:
        if isinstance(order, SetMode | Arm):
            self.aboard.append((order, self.items))
        if isinstance(order, SetMode) and self.refuses:
            self.answers.append(ev.OrderRefused(self.t_s, "mode", "failed", mode=order.mode))
        elif not (isinstance(order, SetMode) and self.ignores):
            super().process_line(order)


def reach(
    phase: Phase, options: PilotOptions | None = None, mission_id: int | None = 7
) -> Recorded:
    made = world(options=options)
    w = Recorded(made.pilot, made.judge, mission_id=mission_id)
    start(w)
    w.until(phase)
    return w


def held(phase: Phase = Phase.OUTBOUND, mission_id: int | None = 7) -> Recorded:
    """Fly with HOLD selected by an operator."""
    w = reach(phase, mission_id=mission_id)
    w.mode = Mode.HOLD
    w.until(Phase.SUSPENDED)
    return let(w, 2.0)


def let(w: Recorded, duration_s: float) -> Recorded:
    for _ in range(round(duration_s * 10)):
        w.step()
    return w


def replace_mission(w: World) -> None:
    """Replace the mission by another station's of the same length, 1.5 km to the north."""
    w.items = tuple(
        i if i.spot is None else replace(i, spot=replace(i.spot, lat_deg=i.spot.lat_deg + 0.0135))
        for i in w.items
    )
    w.mission_id, w.leg = 8, None


def modes(w: World, after_s: float) -> list[Mode]:
    return [a.mode for a in w.orders_after(after_s) if isinstance(a, SetMode)]


# --- retries ------------------------------------------------------------------------------------


def test_safety_rule_1_hold_selected_again_after_a_hand_back_is_not_left_again():
    w = held()
    handed_s = w.t_s
    w.tell(ev.ControlHandedBack(w.t_s, OPERATOR))
    w.run(lambda w: bool(modes(w, handed_s)), 5.0)
    w.mode = Mode.HOLD  # obeyed, and changed back before the next report
    let(w, 20.0)
    assert modes(w, handed_s) == [Mode.MISSION]
    assert w.pilot.phase is Phase.SUSPENDED
    assert "mode command unconfirmed: hand back again" in w.said


@pytest.mark.parametrize("mission_id", [7, None])
def test_safety_rule_1_a_hand_back_resumes_as_soon_as_the_mission_is_verified(mission_id):
    """A later HOLD of the operator must be visible: in HOLD it would not change the mode."""
    w = held(mission_id=mission_id)
    let(w, 15.0)
    handed_s = w.t_s
    w.tell(ev.ControlHandedBack(w.t_s, OPERATOR))
    let(w, 0.3)
    assert modes(w, handed_s) == [Mode.MISSION]
    let(w, 1.0)
    w.mode = Mode.HOLD
    let(w, 20.0)
    assert modes(w, handed_s) == [Mode.MISSION]
    assert w.pilot.phase is Phase.SUSPENDED


def test_safety_rule_1_a_gap_in_the_reports_of_the_mode_ends_a_hand_back():
    w = held()
    w.mission_id = 6  # not verified: it is read first
    let(w, 0.2)
    handed_s = w.t_s
    w.reads, w.takes_uploads = 0, False
    w.tell(ev.ControlHandedBack(w.t_s, OPERATOR))
    w.answers.clear()  # the read-back is delayed
    w.mute = {ev.VehicleState}
    let(w, 1.5)
    w.mute = set()
    let(w, 30.0)
    assert modes(w, handed_s) == []
    assert "gap in telemetry: hand back again" in w.said


def test_safety_rule_1_an_item_selected_while_a_jump_is_unconfirmed_is_kept():
    w = reach(Phase.MEASURE)
    w.run(lambda w: any(isinstance(a, JumpTo) for a in w.orders_after(0.0)))
    ordered_s = w.t_s
    w.index = len(w.items) - 2  # the landing
    let(w, 0.5)
    assert w.pilot.phase is Phase.SUSPENDED
    assert not let(w, 20.0).orders_after(ordered_s)


def test_a_jump_is_not_repeated_while_no_item_is_reported():
    w = reach(Phase.MEASURE)
    w.obeys_jumps = False
    w.run(lambda w: any(isinstance(a, JumpTo) for a in w.orders_after(0.0)))
    ordered_s = w.t_s
    w.mute = {ev.MissionProgress}
    let(w, 2.9)
    assert not [a for a in w.orders_after(ordered_s) if isinstance(a, JumpTo)]


# --- no motion before the mission is verified ---------------------------------------------------


@pytest.mark.parametrize("phase", [Phase.OUTBOUND, Phase.RELEASE, Phase.RETURN])
def test_safety_rule_2_at_a_hand_back_our_mission_is_restored_before_the_mode_is_ordered(phase):
    w = held(phase)
    ours, handed_s = w.items, w.t_s
    replace_mission(w)
    w.aboard.clear()
    assert OperatorResponse(ResponseStatus.ACCEPTED) in w.tell(
        ev.ControlHandedBack(w.t_s, OPERATOR)
    )
    done = w.to_the_end()
    assert [(order, items == ours) for order, items in w.aboard] == [(SetMode(Mode.MISSION), True)]
    assert len([a for a in w.orders_after(handed_s) if isinstance(a, UploadMission)]) == 1
    assert done.home


def test_safety_rule_2_a_hand_back_whose_mission_cannot_be_restored_is_refused_and_taken_later():
    w = held()
    handed_s = w.t_s
    replace_mission(w)
    w.takes_uploads = False
    w.tell(ev.ControlHandedBack(w.t_s, OPERATOR))
    let(w, 10.0)
    assert modes(w, handed_s) == []
    assert w.pilot.phase is Phase.SUSPENDED
    assert "cannot resume: upload failed: error" in w.said
    w.takes_uploads = True
    assert OperatorResponse(ResponseStatus.ACCEPTED) in w.tell(ev.AbortOrdered(w.t_s, OPERATOR))
    assert w.to_the_end().home


@pytest.mark.parametrize("word", [ev.ControlHandedBack, ev.AbortOrdered])
@pytest.mark.parametrize("phase", [Phase.OUTBOUND, Phase.RETURN])
def test_safety_rule_2_after_a_restart_a_foreign_mission_is_replaced_on_an_operators_word(
    phase, word
):
    w = reach(phase)
    let(w, 2.0)
    ours, kept = w.items, [a.content for _, a in w.log if isinstance(a, SaveCheckpoint)][-1]
    replace_mission(w)
    made = world(kept=msgspec.convert(kept, Checkpoint), armed=True)
    again = Recorded(made.pilot, made.judge, w.t_s + 3.0, w.north, w.east, w.height)
    again.mode, again.armed, again.items, again.index = Mode.MISSION, True, w.items, w.index
    start(again)
    again.until(Phase.FOREIGN_MISSION)
    let(again, 21.0)
    alarms = [
        a for _, a in again.log if isinstance(a, AlertReport) and a.severity is Severity.CRITICAL
    ]
    assert len(alarms) == 3, "every 10 s"
    assert OperatorResponse(ResponseStatus.ACCEPTED) in again.tell(word(again.t_s, OPERATOR))
    done = again.to_the_end()
    assert again.items == ours
    assert done.home


@pytest.mark.parametrize("replaced", [False, True])
@pytest.mark.parametrize("mission_id", [7, None])
@pytest.mark.parametrize("gap", [ev.LinkRecovered, ev.ClockJumpedForward])
def test_safety_rule_2_after_a_gap_no_jump_before_the_mission_is_verified(
    gap, mission_id, replaced
):
    w = let(reach(Phase.OUTBOUND, mission_id=mission_id), 1.0)
    w.tell(ev.LinkSilent(w.t_s))
    if replaced:
        replace_mission(w)
        w.mission_id = mission_id and w.mission_id
    reads = w.reads
    w.t_s, back_s = round(w.t_s + 10.0, 3), w.t_s
    if gap is ev.ClockJumpedForward:
        w.tell(ev.LinkRecovered(w.t_s, 0.0))
    w.tell(gap(w.t_s, 10.0))
    w.judge.turn_back = lambda judge: True
    let(w, 8.0)
    moved = [a for a in w.orders_after(back_s) if isinstance(a, JumpTo | SetMode)]
    assert w.reads > reads
    assert bool(moved) is not replaced
    assert (w.pilot.phase is Phase.FOREIGN_MISSION) is replaced


def test_safety_rule_1_a_mode_between_two_ticks_ends_a_hand_back():
    w = reach(Phase.OUTBOUND)
    w.mode = Mode.HOLD
    w.until(Phase.SUSPENDED)
    w.mute.add(ev.MissionVerified)
    w.tell(ev.ControlHandedBack(w.t_s, OPERATOR))
    handed_back_s = w.t_s
    for mode in (Mode.OTHER, Mode.HOLD):
        w.tell(ev.VehicleState(w.t_s, mode, mode.value, armed=True))
    w.mute.clear()
    let(w, 5.0)
    assert w.pilot.phase is Phase.SUSPENDED
    assert not [a for a in w.orders_after(handed_back_s) if isinstance(a, SetMode)]


def test_safety_rule_1_a_flight_that_another_computer_has_is_not_taken_back():
    w = reach(Phase.OUTBOUND)
    later = w.t_s + 1.0
    w.tell(
        ev.OtherCompanionReport(
            w.t_s, active=True, has_control=True, control_since_ms=round(1000.0 * later)
        )
    )
    assert w.pilot.phase is Phase.PASSIVE
    for word in (ev.ControlHandedBack, ev.AbortOrdered):
        assert OperatorResponse(ResponseStatus.DENIED) in w.tell(word(w.t_s, OPERATOR))


def test_safety_rule_2_a_mission_that_was_replaced_is_restored_before_arming():
    w = reach(Phase.READY, PilotOptions(configure=True))
    let(w, 3.0)
    ours = w.items
    replace_mission(w)
    let(w, 3.0)
    w.aboard.clear()
    assert OperatorResponse(ResponseStatus.ACCEPTED) in w.tell(
        ev.MissionAuthorised(w.t_s, OPERATOR)
    )
    assert w.to_the_end().outcome == "SUC"
    assert [items == ours for _, items in w.aboard] == [True, True]  # the mode, then arming


def test_safety_rule_2_a_mission_that_cannot_be_restored_is_not_started():
    w = reach(Phase.READY, PilotOptions(configure=True))
    let(w, 3.0)
    replace_mission(w)
    w.takes_uploads = False
    w.tell(ev.MissionAuthorised(w.t_s, OPERATOR))
    assert "upload refused" in w.to_the_end().reason
    assert not any(isinstance(order, Arm) for order, _ in w.aboard)


# --- the last resort ----------------------------------------------------------------------------


def last_resort() -> Recorded:
    """The mission cannot be restored: RTL is ordered, and refused."""
    w = reach(Phase.OUTBOUND)
    w.takes_uploads, w.refuses = False, True
    replace_mission(w)
    w.until(Phase.LAST_RESORT)
    return w


def critical(w: World) -> list[str]:
    return [
        a.text for _, a in w.log if isinstance(a, AlertReport) and a.severity is Severity.CRITICAL
    ]


def test_an_rtl_that_is_refused_for_12_s_is_ordered_until_it_is_flown():
    w = last_resort()
    began_s = w.t_s
    let(w, 12.0)
    assert set(modes(w, began_s)) == {Mode.RTL}
    assert "RTL not entered (failed): repeating orders" in critical(w)
    w.refuses = False
    let(w, 4.0)
    flown_s = w.t_s
    assert w.mode is Mode.RTL
    assert let(w, 20.0).orders_after(flown_s) == []


@pytest.mark.parametrize("way", ["refused", "without effect"])
def test_after_20_s_without_rtl_land_is_ordered_in_turn(way):
    w = last_resort()
    w.refuses, w.ignores = way == "refused", way != "refused"
    began_s = w.t_s
    let(w, 30.0)
    assert modes(w, began_s)[:11] == [*[Mode.RTL] * 9, Mode.LAND, Mode.RTL]
    assert len([text for text in critical(w) if "not entered" in text]) >= 3, "every 10 s"


def test_safety_rule_1_another_mode_ends_the_last_resort_at_once():
    w = last_resort()
    let(w, 5.0)
    w.mode = Mode.OTHER
    w.until(Phase.SUSPENDED)
    taken_s = w.t_s
    assert let(w, 30.0).orders_after(taken_s) == []


@pytest.mark.parametrize(("away_m", "outcome"), [(100.0, "TAKEN"), (5.0, "ABRT")])
def test_safety_rule_1_land_during_our_rtl_is_a_persons(away_m, outcome):
    w = last_resort()
    w.refuses = False
    w.run(lambda w: w.mode is Mode.RTL, 10.0)
    let(w, 10.0)
    w.north, w.east, w.mode, changed_s = away_m, 0.0, Mode.LAND, w.t_s
    w.pilot.context.telemetry.position_watch = PositionWatch()  # its flight there is left out
    let(w, 1.0)
    assert w.pilot.phase is Phase.SUSPENDED
    done = w.to_the_end()
    assert w.orders_after(changed_s) == [], "settings are not restored"
    assert done.outcome == outcome


@pytest.mark.parametrize("mode", [Mode.RTL, Mode.LAND])
def test_safety_rule_1_a_mode_that_was_ordered_long_ago_is_a_persons(mode):
    w = reach(Phase.OUTBOUND)
    w.ignores = True
    modes_part = w.pilot.parts.part_of_class(OrderedMode)
    modes_part.order_mode(w.pilot.context, mode)
    let(w, 6.0)
    assert w.pilot.phase is Phase.OUTBOUND
    w.mode = mode
    let(w, 1.0)
    assert w.pilot.phase is Phase.SUSPENDED


def test_safety_rule_1_another_stations_mode_command_ends_a_hand_back():
    """HOLD selected again in HOLD shows in no mode report."""
    w = held()
    w.mission_id = 6  # not verified: it is read first
    w.tell(ev.ControlHandedBack(w.t_s, OPERATOR))
    handed_s = w.t_s
    w.tell(ev.OtherStationModeCommand(w.t_s))
    let(w, 20.0)
    assert modes(w, handed_s) == []
    assert w.pilot.phase is Phase.SUSPENDED


def test_safety_rule_1_a_restore_that_another_station_overwrites_is_not_repeated():
    w = reach(Phase.OUTBOUND)
    replace_mission(w)
    w.run(lambda w: any(isinstance(a, UploadMission) for a in w.orders_after(w.t_s - 0.2)), 10.0)
    w.answers.clear()
    uploaded_s = w.t_s
    replace_mission(w)
    w.tell(ev.MissionUploaded(w.t_s, "written by another station", superseded=True))
    let(w, 20.0)
    assert not [a for a in w.orders_after(uploaded_s) if isinstance(a, UploadMission)]
    assert w.pilot.phase is Phase.LAST_RESORT


def test_safety_rule_1_a_mode_selected_after_the_landing_ends_the_disarm_orders():
    w = reach(Phase.LAND)
    w.disarms = False
    w.run(lambda w: any(isinstance(a, Disarm) for a in w.orders_after(0.0)))
    ordered_s, w.mode = w.t_s, Mode.OTHER
    let(w, 20.0)
    assert not [a for a in w.orders_after(ordered_s) if isinstance(a, Disarm)]
