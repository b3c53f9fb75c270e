"""Missions in the air: replacement, interruption, jumps, pauses, detours, and a whole flight."""

import itertools
import math
from dataclasses import dataclass
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.behaviour import AIR, FLIGHT, Behaviours, Observation, field_of
from sim_bridge.conform.behaviours.mission import (
    LAND,
    LOITER_TIME,
    TAKEOFF,
    WAYPOINT,
    count_stored_and_southern,
)
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.missions import Item
from sim_bridge.conform.subject import HEIGHT_M, Subject, observed_once

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

_AWAY_M = 300.0
_SLOW_MPS = 1.0
_TRIGGER = mavlink.MAV_CMD_DO_TRIGGER_CONTROL
_CHANGE_SPEED = mavlink.MAV_CMD_DO_CHANGE_SPEED
_PAUSE_CONTINUE = mavlink.MAV_CMD_DO_PAUSE_CONTINUE
_ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def _straight_mission_items(subject: Subject) -> list[Item]:
    """Three waypoints in a line to the north, so far that none is reached during the test."""
    return [subject.item(WAYPOINT, _AWAY_M + 40.0 * n, 0.0, HEIGHT_M) for n in range(3)]


def _southern_mission_items(subject: Subject) -> list[Item]:
    """As many waypoints in the opposite direction."""
    return [subject.item(WAYPOINT, -_AWAY_M, 40.0 * n, HEIGHT_M) for n in range(3)]


def start_straight_mission(
    subject: Subject,
    items: list[Item] | None = None,
    *,
    min_speed_mps: float = 3.0,
    timeout_s: float = 15.0,
) -> None:
    """Upload and start a mission in the air; return when it flies at speed."""
    subject.upload_accepted(items or _straight_mission_items(subject))
    subject.client.send("MISSION_SET_CURRENT", seq=subject.first_flown_seq())
    subject.client.collect_messages(0.5)
    subject.set_mode_and_wait(subject.dialect.mission)
    if not subject.client.wait_until(
        lambda: subject.latest_position().speed_mps > min_speed_mps, timeout_s
    ):
        raise ObservationError("the mission does not get under way")
    subject.client.collect_messages(1.5)


def _latest_north_speed_mps(subject: Subject) -> float:
    return subject.latest_position().vel_ned_mps[0]


def _min_ground_speed_mps(subject: Subject, duration_s: float) -> float:
    """The lowest ground speed within a time."""
    positions = subject.client.collect_messages(duration_s, "GLOBAL_POSITION_INT")
    return min(math.hypot(m.vx, m.vy) * 0.01 for m in positions)


@behaviour("mission_flight/jump", "DO_SET_MISSION_CURRENT in flight is", AIR)
def _observe_jump_command(subject: Subject) -> str:
    """DO_SET_MISSION_CURRENT to the third waypoint, in flight."""
    start_straight_mission(subject)
    response = subject.client.send_command_and_wait_ack(
        mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, float(subject.first_flown_seq() + 2)
    )
    subject.client.collect_messages(2.5)
    return f"{response}, {'there' if subject.current_item_index() == 2 else 'not there'}"


@behaviour("mission_flight/set_current", "MISSION_SET_CURRENT in flight is", AIR)
def _observe_set_current(subject: Subject) -> str:
    start_straight_mission(subject)
    subject.client.send("MISSION_SET_CURRENT", seq=subject.first_flown_seq() + 2)
    subject.client.collect_messages(2.5)
    return "there" if subject.current_item_index() == 2 else "not there"


@behaviour("mission_flight/brakes", "Sent on before it is there, it", AIR)
def _observe_braking_after_jump(subject: Subject) -> Observation:
    """Compare ground speeds before and after a jump to a waypoint in the direction of flight."""
    start_straight_mission(subject)
    before = _min_ground_speed_mps(subject, 1.0)
    subject.client.send("MISSION_SET_CURRENT", seq=subject.first_flown_seq() + 2)
    after = _min_ground_speed_mps(subject, 4.0)
    word = "brakes" if after < 0.6 * before else "flies on"
    return Observation(word, f"{before:.1f} to {after:.1f} m/s")


