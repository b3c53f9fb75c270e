"""Where in the mission the autopilot is, and jumps that are followed until it obeys.

A jump is believed only when telemetry shows it (jump_watch.py): asked again, then given up.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.base.geo import Ned, horizontal_m
from companion.core.mission.actions import JumpTo, Note, SetMode, Severity
from companion.core.mission.events import (
    Event,
    MissionProgress,
    Mode,
    OrderRefused,
    VehicleState,
)
from companion.core.mission.jump_watch import (
    OLDER_S,
    CourseWatch,
    JumpStatus,
    JumpWatch,
    LegWatch,
    Purpose,
)
from companion.core.mission.mission_items import DeadMansMission, Part
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import (
    CruiseSpeed,
    FlightContext,
    GateState,
    ListInDoubt,
    ModeOrders,
    Preflight,
    Promise,
    RtlHome,
)
from companion.core.pilot.telemetry_state import PROGRESS_MAX_AGE_S
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase, Trigger
from companion.core.vehicle.wind_triangle import airspeeds_along_mps

NEAR_M = 10.0
"""Nearer to its goal than this, the course says nothing."""

OVER_LANDING_M, OVER_LANDING_MPS = 5.0, 1.5
"""Nearer and slower it comes down where it should, whatever list is aboard."""

MOVE_WITNESSES = 2
"""So many messages in a row must show a move that is not ours."""

STANDS_MPS, STANDS_S = 1.0, 20.0
"""Slower for so long on the way home: no turn, no braking. Nothing flies it: ArduCopter does not
begin a mission again that it has completed, though it takes the jump and shows the item.
"""


HELD_MPS = 6.0
"""With less speed than this left against the wind at full tilt it may stand, or drift, and be on
its way all the same: gusts, and an autopilot that tilts less than it may, are within it. What flies
away faster than so much is not blown.
"""


@dataclass(frozen=True, slots=True)
class ForeignMove:
    """An item that the mission was moved to and not by us, reported so many times in a row."""

    index: int
    reports: int


@dataclass(slots=True)
class ProgressState:
    """The item that is flown, the leg of the way out, and the jump and course that are watched."""

    index: int | None = None
    leg: int = 0
    jump: JumpWatch | None = None
    obeyed: JumpWatch | None = None
    """The newest jump that telemetry has shown, and when."""
    obeyed_s: float = 0.0
    reports: tuple[MissionProgress, ...] = ()
    """Those of the last second."""
    course: CourseWatch | None = None
    home_leg: LegWatch | None = None
    """The item that it flies to on the way home."""
    moved_s: float = 0.0
    """When it was last seen to move on the way home."""
    foreign_move: ForeignMove | None = None


class MissionFollower:
    """Follows the mission aboard by the items that the autopilot reports."""

    def __init__(
        self,
        gate: GateState,
        promise: Promise,
        speed: CruiseSpeed,
        preflight: Preflight,
        modes: ModeOrders,
        aboard: ListInDoubt,
    ) -> None:
        self._state = ProgressState()
        self._aboard = aboard
        self._gate = gate
        self._promise = promise
        self._speed = speed
        self._preflight = preflight
        self._modes = modes

    @property
    def index(self) -> int | None:
        """The item that the autopilot flies, as telemetry shows it."""
        return self._state.index

    @property
    def leg(self) -> int:
        """Which leg of the way out."""
        return self._state.leg

    @property
    def jump_index(self) -> int | None:
        """The item of a jump that telemetry does not show yet."""
        return None if self._state.jump is None else self._state.jump.index

    @property
    def jumps_home(self) -> bool:
        """A jump home is under way."""
        return self._state.jump is not None and self._state.jump.purpose is Purpose.HOME

    def to_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"leg": self._state.leg}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        self._state.leg = checkpoint.leg

    # --- orders ----------------------------------------------------------------------------------

    def jump_onward(self, context: FlightContext, index: int) -> None:
        """Leave to go on, to this item."""
        self._jump(context, index, Purpose.ONWARD)

    def jump_to_leg(self, context: FlightContext, leg: int) -> None:
        """Turn outward again, to this leg."""
        assert context.flight_plan is not None
        self._state.leg = leg
        self._jump(context, context.flight_plan.mission.outbound[leg], Purpose.ONWARD)

    def jump_home(self, context: FlightContext, index: int) -> None:
        """The way home, or to a rally point."""
        self._jump(context, index, Purpose.HOME)

    def jump_to_other_home(self, context: FlightContext, index: int) -> None:
        """On the way home: to another stop's items."""
        self._jump(context, index, Purpose.MOVE)

    def cancel_jump(self) -> None:
        """No jump of ours is waited for any more."""
        self._state.jump = None

    def forget_item(self) -> None:
        """Which item is flown has to be found out anew."""
        self._state.index = None
        self._state.home_leg = None
        self._state.obeyed = None
        self._state.foreign_move = None

    def restart_course(self, t_s: float) -> None:
        """A detour is no disobedience: the course is watched from now on, where it is watched."""
        self._state.home_leg = None
        if self._state.course is not None:
            self._state.course = CourseWatch(t_s, math.inf)

    # --- events and ticks ------------------------------------------------------------------------

    def on_event(self, context: FlightContext, event: Event) -> None:
        """The autopilot's current item, or its refusal of an order."""
        match event:
            case MissionProgress():
                self._follow(context, event)
                recent = (r for r in self._state.reports if event.t_s - r.t_s <= OLDER_S)
                self._state.reports = (*recent, event)
            case OrderRefused():
                self._refused(context, event)
            case _:
                return

    def foreign_moves(self, context: FlightContext) -> bool:
        """Tell whether somebody else may control the mission; two reports in a row: suspended.

        One message alone may be a late one from before our own jump: MISSION_CURRENT has no time.
        """
        state, telemetry = self._state, context.telemetry
        move = state.foreign_move
        if not telemetry.is_fresh(telemetry.progress, PROGRESS_MAX_AGE_S):
            state.foreign_move = None
            return False
        if move is not None and move.reports >= MOVE_WITNESSES:
            state.foreign_move = None
            why = f"somebody moved the mission to item {move.index}"
            context.request_transition(Trigger.TAKEN_OVER, why)
        return move is not None

    def tick(self, context: FlightContext) -> None:
        """Ask again for a jump that telemetry does not show, or give it up."""
        jump, reported = self._state.jump, context.telemetry.progress
        if jump is None:
            return
        unknown = reported is None or reported.t_s <= jump.ordered_s
        unknown = unknown and not jump.refused
        match jump.wait(context.t_s):
            case JumpStatus.ASK_AGAIN if unknown:
                context.do(Note(f"jump to item {jump.index} not repeated: item not reported"))
            case JumpStatus.ASK_AGAIN:
                context.do(Note(f"jump to item {jump.index} not seen yet: again"))
                context.do(self._order(context, jump))
            case JumpStatus.REFUSED:
                self._given_up(context)
            case _:
                return

    def goes_on_past_missed(self, context: FlightContext, here: Ned) -> bool:
        """Where it has missed an item of the way home, jump to the next one that is in clear sight;
        tells whether it was ordered now.
        """
        flown, target, leg = context.flight_plan, self._target(context), self._leg_home(context)
        if flown is None or target is None or leg is None:
            return False
        leg.watch(context.t_s, horizontal_m(here, target), self._closing_mps(context, here, target))
        if not leg.has_missed(context.t_s) or self._held_by_wind(context, here, target):
            return False
        missed = flown.mission.stands_for(leg.index)
        beyond = flown.item_beyond(missed, here)
        if beyond is None:
            return False
        label, onward = (flown.mission.items[index].label for index in (missed, beyond))
        context.decide("waypoint_missed", f"{label} passed and not taken: to {onward}")
        context.say(Severity.WARNING, f"{label} missed: on to {onward}")
        self.jump_home(context, beyond)
        return True

    def strays(self, context: FlightContext, here: Ned) -> bool:
        """Tell whether it flies away from the way home; then the course is watched no longer."""
        state, target = self._state, self._target(context)
        if target is None:
            return False
        leg = self._leg_home(context)
        flown_past = leg is not None and leg.has_flown_past()
        disobeys = state.course is not None and self._disobeys(context, here, target)
        if not (flown_past or disobeys) or self._held_by_wind(context, here, target):
            return False
        if not flown_past:
            state.course = None
        return True

    def _leg_home(self, context: FlightContext) -> LegWatch | None:
        """The watch over the item that it shows and flies to; None: it may not be judged now."""
        state, vehicle = self._state, context.telemetry.state
        if state.index is None or vehicle is None or vehicle.mode is not Mode.MISSION:
            state.home_leg = None
            return None
        if state.home_leg is None or state.home_leg.index != state.index:
            state.home_leg = LegWatch(state.index)
        telemetry = context.telemetry
        told = telemetry.is_fresh(telemetry.progress, PROGRESS_MAX_AGE_S)
        if not told or telemetry.position_troubles():
            state.home_leg.pause()
            return None
        return state.home_leg

    def _target(self, context: FlightContext) -> Ned | None:
        """Where the item lies that the autopilot shows; None: it has no place, or none is known."""
        flown, index = context.flight_plan, self._state.index
        spot = flown.mission.spot_at(index) if flown and index is not None else None
        return None if flown is None or spot is None else flown.spot_ned(spot)

    def _held_by_wind(self, context: FlightContext, here: Ned, target: Ned) -> bool:
        """Tell whether the wind leaves it so little speed that its course says nothing.

        RTL would be held by it, too, and goes to a place that nobody promised.
        """
        estimates, away_m = context.estimates, horizontal_m(here, target)
        if estimates.wind is None or not estimates.wind.valid or away_m == 0.0:
            return False
        north, east = (target[0] - here[0]) / away_m, (target[1] - here[1]) / away_m
        to_north, to_east = (float(x) for x in estimates.wind.mean_to_ne_mps)
        along, across = to_north * north + to_east * east, to_east * north - to_north * east
        top_mps = estimates.route_energy.max_airspeed_mps(estimates.payload_kg)
        left_mps = float(airspeeds_along_mps(top_mps, np.array([across]))[0]) + along
        drifts = self._closing_mps(context, here, target) > min(left_mps, 0.0) - HELD_MPS
        return left_mps < HELD_MPS and drifts

    def _is_held(self, context: FlightContext) -> bool:
        """The same of where it is, on its way to the item that it shows."""
        here, target = context.here_ned(), self._target(context)
        return here is not None and target is not None and self._held_by_wind(context, here, target)

    def stands_still(self, context: FlightContext) -> bool:
        """Tell whether it hovers on the way home, whatever item it shows, for long."""
        vehicle, telemetry = context.telemetry.state, context.telemetry
        flies = vehicle is not None and vehicle.mode is Mode.MISSION
        moves = context.speed_mps() > STANDS_MPS or self._is_held(context)
        if moves or not flies or telemetry.position_troubles():
            self._state.moved_s = context.t_s
        stood_s = min(context.phase_s, context.since_s(self._state.moved_s))
        return stood_s > STANDS_S

    def place_by_progress(self, context: FlightContext) -> None:
        """The mission aboard is ours and flies: find the phase by its current item."""
        telemetry, flown = context.telemetry, context.flight_plan
        progress = telemetry.progress
        if progress is None or not telemetry.is_fresh(progress, 3.0) or progress.index is None:
            return
        if telemetry.position_troubles() and not telemetry.is_fresh(telemetry.position, 1.0):
            return
        assert flown is not None
        mission, state, index = flown.mission, self._state, progress.index
        state.index, state.jump, state.foreign_move = index, None, None
        state.home_leg = None
        self._speed.forget_speed()
        if progress.total is not None and progress.total != len(mission.items):
            why = f"another mission aboard ({progress.total} items)"
            context.request_transition(Trigger.MISSION_UNKNOWN, why)
            return
        part = mission.part_at(index)
        if part is None:
            context.request_transition(Trigger.MISSION_UNKNOWN, f"item {index} is not ours")
            return
        words = f"at item {index} ({mission.items[index].label})"
        self._promise.note_item(context, index)
        context.decide("recognised", f"our mission, {words}")
        self._modes.forget()
        self._enter_part(context, part, index, words)

    def is_over_landing(self, context: FlightContext) -> bool:
        """Tell whether it was descending to land, is there, and goes nowhere else."""
        index, flown, here = self._state.index, context.flight_plan, context.here_ned()
        if index is None or flown is None or here is None or context.telemetry.position_troubles():
            return False
        spot = flown.mission.spot_at(index)
        if flown.mission.part_at(index) not in (Part.LAND, Part.RALLY_LAND) or spot is None:
            return False
        away_m = horizontal_m(here, flown.spot_ned(spot))
        return away_m <= OVER_LANDING_M and context.ground_speed_mps() <= OVER_LANDING_MPS

    def last_resort(self, context: FlightContext, rtl_home: RtlHome) -> None:
        """What needs no list: over the landing place down; else RTL, where its altitude clears
        every obstacle; else the mission aboard goes home.
        """
        if self.is_over_landing(context):
            context.say(Severity.CRITICAL, "way home refused: landing here")
            context.decide("last_resort", "over its landing place: down by the autopilot's LAND")
            self._modes.expect(Mode.LAND, context.telemetry.state)
            context.do(SetMode(Mode.LAND))
            return
        if not self._preflight.rtl_is_safe:
            context.say(Severity.CRITICAL, "way home refused, RTL not safe")
            words = "no RTL: its altitude is not known to clear the obstacles"
            context.decide("last_resort", words)
            return
        context.say(Severity.CRITICAL, "way home refused: RTL")
        self._modes.expect(Mode.RTL, context.telemetry.state)
        context.decide("last_resort", f"RTL{rtl_home.order_rtl(context)}")

    # --- inside ----------------------------------------------------------------------------------

    def _jump(self, context: FlightContext, index: int, purpose: Purpose) -> None:
        state = self._state
        recent = {r.index for r in state.reports if context.t_s - r.t_s <= OLDER_S}
        replaced = (state.jump.index, *state.jump.before) if state.jump is not None else ()
        before = {at for at in (*recent, *replaced, state.index) if at is not None}
        if state.index == index:  # it flies there already: nothing tells it from obedience
            before.discard(index)
        state.jump = JumpWatch(index, purpose, context.t_s, frozenset(before))
        state.home_leg = None
        context.do(self._order(context, state.jump))

    @staticmethod
    def _order(context: FlightContext, jump: JumpWatch) -> JumpTo:
        flown = context.flight_plan
        return JumpTo(jump.index, frozenset() if flown is None else jump.shown_by(flown.mission))

    def _follow(self, context: FlightContext, event: MissionProgress) -> None:
        """What the autopilot flies is where we are in the mission."""
        state, flown = self._state, context.flight_plan
        if context.phase not in FLIGHT_PHASES or flown is None or event.index is None:
            return
        mission, vehicle = flown.mission, context.telemetry.state
        if (
            event.in_mission is False
            and context.phase not in (Phase.LAND, Phase.LAST_RESORT)
            and vehicle is not None
            and vehicle.armed
        ):
            context.request_transition(Trigger.TAKEN_OVER, "the autopilot left the mission")
            return
        if self._aboard.in_doubt:
            return  # its index may be another list's
        if state.jump is not None:
            if state.jump.confirms(mission, event.index, event.t_s):
                self._confirmed(context, event.index)
            elif state.jump.explains(mission, event.index):
                state.foreign_move = None  # the jump is under way; the tick asks again or gives up
            else:
                self._note_foreign(event.index)
            return
        if context.phase is Phase.LAST_RESORT and not _is_flown(vehicle):
            state.foreign_move = None
            return  # RTL or a landing needs no item
        if self._may_be_older(mission, event):
            return  # what is flown is reported again within a second
        if event.index == state.index or context.phase is Phase.LAND:
            state.foreign_move = None
            return
        if state.index is not None and not mission.follows(state.index, event.index):
            self._note_foreign(event.index)
            return
        state.foreign_move = None
        self._at_item(context, event.index)

    def _note_foreign(self, index: int) -> None:
        """Count the report. It is judged at the tick: after a silence it moved on by itself."""
        move = self._state.foreign_move
        again = move is not None and move.index == index
        self._state.foreign_move = ForeignMove(index, move.reports + 1 if again and move else 1)

    def _may_be_older(self, mission: DeadMansMission, event: MissionProgress) -> bool:
        """Tell whether this report may have been sent before the jump that was just obeyed."""
        state = self._state
        if state.obeyed is None or event.index is None or event.t_s - state.obeyed_s > OLDER_S:
            return False
        return state.obeyed.left_behind(mission, event.index)

    def _at_item(self, context: FlightContext, index: int) -> None:
        """The autopilot flies this item now: the phase follows."""
        assert context.flight_plan is not None
        mission = context.flight_plan.mission
        self._state.index = index
        self._promise.note_item(context, index)
        match mission.part_at(index):
            case Part.SETTLE if context.phase is Phase.CLIMB:
                if index == mission.settle:
                    context.request_transition(Trigger.AT_HEIGHT)
            case Part.OUTBOUND:
                if index in mission.outbound:
                    self._state.leg = mission.outbound.index(index)
            case Part.RELEASE if context.phase is Phase.DELIVER:
                context.request_transition(Trigger.DROP_REACHED)
            case Part.RETURN:
                self._on_the_way_home(context)
            case Part.LAND | Part.RALLY_LAND | Part.END:
                if context.outward:
                    self._on_the_way_home(context)
                context.request_transition(Trigger.LANDING)
            case _:
                return

    def _on_the_way_home(self, context: FlightContext) -> None:
        """The mission itself went on to the way home."""
        if context.phase is Phase.RELEASE:
            context.request_transition(Trigger.DROP_OVER)
        elif context.outward:
            why = self._gate.closed_by or "no leave to go on was given in time"
            context.decide("turn_back", f"the mission aboard went home by itself: {why}")
            context.say(Severity.WARNING, "going home by the mission aboard")
            context.request_transition(Trigger.HOMEWARD, why)

    def _enter_part(self, context: FlightContext, part: Part, index: int, words: str) -> None:
        """Enter the phase in which this item is flown."""
        assert context.flight_plan is not None
        mission = context.flight_plan.mission
        match part:
            case Part.TAKEOFF:
                context.request_transition(Trigger.TELEMETRY_COMES, words)
            case Part.SETTLE:
                context.request_transition(Trigger.AT_HEIGHT, words)
            case Part.OUTBOUND:
                passed = (k for k, out in enumerate(mission.outbound) if out <= index)
                self._state.leg = max(passed, default=0)
                context.request_transition(Trigger.GO, words)
            case Part.DELIVER:
                context.request_transition(Trigger.CUSTOMER_REACHED, words)
            case Part.RELEASE:
                context.request_transition(Trigger.DROP_REACHED, words)
            case Part.RETURN:
                context.request_transition(Trigger.HOMEWARD, words)
            case Part.RALLY:
                self._gate.choose_landing(context.flight_plan.site_of_item(index))
                context.request_transition(Trigger.RALLY_BOUND, words)
            case Part.LAND | Part.RALLY_LAND | Part.END:
                self._gate.choose_landing(context.flight_plan.site_of_item(index))
                context.request_transition(Trigger.LANDING, words)

    def _refused(self, context: FlightContext, event: OrderRefused) -> None:
        """Take a refusal in flight: a jump is asked again at once."""
        jump = self._state.jump
        if jump is not None and event.order == f"jump to item {jump.index}":
            jump.refused = event.answered
        elif context.phase in FLIGHT_PHASES:
            context.say_once(Severity.WARNING, f"{event.order} refused: {event.reason}")

    def _confirmed(self, context: FlightContext, index: int) -> None:
        state, flown = self._state, context.flight_plan
        assert flown is not None
        assert state.jump is not None
        jump, state.jump = state.jump, None
        state.foreign_move = None
        state.obeyed, state.obeyed_s = jump, context.t_s
        part = flown.mission.part_at(jump.index)
        state.index = jump.index
        self._promise.note_item(context, jump.index)
        if jump.purpose is not Purpose.ONWARD:
            self._watch_course(context, jump.index)
            context.do(Note(f"on the way home by item {jump.index}"))
            if jump.purpose is Purpose.MOVE:
                site = flown.site_of_item(jump.index)
                self._gate.choose_landing(site)
                trigger = Trigger.HOMEWARD if site is None else Trigger.RALLY_BOUND
                context.request_transition(trigger)
        elif part is Part.OUTBOUND:
            state.leg = flown.mission.outbound.index(jump.index)
            context.request_transition(Trigger.GO)
        elif part is Part.DELIVER:
            context.request_transition(Trigger.CUSTOMER_REACHED)
        if index != jump.index:
            self._at_item(context, index)

    def _watch_course(self, context: FlightContext, index: int) -> None:
        flown, position = context.flight_plan, context.telemetry.position
        assert flown is not None
        spot = flown.mission.spot_at(index)
        if spot is not None and position is not None:
            away_m = horizontal_m(flown.ned_of(position), flown.spot_ned(spot))
            self._state.course = CourseWatch(context.t_s, away_m)

    def _given_up(self, context: FlightContext) -> None:
        """The autopilot does not obey this jump."""
        state = self._state
        assert state.jump is not None
        jump, state.jump = state.jump, None
        context.say(Severity.WARNING, f"jump to item {jump.index} is not obeyed")
        words = f"jump to item {jump.index} not confirmed by telemetry"
        if jump.purpose is Purpose.HOME:
            context.decide("way_home_refused", words)
            why = "the jump home was not obeyed"
            context.request_transition(Trigger.WAY_HOME_REFUSED, why)
            return
        if jump.purpose is Purpose.MOVE:
            self._promise.want(context, None)
            context.decide("home_stays", words)
            return
        # Without leave the mission aboard goes home by itself.
        context.decide("onward_refused", words)
        self._gate.close("the autopilot does not jump onward")
        progress = context.telemetry.progress
        if progress is not None and progress.index is not None:
            self._at_item(context, progress.index)

    def _disobeys(self, context: FlightContext, here: Ned, target: Ned) -> bool:
        course = self._state.course
        assert course is not None
        away_m = horizontal_m(here, target)
        if away_m < NEAR_M:
            self._state.course = None
            return False
        return course.disobeys(context.t_s, away_m, self._closing_mps(context, here, target))

    def _closing_mps(self, context: FlightContext, here: Ned, target: Ned) -> float:
        """Speed towards a place (m/s); away from it is negative, at it is none."""
        position, away_m = context.telemetry.position, horizontal_m(here, target)
        if position is None or away_m == 0.0:
            return 0.0
        north, east = (target[0] - here[0]) / away_m, (target[1] - here[1]) / away_m
        return position.vel_n_mps * north + position.vel_e_mps * east


def _is_flown(state: VehicleState | None) -> bool:
    return state is None or state.mode is Mode.MISSION
