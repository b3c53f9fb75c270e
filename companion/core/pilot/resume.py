"""A flight that is picked up again: after a restart, a silence, a reboot, or handed back."""

from typing import Any, Protocol

import msgspec

from companion.core.mission.actions import (
    AskBoard,
    AskTelemetry,
    DropOrders,
    Note,
    ReadMissionBack,
    SetMode,
    Severity,
)
from companion.core.mission.events import (
    ClockLeapt,
    ClockStepped,
    Event,
    LinkBack,
    LinkSilent,
    MissionReadBack,
    Mode,
    VehicleState,
)
from companion.core.mission.flight_plan import FlightPlan, lay_out, site_map
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import Airborne, FlightContext, ModeOrders
from companion.core.pilot.estimates import EstimatesSnapshot
from companion.core.pilot.telemetry_state import STATE_MAX_AGE_S
from companion.core.pilot.transitions import Phase, Trigger

LULL_S = 3.0
"""A gap of the autopilot's time up to this is a lull; a longer one means reading all again."""

SAME_MISSION_S = 30.0
"""After a gap up to this the mission aboard need not be read item by item again."""

POSITION_WAIT_S = 30.0
"""Found on the ground, where it is tells whether it is home; a receiver may take as long."""

MODE_WAIT_S = 15.0
READ_AGAIN_S = 20.0


class SettingsCheck(Protocol):
    """The ground sequence's part: the settings that the promise rests on."""

    def ask_parameters(self, context: FlightContext) -> None:
        """Ask for them again."""
        ...


class ItemSearch(Protocol):
    """Mission progress's part: where in the mission the autopilot is."""

    def forget_item(self) -> None:
        """Which item is flown has to be found out anew."""
        ...

    def cancel_jump(self) -> None:
        """No jump is waited for any more."""
        ...

    def place_by_progress(self, context: FlightContext) -> None:
        """Find the phase by the current item."""
        ...


class ModeWatch(ModeOrders, Protocol):
    """Authority's part."""

    def mode_intrusion(self, state: VehicleState) -> str | None:
        """Why this mode shows that somebody else has control."""
        ...


class Touchdown(Protocol):
    """Landing's part."""

    def tick(self, context: FlightContext) -> None:
        """See it down."""
        ...


