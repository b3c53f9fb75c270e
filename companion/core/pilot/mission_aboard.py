"""Safety rule 2 in flight: the list aboard is ours, or no jump and no promise rests on it.

Another station may rewrite the mission at any moment, and its number of items need not change. Its
id tells (PX4), or ArduCopter's own words, or an acknowledgement to somebody else; where no id is
sent the list is read back all the time, slowly. Whatever tells is a doubt: the whole list is read
at once. If it is ours, nothing was. If not, the gate closes and ours is put back, once. That is
safe in flight: both autopilots keep the index; PX4 changes over when the whole list is there, and
on ArduCopter each item that arrives replaces a foreign one. Then one jump leads home. What needs no
list is the last resort, where ours cannot be put back or does not stay, and over the landing place:
PX4 takes off again for an item after our landing, and holds when our list is back and over.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from companion.core.mission.actions import Note, ReadMissionBack, Severity, UploadMission
from companion.core.mission.events import (
    Event,
    MissionProgress,
    MissionReadBack,
    MissionTouched,
    MissionUploaded,
)
from companion.core.mission.mission_items import MissionItem
from companion.core.pilot.context import FlightContext, GateState, Jumps
from companion.core.pilot.transitions import (
    FLIGHT_PHASES,
    OUTWARD_PHASES,
    Phase,
    Trigger,
)

PACE_S = 0.5
"""Between two items of the slow reading: 70 bytes each, 2.5 % of a radio of 57,600 baud."""

PAUSE_S = 10.0
"""Between two slow readings, and room for what is asked again in one."""

AGAIN_S = 2.0
"""A transfer that failed is begun again after so long: the autopilot works on another station's,
which ends by itself or with a time-out (PX4's 5 s, ArduCopter's 8 s)."""

GIVE_UP_S = 30.0
"""A list in doubt for so long is given up: one such time-out, and three transfers of 60 items at
ten a second: read, put back, read."""

FLOWN_PHASES = tuple(phase for phase in FLIGHT_PHASES if phase is not Phase.LAST_RESORT)
"""Phases in which the list is flown; RTL needs none."""


class Step(Enum):
    """What is done about a list in doubt."""

    READ = "read"
    RESTORE = "restore"
    GIVEN_UP = "given up"


@dataclass(slots=True)
class AboardState:
    """Whether the list aboard is proven, and since when it is not."""

    mission_id: int | None = None
    doubted_s: float | None = None
    step: Step = Step.READ
    asked_s: float | None = None
    """When the last slow reading began."""
    failed_s: float | None = None
    """When the transfer failed that has to be begun again."""
    touched: bool = False
    """Written to since the reading began that is under way."""
    restored: bool = False
    foreign_s: float | None = None
    """When telemetry last told of another list than ours, or of none; also after hands off."""

    @property
    def in_doubt(self) -> bool:
        """The list aboard may be another's."""
        return self.doubted_s is not None


class TurnBack(Protocol):
    """The return decision."""

    def gate(self, context: FlightContext) -> bool:
        """Turn back when the gate is closed."""
        ...


