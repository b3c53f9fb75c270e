"""The autonomous mission, followed as an autopilot does; changes accepted at its read-back."""

import dataclasses
import math
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.adapters.autopilots.codec import mavlink
from companion.adapters.autopilots.mission_wire import decode_mission_item, encode_mission_items
from companion.core.base.errors import LeewayError
from companion.core.mission.jump_watch import JumpMonitor, JumpStatus, JumpType
from companion.core.mission.mission_items import (
    POSITIONED_KINDS,
    ItemKind,
    MissionPosition,
    Part,
    ReturnByDefaultMission,
    build_return_by_default_mission,
    mission_differences,
)

TIMES = {
    "settle_hover_s": 18.0,
    "customer_hold_s": 6.0,
    "loaded_hover_s": 5.0,
    "release_hover_s": 8.0,
}


def mission(
    legs: int = 3, rallies: int = 2, entries: list[int] | None = None
) -> ReturnByDefaultMission:
    """A straight mission to the east that returns over the same points."""
    out = [MissionPosition(55.47, 8.45 + 0.01 * (i + 1), 40.0) for i in range(legs)]
    back = [out[-1], *reversed(out[:-1]), MissionPosition(55.47, 8.45, 40.0)]
    sites = [(55.48, 8.45 + 0.01 * i) for i in range(rallies)]
    return build_return_by_default_mission(
        landing_position=MissionPosition(55.47, 8.45, 0.0),
        outbound=out,
        drop_position=dataclasses.replace(out[-1], height_rel_m=6.0),
        returning=back,
        return_entry_by_outbound=entries or [legs - i for i in range(legs)],
        rally_overhead_and_ground=[
            (MissionPosition(*site, 40.0), MissionPosition(*site, 2.0)) for site in sites
        ],
        home_speed_mps=9.0,
        **TIMES,
    )


def walk(flight: ReturnByDefaultMission, index: int, steps: int = 200) -> list[int]:
    """Return the items that an autopilot passes from one on, following each JUMP, to the end."""
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
        placed = [i for i in walk(flight, start) if flight.items[i].kind in POSITIONED_KINDS]
        landings = [i for i in placed if flight.items[i].kind is ItemKind.LAND]
        if flight.items[start].part is Part.END or flight.items[start].label == "end":
            assert not placed
            continue
        assert landings
        # After a landing only that landing follows.
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
    """Flown on PX4 1.18: with a last item without a position it finishes, landed, and disarms."""
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
    assert flight.is_item_reachable_without_jump(first, flight.entry_of_outbound[0])
    assert flight.is_item_reachable_without_jump(flight.takeoff, flight.settle)
    assert not flight.is_item_reachable_without_jump(first, second)
    assert not flight.is_item_reachable_without_jump(flight.settle, first)
    assert not flight.is_item_reachable_without_jump(flight.returning[0], flight.deliver)


def test_an_item_of_the_way_home_shows_no_jump_outward_though_it_follows_one():
    # Flown on ArduCopter: sent onward again on the return route, the previously reported item was
    # mistaken for the jump's result, and the flight for one that returned by itself.
    flight = mission()
    out, home = flight.outbound[1], flight.entry_of_outbound[1]
    assert flight.is_item_reachable_without_jump(out, home)
    onward = JumpMonitor(out, JumpType.ONWARD, 0.0)
    assert not onward.is_confirmed_by_report(flight, home, 0.1)
    assert onward.is_confirmed_by_report(flight, out, 0.2)
    assert onward.is_confirmed_by_report(flight, out + 1, 0.2)
    back = JumpMonitor(home, JumpType.HOME, 0.0)
    assert back.is_confirmed_by_report(flight, home + 1, 0.1)


def test_a_report_that_may_be_older_than_the_jump_says_nothing_of_it():
    flight = mission()
    out, home = flight.outbound[1], flight.entry_of_outbound[1]
    again = JumpMonitor(out, JumpType.ONWARD, 10.0, previous_items=frozenset({out, home}))
    assert not again.is_confirmed_by_report(flight, out, 10.4), (
        "overtaken by the one that said: homeward"
    )
    assert again.is_confirmed_by_report(flight, out, 11.2)
    assert again.is_possibly_stale_item(flight, home)
    assert not again.is_possibly_stale_item(flight, out)
    assert JumpMonitor(out, JumpType.ONWARD, 10.0).is_confirmed_by_report(flight, out, 10.1), (
        "not flown before"
    )


