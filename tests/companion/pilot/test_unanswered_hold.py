"""A HOLD entered by the autopilot itself: alarms, and the action configured by the operator."""

import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import AlertReport, SetMode
from companion.core.mission.alerts import Severity
from companion.core.mission.events import Mode
from companion.core.pilot.context import PilotOptions, UnansweredHoldAction
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import World, world

RETURN = PilotOptions(
    configure=True, authorise=True, unanswered_hold_action=UnansweredHoldAction.RETURN
)
LAND = PilotOptions(
    configure=True, authorise=True, unanswered_hold_action=UnansweredHoldAction.LAND
)
FLOWN = [Phase.CLIMB, Phase.OUTBOUND, Phase.RELEASE, Phase.RETURN]
WAIT_S = 30.0


def cleared(phase: Phase, options: PilotOptions | None = None) -> World:
    """Clear the mission in flight; the vehicle holds."""
    w = world(options=options).until(phase)
    w.takes_uploads = False
    w.items, w.index = (), 0
    w.mode = Mode.HOLD
    return w.until(Phase.SUSPENDED)


def fails_safe(options: PilotOptions | None = None) -> World:
    """Hold by a failsafe of the autopilot, as PX4 beyond a fence."""
    w = world(options=options).until(Phase.OUTBOUND)
    w.mode, w.failsafe = Mode.HOLD, True
    return w.until(Phase.SUSPENDED)


def let(w: World, duration_s: float) -> World:
    for _ in range(round(duration_s * 10)):
        w.step()
    return w


def alarms(w: World) -> list[float]:
    return [t for t, a in w.log if isinstance(a, AlertReport) and ", on HOLD: " in a.text]


def modes(w: World) -> list[Mode]:
    """Return the modes ordered in flight, without the first, which started the mission."""
    return [a.mode for _, a in w.log if isinstance(a, SetMode)][1:]


@pytest.mark.parametrize("phase", FLOWN)
def test_safety_rule_1_without_a_choice_it_alarms_again_and_again_and_orders_nothing(phase):
    w = cleared(phase)
    held_s = w.t_s
    let(w, 60.0)
    assert alarms(w)[0] <= held_s + 0.2
    gaps = [b - a for a, b in zip(alarms(w), alarms(w)[1:], strict=False)]
    assert gaps == pytest.approx([10.0] * len(gaps), abs=0.15)
    assert len(gaps) == 6
    said = [a for _, a in w.log if isinstance(a, AlertReport) and "on HOLD" in a.text]
    assert {a.severity for a in said} == {Severity.CRITICAL}
    assert all(len(a.text.encode()) <= 50 for a in said)
    assert w.orders_after(held_s) == []


@pytest.mark.parametrize("phase", FLOWN)
@pytest.mark.parametrize(("options", "mode"), [(RETURN, Mode.RTL), (LAND, Mode.LAND)])
def test_safety_rule_1_unanswered_it_orders_once_what_the_operator_chose(phase, options, mode):
    w = cleared(phase, options)
    held_s = w.t_s
    let(w, WAIT_S - 1.0)
    assert w.orders_after(held_s) == []
    let(w, 2.0)
    assert modes(w) == [mode]
    assert w.pilot.phase is Phase.LAST_RESORT
    assert "last_resort" in w.kinds


@pytest.mark.parametrize(("kind", "is_by_itself"), [("PX4", True), ("ARDUPILOT", False)])
def test_safety_rule_1_only_px4_holds_by_itself_after_a_changed_list(kind, is_by_itself):
    w = world(options=RETURN).until(Phase.OUTBOUND)
    w.pilot.context.telemetry.autopilot_kind = ev.AutopilotKind[kind]
    w.takes_uploads = False
    w.items, w.index, w.mode = (), 0, Mode.HOLD
    held_s = w.until(Phase.SUSPENDED).t_s
    let(w, WAIT_S + 2.0)
    assert bool(w.orders_after(held_s)) is is_by_itself
    assert bool(alarms(w)) is is_by_itself


def test_an_empty_list_in_a_return_that_needs_none_is_no_other_hand():
    w = let(cleared(Phase.OUTBOUND, RETURN), WAIT_S + 20.0)
    assert w.pilot.phase is Phase.LAST_RESORT