@behaviour("mission_flight/pause", "DO_PAUSE_CONTINUE is", AIR)
def _observe_pause_and_continue(subject: Subject) -> str:
    start_straight_mission(subject)
    response = subject.client.send_command_and_wait_ack(_PAUSE_CONTINUE, 0.0)
    is_stationary = subject.client.wait_until(
        lambda: subject.latest_position().speed_mps < _SLOW_MPS, 8.0
    )
    mode = subject.mode
    if response != "ACCEPTED":
        return f"{response}, {'stops' if is_stationary else 'flies on'}"
    subject.client.send_command_and_wait_ack(_PAUSE_CONTINUE, 1.0)
    is_continuing = subject.client.wait_until(
        lambda: subject.latest_position().speed_mps > 2.0, 8.0
    )
    rest = "goes on" if is_continuing else "stays"
    return f"{response}, {'stops' if is_stationary else 'flies on'} in {mode}, then {rest}"


@behaviour("mission_flight/detour", "After a detour to hold the mission goes on", AIR)
def _observe_item_after_hold_detour(subject: Subject) -> Observation:
    """The hold mode during the second leg, then the mission again."""
    start_straight_mission(subject)
    subject.client.send("MISSION_SET_CURRENT", seq=subject.first_flown_seq() + 1)
    subject.client.collect_messages(2.0)
    before = subject.current_item_index()
    subject.set_mode_and_wait(subject.dialect.hold)
    subject.client.collect_messages(3.0)
    subject.set_mode_and_wait(subject.dialect.mission)
    subject.client.collect_messages(2.0)
    after = subject.current_item_index()
    return Observation(
        "at the same item" if after == before else "at another", f"{before} to {after}"
    )


@behaviour("mission_flight/clear", "Clearing while the mission is flown is", AIR)
def _observe_clear_in_flight(subject: Subject) -> str:
    start_straight_mission(subject)
    response = missions.clear_stored_list(subject.client)
    subject.client.collect_messages(4.0)
    return f"{response}, then {subject.mode}"


@behaviour("mission_flight/replace", "Another mission uploaded in flight is", AIR)
def _observe_replacement_in_flight(subject: Subject) -> Observation:
    """Another mission of the same length while the second item is flown."""
    start_straight_mission(subject)
    subject.client.send("MISSION_SET_CURRENT", seq=subject.first_flown_seq() + 1)
    subject.client.collect_messages(2.0)
    done = subject.upload(_southern_mission_items(subject))
    subject.client.collect_messages(3.0)
    kept = "kept" if subject.current_item_index() == 1 else f"now {subject.current_item_index()}"
    return Observation(f"{done.ack}, index {kept}, {subject.mode}")


@behaviour(
    "mission_flight/replace_after", "It turns to a new mission after", AIR, unit="s", within=1.2
)
def _measure_replacement_delay_s(subject: Subject) -> float:
    """Measure the time from the end of an upload to braking towards the new position."""
    start_straight_mission(subject)
    subject.client.collect_messages(2.0)
    before = _latest_north_speed_mps(subject)
    subject.upload_accepted([subject.item(WAYPOINT, -_AWAY_M, 0.0, HEIGHT_M)] * 3)
    start_s = subject.client.t_s
    if not subject.client.wait_until(lambda: _latest_north_speed_mps(subject) < before - 1.0, 12.0):
        raise ObservationError("it does not turn round")
    return round(subject.client.t_s - start_s, 1)


@behaviour("mission_flight/restart_text", "A text reports the restarted command", AIR)
def _is_restart_text_sent(subject: Subject) -> bool:
    """Report whether a text states that an upload in flight restarted the command."""
    start_straight_mission(subject)
    subject.client.clear_received()
    subject.upload(_straight_mission_items(subject))
    subject.client.collect_messages(2.0)
    return any("restarted command" in text for text in subject.client.status_texts())


