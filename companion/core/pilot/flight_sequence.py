"""The mission in the air: measure the wind, give leave, deliver, bring it home."""

from dataclasses import dataclass
from typing import Any, Protocol

from companion.core.base.geo import Ned, horizontal_m
from companion.core.mission.actions import SetGroundSpeed, Severity
from companion.core.mission.flight_plan import DROP_S
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import (
    FlightContext,
    Jumps,
    ListInDoubt,
    Parcel,
    ReturnBudget,
    RtlHome,
    SetpointFlight,
)
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase, Trigger
from companion.core.return_budget.budget import Assessment
from companion.core.return_budget.remaining_from_plan import ahead_outbound

ASSESS_S = 1.0
ASSESS_AT_WAYPOINT_S = 0.35
REACTION_S = 1.5
NEAR_M = 10.0
OVER_CUSTOMER_M = 4.0
OVER_CUSTOMER_MPS = 1.5
SPEED_STEP_MPS = 0.5
SPEED_STEP_FRAC = 0.05
SPEED_EVERY_S = 5.0
SPEED_ASSESS_S = 1.0
TURNS_AGAIN = 3
STRAIGHT_M = 30.0


class Ticking(Protocol):
    """Works at every tick of the flight."""

    def tick(self, context: FlightContext) -> None:
        """Once a tick."""
        ...


class MissionControl(Jumps, Ticking, Protocol):
    """The mission aboard: its items, jumps, and who moves it."""

    def foreign_moves(self, context: FlightContext) -> bool:
        """Somebody else may control the mission."""
        ...

    def jump_to_leg(self, context: FlightContext, leg: int) -> None:
        """Turn outward again, to this leg."""
        ...

    def goes_on_past_missed(self, context: FlightContext, here: Ned) -> bool:
        """Where it has missed an item of the way home, go on to one beyond; tells whether it was
        ordered now.
        """
        ...

    def strays(self, context: FlightContext, here: Ned) -> bool:
        """It flies away from the way home that it was sent on."""
        ...

    def stands_still(self, context: FlightContext) -> bool:
        """Tell whether it hovers on the way home."""
        ...

    def last_resort(self, context: FlightContext, rtl_home: RtlHome) -> None:
        """The way home is refused."""
        ...


class MissionBudget(ReturnBudget, Protocol):
    """The gate's answers, also to a departure and a delivery."""

    def assess_departure(self, context: FlightContext) -> Assessment | None:
        """For the whole mission."""
        ...

    def assess_delivery(self, context: FlightContext) -> Assessment | None:
        """From over the customer."""
        ...


class LeaveToGo(Protocol):
    """Whether to go on or to turn back."""

    @property
    def closed_by(self) -> str:
        """What closed the gate; `""` while it is open."""
        ...

    def gate(self, context: FlightContext) -> bool:
        """Turn back when the gate is closed; tells whether it is open."""
        ...

    def no_leave(self, context: FlightContext) -> str:
        """Why leave cannot be given now; `""` when it can."""
        ...

    def closed_beside_energy(self, context: FlightContext) -> str:
        """What closes the gate besides the budget."""
        ...

    def rally_instead(self, context: FlightContext, here: Ned) -> str | None:
        """A rally point that keeps the promise when the way home does not."""
        ...

    def divert(self, context: FlightContext, rally: str, why: str) -> None:
        """Jump to it."""
        ...


class StopMove(Protocol):
    """A home that moves to another stop."""

    def home(self, context: FlightContext) -> str | None:
        """The stop at which the flight ends now."""
        ...

    def turn_to_wanted(self, context: FlightContext, here: Ned) -> bool:
        """Turn to the stop that is wanted; tells whether it was ordered now."""
        ...


class DropWork(Ticking, Protocol):
    """The release of the parcel."""

    def observe(self, context: FlightContext) -> None:
        """Watch the hover over the customer."""
        ...

    def begin(self, context: FlightContext) -> None:
        """The mission aboard releases it now."""
        ...

    def end(self, context: FlightContext) -> None:
        """Leaving the customer."""
        ...


