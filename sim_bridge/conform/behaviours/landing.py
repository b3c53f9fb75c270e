"""Landings that somebody disturbs, and waypoints that are passed out of their height."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import Behaviour, Finding, Value, Where
from sim_bridge.conform.behaviours.mission import LAND, TAKEOFF, waypoint
from sim_bridge.conform.behaviours.mission_flight import fly_straight, start_mission
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.missions import Item, Uploaded
from sim_bridge.conform.subject import HEIGHT_M, Subject, position_in

_HIGH_M, _SINKS_FROM_M = 14.0, 8.0
_LAND = 2
"""LAND's place in the list, counted from the first real item."""
_ALT_RADIUS = "NAV_MC_ALT_RAD"
_LEVEL_M, _STEEP_M, _AWAY_M = 40.0, 60.0, 300.0
_SUNK_M, _CLIMBED_M = 18.0, 50.0
"""Over the second leg: a descent that at 8 m/s of way ends some metres short, a climb far short."""
_TURNS_MPS = 0.5
_FAST_MPS = 8.0
_BEYOND_M = 40.0
"""So far beyond a waypoint no radius of acceptance reaches."""


def _list(s: Subject) -> list[Item]:
    """Up, a waypoint, and down there."""
    return [
        Item(TAKEOFF, *s.place(0.0, 0.0), _HIGH_M, param4=math.nan),
        waypoint(s, 15.0, 0.0, _HIGH_M),
        Item(LAND, *s.place(15.0, 0.0), 0.0),
    ]


def _seq(s: Subject) -> int:
    """MISSION_CURRENT, counted from the first real item."""
    message = s.client.latest.get("MISSION_CURRENT")
    if message is None:
        raise CannotSee("no MISSION_CURRENT comes")
    return message.seq - s.first_seq()


def _rel_m(s: Subject) -> float:
    return s.client.latest["GLOBAL_POSITION_INT"].relative_alt * 1e-3


def _sinks(s: Subject, into_m: float) -> None:
    """The list flown until it is in its landing, `into_m` above the ground."""
    done = s.upload(_list(s))
    if done.ack != "ACCEPTED":
        raise CannotSee(f"the mission was not taken: {done.ack}")
    start_mission(s)
    if not s.client.until(lambda: _seq(s) == _LAND and _rel_m(s) < into_m, 90.0):
        raise CannotSee(f"it does not come to land: {s.mode}, item {_seq(s)}, {_rel_m(s):.1f} m")


@dataclass(frozen=True, slots=True)
class _Disturbed:
    """A landing in the mission amid which a list was uploaded."""

    ack: str
    index: Finding
    end: Finding


def _watch_end(s: Subject) -> Finding:
    """Whether it comes down and disarms, or rises again; the mode that it is in then."""
    lowest = [_rel_m(s)]

    def is_over() -> bool:
        lowest[0] = min(lowest[0], _rel_m(s))
        return not s.is_armed or _rel_m(s) > lowest[0] + 3.0

    over = s.client.until(is_over, 60.0)
    word = "comes down and disarms" if not s.is_armed else "rises" if over else "stays armed"
    return Finding(word, f"{_rel_m(s):.1f} m after {lowest[0]:.1f} m, {s.mode}")


def _disturb(s: Subject, items: Callable[[Subject], list[Item]]) -> _Disturbed:
    _sinks(s, _SINKS_FROM_M)
    done: Uploaded = s.upload(items(s))
    s.client.collect(2.5)
    at = _seq(s)
    kept = "kept" if at == _LAND else f"now {at}"
    index = Finding(f"{kept}, {s.mode}", f"{_rel_m(s):.1f} m")
    return _Disturbed(done.ack, index, _watch_end(s))


def _longer(s: Subject) -> list[Item]:
    """The same list with two waypoints and a landing behind its landing."""
    more = [waypoint(s, 60.0, 0.0, _HIGH_M), waypoint(s, 60.0, 30.0, _HIGH_M)]
    return [*_list(s), *more, Item(LAND, *s.place(60.0, 30.0), 0.0)]


def _shorter(s: Subject) -> list[Item]:
    return _list(s)[:2]