class Resume:
    """Finds out where the flight is, and goes on with it."""

    __slots__ = (
        "_asked_s",
        "_checkpoint",
        "_flight",
        "_landing",
        "_mission_matches",
        "_modes",
        "_obstacles",
        "_progress",
        "_settings",
    )

    def __init__(
        self,
        flight: Airborne,
        settings: SettingsCheck,
        progress: ItemSearch,
        modes: ModeWatch,
        landing: Touchdown,
        obstacles: dict[str, Any] | None,
    ) -> None:
        self._flight = flight
        self._settings = settings
        self._progress = progress
        self._modes = modes
        self._landing = landing
        self._obstacles = obstacles
        self._checkpoint: Checkpoint | None = None
        self._mission_matches = False
        self._asked_s: float | None = None

    def restore(self, context: FlightContext, checkpoint: Checkpoint) -> None:
        """Take up the plan, the estimates and the time of a checkpoint."""
        self._checkpoint = checkpoint
        context.estimates.restore(msgspec.convert(checkpoint.judgement, EstimatesSnapshot))
        context.telemetry.t_s = checkpoint.t_s
        if checkpoint.flying and checkpoint.plan is not None and checkpoint.frame is not None:
            here = context.options.here
            site = site_map(context.flight, checkpoint.frame, self._obstacles, here=here)
            mission = lay_out(context.flight, site, checkpoint.plan, asides=checkpoint.asides)
            context.flight_plan = FlightPlan(site, checkpoint.plan, mission)
            self._flight.resume_flight()

    def identified(self, context: FlightContext) -> None:
        """The autopilot is identified: begin on the ground, or pick the flight up."""
        kept, armed = self._checkpoint, context.telemetry.armed
        if kept is not None and kept.flying and context.flight_plan is not None:
            found = "armed" if armed else "disarmed"  # down meanwhile: never flown again
            why = f"{found}, and our checkpoint says in flight"
            context.request_transition(Trigger.AIRBORNE_AT_START, why)
        elif not armed:
            context.request_transition(Trigger.IDENTIFIED)
        else:
            context.request_transition(Trigger.MISSION_UNKNOWN, "armed, and not by us")

    def begin(self, context: FlightContext, why: str) -> None:
        """Ask for everything again, if this flight is ours to fly at all."""
        state, kept = context.telemetry.state, self._checkpoint
        self._mission_matches = False
        ordered_back = self._modes.ordered is Mode.MISSION
        self._checkpoint = None
        if kept is not None and not kept.authority and not ordered_back:
            words = "we had no authority before the restart"
            context.request_transition(Trigger.TAKEN_OVER, words)
            return
        if state is not None and state.armed and state.mode is not Mode.MISSION:
            if not ordered_back:
                context.request_transition(Trigger.TAKEN_OVER, f"mode is {state.mode_name}")
                return
            context.do(SetMode(Mode.MISSION))
        if context.flight_plan is None:
            return
        context.decide("recognise", why or "reading the mission aboard again")
        context.do(AskTelemetry(), AskBoard(), ReadMissionBack(context.flight_plan.mission.items))
        self._settings.ask_parameters(context)
        self._asked_s = context.t_s
        self._progress.forget_item()

    def tick(self, context: FlightContext) -> None:
        """On the ground there is nothing to recognise; in the air the read-back decides."""
        telemetry = context.telemetry
        state = telemetry.state
        if state is None or not telemetry.is_fresh(state, STATE_MAX_AGE_S):
            return
        if not state.armed:
            self._found_disarmed(context)
            return
        if context.flight_plan is None:
            context.request_transition(Trigger.MISSION_UNKNOWN, "armed, and no mission of ours")
            return
        if state.mode is not Mode.MISSION:
            why = self._modes.mode_intrusion(state)
            if why is not None or self._modes.ordered is None or context.phase_s > MODE_WAIT_S:
                words = why or f"mode stays {state.mode_name}"
                context.request_transition(Trigger.TAKEN_OVER, words)
            return
        if self._mission_matches:
            self._progress.place_by_progress(context)
        elif context.since_s(self._asked_s) > READ_AGAIN_S:
            self._asked_s = context.t_s
            context.do(ReadMissionBack(context.flight_plan.mission.items))

    def on_event(self, context: FlightContext, event: Event) -> None:
        """The link, the autopilot's clock, and the mission as it was read back."""
        match event:
            case LinkSilent():
                context.do(Note("link silent"))
                context.request_transition(Trigger.LINK_SILENT)
            case LinkBack():
                self._link_back(context, event.gap_s)
            case ClockLeapt():
                context.do(Note(f"the autopilot's clock leapt {event.ahead_s:.1f} s ahead"))
                if context.phase is not Phase.LINK_LOST:
                    self._link_back(context, event.ahead_s)
            case ClockStepped():
                self._rebooted(context, event)
            case MissionReadBack():
                self._read_back(context, event)
            case _:
                return

    def _found_disarmed(self, context: FlightContext) -> None:
        if not self._flight.flying:
            context.request_transition(Trigger.STILL_ON_GROUND)
        elif context.telemetry.position is not None or context.phase_s > POSITION_WAIT_S:
            self._landing.tick(context)

    def _link_back(self, context: FlightContext, gap_s: float) -> None:
        if gap_s <= LULL_S:
            context.request_transition(Trigger.LULL_OVER)
            return
        context.say(Severity.WARNING, f"link back after {gap_s:.0f} s")
        context.decide("link_back", f"nothing heard for {gap_s:.0f} s")
        context.request_transition(Trigger.LINK_BACK, f"link back after {gap_s:.0f} s")
        if context.phase is Phase.RECOGNISE and gap_s <= SAME_MISSION_S:
            self._mission_matches = True  # its number of items is compared all the same

    def _rebooted(self, context: FlightContext, event: ClockStepped) -> None:
        back_s = event.back_s
        context.say(Severity.WARNING, f"autopilot clock went back {back_s:.0f} s: rebooted?")
        context.decide("reboot", f"the autopilot's clock went back by {back_s:.0f} s")
        context.telemetry.forget()
        self._progress.cancel_jump()
        context.do(DropOrders())
        context.request_transition(Trigger.REBOOTED, "the autopilot rebooted")

    def _read_back(self, context: FlightContext, event: MissionReadBack) -> None:
        """Take what the mission aboard was found to be."""
        if context.phase is not Phase.RECOGNISE:
            return
        if not event.differences:
            self._mission_matches = True
            return
        if not context.telemetry.armed:
            return  # down: whatever is aboard is not flown any more, and the tick ends the flight
        for words in event.differences[:10]:
            context.do(Note(f"mission aboard: {words}"))
        if event.differences[0].startswith("no answer"):
            return  # asked again from the tick
        context.request_transition(Trigger.MISSION_UNKNOWN, "the mission aboard is not ours")
