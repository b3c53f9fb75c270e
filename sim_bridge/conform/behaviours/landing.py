"""Interrupted landings, and waypoints that are passed at the wrong height."""

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import AIR, FLIGHT, Behaviours, Observation, field_of
from sim_bridge.conform.behaviours.mission import LAND, TAKEOFF, WAYPOINT
from sim_bridge.conform.behaviours.mission_flight import (
    start_mission_from_ground,
    start_straight_mission,
)
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.missions import Item
from sim_bridge.conform.subject import HEIGHT_M, Subject, observed_once

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

_HIGH_M, _SINKS_FROM_M = 14.0, 8.0
_LAND = 2
"""Index of LAND in the list, counted from the first real item."""
_ALT_RADIUS = "NAV_MC_ALT_RAD"
_LEVEL_M, _STEEP_M, _AWAY_M = 40.0, 60.0, 300.0
_SUNK_M, _CLIMBED_M = 18.0, 50.0
"""Height change over the second leg: at 8 m/s ground speed a descent ends some metres short of its
height, a climb far short."""
_REVERSAL_SPEED_MPS = 0.5
_FAST_MPS = 8.0
_OVERSHOOT_M = 40.0
"""Distance past a waypoint that exceeds any acceptance radius."""


def _landing_mission_items(subject: Subject) -> list[Item]:
    """Return a take-off, a waypoint and a landing there."""
    return [
        subject.item(TAKEOFF, 0.0, 0.0, _HIGH_M, param4=math.nan),
        subject.item(WAYPOINT, 15.0, 0.0, _HIGH_M),
        subject.item(LAND, 15.0, 0.0),
    ]


def _fly_mission_until_landing_below(subject: Subject, height_above_home_m: float) -> None:
    """Fly the list until its landing is `height_above_home_m` above the ground."""
    subject.upload_accepted(_landing_mission_items(subject))
    start_mission_from_ground(subject)
    if not subject.client.wait_until(
        lambda: (
            subject.current_item_index() == _LAND
            and subject.latest_position().rel_m < height_above_home_m
        ),
        90.0,
    ):
        raise ObservationError(
            f"it does not come to land: {subject.mode}, item {subject.current_item_index()},"
            f" {subject.latest_position().rel_m:.1f} m"
        )


@dataclass(frozen=True, slots=True)
class _InterruptedLanding:
    """A mission landing during which a list was uploaded."""

    ack: str
    index: Observation
    end: Observation


def _wait_for_disarm_or_climb(subject: Subject) -> Observation:
    """Watch for landing and disarming, or a climb; report the mode at that time."""
    lowest = [subject.latest_position().rel_m]

    def record_lowest_and_test_end() -> bool:
        lowest[0] = min(lowest[0], subject.latest_position().rel_m)
        return not subject.is_armed or subject.latest_position().rel_m > lowest[0] + 3.0

    over = subject.client.wait_until(record_lowest_and_test_end, 60.0)
    word = "comes down and disarms" if not subject.is_armed else "rises" if over else "stays armed"
    return Observation(
        word,
        f"{subject.latest_position().rel_m:.1f} m after {lowest[0]:.1f} m, {subject.mode}",
    )


def _upload_during_landing(subject: Subject, items: list[Item]) -> _InterruptedLanding:
    _fly_mission_until_landing_below(subject, _SINKS_FROM_M)
    ack = subject.upload(items).ack
    subject.client.collect_messages(2.5)
    at = subject.current_item_index()
    kept = "kept" if at == _LAND else f"now {at}"
    observed = Observation(f"{kept}, {subject.mode}", f"{subject.latest_position().rel_m:.1f} m")
    return _InterruptedLanding(ack, observed, _wait_for_disarm_or_climb(subject))


def _extended_mission_items(subject: Subject) -> list[Item]:
    """The same list with two waypoints and a landing behind its landing."""
    return [
        *_landing_mission_items(subject),
        subject.item(WAYPOINT, 60.0, 0.0, _HIGH_M),
        subject.item(WAYPOINT, 60.0, 30.0, _HIGH_M),
        subject.item(LAND, 60.0, 30.0),
    ]


@observed_once
def _upload_longer(subject: Subject) -> _InterruptedLanding:
    return _upload_during_landing(subject, _extended_mission_items(subject))


