"""The plan of the search carried out event by event, as the desk will: with pads, drones, layers.

The search decides who is brought by whom, from where to where and in which order. Here the driver
launches at each stop what can be launched, in the search's order, recovers what has landed,
delivers, and waits. A launch waits until it is separated from everybody in the air. A launch that
is blocked by a drone on its way to a later stop goes to the next stop itself: the truck cannot wait
for that drone here.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise

from ground_station.core.deconfliction.pads import StopPads
from ground_station.core.deconfliction.separation import SLACK_S, OperationalVolume
from ground_station.core.planning.asked_day import AskedDay
from ground_station.core.planning.day_problem import DayProblem
from ground_station.core.planning.launch_slots import Blocked, LaunchSlot, SlotFinder, SortieRequest
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.schedule import Stop, flights_of
from ground_station.core.truck_drones.tables import Plan

MOST_PUSHES = 2
"""How often a launch is put off for a truck that comes late, before it is met a stop sooner."""
PUSH_S = 30.0
"""[est] A launch that would be put off by more is met a stop sooner at once."""
MOST_RETURNS = 50
RETURNS_FOR_EACH = 20
"""So many returns in all and for each sortie; from then on a drone that would land before the truck
is met where it is launched."""
EPSILON_S = 1e-6


@dataclass(slots=True)
class ForwardSchedule:
    """Stops, launch slots, pads by node, and the customers that found no slot."""

    stops: list[Stop] = field(default_factory=list[Stop])
    slots: list[LaunchSlot] = field(default_factory=list[LaunchSlot])
    pads: dict[int, StopPads] = field(default_factory=dict[int, StopPads])
    lost: list[int] = field(default_factory=list[int])

    @property
    def makespan_s(self) -> float:
        """From the start to the last departure."""
        return self.stops[-1].depart_s if self.stops else 0.0


@dataclass(frozen=True, slots=True)
class TriedPlan:
    """One of the search's plans: the makespan that its prices promise (None: they made no plan of
    it), and as it is driven.

    `elsewhere`: sorties that land at another stop than they took off from. `moved`: launches that
    the forward pass put off to another stop than was planned. `lost`: orders without a launch.
    """

    name: str
    promised_s: float | None
    driven_s: float
    launch_stops: int
    elsewhere: int
    moved: int | None
    lost: int


def tried_plan(
    name: str, promised_s: float | None, wished: Iterable[SortieRequest], driven: ForwardSchedule
) -> TriedPlan:
    """What became of these sorties on the road."""
    planned = {wish.customer: wish.launch for wish in wished}
    wishes = [slot.wish for slot in driven.slots]
    return TriedPlan(
        name,
        promised_s,
        driven.makespan_s,
        len({wish.launch for wish in wishes}),
        sum(wish.launch != wish.meet for wish in wishes),
        sum(planned[wish.customer] != wish.launch for wish in wishes),
        len(driven.lost),
    )


POLISH_DRIVES = 50
POLISH_ORDERS = 2_000
"""Together: with more orders fewer passes, since each takes longer."""


class ForwardPass:
    """Carries out one plan of the search; no drone lands before the truck."""

    def __init__(
        self,
        nodes: DayProblem,
        finder: SlotFinder,
        standing: list[OperationalVolume],
        t0_s: float,
        ready_s: float,
    ) -> None:
        """`standing`: volumes in the air already (the day's time; the truck starts at `t0_s`)."""
        self._nodes, self._finder, self._standing, self._t0_s = nodes, finder, standing, t0_s
        self._ready_s = ready_s

    def asked(self, problem: TruckAndDrones, plan: Plan) -> AskedDay:
        """What a plan of the search asks for: its route, its sorties in their order of launch, and
        when the driver begins each of them there.
        """
        stops, flights = flights_of(problem, plan)
        return AskedDay(
            tuple(stop.node for stop in stops),
            tuple(SortieRequest(f.customer, f.kind, f.launch, f.meet) for f in flights),
            {f.customer: f.launched_s - problem.kinds[f.kind].launch_s for f in flights},
            {f.customer: f.layer for f in flights if f.layer is not None},
        )

    def driven(self, asked: AskedDay) -> ForwardSchedule:
        """The schedule; at each rendezvous the truck is there `lead_s` before its drones."""
        road = (self._nodes, self._finder, self._standing, self._t0_s, self._ready_s)
        return _Pass(*road, asked).driven()


def polished(drive: ForwardPass, asked: AskedDay, driven: ForwardSchedule) -> ForwardSchedule:
    """Recover the last launches of a stop at the next one, where that ends the day sooner."""
    left = min(POLISH_DRIVES, POLISH_ORDERS // max(1, len(asked.wishes)))
    for here, there in pairwise(asked.route):
        loops = [s for s in driven.slots if s.wish.launch == s.wish.meet == here]
        for slot in sorted(loops, key=lambda slot: -slot.launched_s):
            if left == 0:
                return driven
            left -= 1
            customer = slot.wish.customer
            wishes = tuple(
                replace(w, meet=there) if w.customer == customer else w for w in asked.wishes
            )
            other = replace(asked, wishes=wishes)
            tried = drive.driven(other)
            if len(tried.lost) <= len(driven.lost) and tried.makespan_s < driven.makespan_s - 1.0:
                asked, driven = other, tried
    return driven


@dataclass(frozen=True, slots=True)
class _Arrival:
    """All that is as it was when the truck came to a stop, so that it can be driven on from there
    once more.
    """

    now_s: float
    aboard: tuple[dict[str, float], ...]
    out: tuple[LaunchSlot, ...]
    blocked_until_s: dict[int, float]
    wishes: tuple[SortieRequest, ...]
    stops: int
    slots: int
    lost: int
    pads: int


class _Pass:
    """The way along the route, and back to a launch that turns out to be too early."""

    def __init__(
        self,
        nodes: DayProblem,
        finder: SlotFinder,
        standing: list[OperationalVolume],
        t0_s: float,
        ready_s: float,
        asked: AskedDay,
    ) -> None:
        self._nodes, self._finder, self._route = nodes, finder, asked.route
        self._problem, self._t0_s = nodes.problem, t0_s
        self._standing, self._ready_s = standing, ready_s
        self._place = {node: number for number, node in enumerate(asked.route)}
        self._wishes = list(asked.wishes)
        self._layers = asked.layers
        self._release_s = {
            w.customer: asked.not_before_s.get(w.customer, 0.0) for w in asked.wishes
        }
        self._pushes = dict.fromkeys(self._release_s, 0)
        self._day = ForwardSchedule()
        self._now_s = 0.0
        self._aboard = [
            dict.fromkeys(of.ids, kind.from_s)
            # A fleet without drones has one kind, of none.
            for of, kind in zip(nodes.classes, nodes.problem.kinds, strict=False)
        ]
        self._out: list[LaunchSlot] = []
        """Not recovered yet."""
        self._blocked_until_s: dict[int, float] = {}
        self._pads_taken: list[tuple[int, str]] = []
        """Each pad that a drone got, in this order: node and drone."""
        self._arrivals: list[_Arrival] = []
        self._returns_left = MOST_RETURNS + RETURNS_FOR_EACH * len(asked.wishes)
        self._loops: set[int] = set()
        """Customers whose drones are met where they are launched, whatever was asked."""

    def driven(self) -> ForwardSchedule:
        """The schedule.

        It ends: each return after the last that is allowed makes one more sortie land where it
        starts, and that one is never too early again.
        """
        for number, node in enumerate(self._route):
            self._day.pads[node] = self._finder.pads_at(node, first=number == 0)
        number = 0
        while number < len(self._route):
            early = self._too_early(self._route[number])
            if early:
                number = self._launched_later(early)
                continue
            self._arrivals[number:] = [self._arrival()]
            self._visit(number)
            number += 1
        return self._day

    def _visit(self, number: int) -> None:
        """A stop, and the way to the next."""
        node, arrive_s = self._route[number], self._now_s
        following = self._route[number + 1] if number + 1 < len(self._route) else None
        mine = [
            replace(wish, meet=node) if wish.customer in self._loops else wish
            for wish in self._wishes
            if wish.launch == node
        ]
        put_off = self._stop(node, mine, last=following is None)
        if number == 0:
            self._now_s = max(self._now_s, self._problem.hold_s)
        # The truck does not leave a drone that has not taken off.
        self._now_s = max([self._now_s, *(slot.launched_s for slot in self._out)])
        self._day.stops.append(Stop(node, arrive_s, self._now_s))
        if following is not None:
            self._now_s += float(self._problem.travel_s[node, following])
            gone = {wish.customer for wish in put_off}
            self._wishes = [wish for wish in self._wishes if wish.customer not in gone] + [
                self._from_next(wish, number) for wish in put_off
            ]

    def _from_next(self, wish: SortieRequest, number: int) -> SortieRequest:
        """Launched at the next stop instead, and met as many stops on from there."""
        span = self._place[wish.meet] - number
        meet = self._route[min(number + 1 + span, len(self._route) - 1)]
        return replace(wish, launch=self._route[number + 1], meet=meet)

    def _too_early(self, node: int) -> list[tuple[LaunchSlot, float]]:
        """Who lands here before the truck is ready for it, which has just come, and by how much."""
        ready_s = self._now_s + self._problem.lead_s
        return [
            (slot, ready_s - slot.landed_s)
            for slot in self._out
            if slot.wish.meet == node
            and slot.wish.launch != node
            and ready_s - slot.landed_s > EPSILON_S
        ]

    def _launched_later(self, early: list[tuple[LaunchSlot, float]]) -> int:
        """Go back to the first stop where one of these was launched; its number."""
        number = min(self._place[slot.wish.launch] for slot, _ in early)
        self._go_back_to(self._arrivals[number])
        self._returns_left -= 1
        if self._returns_left < 0:
            self._loops.update(slot.wish.customer for slot, _ in early)
            return number
        for slot, by_s in early:
            wish, customer = slot.wish, slot.wish.customer
            starts_s = slot.launched_s - self._ready_s - self._problem.kinds[wish.kind].launch_s
            self._release_s[customer] = starts_s + by_s + EPSILON_S
            self._pushes[customer] += 1
            if by_s > PUSH_S or self._pushes[customer] > MOST_PUSHES:
                self._release_s[customer] = 0.0
                self._pushes[customer] = 0
                before = self._route[self._place[wish.meet] - 1]
                self._wishes = [
                    replace(one, meet=before) if one.customer == customer else one
                    for one in self._wishes
                ]
        return number

    def _arrival(self) -> _Arrival:
        return _Arrival(
            self._now_s,
            tuple(dict(aboard) for aboard in self._aboard),
            tuple(self._out),
            dict(self._blocked_until_s),
            tuple(self._wishes),
            len(self._day.stops),
            len(self._day.slots),
            len(self._day.lost),
            len(self._pads_taken),
        )

    def _go_back_to(self, then: _Arrival) -> None:
        self._now_s = then.now_s
        self._aboard = [dict(aboard) for aboard in then.aboard]
        self._out = list(then.out)
        self._blocked_until_s = dict(then.blocked_until_s)
        self._wishes = list(then.wishes)
        del self._day.stops[then.stops :]
        del self._day.slots[then.slots :]
        del self._day.lost[then.lost :]
        for node, drone in self._pads_taken[then.pads :]:
            del self._day.pads[node].of[drone]
        del self._pads_taken[then.pads :]

    def _stop(self, node: int, wishes: list[SortieRequest], *, last: bool) -> list[SortieRequest]:
        """Everything at this stop; returns the launches that must go to the next one."""
        deliver_s = float(self._problem.deliver_s[node])
        waiting, put_off = list(wishes), list[SortieRequest]()
        while True:
            launched, until_s = self._launch(waiting, put_off, node, last=last)
            if launched is not None:
                waiting.remove(launched)
                continue
            home = [slot for slot in self._out if slot.wish.meet == node]
            landed = [slot for slot in home if slot.landed_s <= self._now_s + EPSILON_S]
            if landed:
                self._take_in(min(landed, key=lambda slot: slot.landed_s))
            elif deliver_s > 0.0:
                self._now_s += deliver_s
                deliver_s = 0.0
            elif home or waiting:
                times_s = [slot.landed_s for slot in home] + until_s
                if not times_s:
                    self._day.lost += [wish.customer for wish in waiting]
                    return put_off
                self._now_s = max(min(times_s), self._now_s)
            else:
                return put_off

    def _take_in(self, slot: LaunchSlot) -> None:
        self._now_s += self._problem.kinds[slot.wish.kind].recover_s
        self._out.remove(slot)
        self._aboard[slot.wish.kind][slot.drone] = self._now_s
        self._blocked_until_s.clear()  # its pads may lie better

    def _launch(
        self, waiting: list[SortieRequest], put_off: list[SortieRequest], node: int, *, last: bool
    ) -> tuple[SortieRequest | None, list[float]]:
        """Launch the first that can go now; else the times when others may be able to."""
        until_s: list[float] = []
        for wish in list(waiting):
            not_before_s = max(
                self._release_s[wish.customer], self._blocked_until_s.get(wish.customer, 0.0)
            )
            if not_before_s > self._now_s + EPSILON_S:
                until_s.append(not_before_s)
                continue
            drones = [
                drone
                for drone, from_s in self._aboard[wish.kind].items()
                if from_s <= self._now_s + EPSILON_S
            ]
            if not drones:
                later_s = [s for s in self._aboard[wish.kind].values() if s > self._now_s]
                until_s += later_s
                if not later_s and not self._coming(wish.kind, node):
                    self._pass_on(wish, waiting, put_off, last=last)
                continue
            put_out_s = self._now_s + self._problem.kinds[wish.kind].launch_s
            launched_s = put_out_s + self._ready_s
            in_air = self._in_air(launched_s)
            layer = self._layers.get(wish.customer)
            found = self._finder.find(wish, launched_s, drones, self._day.pads, in_air, layer)
            if isinstance(found, LaunchSlot):
                self._now_s = put_out_s
                del self._aboard[wish.kind][found.drone]
                self._out.append(found)
                self._day.slots.append(found)
                self._take_pads(found)
                return wish, []
            self._wait_or_pass_on(wish, found, launched_s, (waiting, put_off, until_s), node, last)
        return None, until_s

    def _take_pads(self, slot: LaunchSlot) -> None:
        for node, ned_m in (
            (slot.wish.launch, slot.from_pad_ned_m),
            (slot.wish.meet, slot.to_pad_ned_m),
        ):
            of = self._day.pads[node].of
            if slot.drone not in of:
                of[slot.drone] = ned_m
                self._pads_taken.append((node, slot.drone))

    def _wait_or_pass_on(
        self,
        wish: SortieRequest,
        found: Blocked,
        launched_s: float,
        lists: tuple[list[SortieRequest], list[SortieRequest], list[float]],
        node: int,
        last: bool,
    ) -> None:
        waiting, put_off, until_s = lists
        if found.until_s is not None:
            free_s = found.until_s - self._t0_s + SLACK_S + EPSILON_S
            wait_s = free_s - (launched_s - self._now_s)
            home_here = [s.landed_s for s in self._out if s.wish.meet == node]
            foreign = [s.landed_s for s in self._out if s.wish.meet != node]
            if last or not foreign or (home_here and min(foreign) + SLACK_S > free_s):
                wait_s = max(wait_s, self._now_s + EPSILON_S)
                self._blocked_until_s[wish.customer] = wait_s
                until_s.append(wait_s)
                return
        self._pass_on(wish, waiting, put_off, last=last)

    def _coming(self, kind: int, node: int) -> bool:
        """Whether a drone of this kind will be recovered here."""
        return any(slot.wish.meet == node and slot.wish.kind == kind for slot in self._out)

    def _pass_on(
        self,
        wish: SortieRequest,
        waiting: list[SortieRequest],
        put_off: list[SortieRequest],
        *,
        last: bool,
    ) -> None:
        waiting.remove(wish)
        if last:
            self._day.lost.append(wish.customer)
        else:
            put_off.append(wish)

    def _in_air(self, at_s: float) -> list[OperationalVolume]:
        """Volumes that may be in use at this time or later."""
        until_s = self._t0_s + at_s - SLACK_S
        volume = [slot.volume for slot in self._day.slots]
        return [one for one in (*self._standing, *volume) if one.to_s > until_s]
