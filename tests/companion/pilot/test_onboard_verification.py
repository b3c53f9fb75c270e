"""Safety rule 2 in flight: an altered onboard mission is restored or not used (fake vehicle)."""

from dataclasses import replace

import pytest

from companion.core.mission import events as ev
from companion.core.mission.actions import JumpTo, SetMode, UploadMission, VerifyMission
from companion.core.mission.events import Mode
from companion.core.mission.mission_items import MissionItem
from companion.core.pilot.transitions import Phase
from tests.companion.pilot.fake_vehicle import World, world

FLOWN = [Phase.CLIMB, Phase.MEASURE, Phase.OUTBOUND, Phase.DELIVER, Phase.RELEASE, Phase.RETURN]
ID, OTHER_ID = 7, 8


def reach(phase: Phase, mission_id: int | None = ID) -> World:
    w = world()
    w.mission_id = mission_id
    return w.until(phase)


def dragged(items: tuple[MissionItem, ...]) -> tuple[MissionItem, ...]:
    """Return the items with each position shifted 1.5 km to the north."""
    return tuple(
        i if i.spot is None else replace(i, spot=replace(i.spot, lat_deg=i.spot.lat_deg + 0.0135))
        for i in items
    )


def edits(w: World) -> dict[str, tuple[MissionItem, ...]]:
    items = w.items
    return {
        "dragged": dragged(items),
        "shorter": items[:-3],
        "longer": (*items, *items[-3:]),
        "reversed": (items[0], *items[:0:-1]),
    }


def put_aboard(w: World, items: tuple[MissionItem, ...]) -> None:
    w.items, w.leg = items, None
    w.mission_id = None if w.mission_id is None else OTHER_ID


def uploads(w: World, after_s: float) -> list[UploadMission]:
    return [a for a in w.orders_after(after_s) if isinstance(a, UploadMission)]


@pytest.mark.parametrize("phase", FLOWN)
@pytest.mark.parametrize("edit", ["dragged", "shorter", "longer", "reversed"])
def test_safety_rule_2_a_list_that_another_hand_uploads_is_replaced_by_ours_and_it_comes_home(
    phase, edit
):
    w = reach(phase)
    ours, changed_s = w.items, w.t_s
    put_aboard(w, edits(w)[edit])
    done = w.to_the_end()
    assert w.items == ours
    assert len(uploads(w, changed_s)) == 1
    assert {"mission_in_doubt", "mission_changed", "mission_restored"} <= set(w.kinds)
    assert "mission changed by another station: restoring" in w.said
    assert done.home
    assert abs(w.north) < 3.0
    assert done.delivered is (phase is Phase.RETURN)


@pytest.mark.parametrize("edit", ["shorter", "longer"])
def test_safety_rule_2_over_its_landing_place_it_lands_by_what_needs_no_list(edit):
    w = reach(Phase.LAND).run(lambda w: w.height < 10.0)
    changed_s = w.t_s
    put_aboard(w, edits(w)[edit])
    done = w.to_the_end()
    assert [a.mode for a in w.orders_after(changed_s) if isinstance(a, SetMode)] == [Mode.LAND]
    assert uploads(w, changed_s) == []
    assert "mission not usable: landing here" in w.said
    assert done.home
    assert done.delivered


def test_safety_rule_2_in_the_landing_a_list_that_led_it_away_is_replaced():
    w = reach(Phase.LAND)
    ours, changed_s = w.items, w.t_s
    w.north += 8.0
    put_aboard(w, dragged(w.items))
    w.run(lambda w: bool(uploads(w, changed_s)), 20.0)
    assert w.items == ours


def test_safety_rule_2_without_an_id_the_slow_reading_finds_a_dragged_item():
    w = reach(Phase.OUTBOUND, mission_id=None)
    put_aboard(w, dragged(w.items))
    w.run(lambda w: "mission_restored" in w.kinds, 60.0)
    assert w.to_the_end().home