@observed_once
def _upload_shorter(subject: Subject) -> _InterruptedLanding:
    return _upload_during_landing(subject, _landing_mission_items(subject)[:2])


@behaviour("landing/by_command", "LAND by command after an extended list is", FLIGHT)
def _observe_land_command_after_upload(subject: Subject) -> Observation:
    """Upload a longer list during the landing, then command LAND."""
    _fly_mission_until_landing_below(subject, _SINKS_FROM_M)
    subject.upload(_extended_mission_items(subject))
    response = subject.request_mode("LAND")
    subject.client.wait_until(lambda: subject.mode == "LAND", 3.0)
    initial_mode = subject.mode
    end = _wait_for_disarm_or_climb(subject)
    return Observation(
        f"{response}, {initial_mode}, {end.value}",
        f"{end.note}, item {subject.current_item_index()}",
    )


def _observe_steep_leg(subject: Subject, start_height_m: float, end_height_m: float) -> Observation:
    """A level leg, a steep one, a level one, all straight on: what it does about the end of the
    steep one. (To the height of its first waypoint PX4 climbs before it sets out.)
    """
    items = [
        subject.item(WAYPOINT, _LEVEL_M, 0.0, start_height_m),
        subject.item(WAYPOINT, _LEVEL_M + _STEEP_M, 0.0, end_height_m),
        subject.item(WAYPOINT, _AWAY_M, 0.0, end_height_m),
    ]
    start_straight_mission(subject, items, min_speed_mps=2.0, timeout_s=60.0)
    subject.client.send_command_and_wait_ack(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, _FAST_MPS, -1.0)
    off_m, has_reversed = [math.nan], [False]

    def record_pass_and_test_end() -> bool:
        here = subject.latest_position()
        overshoot_m = subject.offset_from_home_ne_m(here)[0] - _LEVEL_M - _STEEP_M
        has_reversed[0] = has_reversed[0] or (
            overshoot_m > 0.0 and here.vel_ned_mps[0] < -_REVERSAL_SPEED_MPS
        )
        if not has_reversed[0] and overshoot_m < 0.0:
            off_m[0] = here.rel_m - end_height_m
        return subject.current_item_index() > 1 or overshoot_m > _OVERSHOOT_M

    over = subject.client.wait_until(record_pass_and_test_end, 60.0)
    if subject.current_item_index() > 1:
        word = "turns back, taken" if has_reversed[0] else "taken"
    else:
        word = "not taken, flies on" if over else "not taken, stays"
    return Observation(
        word,
        f"{off_m[0]:+.1f} m as it passed, then {subject.latest_position().rel_m:.1f} m,"
        f" {subject.mode}",
    )


@behaviour("height/out", "A waypoint that it would pass far below its height is", AIR)
def _observe_steep_climb_leg(subject: Subject) -> Observation:
    return _observe_steep_leg(subject, HEIGHT_M, HEIGHT_M + _CLIMBED_M)


@behaviour(
    "height/allowed", "Some metres above its height, with NAV_MC_ALT_RAD allowing it, it is", AIR
)
def _observe_descent_with_wide_acceptance(subject: Subject) -> Observation:
    """Test the steep leg with the parameter that sets the vertical acceptance distance."""
    if not subject.is_px4:
        return Observation("there is no such setting")
    subject.parameters.set_until_restored(_ALT_RADIUS, _SUNK_M)
    return _observe_steep_leg(subject, HEIGHT_M + _SUNK_M, HEIGHT_M)


for _name, _description, _observe, _field in (
    ("landing/longer", "An extended list uploaded during a landing is", _upload_longer, "ack"),
    ("landing/longer_index", "The item that is flown, after it, is", _upload_longer, "index"),
    ("landing/longer_end", "At LAND, with more behind it now, it", _upload_longer, "end"),
    ("landing/shorter", "Amid a landing a list without the landing is", _upload_shorter, "ack"),
    ("landing/shorter_index", "The item that is flown, after that, is", _upload_shorter, "index"),
    ("landing/shorter_end", "With its landing gone from the list it", _upload_shorter, "end"),
):
    BEHAVIOURS.add(_name, _description, field_of(_observe, _field), FLIGHT)
