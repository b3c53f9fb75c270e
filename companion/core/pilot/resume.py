"""A flight that is picked up again: after a restart, a silence, a reboot, or handed back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from companion.core.mission.actions import AskTelemetry, Note, ReadMissionBack, SetMode
from companion.core.mission.events import MissionReadBack, Mode
from companion.core.mission.flight_plan import FlightPlan, lay_out, site_map
from companion.core.pilot import ground_sequence as before_flight
from companion.core.pilot import landing as touchdown
from companion.core.pilot import mission_progress as progress
from companion.core.pilot.estimates import JudgementKept
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase, Trigger

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

POSITION_WAIT_S = 30.0
"""Found on the ground, where it is tells whether it is home; a receiver may take as long."""


def restore(pilot: Pilot) -> None:
    """Take up what a checkpoint kept, if there is one to go on from."""
    kept = pilot.checkpoint
    if kept is None:
        return
    pilot.judge.restore(msgspec.convert(kept.judgement, JudgementKept))
    pilot.now.t_s = kept.t_s
    air = pilot.air
    air.authorised, air.delivered = kept.authorised, kept.delivered
    over_customer = (
        Phase.DELIVER.value,
        Phase.RELEASE.value,
    )  # the mission aboard went on by itself
    air.drop_begun = kept.drop_begun or kept.phase in over_customer
    air.gate_closed, air.took_off_s, air.rally = kept.gate_closed, kept.took_off_s, kept.rally
    air.leg, air.home, air.wanted = kept.leg, kept.home, kept.wanted
    pilot.ground.settings_before = dict(kept.settings_before)
    if kept.flying and kept.plan is not None and kept.frame is not None:
        site = site_map(pilot.flight, kept.frame, pilot.obstacles, here=pilot.options.here)
        mission = lay_out(pilot.flight, site, kept.plan, asides=kept.asides)
        pilot.flown = FlightPlan(site, kept.plan, mission)
        air.flying = True


def begin(pilot: Pilot, why: str) -> None:
    """Ask for everything again, if this flight is ours to fly at all."""
    state = pilot.now.state
    pilot.ground.mission_matches = False
    ordered_back = pilot.authority.ordered is Mode.MISSION
    if pilot.checkpoint is not None and not pilot.checkpoint.authority and not ordered_back:
        pilot.checkpoint = None
        pilot.fire(Trigger.TAKEN_OVER, "we had no authority before the restart")
        return
    pilot.checkpoint = None
    if state is not None and state.armed and state.mode is not Mode.MISSION:
        if not ordered_back:
            pilot.fire(Trigger.TAKEN_OVER, f"mode is {state.mode_name}")
            return
        pilot.do(SetMode(Mode.MISSION))
    if pilot.flown is None:
        return
    pilot.decide("recognise", why or "reading the mission aboard again")
    pilot.do(AskTelemetry(), ReadMissionBack(pilot.flown.mission.items))
    before_flight.ask_parameters(pilot)
    pilot.ground.asked_s = pilot.now.t_s
    pilot.air.index = None
    pilot.air.moved_to = None


def tick(pilot: Pilot) -> None:
    """On the ground there is nothing to recognise; in the air the read-back decides."""
    state = pilot.now.state
    if state is None or not pilot.now.is_fresh(state, 3.5):
        return
    if not state.armed:
        if pilot.air.flying:
            waited_s = pilot.now.t_s - pilot.phase_since_s
            if pilot.now.position is not None or waited_s > POSITION_WAIT_S:
                touchdown.watch_landing(pilot)
        else:
            pilot.fire(Trigger.STILL_ON_GROUND)
        return
    if pilot.flown is None:
        pilot.fire(Trigger.MISSION_UNKNOWN, "armed, and no mission of ours")
        return
    if state.mode is not Mode.MISSION:
        why = pilot.authority.intrusion(Phase.ARM, state, on_ground=False)
        waited_s = pilot.now.t_s - pilot.phase_since_s
        if why is not None or pilot.authority.ordered is None or waited_s > 15.0:
            pilot.fire(Trigger.TAKEN_OVER, why or f"mode stays {state.mode_name}")
        return
    if pilot.ground.mission_matches:
        progress.place_by_progress(pilot)
    elif pilot.now.t_s - pilot.ground.asked_s > 20.0:
        pilot.ground.asked_s = pilot.now.t_s
        pilot.do(ReadMissionBack(pilot.flown.mission.items))


def read_back(pilot: Pilot, event: MissionReadBack) -> None:
    """Take what the mission aboard was found to be."""
    if pilot.phase is not Phase.RECOGNISE:
        if event.differences and pilot.phase in FLIGHT_PHASES:
            pilot.fire(Trigger.TAKEN_OVER, "the mission aboard is not ours")
        before_flight.hear(pilot, event)
        return
    if not event.differences:
        pilot.ground.mission_matches = True
        return
    if not pilot.now.armed:
        return  # down: whatever is aboard is not flown any more, and the tick ends the flight
    for words in event.differences[:10]:
        pilot.do(Note(f"mission aboard: {words}"))
    if event.differences[0].startswith("no answer"):
        return  # asked again from the tick
    pilot.fire(Trigger.MISSION_UNKNOWN, "the mission aboard is not ours")
