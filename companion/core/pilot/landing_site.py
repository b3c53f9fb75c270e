"""The promised stop: where what is aboard ends, and a home that moves to another stop.

Safety rule 3. Where the flight ends is read off the item that the autopilot flies, never off what
was ordered: the truck stays bound to a stop until the autopilot itself shows that it goes
elsewhere. Until then both stops are promised, and may be chosen.

The truck asks for another stop, and the gate judges it before it is flown to. On the way out the
wish is kept; on the way home one jump carries it out, as soon as the stop is in clear sight and the
way there keeps the promise.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

from companion.core.base.geo import LocalFrame, Ned, horizontal_m
from companion.core.mission.actions import Answer, Reply, Severity
from companion.core.mission.events import Event, HomeMoved
from companion.core.mission.flight_plan import FlightPlan
from companion.core.mission.mission_items import Part
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import FlightContext, HomeMoves, ReturnBudget
from companion.core.pilot.transitions import OUTWARD_PHASES, Phase
from companion.core.return_budget.budget import told_apart
from companion.core.return_budget.remaining_mission import Ahead, Stage, WayHome

ASSESS_S = 1.0
LOW_M = 5.0
"""So far under the layer of the way back it goes on climbing before it turns to another stop."""

STOP_RADIUS_M = 20.0
"""A place that an operator names is the stop whose pad is no further away."""

MOVING_PHASES = (*OUTWARD_PHASES, Phase.RETURN, Phase.DIVERT)
LATER_PHASES = (Phase.RECOGNISE, Phase.LINK_LOST)


@dataclass(slots=True)
class PromisedStop:
    """Where what is aboard ends were we to die now, and the stop that the truck asks for."""

    noted_home: str | None = None
    """Only on flights to a promised stop, once the autopilot was seen on its way."""
    wanted: str | None = None
    """`None`: the stop that it is."""

    def home(self, context: FlightContext) -> str | None:
        """The stop at which the flight ends were the companion to die now; `None`: no stops."""
        return self.noted_home or context.flight.site.home

    def note_item(self, context: FlightContext, index: int) -> None:
        """The autopilot flies this item: report where it leads when that is another stop."""
        flown = context.flight_plan
        if flown is None or flown.plan.home is None:
            return
        part = flown.mission.part_at(index)
        if part is None or part is Part.END:
            return
        home = flown.landing_from(index)[0]
        before = self.home(context)
        self.noted_home = home
        if home == before:
            return
        self.want(context, None if self.wanted == home else self.wanted)
        context.say(Severity.NOTICE, f"home is now {home}")
        context.decide("home_moved", f"what is aboard ends at {home}, no longer at {before}")
        context.save()

    def want(self, context: FlightContext, stop: str | None) -> None:
        """The stop that the truck asks for, or none: it and the present home may be chosen."""
        flown = context.flight_plan
        self.wanted = stop
        if flown is None or flown.plan.home is None:
            return
        plan = flown.plan.promised(self.home(context), stop)
        if plan != flown.plan:
            context.flight_plan = replace(flown, plan=plan)

    def to_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"home": self.noted_home, "wanted": self.wanted}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        self.noted_home, self.wanted = checkpoint.home, checkpoint.wanted


class LandingSite:
    """Moves home to the stop that the truck asks for."""

    def __init__(self, promise: PromisedStop, jumps: HomeMoves, budget: ReturnBudget) -> None:
        self._promise = promise
        self._jumps = jumps
        self._budget = budget
        self._assessed_s: float | None = None

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Answer the request for another home, and take it up."""
        if not isinstance(event, HomeMoved):
            return
        reply, reason = self._answer(context, event)
        name = event.stop or "another stop"
        if reply is Reply.DENIED:
            context.say(Severity.WARNING, f"home not moved: {reason}")
            context.decide("home_refused", f"to {name}, asked by {event.by}: {reason}")
        context.do(Answer(reply, reason))

    def home(self, context: FlightContext) -> str | None:
        """The stop at which the flight ends were the companion to die now; `None`: no stops."""
        return self._promise.home(context)

    def turn_to_wanted(self, context: FlightContext, here: Ned) -> bool:
        """On the way home: turn to the stop that is wanted; tells whether it was ordered now."""
        wanted, flown = self._promise.wanted, context.flight_plan
        if wanted is None or flown is None or self._jumps.jump_index is not None:
            return False
        if context.telemetry.troubles() or context.since_s(self._assessed_s) < ASSESS_S - 1e-6:
            return False
        self._assessed_s = context.t_s
        if here[2] > max(p[2] for p in flown.plan.return_ned_m) + LOW_M:
            return False
        item = _item_to(flown, here, wanted)
        if item is None:
            return False
        reply, reason = self._assessed(context, wanted)
        if reply is not Reply.ACCEPTED:
            context.say_once(Severity.WARNING, f"not yet to {wanted}: {reason}")
            return False
        context.decide("move_home", f"to {wanted}: {reason}")
        self._jumps.jump_to_other_home(context, item)
        return True

    def _answer(self, context: FlightContext, event: HomeMoved) -> tuple[Reply, str]:
        flown, home = context.flight_plan, self._promise.home(context)
        if context.flight.site.home is None:
            return Reply.DENIED, "this flight is not to a truck's stop"
        if context.phase in LATER_PHASES:
            return Reply.LATER, f"in phase {context.phase.value}"
        if flown is None or context.phase not in MOVING_PHASES:
            return Reply.DENIED, f"in phase {context.phase.value}"
        name = _stop_named(flown, event)
        stops = [flown.plan.landing, *(stop.name for stop in flown.plan.stops)]
        if name not in stops:
            return Reply.DENIED, f"no such stop aboard; there are {', '.join(stops)}"
        jump_index = self._jumps.jump_index
        if jump_index is not None and flown.landing_from(jump_index)[0] != home:
            return Reply.LATER, "turning to another landing site just now"
        if name == home:
            self._promise.want(context, None)
            return Reply.ACCEPTED, f"home is {name}"
        reply, reason = self._assessed(context, name)
        if reply is Reply.ACCEPTED:
            self._take_up(context, name, event.by)
        return reply, reason

    def _take_up(self, context: FlightContext, name: str, by: str) -> None:
        self._promise.want(context, name)
        home = self._promise.home(context)
        context.decide("home_wanted", f"{name}, asked by {by}; aboard is {home}")
        context.say(Severity.NOTICE, f"will land at {name}")
        context.save()

    def _assessed(self, context: FlightContext, name: str) -> tuple[Reply, str]:
        """What the gate says of a flight that ends at this stop."""
        here, troubles = context.here_ned(), context.telemetry.troubles()
        if here is None or troubles:
            return Reply.LATER, troubles[0] if troubles else "no fresh position"
        ahead = self._ending_at(context, here, name)
        if ahead is None:
            return Reply.DENIED, f"no clear way to {name}"
        seen = context.estimates.assess(ahead)
        if seen is None:
            return Reply.LATER, "wind or energy unknown"
        promise = 1.0 - context.estimates.limits.max_loss
        words = f"P(home) {seen.p_home:.3f} by way of {name}"
        if not context.options.gate_on:
            return Reply.ACCEPTED, words
        if ahead.stages and seen.turn_back:
            return Reply.DENIED, f"{words}: {seen.reason}"
        if not ahead.stages and seen.p_home < promise:
            low, high = told_apart(seen.p_home, promise)
            return Reply.DENIED, f"P(home) {low} by way of {name} is under {high}"
        return Reply.ACCEPTED, words

    def _ending_at(self, context: FlightContext, here: Ned, name: str) -> Ahead | None:
        """What is left to fly when it is to end at this stop; `None` where no clear way leads
        there.
        """
        flown, budget = context.flight_plan, self._budget
        assert flown is not None
        plan = flown.plan.promised(self._promise.home(context), name)
        item = None if context.outward else _item_to(flown, here, name)
        if item is None:
            ahead = budget.remaining(context, here, plan)
        else:
            ahead = budget.remaining_from(context, here, plan, item)
        now = _ways_to(name, ahead.ways_home_now)
        stages = tuple(
            Stage(s.legs, _ways_to(name, s.ways_home) or s.ways_home, s.delivers)
            for s in ahead.stages
        )
        ends = _ways_to(name, ahead.stages[-1].ways_home) if ahead.stages else now
        return Ahead(now or ahead.ways_home_now, stages, ahead.delivered) if ends else None


def _stop_named(flown: FlightPlan, event: HomeMoved) -> str | None:
    """The stop that is meant."""
    if event.stop is not None or event.lat_deg is None or event.lon_deg is None:
        return event.stop
    at = _ground_at(flown.site.frame, event.lat_deg, event.lon_deg)
    places = [(horizontal_m(ground, at), name) for name, ground in flown.site.stops_ned_m]
    away_m, name = min(places)
    return name if away_m <= STOP_RADIUS_M else None


def _ground_at(frame: LocalFrame, lat_deg: float, lon_deg: float) -> Ned:
    return frame.to_ned(math.radians(lat_deg), math.radians(lon_deg), frame.alt_amsl_m)


def _item_to(flown: FlightPlan, here: Ned, name: str) -> int | None:
    """The item to jump to for a straight clear way to a stop; `None` while there is none."""
    plan = flown.plan
    if name == plan.landing:
        return flown.item_home_from(here)
    above = next(s for s in plan.stops if s.name == name).above(plan.return_ned_m[-1])
    return flown.site_items(name)[0] if flown.sees(here, above) else None


def _ways_to(name: str, ways: tuple[WayHome, ...]) -> tuple[WayHome, ...]:
    return tuple(way for way in ways if way.landing == name)
