"""The end: see the vehicle down, give the autopilot its settings back, say how it ended."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from companion.core.base.geo import Ned, horizontal_m
from companion.core.mission.actions import (
    Configure,
    Disarm,
    Note,
    Severity,
)
from companion.core.mission.events import Ground
from companion.core.pilot.budget_question import ground_mps, here_ned
from companion.core.pilot.mission_end import promised_places
from companion.core.pilot.position_loss import last_seen
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase, Trigger

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

LANDED_AFTER_S = 5.0
STILL_S = 15.0
STILL_MPS = 0.4
STILL_HEIGHT_M = 1.5
STILL_ARMED_S = 40.0
DISARM_EVERY_S = 5.0
DISARMS = 3
HOME_RADIUS_M = 30.0
CRASH_HEIGHT_M = 4.0
RESTORE_LIMIT_S = 4.0


def watch_landing(pilot: Pilot) -> None:
    """See it down: disarmed, or standing still on the ground; never a forced disarm."""
    now, air = pilot.now, pilot.air
    if now.state is None:
        return
    if not now.state.armed:
        air.disarmed_s = now.t_s if air.disarmed_s is None else air.disarmed_s
        if now.t_s - air.disarmed_s >= 0.9:
            _landed(pilot)
        return
    air.disarmed_s = None
    if pilot.phase not in (Phase.LAND, Phase.LAST_RESORT):
        return
    down = now.ground is not None and now.ground.ground is Ground.ON_GROUND
    if not (down or _stands_still(pilot)):
        air.still_s = None
        return
    air.still_s = now.t_s if air.still_s is None else air.still_s
    waited_s = now.t_s - air.still_s
    if waited_s < (LANDED_AFTER_S if down else STILL_S):
        return
    if now.t_s - air.disarm_asked_s > DISARM_EVERY_S and air.disarms_asked < DISARMS:
        air.disarm_asked_s = now.t_s
        air.disarms_asked += 1
        pilot.do(Note("on the ground and still armed: plain disarm"), Disarm())
    if waited_s > STILL_ARMED_S:
        pilot.say(Severity.WARNING, "landed, still armed: disarm by hand")
        _landed(pilot)


def _stands_still(pilot: Pilot) -> bool:
    here, position = here_ned(pilot), pilot.now.position
    if here is None or position is None or pilot.flown is None:
        return False
    ground = _landing_ned(pilot)
    speed = math.hypot(ground_mps(pilot), position.vel_d_mps)
    return abs(here[2] - ground[2]) < STILL_HEIGHT_M and speed < STILL_MPS


def _landing_ned(pilot: Pilot) -> Ned:
    assert pilot.flown is not None
    plan = pilot.flown.plan
    for rally in plan.rally:
        if rally.name == pilot.air.rally:
            return rally.ground_ned_m
    return plan.landing_ned_m


def _landed(pilot: Pilot) -> None:
    """Put the autopilot's settings back (only under our own authority), then end."""
    air, ground, now = pilot.air, pilot.ground, pilot.now
    if air.landed_s is None:
        air.landed_s = now.t_s
        air.energy_landed = pilot.judge.energy  # before our own settings move the percentage
        pilot.decide("landed", "on the ground")
        if ground.settings_before:
            _put_settings_back(pilot)
    restored = ground.giving_up != "landed" or not ground.settings_before
    if restored or now.t_s - air.landed_s > RESTORE_LIMIT_S:
        pilot.fire(Trigger.LANDED, "landed")


def _put_settings_back(pilot: Pilot) -> None:
    """Give the autopilot its own settings, or say which ones it does not get, and why."""
    ground, state = pilot.ground, pilot.now.state
    armed = state is None or state.armed
    if pilot.phase in (*FLIGHT_PHASES, Phase.RECOGNISE) and not armed:
        pilot.do(Configure(dict(ground.settings_before)))
        ground.giving_up = "landed"
        return
    why = "still armed" if armed else "another hand has the vehicle"
    pilot.say(Severity.WARNING, f"settings not put back: {why}")
    before = ", ".join(f"{name} {value:g}" for name, value in ground.settings_before.items())
    pilot.do(Note(f"settings before the flight, to be put back by hand: {before}"))


def conclude(pilot: Pilot, why: str) -> None:
    """The mission is over: the outcome by our own record."""
    air, flown = pilot.air, pilot.flown
    if not air.flying or flown is None:
        pilot.finish("ABRT", why or "never took off", home=True)
        return
    position = pilot.now.position
    home, where = False, "position unknown"
    if air.position_lost_s is not None:
        where = f"position lost, {last_seen(pilot)}"
    elif position is not None:
        here = flown.ned_of(position)
        places = promised_places(flown.plan, air.home)
        name, place = min(places, key=lambda p: horizontal_m(here, p[1]))
        away_m = horizontal_m(here, place)
        high_m = place[2] - here[2]
        home = away_m <= HOME_RADIUS_M and high_m < CRASH_HEIGHT_M
        where = f"{away_m:.0f} m from {name}"
    energy = air.energy_landed or pilot.judge.energy
    margin_wh = None
    if energy is not None:
        margin_wh = energy.mean_wh - pilot.judge.limits.reserve_frac * energy.usable_full_wh
        where += f", {margin_wh:.1f} Wh above the reserve"
        home = home and margin_wh >= 0.0
    outcome = {
        (True, True): "SUC",
        (True, False): "DEL",
        (False, True): "ABRT",
        (False, False): "FAIL",
    }[air.delivered, home]
    pilot.finish(outcome, where, home=home, margin_wh=margin_wh)
