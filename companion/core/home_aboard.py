"""Where what is aboard the autopilot ends: the promised stop (safety rule 3), as last seen.

Read off the item that the autopilot flies, never off what was ordered: the truck stays bound to a
stop until the autopilot itself shows that it goes elsewhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from companion.core.actions import Severity
from companion.core.geo import Ned
from companion.core.mission_items import Part
from companion.core.planner import Plan

if TYPE_CHECKING:
    from companion.core.pilot import Pilot


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
    home = flown.site_of_item(index) or flown.plan.landing
    before = home_now(pilot)
    pilot.air.home = home
    if home == before:
        return
    if pilot.air.wanted == home:
        pilot.air.wanted = None
    pilot.say(Severity.NOTICE, f"home is now {home}")
    pilot.decide("home_moved", f"what is aboard ends at {home}, no longer at {before}")
    pilot.save()


def promised_places(plan: Plan, home: str | None) -> list[tuple[str, Ned]]:
    """Where it may come down, by name: the end of what is aboard, and declared rally points."""
    sites = {site.name: site.ground_ned_m for site in plan.sites}
    stops = {stop.name for stop in plan.stops}
    ends = home if home in stops else plan.landing
    places = [(ends, sites[ends] if ends in stops else plan.landing_ned_m)]
    return [*places, *((n, ground) for n, ground in sites.items() if n not in stops)]