@behaviour("mission_flight/cut", "After an upload that breaks off it has", AIR)
def _observe_interrupted_upload_in_flight(subject: Subject) -> Observation:
    """In the mission mode, upload other positions and stop after two items."""
    start_straight_mission(subject)
    subject.upload(_southern_mission_items(subject), max_items=2)
    subject.client.collect_messages(12.0)
    heading = "turned round" if _latest_north_speed_mps(subject) < 0.0 else "flies as before"
    mode = subject.mode
    count, south = count_stored_and_southern(subject)
    word = "the old mission" if south == 0 else "a mixture"
    return Observation(f"{word}, {heading}, {mode}", f"{count} stored, {south} new")


@behaviour("mission_flight/partial", "A partial write in flight is", AIR)
def _observe_partial_write_in_flight(subject: Subject) -> str:
    """The last waypoint rewritten while the first is flown."""
    start_straight_mission(subject)
    done = missions.write_partial(
        subject.client,
        subject.first_flown_seq() + 2,
        [subject.item(WAYPOINT, 0.0, _AWAY_M, HEIGHT_M)],
    )
    subject.client.collect_messages(2.0)
    return f"{done.ack}, index {subject.current_item_index()}, {subject.mode}"


def _observe_change_speed(speed_type: float, speed_mps: float, subject: Subject) -> Observation:
    """DO_CHANGE_SPEED in a mission: its acknowledgement, and the speed 6 s after it."""
    start_straight_mission(subject)
    subject.client.collect_messages(3.0)
    before = subject.latest_position().speed_mps
    response = subject.client.send_command_and_wait_ack(_CHANGE_SPEED, speed_type, speed_mps, -1.0)
    subject.client.collect_messages(6.0)
    after = subject.latest_position().speed_mps
    flies = abs(after - speed_mps) < 0.7
    word = "flies it" if flies else "no change" if abs(after - before) < 1.0 else "another"
    return Observation(f"{response}, {word}", f"{before:.1f} to {after:.1f} m/s")


@behaviour("speed/none", "DO_CHANGE_SPEED to -1 and to 0 is", AIR)
def _observe_default_speed_commands(subject: Subject) -> Observation:
    """Slowed to 2 m/s, then DO_CHANGE_SPEED with -1, and with 0."""
    start_straight_mission(subject)
    subject.client.send_command_and_wait_ack(_CHANGE_SPEED, 1.0, 2.0, -1.0)
    subject.client.wait_until(lambda: subject.latest_position().speed_mps < 2.6, 8.0)
    responses, speeds = [], []
    for value in (-1.0, 0.0):
        responses.append(subject.client.send_command_and_wait_ack(_CHANGE_SPEED, 1.0, value, -1.0))
        subject.client.collect_messages(6.0)
        speeds.append(subject.latest_position().speed_mps)
    words = ["faster" if speed > 3.2 else "as before" for speed in speeds]
    note = f"{speeds[0]:.1f}, then {speeds[1]:.1f} m/s"
    return Observation(f"-1: {responses[0]}, {words[0]}; 0: {responses[1]}, {words[1]}", note)


@dataclass(frozen=True, slots=True)
class _Flight:
    """A mission from the ground to the ground."""

    start: str
    takeoff: Observation
    land_reached: Observation
    disarms: Observation
    mode_at_end: str
    reached_repeats: int
    asks_companions: Observation


