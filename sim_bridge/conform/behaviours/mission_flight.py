"""Missions in the air: replacement, interruption, jumps, pauses, detours, and a whole flight."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.behaviour import Behaviour, Finding, Value, Where
from sim_bridge.conform.behaviours.mission import LAND, LOITER_TIME, TAKEOFF, WAYPOINT, waypoint
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.missions import Item
from sim_bridge.conform.subject import HEIGHT_M, Subject

_AWAY_M = 300.0
_SLOW_MPS = 1.0
_TRIGGER = mavlink.MAV_CMD_DO_TRIGGER_CONTROL
_ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def _straight(s: Subject) -> list[Item]:
    """Three waypoints in a line to the north, so far that none is reached during the test."""
    return [waypoint(s, _AWAY_M + 40.0 * n, 0.0, HEIGHT_M) for n in range(3)]


def fly_straight(
    s: Subject,
    items: list[Item] | None = None,
    *,
    at_mps: float = 3.0,
    within_s: float = 15.0,
) -> None:
    """A mission in the air, flown until it is under way at speed."""
    done = s.upload(items or _straight(s))
    if done.ack != "ACCEPTED":
        raise CannotSee(f"the mission was not taken: {done.ack}")
    s.client.send("MISSION_SET_CURRENT", seq=s.first_seq())
    s.client.collect(0.5)
    s.enter(s.dialect.mission)
    if not s.client.until(lambda: _speed(s) > at_mps, within_s):
        raise CannotSee("the mission does not get under way")
    s.client.collect(1.5)


def _speed(s: Subject) -> float:
    message = s.client.latest["GLOBAL_POSITION_INT"]
    return math.hypot(message.vx, message.vy) * 0.01


def _north_speed(s: Subject) -> float:
    return s.client.latest["GLOBAL_POSITION_INT"].vx * 0.01


def _seq(s: Subject) -> int:
    message = s.client.latest.get("MISSION_CURRENT")
    if message is None:
        raise CannotSee("no MISSION_CURRENT comes")
    return message.seq - s.first_seq()


def _slowest(s: Subject, for_s: float) -> float:
    """The lowest ground speed within a time."""
    heard = s.client.collect(for_s, "GLOBAL_POSITION_INT")
    return min(math.hypot(m.vx, m.vy) * 0.01 for m in heard)


def _jump(s: Subject) -> str:
    """DO_SET_MISSION_CURRENT to the third waypoint, in flight."""
    fly_straight(s)
    answer = s.client.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, float(s.first_seq() + 2))
    s.client.collect(2.5)
    return f"{answer}, {'there' if _seq(s) == 2 else 'not there'}"


def _set_current(s: Subject) -> str:
    fly_straight(s)
    s.client.send("MISSION_SET_CURRENT", seq=s.first_seq() + 2)
    s.client.collect(2.5)
    return "there" if _seq(s) == 2 else "not there"


def _brakes(s: Subject) -> Finding:
    """Ground speed after a jump to a waypoint straight ahead, against that before it."""
    fly_straight(s)
    before = _slowest(s, 1.0)
    s.client.send("MISSION_SET_CURRENT", seq=s.first_seq() + 2)
    after = _slowest(s, 4.0)
    word = "brakes" if after < 0.6 * before else "flies on"
    return Finding(word, f"{before:.1f} to {after:.1f} m/s")


def _pause(s: Subject) -> str:
    fly_straight(s)
    answer = s.client.command(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
    stopped = s.client.until(lambda: _speed(s) < _SLOW_MPS, 8.0)
    mode = s.mode
    if answer != "ACCEPTED":
        return f"{answer}, {'stops' if stopped else 'flies on'}"
    s.client.command(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
    goes_on = s.client.until(lambda: _speed(s) > 2.0, 8.0)
    rest = "goes on" if goes_on else "stays"
    return f"{answer}, {'stops' if stopped else 'flies on'} in {mode}, then {rest}"


def _detour(s: Subject) -> Finding:
    """The hold mode during the second leg, then the mission again."""
    fly_straight(s)
    s.client.send("MISSION_SET_CURRENT", seq=s.first_seq() + 1)
    s.client.collect(2.0)
    before = _seq(s)
    s.enter(s.dialect.hold)
    s.client.collect(3.0)
    s.enter(s.dialect.mission)
    s.client.collect(2.0)
    after = _seq(s)
    return Finding("at the same item" if after == before else "at another", f"{before} to {after}")


def _clear_in_flight(s: Subject) -> str:
    fly_straight(s)
    answer = missions.clear(s.client)
    s.client.collect(4.0)
    return f"{answer}, then {s.mode}"


def _replace(s: Subject) -> Finding:
    """Another mission of the same length while the second item is flown."""
    fly_straight(s)
    s.client.send("MISSION_SET_CURRENT", seq=s.first_seq() + 1)
    s.client.collect(2.0)
    other = [waypoint(s, -_AWAY_M, 40.0 * n, HEIGHT_M) for n in range(3)]
    done = s.upload(other)
    s.client.collect(3.0)
    kept = "kept" if _seq(s) == 1 else f"now {_seq(s)}"
    return Finding(f"{done.ack}, index {kept}, {s.mode}")


def _replace_after(s: Subject) -> float:
    """Time from the end of an upload to the first braking towards the new place."""
    fly_straight(s)
    s.client.collect(2.0)
    before = _north_speed(s)
    done = s.upload([waypoint(s, -_AWAY_M, 0.0, HEIGHT_M)] * 3)
    if done.ack != "ACCEPTED":
        raise CannotSee(f"the upload was {done.ack}")
    start_s = s.client.t_s
    if not s.client.until(lambda: _north_speed(s) < before - 1.0, 12.0):
        raise CannotSee("it does not turn round")
    return round(s.client.t_s - start_s, 1)


def _restart_text(s: Subject) -> bool:
    """Whether it says, for an upload in flight, that it restarted its command."""
    fly_straight(s)
    s.client.forget()
    s.upload(_straight(s))
    s.client.collect(2.0)
    return any("restarted command" in text for text in s.client.texts())


def _cut_in_flight(s: Subject) -> Finding:
    """An upload of other places that breaks off after two items, in the mission mode."""
    fly_straight(s)
    other = s.with_home([waypoint(s, -_AWAY_M, 40.0 * n, HEIGHT_M) for n in range(3)])
    missions.upload(s.client, other, only=2)
    s.client.collect(12.0)
    heading = "turned round" if _north_speed(s) < 0.0 else "flies as before"
    mode = s.mode
    stored = missions.download(s.client)
    if stored is None:
        raise CannotSee("no read-back")
    south = sum(m.x * 1e-7 < s.place(-40.0, 0.0)[0] for m in stored if m.command == WAYPOINT)
    word = "the old mission" if south == 0 else "a mixture"
    return Finding(f"{word}, {heading}, {mode}", f"{len(stored)} stored, {south} new")


def _partial_in_flight(s: Subject) -> str:
    """The last waypoint rewritten while the first is flown."""
    fly_straight(s)
    done = missions.write_partial(s.client, s.first_seq() + 2, [waypoint(s, 0.0, _AWAY_M)])
    s.client.collect(2.0)
    return f"{done.ack}, index {_seq(s)}, {s.mode}"


def _change_speed(kind: float, speed_mps: float) -> Callable[[Subject], Finding]:
    """DO_CHANGE_SPEED in a mission: its acknowledgement, and the speed 6 s after it."""

    def see(s: Subject) -> Finding:
        fly_straight(s)
        s.client.collect(3.0)
        before = _speed(s)
        answer = s.client.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, kind, speed_mps, -1.0)
        s.client.collect(6.0)
        after = _speed(s)
        flies = abs(after - speed_mps) < 0.7
        word = "flies it" if flies else "no change" if abs(after - before) < 1.0 else "another"
        return Finding(f"{answer}, {word}", f"{before:.1f} to {after:.1f} m/s")

    return see


def _speed_to_default(s: Subject) -> Finding:
    """Slowed to 2 m/s, then DO_CHANGE_SPEED with -1, and with 0."""
    fly_straight(s)
    s.client.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, 2.0, -1.0)
    s.client.until(lambda: _speed(s) < 2.6, 8.0)
    answers, speeds = [], []
    for value in (-1.0, 0.0):
        answers.append(s.client.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, value, -1.0))
        s.client.collect(6.0)
        speeds.append(_speed(s))
    words = ["faster" if speed > 3.2 else "as before" for speed in speeds]
    note = f"{speeds[0]:.1f}, then {speeds[1]:.1f} m/s"
    return Finding(f"-1: {answers[0]}, {words[0]}; 0: {answers[1]}, {words[1]}", note)


@dataclass(frozen=True, slots=True)
class _Flight:
    """A mission from the ground to the ground."""

    start: str
    climbed_m: float
    land_reached: Finding
    disarm_after_s: float
    mode_at_end: str
    reached_repeats: int
    asks_companions: Finding


def _whole_flight(s: Subject) -> _Flight:
    """Take-off, a waypoint, a short loiter, LAND 25 m beside it: from arming to disarming."""
    return cast(_Flight, s.remember("a whole flight", lambda: _fly_whole(s)))


def _fly_whole(s: Subject) -> _Flight:
    items = [
        Item(TAKEOFF, *s.place(0.0, 0.0), 12.0, param4=math.nan),
        waypoint(s, 25.0, 0.0, 12.0),
        Item(LOITER_TIME, *s.place(25.0, 0.0), 12.0, param1=2.0),
        Item(LAND, *s.place(25.0, 25.0), 0.0),
    ]
    done = s.upload(items)
    if done.ack != "ACCEPTED":
        raise CannotSee(f"the mission was not taken: {done.ack}")
    client = s.client
    client.forget()
    client.beat(client.companion)
    start = start_mission(s)
    client.beat(client.companion)
    if not client.until(lambda: not s.is_armed and s.is_on_ground, 150.0):
        raise CannotSee(f"it did not come down: {s.mode}; {'; '.join(client.texts()[-4:])}")
    client.collect(1.5)
    land_seq = s.first_seq() + 3
    reached = [m for m in client.heard if m.get_type() == "MISSION_ITEM_REACHED"]
    states = [m for m in client.heard if m.get_type() == "EXTENDED_SYS_STATE"]
    beats = [m for m in client.heard if m.get_type() == "HEARTBEAT"]
    heights = [m.relative_alt for m in client.heard if m.get_type() == "GLOBAL_POSITION_INT"]
    down_s = _last_landing_s(states)
    off_s = next(m.heard_s for m in reversed(beats) if m.base_mode & _ARMED)
    first = s.first_seq() + 1
    own = {m.command for m in client.heard if m.get_type() == "COMMAND_LONG"}
    return _Flight(
        start,
        max(heights) * 1e-3,
        _where_reached([m.heard_s for m in reached if m.seq == land_seq], down_s),
        max(off_s - down_s, 0.0),
        s.mode,
        sum(m.seq == first for m in reached),
        Finding(_TRIGGER in own, _numbers(own)),
    )


def _numbers(commands: set[int]) -> str:
    return ", ".join(str(number) for number in sorted(commands)) or "none"


def _asked_in_air(s: Subject) -> str:
    """What a companion is told to do when the mission mode is left in the air."""
    fly_straight(s)
    s.client.beat(s.client.companion)
    s.client.collect(1.0)
    s.client.forget()
    s.enter(s.dialect.hold)
    s.client.collect(3.0)
    commands = {m.command for m in s.client.heard if m.get_type() == "COMMAND_LONG"}
    return _numbers(commands)


def start_mission(s: Subject) -> str:
    """PX4: arming in MISSION. ArduCopter: armed in GUIDED, AUTO, MISSION_START."""
    if s.is_px4:
        s.enter("MISSION")
        s.arm()
    else:
        s.arm()
        s.enter("AUTO")
        s.client.collect(1.0)
    airborne = s.client.until(lambda: not s.is_on_ground, 5.0)
    if airborne:
        return "armed and in the mission mode"
    answer = s.client.command(mavlink.MAV_CMD_MISSION_START)
    if not s.client.until(lambda: not s.is_on_ground, 15.0):
        raise CannotSee(f"the mission does not start: {answer}")
    return "MISSION_START"


def _last_landing_s(states: list) -> float:
    """When it was last seen to come from the air to the ground."""
    down_s = math.nan
    for before, after in itertools.pairwise(states):
        ground = mavlink.MAV_LANDED_STATE_ON_GROUND
        if after.landed_state == ground and before.landed_state != ground:
            down_s = after.heard_s
    return down_s


def _where_reached(times_s: list[float], down_s: float) -> Finding:
    if not times_s:
        return Finding("never")
    early_s = down_s - times_s[0]
    word = "in the air" if early_s > 1.0 else "on the ground"
    return Finding(word, f"{early_s:.1f} s before it says that it is on the ground")


def _field(name: str) -> Callable[[Subject], Finding | Value]:
    def see(s: Subject) -> Finding | Value:
        return getattr(_whole_flight(s), name)

    return see


def _disarm_after(s: Subject) -> Finding:
    """HEARTBEAT tells it with up to 1 s of lag."""
    value = _whole_flight(s).disarm_after_s
    return Finding("within 2 s" if value < 2.0 else "later", f"{value:.1f} s, by HEARTBEAT")


def _takeoff_item(s: Subject) -> Finding:
    climbed = _whole_flight(s).climbed_m
    return Finding("above home" if abs(climbed - 12.0) < 2.5 else "elsewhere", f"{climbed:.1f} m")


def _behind_land(s: Subject) -> tuple[str, Finding]:
    """Take-off, LAND here, then waypoints: what follows the landing, and where LAND is told."""

    def look() -> tuple[str, Finding]:
        items = [
            Item(TAKEOFF, *s.place(0.0, 0.0), 8.0, param4=math.nan),
            Item(LAND, *s.place(0.0, 0.0), 0.0),
            waypoint(s, 30.0, 0.0, 10.0),
            waypoint(s, 60.0, 0.0, 10.0),
        ]
        s.upload(items)
        client = s.client
        client.forget()
        start_mission(s)
        if not client.until(lambda: s.is_on_ground, 90.0):
            raise CannotSee("it did not land")
        again = client.until(lambda: not s.is_on_ground or not s.is_armed, 30.0)
        word = "disarms" if s.is_on_ground else "takes off again"
        land_seq = s.first_seq() + 1
        reached = [m for m in client.heard if m.get_type() == "MISSION_ITEM_REACHED"]
        states = [m for m in client.heard if m.get_type() == "EXTENDED_SYS_STATE"]
        told = [m.heard_s for m in reached if m.seq == land_seq]
        where = _where_reached(told, _last_landing_s(states))
        return word if again else "stays armed on the ground", where

    return cast(tuple[str, Finding], s.remember("an item behind LAND", look))


def _item_behind_land(s: Subject) -> str:
    return _behind_land(s)[0]


def _land_reached_amid(s: Subject) -> Finding:
    return _behind_land(s)[1]


def _mission_end_in_air(s: Subject) -> str:
    """A mission whose last item is a waypoint, 60 m from where it is."""
    north_m, east_m = s.from_home_m(s.position())
    fly_straight(s, [waypoint(s, north_m + 60.0, east_m, HEIGHT_M)])
    s.client.until(lambda: _speed(s) < _SLOW_MPS, 40.0)
    s.client.collect(4.0)
    return f"holds in {s.mode}" if _speed(s) < _SLOW_MPS else f"flies on in {s.mode}"


BEHAVIOURS = (
    Behaviour("mission_flight/jump", "DO_SET_MISSION_CURRENT in flight is", _jump, Where.AIR),
    Behaviour(
        "mission_flight/set_current", "MISSION_SET_CURRENT in flight is", _set_current, Where.AIR
    ),
    Behaviour("mission_flight/brakes", "Sent on before it is there, it", _brakes, Where.AIR),
    Behaviour("mission_flight/pause", "DO_PAUSE_CONTINUE is", _pause, Where.AIR),
    Behaviour(
        "mission_flight/detour", "After a detour to hold the mission goes on", _detour, Where.AIR
    ),
    Behaviour(
        "mission_flight/clear",
        "Clearing while the mission is flown is",
        _clear_in_flight,
        Where.AIR,
    ),
    Behaviour(
        "mission_flight/replace", "Another mission uploaded in flight is", _replace, Where.AIR
    ),
    Behaviour(
        "mission_flight/replace_after",
        "It turns to a new mission after",
        _replace_after,
        Where.AIR,
        unit="s",
        within=1.2,
    ),
    Behaviour(
        "mission_flight/restart_text",
        "It says that it restarted its command",
        _restart_text,
        Where.AIR,
    ),
    Behaviour(
        "mission_flight/cut", "After an upload that breaks off it has", _cut_in_flight, Where.AIR
    ),
    Behaviour(
        "mission_flight/partial", "A partial write in flight is", _partial_in_flight, Where.AIR
    ),
    Behaviour(
        "mission_flight/ends_in_air", "Behind a last waypoint it", _mission_end_in_air, Where.AIR
    ),
    Behaviour(
        "speed/ground",
        "DO_CHANGE_SPEED to 2 m/s, ground speed, is",
        _change_speed(1.0, 2.0),
        Where.AIR,
    ),
    Behaviour(
        "speed/air", "DO_CHANGE_SPEED to 2 m/s, airspeed, is", _change_speed(0.0, 2.0), Where.AIR
    ),
    Behaviour("speed/none", "DO_CHANGE_SPEED to -1 and to 0 is", _speed_to_default, Where.AIR),
    Behaviour("mission_flight/start", "A mission starts once it is", _field("start"), Where.FLIGHT),
    Behaviour(
        "mission_flight/takeoff", "NAV_TAKEOFF at 12 m, relative, ends", _takeoff_item, Where.FLIGHT
    ),
    Behaviour(
        "mission_flight/land_reached",
        "LAND 25 m from the last waypoint is told as reached",
        _field("land_reached"),
        Where.FLIGHT,
    ),
    Behaviour("mission_flight/disarms", "It disarms after landing", _disarm_after, Where.FLIGHT),
    Behaviour(
        "mission_flight/mode_at_end",
        "The mode after the landing is",
        _field("mode_at_end"),
        Where.FLIGHT,
    ),
    Behaviour(
        "mission_flight/reached_repeats",
        "MISSION_ITEM_REACHED for a waypoint comes so often",
        _field("reached_repeats"),
        Where.FLIGHT,
        within=3.0,
    ),
    Behaviour(
        "foreign/asked_in_air",
        "Commands sent to a companion when a mission is left in the air",
        _asked_in_air,
        Where.AIR,
    ),
    Behaviour(
        "foreign/asks_companions",
        "A companion is told to rest its camera by the end of a mission",
        _field("asks_companions"),
        Where.FLIGHT,
    ),
    Behaviour(
        "mission_flight/behind_land",
        "At LAND with a waypoint behind it, it",
        _item_behind_land,
        Where.FLIGHT,
    ),
    Behaviour(
        "mission_flight/land_reached_amid",
        "LAND below, with a waypoint behind it, is told as reached",
        _land_reached_amid,
        Where.FLIGHT,
    ),
)
