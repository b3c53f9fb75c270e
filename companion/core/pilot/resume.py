"""A flight that is picked up again: after a restart, a silence, a reboot, or handed back."""

from typing import Any, Protocol

import msgspec

from companion.core.mission.actions import (
    AskBoard,
    AskTelemetry,
    DropOrders,
    JumpTo,
    Note,
    ReadMissionBack,
    SetMode,
    Severity,
    UploadMission,
)
from companion.core.mission.events import (
    ClockLeapt,
    ClockStepped,
    Event,
    LinkBack,
    LinkSilent,
    MissionReadBack,
    MissionTouched,
    MissionUploaded,
    Mode,
    OrderRefused,
    VehicleState,
)
from companion.core.mission.flight_plan import FlightPlan, lay_out, site_map
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import Airborne, FlightContext, GateState, ModeOrders
from companion.core.pilot.estimates import EstimatesSnapshot
from companion.core.pilot.telemetry_state import STATE_MAX_AGE_S
from companion.core.pilot.transitions import Phase, Trigger

LULL_S = 3.0
"""A gap of the autopilot's time up to this is a lull; a longer one means reading all again."""

SAME_MISSION_S = 30.0
"""After a gap up to this the mission aboard need not be read item by item again."""

POSITION_WAIT_S = 30.0
"""Found on the ground, where it is tells whether it is home; a receiver may take as long."""

MODE_SHOWS_S = 5.0
"""A mode command shows within this: its answer, a heartbeat at 1 Hz, and a slow link."""

READ_AGAIN_S = 20.0

WINDOW = 12
"""Items requested at a time at a hand-back: 0.1 s of a radio of 57,600 baud. Until the mode command
leaves, a person who selects HOLD in HOLD is not seen to do so.
"""

JUMP_AGAIN_S = 2.5
MODE_ORDER = f"mode {Mode.MISSION.value}"
"""What the adapter calls the order."""

RESUME_S = 60.0
"""A hand-back ends after so long: three readings, an upload and a jump on a slow link."""


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

    @property
    def handed_back(self) -> bool:
        """An operator has given control back, and the flight has not been resumed yet."""
        ...

    def mode_intrusion(self, state: VehicleState) -> str | None:
        """Why this mode shows that somebody else has control."""
        ...


class MissionProof(Protocol):
    """Verification of the mission onboard without a read-back."""

    def is_proven(self, context: FlightContext) -> bool:
        """Whether the list is known to be ours, by a report of this phase."""
        ...


class HomeEntry(Protocol):
    """The return decision's part."""

    def item_home(self, context: FlightContext) -> int | None:
        """The item at which the way home is entered from here."""
        ...


class Touchdown(Protocol):
    """Landing's part."""

    def tick(self, context: FlightContext) -> None:
        """See it down."""
        ...


