"""Past a waypoint by set-points: the autopilot counts none meanwhile, so the mission is told.

Without this, who is kept from handing back waits over its waypoint for whoever waits for that
place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from companion.core.mission.actions import JumpTo
from companion.core.mission.mission_items import Part
from companion.core.pilot.desired_velocity import target
from companion.core.separation.setpoint_motion import Floats

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

REACHED_M = 3.0
"""Over the ground, from a waypoint of the way home that counts as passed: between what the
autopilots' own have by default (ArduCopter's WPNAV_RADIUS 2 m, PX4's NAV_ACC_RAD 10 m)."""

ASK_AGAIN_S = 1.5
MOST_ASKS = 3
"""So often a mission is told to go on past a waypoint; then it is handed back as it is."""


@dataclass(slots=True)
class Passing:
    """Orders to go on past an item."""

    item: int
    asked: int
    asked_s: float


def pass_by(pilot: Pilot, here: Floats) -> bool:
    """Whether the mission is being told to go on past a waypoint that set-points have reached.

    As if the autopilot had reached it by itself; telemetry tells when it obeys. Meanwhile nothing
    is handed back: two orders of which item to fly would be one too many.
    """
    apart, item, t_s = pilot.apart, pilot.air.index, pilot.now.t_s
    on = _item_after(pilot, here)
    if on is None or item is None:
        return False
    before = apart.passing if apart.passing and apart.passing.item == item else None
    asked = before.asked if before else 0
    if before is None or t_s - before.asked_s >= ASK_AGAIN_S:
        if asked == MOST_ASKS:
            return False
        apart.passing = Passing(item, asked + 1, t_s)
        pilot.do(JumpTo(on))
    return True


def _item_after(pilot: Pilot, here: Floats) -> int | None:
    """The item to go on to, where set-points have reached a waypoint of the way home.

    Outbound, leave to go on comes before the waypoint. At what height it is passed is no matter, if
    the line on is clear.
    """
    flown, air = pilot.flown, pilot.air
    if flown is None or air.index is None or air.jump is not None:
        return None
    if flown.mission.part_at(air.index) not in (Part.RETURN, Part.RALLY):
        return None
    goal, on = target(pilot, here), flown.mission.next_place(air.index)
    if goal is None or on is None:
        return None
    spot = flown.mission.items[on].spot
    assert spot is not None
    if math.hypot(goal[0] - here[0], goal[1] - here[1]) > REACHED_M:
        return None
    north, east, down = flown.spot_ned(spot)
    lands = flown.mission.part_at(on) in (Part.LAND, Part.RALLY_LAND)
    further = (north, east, float(here[2]) if lands else down)
    return on if flown.sees((here[0], here[1], here[2]), further) else None
