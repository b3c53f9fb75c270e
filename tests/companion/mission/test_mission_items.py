"""The dead man's mission, walked as an autopilot walks it; and what reading it back may change."""

import dataclasses
import math
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.adapters.autopilots.codec import mavlink
from companion.adapters.autopilots.mission_wire import item_from_wire, wire_items
from companion.core.base.errors import LeewayError
from companion.core.mission.jump_watch import JumpStatus, JumpWatch, Purpose
from companion.core.mission.mission_items import (
    PLACED,
    DeadMansMission,
    ItemKind,
    Part,
    Spot,
    build_dead_mans_mission,
    differences,
)


def mission(legs: int = 3, rallies: int = 2, entries: list[int] | None = None) -> DeadMansMission:
    """A straight mission eastwards, its way back through the same points."""
    out = [Spot(55.47, 8.45 + 0.01 * (i + 1), 40.0) for i in range(legs)]
    back = [out[-1], *reversed(out[:-1]), Spot(55.47, 8.45, 40.0)]
    return build_dead_mans_mission(
        depot=Spot(55.47, 8.45, 0.0),
        outbound=out,
        drop=dataclasses.replace(out[-1], height_rel_m=6.0),
        returning=back,
        entries=entries or [legs - i for i in range(legs)],
        rally=[
            (Spot(55.48, 8.45 + 0.01 * i, 40.0), Spot(55.48, 8.45 + 0.01 * i, 2.0))
            for i in range(rallies)
        ],
        settle_s=18.0,
        hold_s=6.0,
        weigh_s=5.0,
        delay_s=8.0,
        home_speed_mps=9.0,
    )


def walk(flight: DeadMansMission, index: int, steps: int = 200) -> list[int]:
    """Items that an autopilot passes by itself from one on, following every JUMP, to the end."""
    passed = []
    while 0 <= index < len(flight.items) and len(passed) < steps:
        passed.append(index)
        item = flight.items[index]
        index = int(item.value) if item.kind is ItemKind.JUMP else index + 1
    return passed


@given(st.integers(1, 8), st.integers(0, 3), st.data())
@settings(max_examples=60, deadline=None)
def test_safety_rule_2_from_every_item_the_untouched_mission_ends_in_a_landing(legs, rallies, data):
    entries = data.draw(st.lists(st.integers(0, legs), min_size=legs, max_size=legs))
    flight = mission(legs, rallies, entries)
    for start in range(len(flight.items)):
        placed = [i for i in walk(flight, start) if flight.items[i].kind in PLACED]
        landings = [i for i in placed if flight.items[i].kind is ItemKind.LAND]
        if flight.items[start].part is Part.END or flight.items[start].label == "end":
            assert not placed
            continue
        assert landings
        # Once a landing is reached nothing but that landing follows.
        first = placed.index(landings[0])
        assert set(placed[first:]) == {landings[0]}


def test_nobody_says_go_lands_at_the_depot_without_an_outbound_waypoint():
    flight = mission()
    parts = [flight.items[i].part for i in walk(flight, 0)]
    assert Part.OUTBOUND not in parts
    assert [flight.items[i].label for i in walk(flight, 0)[-2:]] == ["land", "end"]


def test_after_each_outbound_waypoint_comes_its_way_home_at_the_home_speed():
    flight = mission(entries=[3, 2, 1])
    for number, index in enumerate(flight.outbound):
        then = walk(flight, index)[1:]
        assert flight.items[then[0]].kind is ItemKind.SPEED
        assert flight.items[then[0]].value == 9.0
        assert flight.items[then[2]].label == f"ret {3 - number}"
        assert Part.OUTBOUND not in {flight.items[i].part for i in then[2:]}


def test_the_drop_is_left_by_itself_for_the_climb_out():
    flight = mission()
    labels = [flight.items[i].label for i in walk(flight, flight.deliver)]
    assert labels[:6] == ["drop", "release", "let go", "home speed", "ret 0", "ret 1"]


def test_every_landing_leads_to_an_end_without_a_place_because_px4_goes_on_after_one():
    """Flown on PX4 1.18: led to a last item without a place it finishes, landed, and disarms."""
    flight = mission()
    end = len(flight.items) - 1
    assert flight.items[end].kind is ItemKind.SPEED
    assert flight.land + 1 == end
    for _, down in flight.rally:
        after = flight.items[down + 1]
        assert (after.kind, int(after.value)) == (ItemKind.JUMP, end)


def test_the_mission_follows_itself_but_not_a_hand_that_moves_it():
    flight = mission()
    first, second = flight.outbound[:2]
    assert flight.follows(first, flight.entry_of_outbound[0])
    assert flight.follows(flight.takeoff, flight.settle)
    assert not flight.follows(first, second)
    assert not flight.follows(flight.settle, first)
    assert not flight.follows(flight.returning[0], flight.deliver)


def test_an_item_of_the_way_home_shows_no_jump_outward_though_it_follows_one():
    # Flown on ArduCopter: sent onward again from the way home, the item that it still told was
    # taken for the jump's own outcome, and the flight for one that had gone home by itself.
    flight = mission()
    out, home = flight.outbound[1], flight.entry_of_outbound[1]
    assert flight.follows(out, home)
    onward = JumpWatch(out, Purpose.ONWARD, 0.0)
    assert not onward.confirms(flight, home, 0.1)
    assert onward.confirms(flight, out, 0.2)
    assert onward.confirms(flight, out + 1, 0.2)
    back = JumpWatch(home, Purpose.HOME, 0.0)
    assert back.confirms(flight, home + 1, 0.1)


