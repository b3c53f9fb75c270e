"""Executes a plan of the search event by event, as the desk does, with pads, drones and layers.

The search decides the vehicle, launch stop, recovery stop and sequence of each delivery. Here the
driver launches drones at each stop in the search's order, recovers landed drones, delivers, and
waits. A launch waits until it is separated from all airborne flights. A launch that is blocked by a
drone bound for a later stop moves to the next stop: the truck cannot wait for that drone here.
"""

from dataclasses import dataclass, field, replace

from ground_station.core.deconfliction.pads import StopPads
from ground_station.core.deconfliction.separation import LATE_MARGIN_S, OperationalVolume
from ground_station.core.planning.day_problem import DayProblem
from ground_station.core.planning.forward_pass_request import ForwardPassRequest
from ground_station.core.planning.launch_slots import LaunchSlot, NoSlot, SlotFinder, SortieRequest
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.schedule import TruckStop, stops_and_flights_in_launch_order
from ground_station.core.truck_drones.tables import Plan

MAX_DELAYS = 2
"""Maximum delays of a launch for a late truck, before its recovery moves one stop earlier."""
MAX_DELAY_S = 30.0
"""[est] Maximum delay of a launch; above this its recovery moves one stop earlier at once."""
MAX_BACKTRACKS = 50
BACKTRACKS_PER_SORTIE = 20
"""Limit of backtracks: in total, plus per sortie. After it a drone that would land before the truck
is recovered at its launch stop."""
EPSILON_S = 1e-6


@dataclass(slots=True)
class ForwardSchedule:
    """Stops, launch slots, pads by node, and customers without a slot."""

    stops: list[TruckStop] = field(default_factory=list[TruckStop])
    slots: list[LaunchSlot] = field(default_factory=list[LaunchSlot])
    pads: dict[int, StopPads] = field(default_factory=dict[int, StopPads])
    lost: list[int] = field(default_factory=list[int])
    served_s: dict[int, float] = field(default_factory=dict[int, float])
    """Time at which the driver begins each delivery, by node."""

    @property
    def delivered_s(self) -> dict[int, float]:
        """Time of each delivery, by node."""
        nodes = {stop.node for stop in self.stops}
        served_s = {node: at_s for node, at_s in self.served_s.items() if node in nodes}
        return served_s | {slot.request.customer: slot.drop_s for slot in self.slots}

    @property
    def makespan_s(self) -> float:
        """Time from the start to the last departure."""
        return self.stops[-1].depart_s if self.stops else 0.0


@dataclass(frozen=True, slots=True)
class ForwardPass:
    """Executes plans of the search; no drone lands before the truck.

    `airborne_volumes`: of airborne sorties (day time; the truck starts at `t0_s`).
    """

    nodes: DayProblem
    finder: SlotFinder
    airborne_volumes: list[OperationalVolume]
    t0_s: float
    ready_s: float

    def request_from_plan(self, problem: TruckAndDrones, plan: Plan) -> ForwardPassRequest:
        """Extract the requests of a plan: route, sorties in launch order, and the time at which the
        driver begins each launch.
        """
        stops, flights = stops_and_flights_in_launch_order(problem, plan)
        return ForwardPassRequest(
            tuple(stop.node for stop in stops),
            tuple(SortieRequest(f.customer, f.kind, f.launch, f.rendezvous) for f in flights),
            {f.customer: f.launched_s - problem.kinds[f.kind].launch_s for f in flights},
            {f.customer: f.layer for f in flights if f.layer is not None},
        )

    def build_schedule(self, plan_request: ForwardPassRequest) -> ForwardSchedule:
        """Return the schedule; the truck is at each rendezvous `lead_s` before its drones."""
        return _Pass(self, plan_request).build_schedule()


@dataclass(frozen=True, slots=True)
class _PassState:
    """Snapshot of the pass at the truck's arrival at a stop, for backtracking."""

    now_s: float
    available_from_s: tuple[dict[str, float], ...]
    airborne: tuple[LaunchSlot, ...]
    blocked_until_s: dict[int, float]
    requests: tuple[SortieRequest, ...]
    stops: int
    slots: int
    lost: int
    pads: int