@observed_once
def _fly_mission(subject: Subject) -> _Flight:
    """Fly take-off, waypoint, short loiter and LAND 25 m away, from arming to disarming."""
    client = subject.client
    subject.upload_accepted(
        [
            subject.item(TAKEOFF, 0.0, 0.0, 12.0, param4=math.nan),
            subject.item(WAYPOINT, 25.0, 0.0, 12.0),
            subject.item(LOITER_TIME, 25.0, 0.0, 12.0, param1=2.0),
            subject.item(LAND, 25.0, 25.0),
        ]
    )
    client.clear_received()
    client.send_heartbeat(client.companion)
    start = start_mission_from_ground(subject)
    client.send_heartbeat(client.companion)
    if not client.wait_until(lambda: not subject.is_armed and subject.is_on_ground, 150.0):
        raise ObservationError(
            f"it did not come down: {subject.mode}; {'; '.join(client.status_texts()[-4:])}"
        )
    client.collect_messages(1.5)
    first = subject.first_flown_seq()
    climbed_m = 1e-3 * max(m.relative_alt for m in client.received_messages("GLOBAL_POSITION_INT"))
    beats = client.received_messages("HEARTBEAT")
    off_s = next(m.heard_s for m in reversed(beats) if m.base_mode & _ARMED)
    disarm_s = max(off_s - _last_landing_time_s(subject), 0.0)
    reached = client.received_messages("MISSION_ITEM_REACHED")
    own = {m.command for m in client.received_messages("COMMAND_LONG")}
    return _Flight(
        start,
        Observation(
            "above home" if abs(climbed_m - 12.0) < 2.5 else "elsewhere", f"{climbed_m:.1f} m"
        ),
        _classify_reached_time(subject, first + 3),
        Observation("within 2 s" if disarm_s < 2.0 else "later", f"{disarm_s:.1f} s, by HEARTBEAT"),
        subject.mode,
        sum(m.seq == first + 1 for m in reached),
        Observation(_TRIGGER in own, _format_command_numbers(own)),
    )


def _format_command_numbers(commands: set[int]) -> str:
    return ", ".join(str(number) for number in sorted(commands)) or "none"


@behaviour(
    "foreign/asked_in_air", "Commands sent to a companion when a mission is left in the air", AIR
)
def _commands_sent_at_mission_exit(subject: Subject) -> str:
    """Report the requests to a companion when the mission mode ends in the air."""
    start_straight_mission(subject)
    subject.client.send_heartbeat(subject.client.companion)
    subject.client.collect_messages(1.0)
    subject.client.clear_received()
    subject.set_mode_and_wait(subject.dialect.hold)
    subject.client.collect_messages(3.0)
    return _format_command_numbers(
        {m.command for m in subject.client.received_messages("COMMAND_LONG")}
    )


def start_mission_from_ground(subject: Subject) -> str:
    """PX4: arming in MISSION. ArduCopter: armed in GUIDED, AUTO, MISSION_START."""
    if subject.is_px4:
        subject.set_mode_and_wait("MISSION")
        subject.arm_with_retries()
    else:
        subject.arm_with_retries()
        subject.set_mode_and_wait("AUTO")
        subject.client.collect_messages(1.0)
    airborne = subject.client.wait_until(lambda: not subject.is_on_ground, 5.0)
    if airborne:
        return "armed and in the mission mode"
    response = subject.client.send_command_and_wait_ack(mavlink.MAV_CMD_MISSION_START)
    if not subject.client.wait_until(lambda: not subject.is_on_ground, 15.0):
        raise ObservationError(f"the mission does not start: {response}")
    return "MISSION_START"


def _last_landing_time_s(subject: Subject) -> float:
    """When it was last seen to come from the air to the ground."""
    down_s = math.nan
    states = subject.client.received_messages("EXTENDED_SYS_STATE")
    for before, after in itertools.pairwise(states):
        ground = mavlink.MAV_LANDED_STATE_ON_GROUND
        if after.landed_state == ground and before.landed_state != ground:
            down_s = after.heard_s
    return down_s