def test_a_report_that_may_be_older_than_the_jump_says_nothing_of_it():
    flight = mission()
    out, home = flight.outbound[1], flight.entry_of_outbound[1]
    again = JumpWatch(out, Purpose.ONWARD, 10.0, before=frozenset({out, home}))
    assert not again.confirms(flight, out, 10.4), "overtaken by the one that said: homeward"
    assert again.confirms(flight, out, 11.2)
    assert again.left_behind(flight, home)
    assert not again.left_behind(flight, out)
    assert JumpWatch(out, Purpose.ONWARD, 10.0).confirms(flight, out, 10.1), "not flown before"


def test_a_jump_that_no_report_confirms_is_asked_again_and_then_given_up():
    jump = JumpWatch(4, Purpose.HOME, 10.0)
    assert jump.wait(12.4) is JumpStatus.WAITING
    assert jump.wait(12.5) is JumpStatus.ASK_AGAIN
    assert jump.wait(15.0) is JumpStatus.ASK_AGAIN
    assert jump.wait(17.5) is JumpStatus.REFUSED


def test_the_spot_of_an_item_without_a_place_is_where_the_mission_flies_next():
    flight = mission(entries=[3, 2, 1])
    jump = flight.outbound[0] + 2
    assert flight.spot_at(jump) == flight.items[flight.returning[3]].spot
    assert flight.spot_at(len(flight.items)) is None


def test_a_way_home_that_does_not_exist_is_refused():
    with pytest.raises(LeewayError, match="way home"):
        mission(3, 0, [0, 0, 9])
    with pytest.raises(LeewayError, match="home speed"):
        build_dead_mans_mission(
            depot=Spot(0, 0, 0),
            outbound=[Spot(0, 0, 40)],
            drop=Spot(0, 0, 6),
            returning=[Spot(0, 0, 40), Spot(0, 0, 40)],
            entries=[1],
            rally=[],
            settle_s=1,
            hold_s=1,
            weigh_s=1,
            delay_s=1,
            home_speed_mps=math.nan,
        )


# --- the wire and the read-back ------------------------------------------------------------------


def aboard(flight: DeadMansMission, home_items: int, **changes: object) -> list[SimpleNamespace]:
    """The mission as MISSION_ITEM_INT messages of an autopilot that keeps it as it came."""
    wire = wire_items(
        flight.items, home_items=home_items, home=Spot(55.47, 8.45, 12.0), free_yaw=math.nan
    )
    messages = [
        SimpleNamespace(
            seq=seq,
            frame=item.frame,
            command=item.command,
            param1=item.params[0],
            param2=item.params[1],
            param3=item.params[2],
            param4=item.params[3],
            x=item.x,
            y=item.y,
            z=item.z,
        )
        for seq, item in enumerate(wire)
    ]
    for message in messages:
        for name, change in changes.items():
            setattr(message, name, change(getattr(message, name)))  # type: ignore[operator]
    return messages


def read(messages: list[SimpleNamespace], home_items: int) -> list:
    return [item_from_wire(m, home_items=home_items) for m in messages][home_items:]


@pytest.mark.parametrize("home_items", [0, 1])
def test_a_mission_that_came_back_as_it_went_shows_no_difference(home_items):
    flight = mission()
    assert differences(flight.items, read(aboard(flight, home_items), home_items)) == ()


def test_what_arducopter_rewrites_is_not_a_difference():
    # Measured on ArduCopter 4.7-dev: frame 6 to 3, NaN to 0, waypoint radius lost, home replaced.
    flight = mission()
    messages = aboard(
        flight,
        1,
        frame=lambda f: 3 if f == 6 else f,
        param4=lambda p: 0.0 if math.isnan(p) else p,
    )
    for message in messages:
        if message.command == mavlink.MAV_CMD_NAV_WAYPOINT:
            message.param2 = 0.0
    messages[0].x, messages[0].y, messages[0].z = 1, 2, 3.0
    assert differences(flight.items, read(messages, 1)) == ()


def test_jumps_are_numbered_as_the_autopilot_counts():
    # ArduPilot keeps its home at 0, so that every item and every jump target lies one higher.
    flight = mission()
    jump = next(i for i, item in enumerate(flight.items) if item.kind is ItemKind.JUMP)
    assert aboard(flight, 0)[jump].param1 == flight.items[jump].value
    assert aboard(flight, 1)[jump + 1].param1 == flight.items[jump].value + 1


CHANGES = {
    "amsl frame": ("frame", mavlink.MAV_FRAME_GLOBAL_INT, "waypoint"),
    "another place": ("x", 554_700_500, "waypoint"),
    "another height": ("z", 35.0, "waypoint"),
    "another speed": ("param2", 5.0, "speed"),
    "airspeed type": ("param1", 0.0, "speed"),
    "another target": ("param1", 7.0, "jump"),
    "no jumps": ("param2", 0.0, "jump"),
    "grab, not release": ("param2", 1.0, "release"),
    "another command": ("command", mavlink.MAV_CMD_NAV_LOITER_UNLIM, "land"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_changes_the_flight_is_a_difference_and_is_named(name):
    key, value, kind = CHANGES[name]
    flight = mission()
    index = next(i for i, item in enumerate(flight.items) if item.kind.value == kind)
    messages = aboard(flight, 0)
    setattr(messages[index], key, value)
    found = differences(flight.items, read(messages, 0))
    assert len(found) == 1
    assert found[0].startswith(f"item {index} ")


def test_a_mission_cut_short_is_a_difference():
    flight = mission()
    found = differences(flight.items, flight.items[:-1])
    assert found == (f"{len(flight.items) - 1} items aboard, {len(flight.items)} uploaded",)
