"""The one exception of safety rule 1: a HOLD that the autopilot entered by itself, unanswered.

PX4 whose mission is cleared or replaced by one that it cannot fly stays in HOLD until it is empty;
so it does by some of its failsafes, as beyond a fence. No pilot asked for that. All the same we let
go, as at any mode change: somebody was at the mission or the settings, and may be at the sticks.
Alarms follow at once. Where the operator chose a landing or a return
before the flight, that is ordered once the stated time has passed without an answer.

An answer is another mode, a disarm, or an order to us to keep off or to go on. Who writes to the
mission meanwhile is at work: the time begins anew.
"""

from dataclasses import dataclass

from companion.core.mission.actions import SetMode, Severity
from companion.core.mission.events import (
    ControlTaken,
    Event,
    MissionProgress,
    MissionTouched,
    Mode,
    ModeNow,
    OrderRefused,
    VehicleState,
)
from companion.core.pilot.context import (
    FlightContext,
    ForeignList,
    ModeOrders,
    Preflight,
    RtlHome,
    Unanswered,
)
from companion.core.pilot.transitions import Phase, Trigger

DIRECTLY_S = 2.0
"""A HOLD and what it follows on, the list or a failsafe, are both told at 1 Hz: so far apart."""

LIST_CHANGED = "mission changed"
FAILSAFE = "failsafe"

ALARM_EVERY_S = 10.0
"""Often enough to be looked at, seldom enough that other words are read between."""

LAST_WORDS_S = 0.5
"""The last half second counts as over: nobody reads an alarm of "in 0 s"."""

MODES = {Unanswered.RETURN: Mode.RTL, Unanswered.LAND: Mode.LAND}
WORDS = {Mode.RTL: "RTL", Mode.LAND: "landing"}

REPEAT_S = 2.0
"""Interval of the orders: a mode shows within 1 s (HEARTBEAT), and as long again on a slow link."""

LAND_AFTER = 10
"""After so many orders of RTL without effect (20 s) LAND and RTL are ordered in turn."""

NAMES = {Mode.RTL: "RTL", Mode.LAND: "LAND"}


@dataclass(slots=True)
class HoldState:
    """The HOLD that is watched. `since_s`: from when on an answer is waited for."""

    mode: Mode | None = None
    held_s: float | None = None
    """When HOLD followed on the mission, without another mode between."""
    cause: str | None = None
    """What had come just then, so that it is no pilot's."""
    calm_s: float | None = None
    """When a heartbeat last told that no failsafe acts."""
    since_s: float | None = None
    alarm_s: float | None = None
    told: tuple[int | None, int | None] | None = None
    """Length and id of the list aboard."""
    answered: bool = False


class UnansweredHold:
    """Alarms, and orders what the operator chose for this."""

    def __init__(
        self, aboard: ForeignList, modes: ModeOrders, preflight: Preflight, home: RtlHome
    ) -> None:
        self._state = HoldState()
        self._aboard = aboard
        self._modes = modes
        self._preflight = preflight
        self._home = home

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Modes, and signs that somebody is there."""
        state = self._state
        match event:
            case VehicleState():
                self._mode(context, event.mode)
                self._failsafe(context, event)
            case ModeNow():
                self._mode(context, event.mode)
            case ControlTaken():
                state.answered = True
            case MissionTouched():
                self._at_work(context)
            case MissionProgress():
                told = event.total, event.mission_id
                if state.told not in (None, told):
                    self._at_work(context)
                state.told = told
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """Alarm while nobody answers; then the operator's choice."""
        state = self._state
        self._find_cause(context)
        if not self._is_unanswered(context):
            state.since_s = state.alarm_s = None
            return
        if state.since_s is None:
            state.since_s = context.t_s
            context.decide("unanswered_hold", f"HOLD follows directly: {state.cause}")
        mode, left_s = self._chosen(context), self._left_s(context)
        if mode is not None and left_s < LAST_WORDS_S:
            self._act(context, mode)
        elif context.since_s(state.alarm_s) >= ALARM_EVERY_S - 1e-6:
            state.alarm_s = context.t_s
            ends = "nobody flies it" if mode is None else f"{WORDS[mode]} in {left_s:.0f} s"
            context.say(Severity.CRITICAL, f"{state.cause}, on HOLD: {ends}")

    def _mode(self, context: FlightContext, mode: Mode) -> None:
        state = self._state
        if mode is not Mode.HOLD:
            state.held_s, state.cause, state.answered = None, None, False
        elif state.mode is Mode.MISSION:
            state.held_s = context.t_s
        state.mode = mode

    def _failsafe(self, context: FlightContext, heartbeat: VehicleState) -> None:
        """A failsafe that begins with HOLD caused it: a pilot's own mode ends PX4's failsafe."""
        state = self._state
        if not heartbeat.failsafe:
            state.calm_s = context.t_s
        elif self._is_direct(context, state.calm_s):
            state.cause = state.cause or FAILSAFE

    def _is_direct(self, context: FlightContext, other_s: float | None) -> bool:
        """Tell whether HOLD has followed just now, and this other thing too."""
        return all(context.since_s(t_s) <= DIRECTLY_S for t_s in (self._state.held_s, other_s))

    def _at_work(self, context: FlightContext) -> None:
        if self._state.since_s is not None:
            self._state.since_s = context.t_s

    def _find_cause(self, context: FlightContext) -> None:
        """A list of ours that is put back meanwhile changes nothing: the autopilot holds."""
        if self._is_direct(context, self._aboard.foreign_s):
            self._state.cause = LIST_CHANGED

    def _is_unanswered(self, context: FlightContext) -> bool:
        """Tell whether nobody flies it, and nobody has said a word."""
        state = self._state
        ours = context.phase is Phase.SUSPENDED and not context.telemetry.on_ground
        return ours and state.cause is not None and not state.answered

    def _chosen(self, context: FlightContext) -> Mode | None:
        """The operator's choice, where it is safe: RTL only over every obstacle, to our home."""
        mode = MODES.get(context.options.unanswered_hold)
        safe = self._preflight.rtl_is_safe and not self._home.in_doubt
        return None if mode is Mode.RTL and not safe else mode

    def _left_s(self, context: FlightContext) -> float:
        return context.options.unanswered_hold_s - context.since_s(self._state.since_s)

    def _act(self, context: FlightContext, mode: Mode) -> None:
        """What the operator chose; from then on any other mode is a take-over again."""
        words = f"nobody answered: {WORDS[mode]}, as chosen before the flight"
        context.say(Severity.CRITICAL, f"nobody answered: {WORDS[mode]}")
        context.request_transition(Trigger.UNANSWERED, words)
        self._modes.expect(mode, context.telemetry.state)
        leads = ""
        if mode is Mode.RTL:
            leads = self._home.order_rtl(context)
        else:
            context.do(SetMode(mode))
        context.decide("last_resort", f"{words}{leads}")


