"""A position that is lost in flight: said at once, with where the vehicle was last.

Nothing is ordered on it. Both autopilots come down by themselves where they are once their
estimator gives up (ArduCopter's EKF failsafe, PX4's descend), and no order of a companion that
knows no position either could do better: it tells the operator where to look.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from companion.core.mission.actions import Severity
from companion.core.mission.events import Mode

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

LOST_S = 1.5
"""Troubles shorter than this are one late message."""


def mind_position(pilot: Pilot) -> None:
    """Follow the position in flight, whoever flies."""
    air, now = pilot.air, pilot.now
    troubles = now.position_troubles()
    if not troubles:
        _is_well(pilot)
        return
    air.doubtful_s = now.t_s if air.doubtful_s is None else air.doubtful_s
    if air.position_lost_s is None and now.t_s - air.doubtful_s >= LOST_S:
        air.position_lost_s = air.doubtful_s
        pilot.assessment = None  # what was promised from there holds no longer
        pilot.say(Severity.CRITICAL, f"position lost: {troubles[0]}")
        pilot.decide("position_lost", f"{'; '.join(troubles)}; {last_seen(pilot)}")
    state = now.state
    if air.position_lost_s is not None and state is not None and state.mode is Mode.LAND:
        pilot.say_once(Severity.CRITICAL, f"coming down blind, {last_seen(pilot)}")


def last_seen(pilot: Pilot) -> str:
    """Where the position was last beyond doubt."""
    sure = pilot.air.last_sure
    return "never seen" if sure is None else f"last at {sure.lat_deg:.5f} {sure.lon_deg:.5f}"


def _is_well(pilot: Pilot) -> None:
    air, now = pilot.air, pilot.now
    air.doubtful_s, air.last_sure = None, now.position
    if air.position_lost_s is not None:
        gone_s = now.t_s - air.position_lost_s
        air.position_lost_s = None
        pilot.say(Severity.NOTICE, f"position back after {gone_s:.0f} s")
        pilot.decide("position_back", f"after {gone_s:.0f} s")
