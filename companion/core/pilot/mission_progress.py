"""Where in the mission the autopilot is, and jumps that are followed until it obeys."""

from __future__ import annotations

from typing import TYPE_CHECKING

from companion.core.base.geo import horizontal_m
from companion.core.mission.actions import (
    JumpTo,
    Note,
    SetMode,
    Severity,
)
from companion.core.mission.events import MissionProgress, Mode, OrderRefused
from companion.core.mission.mission_items import Part
from companion.core.pilot.jump_confirmation import CourseWatch, JumpWatch, Purpose, Verdict
from companion.core.pilot.mission_end import note_home, want
from companion.core.pilot.pilot_state import Move
from companion.core.pilot.telemetry_state import PROGRESS_MAX_AGE_S
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase, Trigger

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot


MOVE_WITNESSES = 2


def follow(pilot: Pilot, event: MissionProgress) -> None:
    """Take the autopilot's current item: what it flies is where we are in the mission."""
    air = pilot.air
    if pilot.phase not in FLIGHT_PHASES or pilot.flown is None or event.index is None:
        return
    mission = pilot.flown.mission
    state = pilot.now.state
    if (
        event.in_mission is False
        and pilot.phase not in (Phase.LAND, Phase.LAST_RESORT)
        and state is not None
        and state.armed
    ):
        pilot.fire(Trigger.TAKEN_OVER, "the autopilot left the mission")
        return
    if event.total is not None and event.total != len(mission.items):
        pilot.fire(Trigger.TAKEN_OVER, f"another mission aboard ({event.total} items)")
        return
    if air.jump is not None:
        if air.jump.look(mission, event.index, air.jump.ordered_s) is not Verdict.CONFIRMED:
            return  # the jump is under way; the tick asks again or gives up
        _jump_confirmed(pilot, event.index)
        return
    if event.index == air.index or pilot.phase is Phase.LAND:
        air.moved_to = None
        return
    if air.index is not None and not mission.follows(air.index, event.index):
        again = air.moved_to is not None and air.moved_to.index == event.index
        air.moved_to = Move(event.index, air.moved_to.told + 1 if again and air.moved_to else 1)
        return  # judged at the tick: after a silence it moved on by itself
    air.moved_to = None
    at_item(pilot, event.index)


def mind_foreign_moves(pilot: Pilot) -> bool:
    """Tell whether the mission may be in another hand; a hand that shows twice takes over.

    One message alone may be a late one from before our own jump: MISSION_CURRENT has no time.
    """
    moved_to, now = pilot.air.moved_to, pilot.now
    if not now.is_fresh(now.progress, PROGRESS_MAX_AGE_S):
        pilot.air.moved_to = None
        return False
    if moved_to is not None and moved_to.told >= MOVE_WITNESSES:
        pilot.air.moved_to = None
        pilot.fire(Trigger.TAKEN_OVER, f"somebody moved the mission to item {moved_to.index}")
    return moved_to is not None


def at_item(pilot: Pilot, index: int) -> None:
    """The autopilot flies this item now: the phase follows."""
    assert pilot.flown is not None
    mission, air = pilot.flown.mission, pilot.air
    air.index = index
    note_home(pilot, index)
    part = mission.part_at(index)
    match part:
        case Part.SETTLE if pilot.phase is Phase.CLIMB:
            if index == mission.settle:
                pilot.fire(Trigger.AT_HEIGHT)
        case Part.OUTBOUND:
            if index in mission.outbound:
                air.leg = mission.outbound.index(index)
        case Part.RELEASE if pilot.phase is Phase.DELIVER:
            pilot.fire(Trigger.DROP_REACHED)
        case Part.RETURN:
            on_the_way_home(pilot)
        case Part.LAND | Part.RALLY_LAND | Part.END:
            if pilot.outward:
                on_the_way_home(pilot)
            pilot.fire(Trigger.LANDING)
        case _:
            return


def on_the_way_home(pilot: Pilot) -> None:
    """The mission itself went on to the way home."""
    if pilot.phase is Phase.RELEASE:
        pilot.fire(Trigger.DROP_OVER)
    elif pilot.outward:
        why = pilot.air.gate_closed or "no leave to go on was given in time"
        pilot.decide("turn_back", f"the mission aboard went home by itself: {why}")
        pilot.say(Severity.WARNING, "going home by the mission aboard")
        pilot.fire(Trigger.HOMEWARD, why)


def place_by_progress(pilot: Pilot) -> None:
    """The mission aboard is ours and flies: find the phase by its current item."""
    progress = pilot.now.progress
    if progress is None or not pilot.now.is_fresh(progress, 3.0) or progress.index is None:
        return
    if pilot.now.position_troubles() and not pilot.now.is_fresh(pilot.now.position, 1.0):
        return
    assert pilot.flown is not None
    mission, air = pilot.flown.mission, pilot.air
    index = progress.index
    air.index, air.jump, air.speed_mps = index, None, None
    air.moved_to = None
    if progress.total is not None and progress.total != len(mission.items):
        pilot.fire(Trigger.MISSION_UNKNOWN, f"another mission aboard ({progress.total} items)")
        return
    part = mission.part_at(index)
    words = f"at item {index} ({mission.items[index].label})" if part is not None else ""
    if part is None:
        pilot.fire(Trigger.MISSION_UNKNOWN, f"item {index} is not ours")
        return
    note_home(pilot, index)
    pilot.decide("recognised", f"our mission, {words}")
    pilot.authority.forget()
    match part:
        case Part.TAKEOFF:
            pilot.fire(Trigger.TELEMETRY_COMES, words)
        case Part.SETTLE:
            pilot.fire(Trigger.AT_HEIGHT, words)
        case Part.OUTBOUND:
            air.leg = max((k for k, out in enumerate(mission.outbound) if out <= index), default=0)
            pilot.fire(Trigger.GO, words)
        case Part.DELIVER:
            pilot.fire(Trigger.CUSTOMER_REACHED, words)
        case Part.RELEASE:
            pilot.fire(Trigger.DROP_REACHED, words)
        case Part.RETURN:
            pilot.fire(Trigger.HOMEWARD, words)
        case Part.RALLY:
            air.rally = rally_of_item(pilot, index)
            pilot.fire(Trigger.RALLY_BOUND, words)
        case Part.LAND | Part.RALLY_LAND | Part.END:
            air.rally = rally_of_item(pilot, index)
            pilot.fire(Trigger.LANDING, words)