class MissionAboard:
    """Proves the list aboard, and puts ours back once."""

    def __init__(
        self, state: AboardState, gate: GateState, jumps: Jumps, decision: TurnBack
    ) -> None:
        self._state = state
        self._gate = gate
        self._jumps = jumps
        self._decision = decision

    def on_event(self, context: FlightContext, event: Event) -> None:
        """What tells of the list aboard, and the answers to our own transfers."""
        if context.flight_plan is None:
            return
        items = context.flight_plan.mission.items
        match event:
            case MissionProgress():
                self._told(context, event, len(items))
            case MissionTouched():
                if context.phase is Phase.READY:
                    self._state.foreign_s = context.t_s
                self._state.touched = self._state.in_doubt
                self._doubt(context, event.words)
            case MissionReadBack() if context.phase in FLOWN_PHASES:
                self._read(context, event, items)
            case MissionUploaded() if self._state.step is Step.RESTORE and event.reason is None:
                self._read_all(context, items)
            case MissionUploaded() if event.reason is not None and self._state.in_doubt:
                self._state.failed_s = context.t_s
                context.do(Note(f"our mission is refused: {event.reason}"))
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """In doubt: go on until it is settled. Else read slowly, where no id is told."""
        state, flown = self._state, context.flight_plan
        if flown is None or context.phase not in FLOWN_PHASES or state.step is Step.GIVEN_UP:
            return
        items = flown.mission.items
        if not state.in_doubt:
            if state.mission_id is None and context.since_s(state.asked_s) > _round_s(items):
                state.asked_s = context.t_s
                context.do(ReadMissionBack(items, PACE_S, first_only=True))
        elif context.since_s(state.doubted_s) > GIVE_UP_S:
            self._give_up(context, "our mission cannot be put back")
        elif state.failed_s is not None and context.since_s(state.failed_s) > AGAIN_S:
            self._try_again(context, items)

    def is_proven(self, context: FlightContext) -> bool:
        """Whether the list is known to be ours by its id, in a report since this phase began."""
        id_, reported = self._state.mission_id, context.telemetry.progress
        if id_ is None or reported is None:
            return False
        return reported.t_s > context.phase_since_s and reported.mission_id == id_

    # --- doubt -----------------------------------------------------------------------------------

    def _told(self, context: FlightContext, event: MissionProgress, ours: int) -> None:
        """Its number of items and its id, which is ours from the read-back before take-off on."""
        state = self._state
        self._note_foreign(context, event, ours)
        if context.phase in (Phase.UPLOAD, Phase.READ_BACK):
            state.mission_id = None
        elif context.phase in FLOWN_PHASES and event.total not in (None, ours):
            self._doubt(context, f"another mission aboard ({event.total} items)")
        elif state.mission_id is None:
            state.mission_id = event.mission_id
        elif event.mission_id not in (None, state.mission_id):
            self._doubt(context, "the mission aboard was changed")

    def _note_foreign(self, context: FlightContext, event: MissionProgress, ours: int) -> None:
        state = self._state
        by_id = state.mission_id is not None and event.mission_id not in (None, state.mission_id)
        if by_id or event.total not in (None, ours):
            state.foreign_s = context.t_s

    def _doubt(self, context: FlightContext, words: str) -> None:
        """Nothing rests on the list until it was read."""
        state = self._state
        if state.in_doubt or context.phase not in FLOWN_PHASES:
            return
        assert context.flight_plan is not None
        state.doubted_s, context.assessment = context.t_s, None
        context.decide("mission_in_doubt", words)
        self._read_all(context, context.flight_plan.mission.items)

    def _read_all(self, context: FlightContext, items: tuple[MissionItem, ...]) -> None:
        state = self._state
        state.step, state.failed_s, state.touched = Step.READ, None, False
        context.do(ReadMissionBack(items, first_only=True))

    def _try_again(self, context: FlightContext, items: tuple[MissionItem, ...]) -> None:
        if self._state.step is Step.READ:
            self._read_all(context, items)
        else:
            self._state.failed_s = None
            context.do(UploadMission(items))

    # --- what was read ---------------------------------------------------------------------------

    def _read(
        self, context: FlightContext, event: MissionReadBack, items: tuple[MissionItem, ...]
    ) -> None:
        state = self._state
        if state.step is not Step.READ:
            return
        if not event.complete:
            state.failed_s = context.t_s
        elif event.differences:
            self._is_foreign(context, event.differences, items)
        elif state.touched:
            self._read_all(context, items)
        elif state.in_doubt:
            self._is_ours(context)

    def _is_foreign(
        self,
        context: FlightContext,
        differences: tuple[str, ...],
        items: tuple[MissionItem, ...],
    ) -> None:
        """Say so at once, close the gate, and put ours back the first time."""
        state = self._state
        for words in differences[:10]:
            context.do(Note(f"mission aboard: {words}"))
        context.decide("mission_changed", differences[0])
        self._gate.close("another hand changed the mission aboard")
        if state.restored:
            self._give_up(context, "the mission was changed again")
            return
        if context.phase is Phase.LAND and self._jumps.is_over_landing(context):
            self._give_up(context, "mission changed by another in the landing")
            return
        context.say(Severity.CRITICAL, "mission changed by another: restoring ours")
        context.assessment = None
        state.doubted_s = state.doubted_s if state.in_doubt else context.t_s
        state.step, state.failed_s, state.restored = Step.RESTORE, None, True
        context.do(UploadMission(items))

    def _is_ours(self, context: FlightContext) -> None:
        """Proven again; where the gate is closed, one jump leads home at once."""
        state = self._state
        state.doubted_s, state.mission_id, state.asked_s = None, None, context.t_s
        if not state.restored:
            context.decide("mission_proven", "the mission aboard is ours")
            return
        context.decide("mission_restored", "our mission is aboard again")
        context.say(Severity.NOTICE, "our mission is aboard again")
        self._go_home(context)

    def _go_home(self, context: FlightContext) -> None:
        """From what was flown: a list that was changed meanwhile may have moved the index."""
        flown, index = context.flight_plan, self._jumps.index
        assert flown is not None
        if context.phase is Phase.RELEASE:
            self._jumps.jump_home(context, flown.mission.returning[0])
            context.request_transition(Trigger.HOMEWARD, self._gate.closed_by)
        elif context.phase in OUTWARD_PHASES:
            self._decision.gate(context)
        elif index is not None:
            self._jumps.jump_home(context, index)

    def _give_up(self, context: FlightContext, words: str) -> None:
        """Home by what needs no list."""
        self._state.step = Step.GIVEN_UP
        context.say(Severity.CRITICAL, words)
        context.decide("mission_lost", words)
        if context.phase in OUTWARD_PHASES:
            context.request_transition(Trigger.HOMEWARD, words)
        context.request_transition(Trigger.WAY_HOME_REFUSED, words)


def _round_s(items: tuple[MissionItem, ...]) -> float:
    """How long a slow reading takes, and the pause after it."""
    return len(items) * PACE_S + PAUSE_S