def _classify_reached_time(subject: Subject, seq: int) -> Observation:
    """Observe whether the item is reported as reached before the landing is."""
    reached = subject.client.received_messages("MISSION_ITEM_REACHED")
    reached_s = next((m.heard_s for m in reached if m.seq == seq), None)
    if reached_s is None:
        return Observation("never")
    early_s = _last_landing_time_s(subject) - reached_s
    word = "in the air" if early_s > 1.0 else "on the ground"
    return Observation(word, f"{early_s:.1f} s before it reports the ground contact")


@dataclass(frozen=True, slots=True)
class _Landing:
    """What follows LAND, and when LAND is reported as reached."""

    then: str
    reached: Observation


@observed_once
def _land_early(subject: Subject) -> _Landing:
    """Fly take-off, LAND and further waypoints."""
    subject.upload(
        [
            subject.item(TAKEOFF, 0.0, 0.0, 8.0, param4=math.nan),
            subject.item(LAND, 0.0, 0.0),
            subject.item(WAYPOINT, 30.0, 0.0, 10.0),
            subject.item(WAYPOINT, 60.0, 0.0, 10.0),
        ]
    )
    client = subject.client
    client.clear_received()
    start_mission_from_ground(subject)
    if not client.wait_until(lambda: subject.is_on_ground, 90.0):
        raise ObservationError("it did not land")
    again = client.wait_until(lambda: not subject.is_on_ground or not subject.is_armed, 30.0)
    word = "disarms" if subject.is_on_ground else "takes off again"
    reached = _classify_reached_time(subject, subject.first_flown_seq() + 1)
    return _Landing(word if again else "stays armed on the ground", reached)


@behaviour("mission_flight/ends_in_air", "Behind a last waypoint it", AIR)
def _observe_mission_end_in_air(subject: Subject) -> str:
    """A mission whose last item is a waypoint, 60 m from where it is."""
    north_m, east_m = subject.offset_from_home_ne_m(subject.wait_position())
    start_straight_mission(subject, [subject.item(WAYPOINT, north_m + 60.0, east_m, HEIGHT_M)])
    subject.client.wait_until(lambda: subject.latest_position().speed_mps < _SLOW_MPS, 40.0)
    subject.client.collect_messages(4.0)
    is_slow = subject.latest_position().speed_mps < _SLOW_MPS
    return f"{'holds' if is_slow else 'flies on'} in {subject.mode}"


add = BEHAVIOURS.add
_ground_speed, _airspeed = (partial(_observe_change_speed, kind, 2.0) for kind in (1.0, 0.0))
add("speed/ground", "DO_CHANGE_SPEED to 2 m/s, ground speed, is", _ground_speed, AIR)
add("speed/air", "DO_CHANGE_SPEED to 2 m/s, airspeed, is", _airspeed, AIR)
for _name, _description, _observe, _field in (
    ("mission_flight/start", "A mission starts once it is", _fly_mission, "start"),
    ("mission_flight/takeoff", "NAV_TAKEOFF at 12 m, relative, ends", _fly_mission, "takeoff"),
    ("mission_flight/disarms", "It disarms after landing", _fly_mission, "disarms"),
    (
        "mission_flight/land_reached",
        "LAND 25 m from the last waypoint is reported as reached",
        _fly_mission,
        "land_reached",
    ),
    ("mission_flight/mode_at_end", "The mode after the landing is", _fly_mission, "mode_at_end"),
    (
        "foreign/asks_companions",
        "The end of a mission commands a companion to stop its camera",
        _fly_mission,
        "asks_companions",
    ),
    ("mission_flight/behind_land", "At LAND with a waypoint behind it, it", _land_early, "then"),
    (
        "mission_flight/land_reached_amid",
        "LAND below, with a waypoint after it, is reported as reached",
        _land_early,
        "reached",
    ),
):
    add(_name, _description, field_of(_observe, _field), FLIGHT)
add(
    "mission_flight/reached_repeats",
    "MISSION_ITEM_REACHED for a waypoint comes so often",
    field_of(_fly_mission, "reached_repeats"),
    FLIGHT,
    within=3.0,
)