class Resume:
    """Finds out where the flight is, and goes on with it."""

    __slots__ = (
        "_aboard",
        "_asked_s",
        "_checkpoint",
        "_decision",
        "_entry",
        "_flight",
        "_gate",
        "_held_mode",
        "_landing",
        "_mission_matches",
        "_modes",
        "_obstacles",
        "_ordered_s",
        "_progress",
        "_restored",
        "_settings",
    )

    def __init__(
        self,
        flight: Airborne,
        settings: SettingsCheck,
        progress: ItemSearch,
        modes: ModeWatch,
        landing: Touchdown,
        gate: GateState,
        decision: HomeEntry,
        aboard: MissionProof,
        obstacles: dict[str, Any] | None,
    ) -> None:
        self._flight = flight
        self._settings = settings
        self._progress = progress
        self._modes = modes
        self._landing = landing
        self._gate = gate
        self._decision = decision
        self._aboard = aboard
        self._obstacles = obstacles
        self._held_mode = ""
        self._ordered_s: float | None = None
        self._restored = False
        self._entry: int | None = None
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
        self._mission_matches = self._restored = False
        self._ordered_s = self._entry = None
        self._held_mode = state.mode_name if state is not None else ""
        handed_back = self._modes.handed_back
        self._checkpoint = None
        if kept is not None and not kept.authority and not handed_back:
            words = "we had no authority before the restart"
            context.request_transition(Trigger.TAKEN_OVER, words)
            return
        flown = state is None or not state.armed or state.mode is Mode.MISSION
        if state is not None and not flown and not handed_back:
            context.request_transition(Trigger.TAKEN_OVER, f"mode is {state.mode_name}")
            return
        if context.flight_plan is None:
            return
        context.decide("recognise", why or "reading the mission aboard again")
        items, window = context.flight_plan.mission.items, WINDOW if handed_back else 1
        context.do(AskTelemetry(), AskBoard(), ReadMissionBack(items, window=window))
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
        why = self._newer_decision(context, state)
        if why:
            context.request_transition(Trigger.TAKEN_OVER, why)
        elif self._modes.handed_back and context.phase_s > RESUME_S:
            self._refuse(context, "mission not verified")
        elif not self._mission_matches:
            if self._modes.handed_back and not self._restored and self._aboard.is_proven(context):
                self._mission_matches = True
            elif context.since_s(self._asked_s) > READ_AGAIN_S:
                self._asked_s = context.t_s
                context.do(ReadMissionBack(context.flight_plan.mission.items))
        elif self._restored and not self._leads_home(context, context.flight_plan):
            return
        elif state.mode is Mode.MISSION:
            self._progress.place_by_progress(context)
        elif self._ordered_s is None:
            self._ordered_s = context.t_s
            self._modes.expect(Mode.MISSION, state)
            context.do(SetMode(Mode.MISSION))

    # --- a hand-back -----------------------------------------------------------------------------

    def _newer_decision(self, context: FlightContext, state: VehicleState) -> str:
        """Say what ends the hand-back: another mode, or one that a person may have selected unseen.

        The mode is ordered once. A person who selects the former mode again may be hidden by lost
        telemetry, and a second order would take the vehicle out of it.
        """
        if state.mode is Mode.MISSION:
            return ""
        if self._ordered_s is not None:
            late = context.since_s(self._ordered_s) > MODE_SHOWS_S
            words = "mode command unconfirmed: hand back again" if late else ""
            return self._modes.mode_intrusion(state) or words
        if state.mode_name != self._held_mode or not self._modes.handed_back:
            return f"mode changed to {state.mode_name}"
        if context.telemetry.has_mode_gap_since(context.phase_since_s):
            return "gap in telemetry: hand back again"
        return ""

    def _leads_home(self, context: FlightContext, flown: FlightPlan) -> bool:
        """After a restoration nothing rests on the current item: lead the mission home first."""
        progress, items = context.telemetry.progress, flown.mission.items
        if progress is None or progress.total not in (None, len(items)):
            return False
        if self._entry is None or context.since_s(self._asked_s) > JUMP_AGAIN_S:
            self._entry, self._asked_s = self._decision.item_home(context), context.t_s
            if self._entry is not None:
                context.do(JumpTo(self._entry))
            return False
        at, reported = progress.index, progress.t_s > (self._asked_s or 0.0)
        return reported and at is not None and flown.mission.follows(self._entry, at)

    def _restore(self, context: FlightContext, flown: FlightPlan) -> None:
        """Replace a foreign mission by ours, once."""
        if self._restored:
            self._refuse(context, "mission replaced again")
            return
        self._restored = True
        self._gate.close("mission replaced by another station")
        context.say(Severity.CRITICAL, "mission onboard is not ours: restoring ours")
        context.decide("mission_changed", "found at the hand-back")
        self._asked_s = context.t_s
        context.do(UploadMission(flown.mission.items))

    def _refuse(self, context: FlightContext, why: str) -> None:
        """Stay in the person's mode; in a foreign mission return by what needs no mission."""
        state = context.telemetry.state
        flies = state is not None and state.mode is Mode.MISSION and not self._mission_matches
        trigger = Trigger.WAY_HOME_REFUSED if flies else Trigger.TAKEN_OVER
        context.request_transition(trigger, f"cannot resume: {why}")

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
            case _ if context.phase is not Phase.RECOGNISE:
                return
            case MissionTouched() if self._mission_matches:  # else it may be our own upload
                self._mission_matches, self._asked_s = False, None
            case MissionUploaded() if event.reason is not None:
                self._refuse(context, f"upload failed: {event.reason}")
            case MissionUploaded():
                self._asked_s = None
            case OrderRefused() if event.order == MODE_ORDER and event.answered:
                self._refuse(context, f"mode refused: {event.reason}")
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
        if not event.complete:
            return  # asked again from the tick
        if self._modes.handed_back and context.flight_plan is not None:
            self._restore(context, context.flight_plan)
            return
        context.request_transition(Trigger.MISSION_UNKNOWN, "the mission aboard is not ours")