def _of(
    name: str, items: Callable[[Subject], list[Item]], what: str
) -> Callable[[Subject], Finding | Value]:
    def see(s: Subject) -> Finding | Value:
        key = f"a landing amid which the {name} list is uploaded"
        seen = cast(_Disturbed, s.remember(key, lambda: _disturb(s, items)))
        return getattr(seen, what)

    return see


def _land_by_command(s: Subject) -> Finding:
    """A longer list amid the landing, then LAND by command."""
    _sinks(s, _SINKS_FROM_M)
    s.upload(_longer(s))
    answer = s.set_mode("LAND")
    s.client.until(lambda: s.mode == "LAND", 3.0)
    entered = s.mode
    end = _watch_end(s)
    return Finding(f"{answer}, {entered}, {end.value}", f"{end.note}, item {_seq(s)}")


def _steep(s: Subject, from_m: float, to_m: float) -> Finding:
    """A level leg, a steep one, a level one, all straight on: what it does about the end of the
    steep one. (To the height of its first waypoint PX4 climbs before it sets out.)
    """
    items = [
        waypoint(s, _LEVEL_M, 0.0, from_m),
        waypoint(s, _LEVEL_M + _STEEP_M, 0.0, to_m),
        waypoint(s, _AWAY_M, 0.0, to_m),
    ]
    fly_straight(s, items, at_mps=2.0, within_s=60.0)
    s.client.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, _FAST_MPS, -1.0)
    off_m, turned = [math.nan], [False]

    def is_over() -> bool:
        here = position_in(s.client.latest["GLOBAL_POSITION_INT"])
        beyond_m = s.from_home_m(here)[0] - _LEVEL_M - _STEEP_M
        turned[0] = turned[0] or (beyond_m > 0.0 and here.vel_ned_mps[0] < -_TURNS_MPS)
        if not turned[0] and beyond_m < 0.0:
            off_m[0] = here.rel_m - to_m
        return _seq(s) > 1 or beyond_m > _BEYOND_M

    over = s.client.until(is_over, 60.0)
    if _seq(s) > 1:
        word = "turns back, taken" if turned[0] else "taken"
    else:
        word = "not taken, flies on" if over else "not taken, stays"
    return Finding(word, f"{off_m[0]:+.1f} m as it passed, then {_rel_m(s):.1f} m, {s.mode}")


def _sinking(s: Subject) -> Finding:
    return _steep(s, HEIGHT_M + _SUNK_M, HEIGHT_M)


def _climbing(s: Subject) -> Finding:
    return _steep(s, HEIGHT_M, HEIGHT_M + _CLIMBED_M)


def _steep_allowed(s: Subject) -> Finding:
    """The same with the setting that says how far off its height a waypoint is taken."""
    if not s.is_px4:
        return Finding("there is no such setting")
    s.set_parameter(_ALT_RADIUS, _SUNK_M)
    return _sinking(s)


BEHAVIOURS = (
    Behaviour(
        "landing/longer",
        "Amid a landing the list with more behind it, uploaded anew, is",
        _of("longer", _longer, "ack"),
        Where.FLIGHT,
    ),
    Behaviour(
        "landing/longer_index",
        "The item that is flown, after it, is",
        _of("longer", _longer, "index"),
        Where.FLIGHT,
    ),
    Behaviour(
        "landing/longer_end",
        "At LAND, with more behind it now, it",
        _of("longer", _longer, "end"),
        Where.FLIGHT,
    ),
    Behaviour(
        "landing/shorter",
        "Amid a landing a list without the landing is",
        _of("shorter", _shorter, "ack"),
        Where.FLIGHT,
    ),
    Behaviour(
        "landing/shorter_index",
        "The item that is flown, after that, is",
        _of("shorter", _shorter, "index"),
        Where.FLIGHT,
    ),
    Behaviour(
        "landing/shorter_end",
        "With its landing gone from the list it",
        _of("shorter", _shorter, "end"),
        Where.FLIGHT,
    ),
    Behaviour(
        "landing/by_command",
        "LAND by command, the list longer since, is",
        _land_by_command,
        Where.FLIGHT,
    ),
    Behaviour(
        "height/out",
        "A waypoint that it would pass far below its height is",
        _climbing,
        Where.AIR,
    ),
    Behaviour(
        "height/allowed",
        "Some metres above its height, with NAV_MC_ALT_RAD allowing it, it is",
        _steep_allowed,
        Where.AIR,
    ),
)
