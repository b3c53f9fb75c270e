"""Snapshot of a day with a truck: rows of the store and status of the fleet."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.order_window import late_text
from ground_station.core.schema.orders import AssignmentRow, AssignmentState, Order
from ground_station.core.schema.sortie_rows import SortieRow, StopTimes

CLOSED_PREFIX = "closed by the forecast"
"""Prefix of the reason of a withdrawal that does not count against the drone."""


@dataclass(frozen=True, slots=True)
class TruckStatus:
    """The truck by its last state. After a drive command `is_en_route` is True and `stop` the
    commanded stop, whether the truck has received the command or not.
    """

    present: bool
    is_en_route: bool
    stop: str


@dataclass(frozen=True, slots=True)
class DroneStatus:
    """A drone by its last state.

    `idle`: on standby, disarmed. `ready`: its assignment waits for the launch. `off_ground`: it has
    left its pad. `silent_s`: time since its last state; None: no state received.
    """

    vehicle: str
    present: bool = False
    doubtful: bool = False
    idle: bool = False
    ready: bool = False
    off_ground: bool = False
    assignment: str | None = None
    home: str | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    charge_frac: float | None = None
    silent_s: float | None = None


@dataclass(frozen=True, slots=True)
class DaySnapshot:
    """Snapshot of the day; `now_s` counts from the start of the day.

    `open_orders`: orders without an assignment; `changed_orders`: changed since the plan, which
    must not be delivered by it; `opens_s`: start of delivery windows, by order.
    `truck_assignments`: the driver's own deliveries. `replanning`: a new plan is being computed.
    `last_replan_s`: time of the end of the last re-planning, `last_replan_key`: its
    `plan_inputs_comparison_key`. `pad_wait_s`: by assignment, how long a drone on its pad has not
    been ready. `wind_deviation_sigmas`: distance of the measured wind from the planned one, in the
    forecast's standard deviations. `desk_start_s`: start of this desk. `drones_on_hold`: drones
    under a hold, `drones_out_of_service`: of them those that no plan uses. `closed_assignments`:
    assignments on the ground whose launch the forecast has closed for the rest of the day, with the
    reason. `plan_closing_text`: the part of the plan that the forecast closes; empty: none.
    """

    now_s: float
    start_us: int
    plan: DayPlan
    truck: TruckStatus | None
    drones: Mapping[str, DroneStatus]
    open_orders: frozenset[str]
    sorties: tuple[SortieRow, ...]
    truck_assignments: tuple[AssignmentRow, ...]
    changed_orders: frozenset[str] = frozenset()
    opens_s: Mapping[str, float] = field(default_factory=dict)
    stop_times: Mapping[str, StopTimes] = field(default_factory=dict)
    replanning: bool = False
    plan_created_s: float = 0.0
    last_replan_s: float | None = None
    last_replan_key: object = None
    pad_wait_s: Mapping[str, float] = field(default_factory=dict)
    wind_deviation_sigmas: float = 0.0
    desk_start_s: float = 0.0
    drones_on_hold: frozenset[str] = frozenset()
    drones_out_of_service: frozenset[str] = frozenset()
    closed_assignments: Mapping[str, str] = field(default_factory=dict)
    plan_closing_text: str = ""

    def is_before_window(self, order: str, after_s: float = 0.0) -> bool:
        """Return whether a delivery in `after_s` would be before the order's window."""
        return self.now_s + after_s < self.opens_s.get(order, -math.inf)

    def is_due(self, order: str) -> bool:
        """Return whether the driver may deliver an order now."""
        return order in self.due_orders and not self.is_before_window(order)

    def must_wait(self, row: SortieRow) -> bool:
        """Return whether a launch waits for a hold, or for the order's window."""
        out_s = row.sortie.drop_s - row.sortie.launch_s
        is_early = self.is_before_window(row.sortie.order, out_s)
        return row.vehicle in self.drones_on_hold or is_early

    def late_texts(self, orders: Iterable[Order]) -> dict[str, str]:
        """Return by open order how late it is for its window, by the plan and the truck's delay."""
        times_s, delay_s = self.plan.delivery_times_s(), max(0.0, self.truck_delay_s())
        late: dict[str, str] = {}
        for order in orders:
            if order.latest_us is None or order.id not in self.open_orders & times_s.keys():
                continue
            planned_s, how = times_s[order.id]
            at_s = max(planned_s + delay_s, self.now_s)
            if text := late_text(order.window, self.start_us + round(1e6 * at_s), how):
                late[order.id] = text
        return late

    @property
    def due_orders(self) -> frozenset[str]:
        """Open orders that the plan may deliver."""
        return self.open_orders - self.changed_orders

    def drone_status(self, vehicle: str) -> DroneStatus:
        """Return the status of a drone; the default status if no state was received."""
        return self.drones.get(vehicle) or DroneStatus(vehicle)

    def epoch_us_to_day_s(self, epoch_us: int) -> float:
        """Convert a time stamp to seconds of the day."""
        return (epoch_us - self.start_us) / 1e6

    @property
    def truck_stop_or_destination_index(self) -> int | None:
        """Index of the stop where the truck is or to which it drives; None: not in the plan."""
        if self.truck is None:
            return None
        ids = [stop.id for stop in self.plan.stops]
        return ids.index(self.truck.stop) if self.truck.stop in ids else None

    @property
    def current_stop(self) -> PlannedStop | None:
        """The stop where the truck is present and not commanded to leave; None: no such stop."""
        truck, index = self.truck, self.truck_stop_or_destination_index
        if truck is None or index is None or not truck.present or truck.is_en_route:
            return None
        return self.plan.stops[index]

    def out_of_service_reason(self, vehicle: str) -> str | None:
        """Return the cause of a drone's removal from service; None: it is in service."""
        if self.drone_status(vehicle).doubtful:
            return "doubtful"
        if vehicle in self.drones_out_of_service:
            return "by a person"
        own_sorties = [row for row in self.sorties if row.vehicle == vehicle]
        for row in own_sorties:
            if row.unavailability_reason:
                return row.unavailability_reason
        unflown = (AssignmentState.REFUSED, AssignmentState.WITHDRAWN)
        last = [
            row.assignment
            for row in own_sorties
            if not row.assignment.reason.startswith(CLOSED_PREFIX)
        ][-2:]
        if len(last) == 2 and all(row.state in unflown for row in last):
            return "last two assignments refused or withdrawn"
        return None

    def is_drone_available_on_truck(self, vehicle: str) -> bool:
        """Return True if a drone is on the truck, with a charged pack, and in service."""
        own_sorties = [row for row in self.sorties if row.vehicle == vehicle]
        return (
            all(row.is_drone_on_truck for row in own_sorties)
            and self.out_of_service_reason(vehicle) is None
        )

    def unassigned_sorties_by_launch_time(self) -> list[PlannedSortie]:
        """Return the planned sorties that are not assigned yet, in order of launch."""
        assigned = [row.sortie for row in self.sorties]
        remaining = [
            s for s in self.plan.sorties if s.order in self.due_orders and s not in assigned
        ]
        return sorted(remaining, key=lambda s: s.launch_s)

    @property
    def plan_inputs_comparison_key(self) -> object:
        """Everything that a plan depends on, except the time. Only for comparison."""
        truck = self.truck
        flights = [
            (
                row.id,
                row.assignment.state,
                row.is_drone_on_truck,
                row.is_drone_lost_off_site_or_overdue,
                row.promised_stop,
                row.requested_stop,
            )
            for row in self.sorties
        ]
        out_of_service = frozenset(
            vehicle for vehicle in self.drones if self.out_of_service_reason(vehicle) is not None
        )
        truck_state = None if truck is None else (truck.stop, truck.is_en_route)
        return truck_state, self.open_orders, tuple(flights), out_of_service

    def expected_landing_s(self, row: SortieRow) -> float:
        """Return the expected touchdown of a sortie: its launch plus the planned duration."""
        if row.launched_us is None:
            return self._earliest_landing_s(row.sortie)
        return self.epoch_us_to_day_s(row.launched_us) + row.sortie.land_s - row.sortie.launch_s

    def _earliest_landing_s(self, sortie: PlannedSortie) -> float:
        return max(self.now_s, sortie.launch_s) + sortie.land_s - sortie.launch_s

    def departure_delay_for_landings_s(self) -> float:
        """Return the delay of the truck at its stop due to drones that still land there (in the
        air, on their pads, or planned). Negative: all land before the planned departure.
        """
        here = self.current_stop
        if here is None:
            return 0.0
        rows = [
            row
            for row in self.sorties
            if not (row.is_finished or row.is_drone_lost_off_site_or_overdue)
        ]
        lands_s = [self.expected_landing_s(row) for row in rows if row.promised_stop == here.id]
        later_sorties = [
            s for s in self.unassigned_sorties_by_launch_time() if s.launch == s.home == here.id
        ]
        lands_s += [
            self._earliest_landing_s(s)
            for s in later_sorties
            if self._is_in_service_on_truck_or_due_at(s.vehicle, here.id)
        ]
        return max(lands_s, default=here.depart_s) - here.depart_s

    def _is_in_service_on_truck_or_due_at(self, vehicle: str, stop: str) -> bool:
        """Return True if a drone is on the truck or lands at this stop next."""
        own_sorties = [
            row for row in self.sorties if row.vehicle == vehicle and not row.is_drone_on_truck
        ]
        return self.out_of_service_reason(vehicle) is None and all(
            row.promised_stop == stop for row in own_sorties
        )

    def truck_delay_s(self) -> float:
        """Return the delay of the truck against the plan; negative: it is early.

        A long stay at the last stop is no delay, because the truck does not leave it.
        """
        index = self.truck_stop_or_destination_index
        if self.truck is None or index is None:
            return 0.0
        stop = self.plan.stops[index]
        if not self.truck.is_en_route:
            times = self.stop_times.get(stop.id)
            arrived_us = times.arrived_us if times is not None else None
            start_delay_s = self._delay_against_plan_s(arrived_us, stop.arrive_s)
            is_last = index + 1 == len(self.plan.stops)
            return start_delay_s if is_last else max(start_delay_s, self.now_s - stop.depart_s)
        previous_stop = self.plan.stops[max(index - 1, 0)]
        times = self.stop_times.get(previous_stop.id)
        left_us = times.departed_us if times is not None else None
        start_delay_s = self._delay_against_plan_s(left_us, previous_stop.depart_s)
        return max(start_delay_s, self.now_s - stop.arrive_s)

    def _delay_against_plan_s(self, actual_epoch_us: int | None, planned_s: float) -> float:
        if actual_epoch_us is None or self.epoch_us_to_day_s(actual_epoch_us) < self.plan_created_s:
            return 0.0
        return self.epoch_us_to_day_s(actual_epoch_us) - planned_s
