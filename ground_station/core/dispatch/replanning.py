"""Re-planning of a day with a truck: triggers, initial state, and acceptance of a new plan.

Promises bind every plan: a new plan begins after the last promised stop.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

import msgspec

from companion.core.base.location import Location
from ground_station.core.dispatch.day_snapshot import DaySnapshot
from ground_station.core.dispatch.dispatch_rules import DispatchParams
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.orders import Service
from ground_station.core.schema.sortie_rows import SortieRow


class ReplanCause(Enum):
    """Cause of a deviation from the plan."""

    DRONE_OUT = "drone out"
    ORDER_UNPLANNED = "order left out"
    TRUCK_LATE = "truck late"
    WIND = "wind"
    FORECAST = "forecast"

    @property
    def is_wind_related(self) -> bool:
        """True if the next plan is computed for another wind."""
        return self in (ReplanCause.WIND, ReplanCause.FORECAST)


@dataclass(frozen=True, slots=True)
class ReplanReason:
    """Cause of a new plan, with a text for the dispatcher.

    Reasons are equal as long as the condition persists. So a reason for which no plan was found is
    not tried again, and does not keep the day from ending.
    """

    cause: ReplanCause
    text: str


def replan_reason(day: DaySnapshot, params: DispatchParams) -> ReplanReason | None:
    """Return the reason for a new plan; None: no new plan is needed."""
    if day.truck is None or day.truck_stop_or_destination_index is None or day.replanning:
        return None
    if day.last_replan_s is not None and day.now_s - day.last_replan_s < params.replan_interval_s:
        return None
    for sortie in day.unassigned_sorties_by_launch_time():
        reason = day.out_of_service_reason(sortie.vehicle)
        if reason is not None:
            text = f"{sortie.vehicle} is out of service ({reason})"
            return ReplanReason(ReplanCause.DRONE_OUT, text)
    unplanned_orders = sorted(
        day.open_orders
        - (
            _orders_still_to_deliver_in_plan(day)
            | {line.order for line in day.plan.unplanned} - day.changed_orders
        )
    )
    if unplanned_orders:
        order = unplanned_orders[0]
        text = f"{order} is open and not in the plan"
        if order in day.changed_orders:
            text = f"{order} was changed"
        return ReplanReason(ReplanCause.ORDER_UNPLANNED, text)
    if (
        day.truck_delay_s() > params.truck_late_s
        and day.plan_inputs_comparison_key != day.last_replan_key
    ):
        text = f"the truck is more than {params.truck_late_s:.0f} s late"
        return ReplanReason(ReplanCause.TRUCK_LATE, text)
    if day.wind_deviation_sigmas > params.wind_deviation_sigmas:
        sigmas = f"{params.wind_deviation_sigmas:g} standard deviations"
        return ReplanReason(ReplanCause.WIND, f"the wind is over {sigmas} from the forecast")
    interval_elapsed = (
        day.last_replan_s is None
        or day.now_s - day.last_replan_s >= params.forecast_replan_interval_s
    )
    if day.plan_closing_text and interval_elapsed:
        return ReplanReason(ReplanCause.FORECAST, day.plan_closing_text)
    return None


def _orders_still_to_deliver_in_plan(day: DaySnapshot) -> set[str]:
    """Return the orders that the plan still delivers."""
    index = day.truck_stop_or_destination_index or 0
    remaining_stops = day.plan.stops[index:]
    serves = {order for stop in remaining_stops for order in stop.serves} - day.changed_orders
    stops = {stop.id for stop in remaining_stops}
    return serves | {s.order for s in day.unassigned_sorties_by_launch_time() if s.launch in stops}


def replanning_start_state(
    day: DaySnapshot, drone_ids: list[str], recovery_duration_s: float
) -> DayState:
    """Return the fixed part of the day: past and promised stops, and the sorties in the air."""
    active_sorties = [
        row
        for row in day.sorties
        if not (row.is_drone_on_truck or row.is_drone_lost_off_site_or_overdue)
    ]
    last = max(
        [
            day.truck_stop_or_destination_index or 0,
            *(_last_promised_stop_index(row, day) for row in active_sorties),
        ]
    )
    delay_s = day.truck_delay_s()
    stops = [_stop_with_expected_times(day, n, delay_s) for n in range(last + 1)]
    serves = {
        order for stop in stops[day.truck_stop_or_destination_index or 0 :] for order in stop.serves
    }
    airborne = tuple(
        _sortie_with_expected_times(row, day) for row in active_sorties if not row.is_finished
    )
    open_orders = sorted(day.open_orders - serves - {sortie.order for sortie in airborne})
    free = {drone: day.now_s for drone in drone_ids if day.is_drone_available_on_truck(drone)}
    for row in active_sorties:
        if day.out_of_service_reason(row.vehicle) is None:
            lands_s = day.now_s if row.is_finished else _sortie_with_expected_times(row, day).land_s
            free[row.vehicle] = max(day.now_s, lands_s) + recovery_duration_s
    return DayState(tuple(stops), airborne, tuple(open_orders), free, day.plan.revision + 1)


def _last_promised_stop_index(row: SortieRow, day: DaySnapshot) -> int:
    ids = [stop.id for stop in day.plan.stops]
    bound = [s for s in (row.sortie.launch, row.promised_stop, row.requested_stop) if s in ids]
    return max((ids.index(s) for s in bound), default=0)


def _stop_with_expected_times(day: DaySnapshot, stop_index: int, delay_s: float) -> PlannedStop:
    """Return a stop with its actual or currently expected times."""
    stop, index = day.plan.stops[stop_index], day.truck_stop_or_destination_index or 0
    if day.changed_orders.intersection(stop.serves):
        serves = [order for order in stop.serves if order not in day.changed_orders]
        stop = msgspec.structs.replace(stop, serves=serves)
    times = day.stop_times.get(stop.id)
    if stop_index < index and times is not None:
        left_s = day.epoch_us_to_day_s(times.departed_us or times.arrived_us)
        return _stop_with_clamped_times(stop, day.epoch_us_to_day_s(times.arrived_us), left_s)
    if stop_index == index and day.truck is not None and not day.truck.is_en_route:
        return _stop_with_clamped_times(
            stop, day.now_s, max(day.now_s, stop.depart_s + min(0.0, delay_s))
        )
    arrive_s = max(day.now_s, stop.arrive_s + delay_s)
    return _stop_with_clamped_times(stop, arrive_s, arrive_s + stop.depart_s - stop.arrive_s)


def _stop_with_clamped_times(stop: PlannedStop, arrive_s: float, depart_s: float) -> PlannedStop:
    arrive_s = max(0.0, arrive_s)
    return msgspec.structs.replace(stop, arrive_s=arrive_s, depart_s=max(arrive_s, depart_s))


def _sortie_with_expected_times(row: SortieRow, day: DaySnapshot) -> PlannedSortie:
    sortie = row.sortie
    if row.launched_us is None:
        launch_s = max(day.now_s, sortie.launch_s)
    else:
        launch_s = max(0.0, day.epoch_us_to_day_s(row.launched_us))
    return msgspec.structs.replace(
        sortie,
        home=row.promised_stop,
        alternative_stops=[row.requested_stop] if row.requested_stop else [],
        launch_s=launch_s,
        land_s=max(day.now_s, launch_s + sortie.land_s - sortie.launch_s),
    )


def broken_promise_reason(plan: DayPlan, start: DayState) -> str | None:
    """Return the promise that a new plan breaks, as text; None: it is acceptable."""
    if plan.revision != start.revision:
        return f"revision {plan.revision}, expected {start.revision}"
    ids = [stop.id for stop in plan.stops]
    if len(set(ids)) < len(ids):
        return "two stops have the same name"
    kept = [stop.id for stop in start.stops]
    if ids[: len(kept)] != kept:
        return f"first stops {', '.join(ids[: len(kept)])}, expected {', '.join(kept)}"
    locations = {stop.id: stop.location for stop in start.stops}
    if any(stop.id in locations and stop.location != locations[stop.id] for stop in plan.stops):
        return "a promised stop has another position"
    missing = {s.order for s in start.airborne} - {s.order for s in plan.sorties}
    if missing:
        return f"sorties in the air are missing: {', '.join(sorted(missing))}"
    known = set(ids)
    unresolved = [s.order for s in plan.sorties if s.launch not in known or s.home not in known]
    return f"{unresolved[0]}: launch or home is not a stop of the plan" if unresolved else None


def delay_plan_by_computation_time(
    plan: DayPlan, start: DayState, requested_s: float, computation_time_s: float
) -> DayPlan:
    """Return the plan requested at `requested_s`, shifted by its computation time
    `computation_time_s`.

    The truck stays during the computation, so all later events shift. Without the shift the plans
    of a slow computer would be late at once and trigger endless re-planning.
    """
    airborne = {sortie.order for sortie in start.airborne}
    stops = [
        _stop_with_clamped_times(
            stop,
            stop.arrive_s + (computation_time_s if stop.arrive_s > requested_s else 0.0),
            stop.depart_s + (computation_time_s if stop.depart_s >= requested_s else 0.0),
        )
        for stop in plan.stops
    ]
    sorties = [
        s
        if s.order in airborne
        else msgspec.structs.replace(
            s, launch_s=s.launch_s + computation_time_s, land_s=s.land_s + computation_time_s
        )
        for s in plan.sorties
    ]
    return msgspec.structs.replace(
        plan, stops=stops, sorties=sorties, makespan_s=plan.makespan_s + computation_time_s
    )


def candidate_landing_pads_by_stop(
    plan: DayPlan, sortie: PlannedSortie, stop_by_id: Mapping[str, PlannedStop]
) -> dict[str, Location]:
    """Return the pads where a sortie may land, by stop: its home, its launch, and the next stop
    after its home that has a pad for it. More pads would make the uploaded mission too long.
    """
    ids = [stop.id for stop in plan.stops]
    later_stops = plan.stops[ids.index(sortie.home) + 1 :] if sortie.home in ids else []
    next_stop_ids = [stop.id for stop in later_stops if sortie.vehicle in stop.pads][:1]
    pad_stops = dict.fromkeys([sortie.home, sortie.launch, *next_stop_ids])
    return {stop: stop_by_id[stop].pads[sortie.vehicle] for stop in pad_stops}


def data_with_returned_orders_by_truck(data: DayData, day: DaySnapshot) -> DayData:
    """Return the day's data for re-planning: a returned parcel goes by the truck, if permitted."""
    returned_orders = {
        row.sortie.order for row in day.sorties if row.is_finished and not row.assignment.delivered
    }
    orders = [
        msgspec.structs.replace(order, service=Service.TRUCK)
        if order.id in returned_orders and order.service is Service.ANY
        else order
        for order in data.orders
    ]
    return replace(data, orders=orders)