@dataclass(slots=True)
class FlightState:
    """Whether the flight has begun, its wind measurement, and the speed that was commanded."""

    flying: bool = False
    took_off_s: float | None = None
    settled_s: float | None = None
    """When the hover began in which the wind is measured."""
    speed_mps: float | None = None
    speed_s: float | None = None
    speed_index: int | None = None

    def take_off(self, t_s: float) -> None:
        """Armed in the mission."""
        self.flying = True
        self.took_off_s = t_s

    def resume_flight(self) -> None:
        """In the air already."""
        self.flying = True

    def settle(self, t_s: float) -> None:
        """Over the depot, at height; the first time counts."""
        self.settled_s = t_s if self.settled_s is None else self.settled_s

    def forget_speed(self) -> None:
        """Command the speed anew."""
        self.speed_mps = None

    def command_speed(self, speed_mps: float, t_s: float, index: int) -> None:
        """This ground speed was commanded on the leg to this item."""
        self.speed_mps, self.speed_s, self.speed_index = speed_mps, t_s, index

    def to_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"flying": self.flying, "took_off_s": self.took_off_s}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint; `resume_flight` says whether there is a flight to go on with."""
        self.took_off_s = checkpoint.took_off_s


class FlightSequence:
    """Works through the flight phases."""

    def __init__(
        self,
        state: FlightState,
        *,
        progress: MissionControl,
        budget: MissionBudget,
        decision: LeaveToGo,
        stops: StopMove,
        parcel: Parcel,
        drop: DropWork,
        position: Ticking,
        home: RtlHome,
        aboard: ListInDoubt,
        landing: Ticking,
        setpoints: SetpointFlight,
    ) -> None:
        self._state = state
        self._progress = progress
        self._budget = budget
        self._decision = decision
        self._stops = stops
        self._parcel = parcel
        self._drop = drop
        self._position = position
        self._home = home
        self._aboard = aboard
        self._landing = landing
        self._setpoints = setpoints
        self._turned_again = 0
        self._turn_assessed_s: float | None = None

    def enter(self, context: FlightContext, left: Phase) -> None:
        """Begin a flight phase."""
        match context.phase:
            case Phase.CLIMB:
                self._state.resume_flight()
            case Phase.MEASURE:
                self._state.settle(context.t_s)
            case Phase.RELEASE:
                self._drop.begin(context)
            case Phase.RETURN | Phase.DIVERT if left is Phase.RELEASE:
                self._drop.end(context)
            case Phase.LAST_RESORT if left is not Phase.SUSPENDED:
                self._progress.last_resort(context, self._home)
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """Work on the flight phase that we are in; in others only watch."""
        if self._state.flying and context.phase in (*FLIGHT_PHASES, Phase.SUSPENDED):
            self._position.tick(context)
        if context.phase is Phase.SUSPENDED and self._state.flying:
            self._budget.assess(context, ASSESS_S)
            self._landing.tick(context)
            return
        if context.phase not in FLIGHT_PHASES:
            return
        if self._progress.foreign_moves(context):
            return  # taken over, or perhaps: the next message tells
        if self._aboard.in_doubt:
            self._landing.tick(context)
            return
        self._drop.observe(context)
        if not self._home.in_doubt:
            self._progress.tick(context)
        if context.phase is not Phase.CLIMB:
            self._budget.assess(context, ASSESS_S)
        match context.phase:
            case phase if phase is not Phase.RELEASE and self._home.in_doubt:
                pass  # no leave and no jump home on heights above a home that has moved
            case Phase.MEASURE:
                self._measure(context)
            case Phase.OUTBOUND:
                self._outbound(context)
            case Phase.DELIVER:
                self._decision.gate(context)
            case Phase.RELEASE:
                self._drop.tick(context)
            case Phase.RETURN | Phase.DIVERT:
                self._homeward(context)
            case _:
                pass
        if not self._setpoints.active:
            self._command_speed(context)
        self._landing.tick(context)

    def _measure(self, context: FlightContext) -> None:
        """Hold over the depot until the wind is known, then decide on going."""
        settled_s, flown = self._state.settled_s, context.flight_plan
        if settled_s is None or flown is None or self._progress.jump_index is not None:
            return
        if context.t_s - settled_s < context.flight.mission.wind_settle_s:
            if self._decision.closed_by:
                self._decision.gate(context)
            return
        why = self._decision.no_leave(context)
        if why:
            context.say_once(Severity.INFO, f"waiting to go: {why}")
            return
        self._budget.assess_departure(context)
        if not self._decision.gate(context):
            return
        seen = context.assessment
        context.decide("go", seen.reason if seen is not None else "")
        context.say(Severity.NOTICE, "gate open: going")
        self._progress.jump_onward(context, flown.mission.outbound[0])

    def _outbound(self, context: FlightContext) -> None:
        """Give leave for the next leg shortly before each waypoint, if the gate is open."""
        flown, progress = context.flight_plan, self._progress
        if flown is None or not self._decision.gate(context) or progress.jump_index is not None:
            return
        here = context.here_ned()
        if here is None:
            return
        leg, points = progress.leg, flown.plan.outbound_ned_m
        away_m = horizontal_m(here, points[leg])
        last = leg == len(points) - 1
        if last:
            if away_m > OVER_CUSTOMER_M or context.ground_speed_mps() > OVER_CUSTOMER_MPS:
                return
        elif not self._near_enough(context, here, away_m):
            return
        why = self._decision.no_leave(context)
        if why:
            context.say_once(Severity.WARNING, f"no leave to go on: {why}")
            return
        if last:
            self._budget.assess_delivery(context)
        else:
            self._budget.assess(context, ASSESS_AT_WAYPOINT_S)
        if not self._decision.gate(context):
            return
        seen = context.assessment
        reason = seen.reason if seen is not None else ""
        if last:
            context.decide("descend", reason)
            progress.jump_onward(context, flown.mission.deliver)
        else:
            context.decide("onward", reason)
            progress.jump_onward(context, flown.mission.outbound[progress.leg + 1])

    def _near_enough(self, context: FlightContext, here: Ned, away_m: float) -> bool:
        """Tell whether leave must be given now for the vehicle not to slow down.

        It brakes over `v^2 / 2a`; the corner is cut only where the straight line on is clear.
        """
        flown = context.flight_plan
        assert flown is not None
        speed = context.ground_speed_mps()
        if away_m < NEAR_M + REACTION_S * speed:
            return True
        braking_m = speed**2 / (2.0 * context.airframe.speeds.accel_mps2)
        if away_m > braking_m + 2.0 * REACTION_S * speed + NEAR_M:
            return False
        return flown.is_clear(here, flown.plan.outbound_ned_m[self._progress.leg + 1])

    def _homeward(self, context: FlightContext) -> None:
        """Watch that it obeys; turn to a rally point when only that keeps the promise."""
        here = context.here_ned()
        if context.flight_plan is None or here is None or self._progress.jump_index is not None:
            return
        if not self._setpoints.active and self._progress.goes_on_past_missed(context, here):
            return
        why = ""
        if self._progress.strays(context, here):
            why = "it flies away from the way home"
        elif self._progress.stands_still(context):
            why = "it stands still on the way home"
        if why:
            context.decide("way_home_refused", why)
            context.request_transition(Trigger.WAY_HOME_REFUSED, why)
            return
        if context.phase is Phase.RETURN and self._turn_again(context, here):
            return
        if self._stops.turn_to_wanted(context, here) or not context.options.gate_on:
            return
        rally = self._decision.rally_instead(context, here)
        if rally is not None and not context.telemetry.troubles():
            where = self._stops.home(context) or "the depot"
            self._decision.divert(context, rally, f"{where} is out of the promise")

    def _turn_again(self, context: FlightContext, here: Ned) -> bool:
        """Go on with a delivery that nobody decided against: leave was only missing at the time.

        After a restart, a silence or a GNSS outage the mission aboard has turned home by itself;
        while the gate is open for going on from here, it may turn again, a few times.
        """
        flown, decision = context.flight_plan, self._decision
        undecided = self._parcel.untouched and not decision.closed_by
        if not undecided or flown is None or self._turned_again >= TURNS_AGAIN:
            return False
        if decision.no_leave(context):
            return False
        outbound, at = flown.plan.outbound_ned_m, self._progress.leg
        ahead = (min(at + 1, len(outbound) - 1), at)
        leg = next((k for k in ahead if flown.sees(here, outbound[k])), None)
        if leg is None or context.since_s(self._turn_assessed_s) < ASSESS_S:
            return False
        self._turn_assessed_s = context.t_s
        payload_kg, drop_m = context.estimates.payload_kg, context.flight.mission.drop_height_m
        going = ahead_outbound(flown.plan, here, leg, payload_kg, drop_m, DROP_S)
        seen = context.estimates.assess(going)
        if seen is None or (seen.turn_back and context.options.gate_on):
            return False
        if decision.closed_beside_energy(context):
            return False
        self._turned_again += 1
        context.assessment = seen
        context.decide("onward_again", f"the gate is open: {seen.reason}")
        context.say(Severity.NOTICE, "gate open: going on")
        self._progress.jump_to_leg(context, leg)
        return True

    def _command_speed(self, context: FlightContext) -> None:
        """Command the ground speed that the wind triangle gives; again when the wind moves."""
        state, flown, index = self._state, context.flight_plan, self._progress.index
        if context.phase not in (Phase.OUTBOUND, Phase.RETURN, Phase.DIVERT):
            return
        if self._progress.jump_index is not None:
            return
        new_leg = state.speed_mps is None or state.speed_index != index
        if not new_leg and context.since_s(state.speed_s) < SPEED_EVERY_S:
            return
        here = context.here_ned()
        if flown is None or here is None or index is None or context.telemetry.position_troubles():
            return
        spot = flown.mission.spot_at(index)
        if spot is None:
            return
        target = flown.spot_ned(spot)
        if horizontal_m(here, target) < STRAIGHT_M:
            return
        wanted = context.estimates.ground_speed_mps(here, target)
        if wanted is None:
            return
        wanted = min(wanted, context.airframe.speeds.max_ground_mps)
        if not new_leg and state.speed_mps is not None:
            step = max(SPEED_STEP_MPS, SPEED_STEP_FRAC * state.speed_mps)
            if abs(wanted - state.speed_mps) < step:
                state.speed_s = context.t_s - SPEED_EVERY_S + SPEED_ASSESS_S
                return
        state.command_speed(wanted, context.t_s, index)
        context.do(SetGroundSpeed(round(wanted, 2)))
