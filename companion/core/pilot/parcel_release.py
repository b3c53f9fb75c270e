"""The drop: watch the hover, look for proof of the release, ask once more, go home."""

from __future__ import annotations

from typing import TYPE_CHECKING

from companion.core.mission.actions import (
    Note,
    Release,
    Severity,
)
from companion.core.pilot.budget_question import assess
from companion.core.pilot.jump_confirmation import Purpose
from companion.core.pilot.mission_progress import jump
from companion.core.pilot.release_detection import ReleaseWatch, observe_hover, watch_for
from companion.core.pilot.transitions import Phase, Trigger

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

RELEASE_AGAIN_S = 3.6


def watch_release(pilot: Pilot) -> ReleaseWatch:
    """The watch over this flight's drop."""
    air = pilot.air
    if air.release is None:
        air.release = watch_for(pilot.judge.route_energy, pilot.flight.vehicle.payload_kg)
    return air.release


def observe_release(pilot: Pilot) -> None:
    """Show the watch what is heard now, over the customer."""
    if pilot.phase in (Phase.DELIVER, Phase.RELEASE) and pilot.flight.vehicle.payload_kg > 0.0:
        observe_hover(watch_release(pilot), pilot.now)


def release(pilot: Pilot) -> None:
    """Look for proof that the parcel is gone; ask once more; then home."""
    air, flown = pilot.air, pilot.flown
    if flown is None or air.jump is not None:
        return
    if air.delivered:
        return
    if pilot.flight.vehicle.payload_kg <= 0.0:
        _delivered(pilot, "there was no parcel to weigh")
        return
    watch = watch_release(pilot)
    evidence = watch.evidence(pilot.now.t_s)
    if evidence is not None:
        _delivered(pilot, evidence)
        return
    if not air.release_asked_again and pilot.now.t_s - pilot.phase_since_s > RELEASE_AGAIN_S:
        air.release_asked_again = True
        if not pilot.now.troubles():
            pilot.do(Release())
            pilot.do(Note("no proof of the release yet: asked once more"))


def _delivered(pilot: Pilot, evidence: str) -> None:
    air, flown = pilot.air, pilot.flown
    assert flown is not None
    air.delivered = True
    pilot.judge.payload_kg = 0.0
    pilot.assessment = None
    assess(pilot, 0.0)
    pilot.decide("delivered", evidence)
    pilot.say(Severity.NOTICE, f"delivered: {evidence}")
    pilot.save()
    if not pilot.now.troubles():
        jump(pilot, flown.mission.returning[0], Purpose.HOME)
        pilot.fire(Trigger.DROP_OVER, "delivered")


def release_ends(pilot: Pilot) -> None:
    """Leaving the drop without proof: the parcel counts as aboard (safety rule 5)."""
    if not pilot.air.delivered:
        pilot.decide("release_unconfirmed", "the parcel counts as aboard: returning loaded")
        pilot.say(Severity.ERROR, "release not confirmed: parcel counts as aboard")
