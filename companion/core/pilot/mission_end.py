"""Where what is aboard the autopilot ends: the promised stop (safety rule 3), as last seen.

Read off the item that the autopilot flies, never off what was ordered: the truck stays bound to a
stop until the autopilot itself shows that it goes elsewhere.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from companion.core.base.geo import Ned
from companion.core.mission.actions import Severity
from companion.core.mission.flight_plan import FlightPlan
from companion.core.mission.mission_items import Part
from companion.core.routing.route_planner import Plan

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot


def home_now(pilot: Pilot) -> str | None:
    """The stop at which the flight ends were the companion to die now; `None`: without stops."""
    return pilot.air.home or pilot.flight.site.home


def note_home(pilot: Pilot, index: int) -> None:
    """The autopilot flies this item: tell and keep where it leads, when that is another place."""
    flown = pilot.flown
    if flown is None or flown.plan.home is None:
        return
    part = flown.mission.part_at(index)
    if part is None or part is Part.END:
        return
    home = end_of(flown, index)
    before = home_now(pilot)
    pilot.air.home = home
    if home == before:
        return
    want(pilot, None if pilot.air.wanted == home else pilot.air.wanted)
    pilot.say(Severity.NOTICE, f"home is now {home}")
    pilot.decide("home_moved", f"what is aboard ends at {home}, no longer at {before}")
    pilot.save()


def end_of(flown: FlightPlan, index: int) -> str:
    """The place where the autopilot ends by itself from an item."""
    return flown.site_of_item(index) or flown.plan.landing


def want(pilot: Pilot, stop: str | None) -> None:
    """The stop that the truck asks for, or none: it and where the flight ends now may be chosen."""
    air, flown = pilot.air, pilot.flown
    air.wanted = stop
    if flown is None or flown.plan.home is None:
        return
    plan = flown.plan.promised(home_now(pilot), stop)
    if plan != flown.plan:
        pilot.flown = replace(flown, plan=plan)
        pilot.judge.table = None  # it was made for other landing sites


def promised_places(plan: Plan, home: str | None) -> list[tuple[str, Ned]]:
    """Where it may come down, by name: the end of what is aboard, and declared rally points."""
    stops = {stop.name for stop in plan.stops}
    places = [(s.name, s.ground_ned_m) for s in plan.sites if s.name == home or s.name not in stops]
    return places if home in dict(places) else [(plan.landing, plan.landing_ned_m), *places]