@pytest.mark.parametrize("mission_id", [ID, None])
def test_safety_rule_2_an_abort_in_a_foreign_list_leads_home_once_ours_is_restored(mission_id):
    w = reach(Phase.OUTBOUND, mission_id)
    w.step()
    put_aboard(w, dragged(w.items))
    aborted_s = w.t_s
    w.tell(ev.AbortOrdered(w.t_s, "255/190"))
    w.run(lambda w: "mission_restored" in w.kinds, 60.0)
    assert w.t_s - aborted_s < 10.0, "the jump is followed by a read-back at once"
    returning = w.pilot.context.flight_plan.mission.returning
    assert all(a.index in returning for a in w.orders_after(aborted_s) if isinstance(a, JumpTo))
    done = w.to_the_end()
    assert (done.home, done.delivered) == (True, False)


def test_safety_rule_2_a_mission_that_ended_is_restarted_by_the_jump_only():
    w = reach(Phase.RETURN, mission_id=None)
    w.mission_state = ev.MissionState.COMPLETE
    put_aboard(w, w.items[:-3])
    w.run(lambda w: "mission_restored" in w.kinds, 60.0)
    jumps = [a for a in w.orders_after(0.0) if isinstance(a, JumpTo)]
    assert [a.is_restart for a in jumps] == [*[False] * (len(jumps) - 1), True]


def test_safety_rule_2_no_jump_and_no_promise_rests_on_a_list_in_doubt():
    w = reach(Phase.OUTBOUND)
    w.takes_uploads = False
    changed_s = w.t_s
    put_aboard(w, dragged(w.items))
    w.steps(100)
    assert not [a for a in w.orders_after(changed_s) if isinstance(a, JumpTo)]
    assert w.pilot.context.recent_assessment() is None


def test_safety_rule_2_where_our_list_cannot_be_put_back_rtl_brings_it_home():
    w = reach(Phase.OUTBOUND)
    w.takes_uploads = False
    put_aboard(w, dragged(w.items))
    w.until(Phase.LAST_RESORT)
    assert w.mode is Mode.RTL
    assert "companion cannot verify or restore the mission" in w.said


@pytest.mark.parametrize("phase", [Phase.OUTBOUND, Phase.LAND])
def test_safety_rule_2_a_list_that_is_changed_again_is_not_fought_over(phase):
    w = reach(phase)
    changed_s = w.t_s
    put_aboard(w, dragged(w.items))
    w.run(lambda w: "mission_restored" in w.kinds, 60.0)
    put_aboard(w, dragged(w.items))
    w.mission_id = 9
    w.until(Phase.LAST_RESORT)
    assert len(uploads(w, changed_s)) == 1
    assert SetMode(Mode.RTL) in w.orders_after(changed_s)


def test_what_is_overheard_is_read_at_once_and_costs_nothing_when_the_list_is_ours():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.MissionWriteDetected(w.t_s, "255/190 wrote the mission"))
    done = w.to_the_end()
    assert (done.outcome, done.delivered) == ("SUC", True)
    assert {"mission_in_doubt", "mission_proven"} <= set(w.kinds)


def test_one_message_with_another_total_is_read_and_not_believed():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.MissionProgress(w.t_s, 3, total=5))
    assert w.to_the_end().outcome == "SUC"


def test_a_list_that_is_written_to_while_it_is_read_is_read_again():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.MissionWriteDetected(w.t_s, "another"))
    w.tell(ev.MissionWriteDetected(w.t_s, "another"))
    read = w.reads
    w.step()
    w.step()
    assert w.reads == read + 1
    assert w.kinds.count("mission_proven") == 1


def test_where_an_id_is_told_nothing_is_read_in_flight():
    w = reach(Phase.CLIMB)
    read = w.reads
    w.to_the_end()
    assert w.reads == read


def test_where_none_is_told_it_is_read_slowly_again_and_again():
    w = reach(Phase.CLIMB, mission_id=None)
    began_s = w.t_s
    w.until(Phase.LAND)
    asked = [a for a in w.orders_after(began_s) if isinstance(a, VerifyMission)]
    assert len(asked) >= 2
    assert all(order.item_interval_s > 0.0 for order in asked)


def test_safety_rule_1_while_another_hand_has_the_vehicle_nothing_is_put_aboard():
    w = reach(Phase.OUTBOUND)
    w.tell(ev.ControlReleaseOrdered(w.t_s, "255/190"))
    taken_s = w.t_s
    put_aboard(w, dragged(w.items))
    w.steps(100)
    assert w.orders_after(taken_s) == []