@pytest.mark.parametrize("reported", [True, False])
def test_a_jump_is_repeated_while_the_item_is_reported_unchanged_and_then_abandoned(reported):
    jump, found = JumpMonitor(4, JumpType.HOME, 0.0), []
    for tenth in range(150):
        jump.unchanged_s = tenth / 10.0 if reported else 0.0
        status = jump.update_retry_status(tenth / 10.0)
        found += [] if status is JumpStatus.WAITING else [(tenth / 10.0, status)]
        if status is JumpStatus.REFUSED:
            break
    times, statuses = zip(*found, strict=True)
    interval_s, status = (1.5, JumpStatus.REPEAT) if reported else (2.5, JumpStatus.UNREPORTED)
    assert times == pytest.approx([interval_s * n for n in range(1, 6)])
    assert statuses == (*[status] * 4, JumpStatus.REFUSED)


def test_a_jump_is_repeated_only_at_a_report_of_the_unchanged_item():
    jump = JumpMonitor(4, JumpType.HOME, 0.0, unchanged_s=1.0)
    assert jump.update_retry_status(1.6) is JumpStatus.WAITING, "may have changed since"
    jump.unchanged_s = 2.0
    assert jump.update_retry_status(2.1) is JumpStatus.REPEAT


def test_the_spot_of_an_item_without_a_place_is_where_the_mission_flies_next():
    flight = mission(entries=[3, 2, 1])
    jump = flight.outbound[0] + 2
    assert flight.position_at_or_after_item(jump) == flight.items[flight.returning[3]].spot
    assert flight.position_at_or_after_item(len(flight.items)) is None


def test_a_way_home_that_does_not_exist_is_refused():
    with pytest.raises(LeewayError, match="return entr"):
        mission(3, 0, [0, 0, 9])
    over = MissionPosition(0, 0, 40)
    with pytest.raises(LeewayError, match="home speed"):
        build_return_by_default_mission(
            landing_position=MissionPosition(0, 0, 0), outbound=[over],
            drop_position=MissionPosition(0, 0, 6),
            returning=[over, over],
            return_entry_by_outbound=[1], rally_overhead_and_ground=[], home_speed_mps=math.nan,
            **TIMES,
        )  # fmt: skip


# --- the wire and the read-back ------------------------------------------------------------------


def aboard(
    flight: ReturnByDefaultMission, home_items: int, **changes: object
) -> list[SimpleNamespace]:
    """Return the mission as MISSION_ITEM_INT messages of an autopilot that stores it unchanged."""
    home = MissionPosition(55.47, 8.45, 12.0)
    wire = encode_mission_items(
        flight.items, home_item_count=home_items, home=home, autopilot_chosen_yaw_value=math.nan
    )
    messages = [
        SimpleNamespace(
            seq=seq, frame=item.frame, command=item.command, x=item.x, y=item.y, z=item.z,
            **{f"param{k}": value for k, value in enumerate(item.params, 1)},
        )
        for seq, item in enumerate(wire)
    ]  # fmt: skip
    for message in messages:
        for name, change in changes.items():
            setattr(message, name, change(getattr(message, name)))  # type: ignore[operator]
    return messages


def read(messages: list[SimpleNamespace], home_items: int) -> list:
    return [decode_mission_item(m, home_item_count=home_items) for m in messages][home_items:]


@pytest.mark.parametrize("home_items", [0, 1])
def test_a_mission_that_came_back_as_it_went_shows_no_difference(home_items):
    flight = mission()
    assert mission_differences(flight.items, read(aboard(flight, home_items), home_items)) == ()
    cut = mission_differences(flight.items, flight.items[:-1])
    assert cut == (f"{len(flight.items) - 1} items onboard, {len(flight.items)} uploaded",)


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
    assert mission_differences(flight.items, read(messages, 1)) == ()


def test_jumps_are_numbered_as_the_autopilot_counts():
    # ArduPilot stores its home at 0, so that each item and jump target is one higher.
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
    found = mission_differences(flight.items, read(messages, 0))
    assert len(found) == 1
    assert found[0].startswith(f"item {index} ")