class _Pass:
    """One pass along the route, with backtracking to launches that are too early."""

    def __init__(self, road: ForwardPass, plan_request: ForwardPassRequest) -> None:
        nodes, self._road = road.nodes, road
        self._problem, self._route = nodes.problem, plan_request.route
        self._route_index = {node: number for number, node in enumerate(plan_request.route)}
        self._requests = list(plan_request.requests)
        self._layers = plan_request.layers
        self._release_s = {
            w.customer: plan_request.earliest_launch_s.get(w.customer, 0.0)
            for w in plan_request.requests
        }
        self._delay_counts = dict.fromkeys(self._release_s, 0)
        self._day = ForwardSchedule()
        self._now_s = 0.0
        self._available_from_s = [
            dict.fromkeys(of.ids, kind.from_s)
            # A fleet without drones has one placeholder kind.
            for of, kind in zip(nodes.classes, nodes.problem.kinds, strict=False)
        ]
        self._airborne: list[LaunchSlot] = []
        """Sorties not yet recovered."""
        self._blocked_until_s: dict[int, float] = {}
        self._assigned_pads: list[tuple[int, str]] = []
        """Assigned pads in order of assignment: node and drone."""
        self._snapshots: list[_PassState] = []
        self._backtracks_left = MAX_BACKTRACKS + BACKTRACKS_PER_SORTIE * len(plan_request.requests)
        self._loop_customers: set[int] = set()
        """Customers whose drones are recovered at the launch stop, overriding the request."""

    def build_schedule(self) -> ForwardSchedule:
        """Return the schedule.

        Terminates: each backtrack over the limit makes one more sortie land at its launch stop,
        and such a sortie is never too early.
        """
        for number, node in enumerate(self._route):
            self._day.pads[node] = self._road.finder.stop_pads_at_node(node, is_start=number == 0)
        number = 0
        while number < len(self._route):
            early = self._early_landings_with_lead_s(self._route[number])
            if early:
                number = self._backtrack_and_delay(early)
                continue
            self._snapshots[number:] = [self._take_snapshot()]
            self._process_stop_and_drive_to_next(number)
            number += 1
        return self._day

    def _process_stop_and_drive_to_next(self, stop_index: int) -> None:
        """Process a stop and the drive to the next."""
        node, arrive_s = self._route[stop_index], self._now_s
        next_node = self._route[stop_index + 1] if stop_index + 1 < len(self._route) else None
        stop_requests = [
            replace(request, rendezvous=node)
            if request.customer in self._loop_customers
            else request
            for request in self._requests
            if request.launch == node
        ]
        moved_requests = self._process_events_at_stop(
            node, stop_requests, is_last_stop=next_node is None
        )
        if stop_index == 0:
            self._now_s = max(self._now_s, self._problem.hold_s)
        # The truck waits until each launched drone has taken off.
        self._now_s = max([self._now_s, *(slot.launched_s for slot in self._airborne)])
        self._day.stops.append(TruckStop(node, arrive_s, self._now_s))
        if next_node is not None:
            self._now_s += float(self._problem.travel_s[node, next_node])
            moved_customers = {request.customer for request in moved_requests}
            self._requests = [
                request for request in self._requests if request.customer not in moved_customers
            ] + [
                self._request_moved_to_next_stop(request, stop_index) for request in moved_requests
            ]

    def _request_moved_to_next_stop(self, request: SortieRequest, stop_index: int) -> SortieRequest:
        """Move launch and rendezvous one stop later."""
        span = self._route_index[request.rendezvous] - stop_index
        rendezvous = self._route[min(stop_index + 1 + span, len(self._route) - 1)]
        return replace(request, launch=self._route[stop_index + 1], rendezvous=rendezvous)

    def _early_landings_with_lead_s(self, node: int) -> list[tuple[LaunchSlot, float]]:
        """Return the sorties that land here before the truck is ready, and by how much."""
        ready_s = self._now_s + self._problem.lead_s
        return [
            (slot, ready_s - slot.landed_s)
            for slot in self._airborne
            if slot.request.rendezvous == node
            and slot.request.launch != node
            and ready_s - slot.landed_s > EPSILON_S
        ]

    def _backtrack_and_delay(self, early_landings: list[tuple[LaunchSlot, float]]) -> int:
        """Backtrack to the first stop that launched one of these, delay them; return its index."""
        number = min(self._route_index[slot.request.launch] for slot, _ in early_landings)
        self._restore_snapshot(self._snapshots[number])
        self._backtracks_left -= 1
        if self._backtracks_left < 0:
            self._loop_customers.update(slot.request.customer for slot, _ in early_landings)
            return number
        for slot, by_s in early_landings:
            request, customer = slot.request, slot.request.customer
            start_s = (
                slot.launched_s - self._road.ready_s - self._problem.kinds[request.kind].launch_s
            )
            self._release_s[customer] = start_s + by_s + EPSILON_S
            self._delay_counts[customer] += 1
            if by_s > MAX_DELAY_S or self._delay_counts[customer] > MAX_DELAYS:
                self._release_s[customer] = 0.0
                self._delay_counts[customer] = 0
                before = self._route[self._route_index[request.rendezvous] - 1]
                self._requests = [
                    replace(one, rendezvous=before) if one.customer == customer else one
                    for one in self._requests
                ]
        return number

    def _take_snapshot(self) -> _PassState:
        return _PassState(
            self._now_s,
            tuple(dict(available_s) for available_s in self._available_from_s),
            tuple(self._airborne),
            dict(self._blocked_until_s),
            tuple(self._requests),
            len(self._day.stops),
            len(self._day.slots),
            len(self._day.lost),
            len(self._assigned_pads),
        )

    def _restore_snapshot(self, state: _PassState) -> None:
        self._now_s = state.now_s
        self._available_from_s = [dict(available_s) for available_s in state.available_from_s]
        self._airborne = list(state.airborne)
        self._blocked_until_s = dict(state.blocked_until_s)
        self._requests = list(state.requests)
        del self._day.stops[state.stops :]
        del self._day.slots[state.slots :]
        del self._day.lost[state.lost :]
        for node, drone in self._assigned_pads[state.pads :]:
            del self._day.pads[node].pad_by_drone[drone]
        del self._assigned_pads[state.pads :]

    def _process_events_at_stop(
        self, node: int, requests: list[SortieRequest], *, is_last_stop: bool
    ) -> list[SortieRequest]:
        """Process all events at this stop; return the launches to move to the next stop."""
        deliver_s = float(self._problem.deliver_s[node])
        opens_s = self._road.nodes.window_s(node)[0]
        waiting, moved_requests = list(requests), list[SortieRequest]()
        while True:
            launched, until_s = self._launch_first_possible_or_retry_times_s(
                waiting, moved_requests, node, is_last_stop=is_last_stop
            )
            if launched is not None:
                waiting.remove(launched)
                continue
            home = [slot for slot in self._airborne if slot.request.rendezvous == node]
            landed = [slot for slot in home if slot.landed_s <= self._now_s + EPSILON_S]
            if landed:
                self._recover_drone_and_advance_clock(min(landed, key=lambda slot: slot.landed_s))
            elif deliver_s > 0.0 and self._now_s >= opens_s - EPSILON_S:
                self._day.served_s[node] = self._now_s
                self._now_s += deliver_s
                deliver_s = 0.0
            elif home or waiting or deliver_s > 0.0:
                times_s = [slot.landed_s for slot in home] + until_s + [opens_s] * (deliver_s > 0.0)
                if not times_s:
                    self._day.lost += [request.customer for request in waiting]
                    return moved_requests
                self._now_s = max(min(times_s), self._now_s)
            else:
                return moved_requests

    def _recover_drone_and_advance_clock(self, slot: LaunchSlot) -> None:
        self._now_s += self._problem.kinds[slot.request.kind].recover_s
        self._airborne.remove(slot)
        self._available_from_s[slot.request.kind][slot.drone] = self._now_s
        self._blocked_until_s.clear()  # its pads may be closer to the route

    def _launch_first_possible_or_retry_times_s(
        self,
        waiting: list[SortieRequest],
        moved_requests: list[SortieRequest],
        node: int,
        *,
        is_last_stop: bool,
    ) -> tuple[SortieRequest | None, list[float]]:
        """Launch the first sortie that is possible now; else return the times of retries."""
        until_s: list[float] = []
        for request in list(waiting):
            not_before_s = max(
                self._release_s[request.customer], self._blocked_until_s.get(request.customer, 0.0)
            )
            if not_before_s > self._now_s + EPSILON_S:
                until_s.append(not_before_s)
                continue
            drones = [
                drone
                for drone, from_s in self._available_from_s[request.kind].items()
                if from_s <= self._now_s + EPSILON_S
            ]
            if not drones:
                later_s = [
                    s for s in self._available_from_s[request.kind].values() if s > self._now_s
                ]
                until_s += later_s
                if not later_s and not any(
                    (slot.request.rendezvous, slot.request.kind) == (node, request.kind)
                    for slot in self._airborne
                ):
                    self._defer_waiting_request_or_mark_lost(
                        request, waiting, moved_requests, is_last_stop=is_last_stop
                    )
                continue
            put_out_s = self._now_s + self._problem.kinds[request.kind].launch_s
            launched_s = put_out_s + self._road.ready_s
            in_air = self._volumes_possibly_in_use_from(launched_s)
            layer = self._layers.get(request.customer)
            found = self._road.finder.find_slot(
                request, launched_s, drones, self._day.pads, in_air, layer
            )
            if isinstance(found, LaunchSlot):
                early_s = self._road.nodes.window_s(request.customer)[0] - found.drop_s
                if early_s > EPSILON_S:  # wait here: the drop is not before the window
                    until_s.append(self._now_s + early_s)
                    continue
                self._now_s = put_out_s
                del self._available_from_s[request.kind][found.drone]
                self._airborne.append(found)
                self._day.slots.append(found)
                self._assign_pads(found)
                return request, []
            self._set_retry_time_or_move_request(
                request, found, launched_s, (waiting, moved_requests, until_s), node, is_last_stop
            )
        return None, until_s

    def _assign_pads(self, slot: LaunchSlot) -> None:
        for node, ned_m in (
            (slot.request.launch, slot.from_pad_ned_m),
            (slot.request.rendezvous, slot.to_pad_ned_m),
        ):
            of = self._day.pads[node].pad_by_drone
            if slot.drone not in of:
                of[slot.drone] = ned_m
                self._assigned_pads.append((node, slot.drone))

    def _set_retry_time_or_move_request(
        self,
        request: SortieRequest,
        no_slot: NoSlot,
        launched_s: float,
        waiting_moved_retry_lists: tuple[list[SortieRequest], list[SortieRequest], list[float]],
        node: int,
        is_last_stop: bool,
    ) -> None:
        waiting, moved_requests, until_s = waiting_moved_retry_lists
        if no_slot.until_s is not None:
            free_s = no_slot.until_s - self._road.t0_s + LATE_MARGIN_S + EPSILON_S
            wait_s = free_s - (launched_s - self._now_s)
            home_here = [s.landed_s for s in self._airborne if s.request.rendezvous == node]
            other_landings_s = [s.landed_s for s in self._airborne if s.request.rendezvous != node]
            if (
                is_last_stop
                or not other_landings_s
                or (home_here and min(other_landings_s) + LATE_MARGIN_S > free_s)
            ):
                wait_s = max(wait_s, self._now_s + EPSILON_S)
                self._blocked_until_s[request.customer] = wait_s
                until_s.append(wait_s)
                return
        self._defer_waiting_request_or_mark_lost(
            request, waiting, moved_requests, is_last_stop=is_last_stop
        )

    def _defer_waiting_request_or_mark_lost(
        self,
        request: SortieRequest,
        waiting: list[SortieRequest],
        moved_requests: list[SortieRequest],
        *,
        is_last_stop: bool,
    ) -> None:
        waiting.remove(request)
        if is_last_stop:
            self._day.lost.append(request.customer)
        else:
            moved_requests.append(request)

    def _volumes_possibly_in_use_from(self, at_s: float) -> list[OperationalVolume]:
        """Return the volumes that may be in use at this time or later."""
        until_s = self._road.t0_s + at_s - LATE_MARGIN_S
        volume = [slot.volume for slot in self._day.slots]
        return [one for one in (*self._road.airborne_volumes, *volume) if one.to_s > until_s]