@dataclass(slots=True)
class ResortState:
    """The orders given so far; `chosen` is the mode that was ordered first."""

    chosen: Mode | None = None
    began_s: float = 0.0
    ordered_s: float = 0.0
    orders: int = 1
    refusal: str = ""
    alarm_s: float | None = None


class LastResort:
    """Orders RTL or LAND again until telemetry shows that it is flown; alarms, falls back on LAND.

    An autopilot may refuse the mode for some seconds, or accept it without effect. Another mode is
    a person's, and ends this at once (authority.py). So does a gap in telemetry after which the
    vehicle is back in a mode that a person selected before.
    """

    def __init__(self, modes: ModeOrders, home: RtlHome) -> None:
        self._state = ResortState()
        self._modes = modes
        self._home = home

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Keep the autopilot's reason for the alarm."""
        if isinstance(event, OrderRefused) and event.order.startswith("mode "):
            self._state.refusal = event.reason

    def tick(self, context: FlightContext) -> None:
        """Order it again where it is due."""
        state, vehicle, mode = self._state, context.telemetry.state, self._modes.ordered
        ours = context.phase is Phase.LAST_RESORT and context.telemetry.airborne
        if not ours or vehicle is None or mode not in NAMES or vehicle.mode in (mode, Mode.LAND):
            self._state = ResortState()
        elif state.chosen is None or self._home.rtl_waits:
            self._state = ResortState(mode, context.t_s, context.t_s)
        elif vehicle.mode is not Mode.MISSION and context.telemetry.has_mode_gap_since(
            state.began_s
        ):
            words = "gap in telemetry after the mode command"
            context.request_transition(Trigger.TAKEN_OVER, words)
        else:
            self._alarm(context, mode)
            if context.since_s(state.ordered_s) >= REPEAT_S - 1e-6:
                self._order(context, state.chosen)

    def _alarm(self, context: FlightContext, mode: Mode) -> None:
        state = self._state
        overdue = state.refusal or context.since_s(state.ordered_s) >= REPEAT_S - 1e-6
        if overdue and context.since_s(state.alarm_s) >= ALARM_EVERY_S - 1e-6:
            state.alarm_s = context.t_s
            words = f"{NAMES[mode]} not in effect ({state.refusal or 'unconfirmed'}): repeating"
            context.say(Severity.CRITICAL, words)

    def _order(self, context: FlightContext, chosen: Mode) -> None:
        state = self._state
        mode = Mode.LAND if state.orders >= LAND_AFTER and state.orders % 2 == 0 else chosen
        if state.orders == LAND_AFTER and mode is not chosen:
            context.say(Severity.CRITICAL, f"RTL without effect {LAND_AFTER} times: LAND here")
            context.decide("last_resort", "RTL is not obeyed: LAND")
        state.orders += 1
        state.ordered_s = context.t_s
        self._modes.expect(mode, context.telemetry.state)
        context.do(SetMode(mode))