def test_safety_rule_1_a_take_over_after_that_order_is_hands_off_again():
    w = let(cleared(Phase.OUTBOUND, RETURN), WAIT_S + 2.0)
    w.mode = Mode.OTHER
    let(w, 1.0)
    taken_s = w.t_s
    assert w.pilot.phase is Phase.SUSPENDED
    assert let(w, 60.0).orders_after(taken_s) == []


def takes_another_mode(w: World) -> None:
    w.mode = Mode.OTHER
    let(w, 1.0)
    w.mode = Mode.HOLD


def says_hands_off(w: World) -> None:
    w.tell(ev.ControlReleaseOrdered(w.t_s, "255/190"))


@pytest.mark.parametrize("answer", [takes_another_mode, says_hands_off])
def test_safety_rule_1_who_answers_keeps_the_vehicle(answer):
    w = let(cleared(Phase.OUTBOUND, RETURN), 5.0)
    answer(w)
    heard = len(alarms(w))
    let(w, 90.0)
    assert modes(w) == []
    assert len(alarms(w)) == heard


def test_safety_rule_1_who_writes_to_the_mission_meanwhile_is_given_the_time_anew():
    w = let(cleared(Phase.OUTBOUND, RETURN), WAIT_S - 5.0)
    w.tell(ev.MissionWriteDetected(w.t_s, "254/190 wrote the mission"))
    let(w, WAIT_S - 1.0)
    assert modes(w) == []
    let(w, 2.0)
    assert modes(w) == [Mode.RTL]


def test_safety_rule_1_a_pilots_hold_is_a_take_over_whatever_was_chosen():
    w = world(options=RETURN).until(Phase.OUTBOUND)
    w.mode = Mode.HOLD
    w.until(Phase.SUSPENDED)
    let(w, 3.0)
    w.items = ()  # cleared later: the pilot wanted to stop there
    let(w, 90.0)
    assert alarms(w) == []
    assert modes(w) == []


@pytest.mark.parametrize("items_left", [0, 3])
@pytest.mark.parametrize("is_reported_between", [True, False])
def test_safety_rule_1_a_hold_that_precedes_the_upload_is_a_persons(
    items_left, is_reported_between
):
    w = world(options=RETURN).until(Phase.OUTBOUND)
    w.mode, w.takes_uploads = Mode.HOLD, False
    w.mute = set() if is_reported_between else {ev.MissionProgress}
    w.until(Phase.SUSPENDED)
    let(w, 0.4)
    w.items, w.mute = w.items[:items_left], set()
    let(w, 40.0)
    # A list that is cleared before the next report (1 Hz) may have been the cause of the HOLD.
    assert modes(w) == ([] if is_reported_between or items_left else [Mode.RTL])


def test_safety_rule_3_no_return_is_ordered_to_a_home_that_moved():
    w = cleared(Phase.OUTBOUND, RETURN)
    w.home_up = 40.0  # not restored after a release of control
    let(w, WAIT_S + 10.0)
    assert modes(w) == []
    assert "no pilot" in w.said


def test_safety_rule_1_a_failsafes_hold_unanswered_is_ended_as_the_operator_chose():
    w = fails_safe(RETURN)
    held_s = w.t_s
    let(w, WAIT_S - 1.0)
    assert alarms(w)[0] <= held_s + 1.2
    assert "failsafe, on HOLD: RTL in 30 s" in w.said
    assert w.orders_after(held_s) == []
    let(w, 2.0)
    assert modes(w) == [Mode.RTL]


def test_safety_rule_1_a_failsafes_hold_without_a_choice_alarms_and_orders_nothing():
    w = fails_safe()
    held_s = w.t_s
    let(w, 60.0)
    assert len(alarms(w)) == 7
    assert w.orders_after(held_s) == []


def test_safety_rule_1_a_failsafe_that_acted_long_before_makes_no_hold_its_own():
    w = world(options=RETURN).until(Phase.OUTBOUND)
    w.failsafe = True
    let(w, 5.0)
    w.mode = Mode.HOLD
    let(w, 90.0)
    assert w.pilot.phase is Phase.SUSPENDED
    assert alarms(w) == []
    assert modes(w) == []


def test_safety_rule_1_a_failsafe_that_begins_in_a_pilots_hold_is_not_its_cause():
    w = world(options=RETURN).until(Phase.OUTBOUND)
    w.mode = Mode.HOLD
    let(w, 5.0)
    w.failsafe = True
    let(w, 90.0)
    assert alarms(w) == []
    assert modes(w) == []