def jump(pilot: Pilot, index: int, purpose: Purpose) -> None:
    pilot.air.jump = JumpWatch(index, purpose, pilot.now.t_s)
    pilot.do(JumpTo(index))


def jump_refusal(pilot: Pilot, event: OrderRefused) -> None:
    """Take a refusal in flight: a jump is asked again at once."""
    jump = pilot.air.jump
    if jump is not None and event.order == f"jump to item {jump.index}":
        jump.refused = True
    elif pilot.phase in FLIGHT_PHASES:
        pilot.say_once(Severity.WARNING, f"{event.order} refused: {event.reason}")


def mind_the_jump(pilot: Pilot) -> None:
    """Ask again for a jump that telemetry does not show, or give it up."""
    air = pilot.air
    if air.jump is None or pilot.flown is None:
        return
    progress = pilot.now.progress
    fresh = progress is not None and progress.t_s > air.jump.ordered_s
    index = progress.index if progress is not None and fresh else None
    match air.jump.look(pilot.flown.mission, index, pilot.now.t_s):
        case Verdict.CONFIRMED if index is not None:
            _jump_confirmed(pilot, index)
        case Verdict.ASK_AGAIN:
            pilot.do(Note(f"jump to item {air.jump.index} not seen yet: again"))
            pilot.do(JumpTo(air.jump.index))
        case Verdict.REFUSED:
            _jump_refused(pilot)
        case _:
            return


def _jump_confirmed(pilot: Pilot, index: int) -> None:
    air, flown = pilot.air, pilot.flown
    assert flown is not None
    assert air.jump is not None
    jump, air.jump = air.jump, None
    part = flown.mission.part_at(jump.index)
    air.index = jump.index
    note_home(pilot, jump.index)
    if jump.purpose is not Purpose.ONWARD:
        spot = flown.mission.spot_at(jump.index)
        position = pilot.now.position
        if spot is not None and position is not None:
            away_m = horizontal_m(flown.ned_of(position), flown.spot_ned(spot))
            air.course = CourseWatch(pilot.now.t_s, away_m)
        pilot.do(Note(f"on the way home by item {jump.index}"))
        if jump.purpose is Purpose.MOVE:
            air.rally = rally_of_item(pilot, jump.index)
            pilot.fire(Trigger.HOMEWARD if air.rally is None else Trigger.RALLY_BOUND)
    elif part is Part.OUTBOUND:
        air.leg = flown.mission.outbound.index(jump.index)
        pilot.fire(Trigger.GO)
    elif part is Part.DELIVER:
        pilot.fire(Trigger.CUSTOMER_REACHED)
    if index != jump.index:
        at_item(pilot, index)


def _jump_refused(pilot: Pilot) -> None:
    air = pilot.air
    assert air.jump is not None
    assert pilot.flown is not None
    jump, air.jump = air.jump, None
    pilot.say(Severity.WARNING, f"jump to item {jump.index} is not obeyed")
    if jump.purpose is Purpose.HOME:
        pilot.decide("way_home_refused", f"jump to item {jump.index} not confirmed by telemetry")
        pilot.fire(Trigger.WAY_HOME_REFUSED, "the jump home was not obeyed")
        return
    if jump.purpose is Purpose.MOVE:
        want(pilot, None)
        pilot.decide("home_stays", f"jump to item {jump.index} not confirmed by telemetry")
        return
    # Without leave the mission aboard goes home by itself.
    pilot.decide("onward_refused", f"jump to item {jump.index} not confirmed by telemetry")
    air.gate_closed = air.gate_closed or "the autopilot does not jump onward"
    progress = pilot.now.progress
    if progress is not None and progress.index is not None:
        at_item(pilot, progress.index)


def last_resort(pilot: Pilot) -> None:
    """RTL, where its altitude clears every obstacle; else the mission aboard still goes home."""
    unsafe = [f for f in pilot.ground.findings if f.name.startswith("RTL")]
    if unsafe or not pilot.ground.findings_known:
        pilot.say(Severity.CRITICAL, "way home refused, RTL not safe")
        pilot.decide("last_resort", "no RTL: its altitude is not known to clear the obstacles")
        return
    pilot.say(Severity.CRITICAL, "way home refused: RTL")
    away = pilot.flown is not None and bool(pilot.flown.plan.away_ned_m)
    pilot.decide("last_resort", "RTL: to the launch pad, which nobody promised" if away else "RTL")
    pilot.authority.order(Mode.RTL, pilot.now.state)
    pilot.do(SetMode(Mode.RTL))


def rally_of_item(pilot: Pilot, index: int) -> str | None:
    assert pilot.flown is not None
    return pilot.flown.site_of_item(index)
