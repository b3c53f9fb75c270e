"""The truck, its plan and the orders, for the map."""

from collections.abc import Collection, Mapping
from typing import Any

from companion.fleet.messages import State
from ground_station.app.map.drone_view import point_of_location
from ground_station.app.map.picture import (
    DriveShown,
    OrderShown,
    PlanShown,
    Point,
    SortieShown,
    StopShown,
    TruckShown,
)
from ground_station.app.views.day_content import DayShown, DisplayRows
from ground_station.core.fleet.fleet_status import VehicleStatus
from ground_station.core.fleet.risk_words import format_reason
from ground_station.core.fleet.truck_state import EN_ROUTE
from ground_station.core.schema.orders import IN_FORCE, Order, OrderState
from ground_station.core.schema.sortie_rows import SortieRow


def orders_shown(rows: DisplayRows, released: Collection[str] = ()) -> dict[str, OrderShown]:
    """Return all orders, each with the vehicle that delivers it. An order is delivered once the
    release of its assignment is confirmed (`released`), not at the landing.
    """
    by = {row.order_id: row for row in rows.assignments if row.state in IN_FORCE}
    done = {row.order_id for row in by.values() if row.id in released}
    return {
        row.order.id: OrderShown(
            position=(row.order.lat_deg, row.order.lon_deg),
            state=(OrderState.DELIVERED if row.order.id in done else row.state).value,
            mass_kg=row.order.mass_kg,
            vehicle=None if row.order.id not in by else by[row.order.id].vehicle,
            confirmed_by=None if row.order.id not in by else by[row.order.id].confirmed_by,
            reason=format_reason(row.reason),
            note=row.order.note,
            **_customer_fields(row.order),
        )
        for row in rows.orders
    }


def _customer_fields(order: Order) -> dict[str, Any]:
    """Return the customer's data that an order has."""
    names = ("customer", "address", "phone", "earliest_us", "latest_us", "service_s")
    found = {name: value for name in names if (value := getattr(order, name)) not in (None, "")}
    return found | {"priority": order.is_urgent}


def plan_shown(rows: DisplayRows) -> PlanShown | None:
    """Return the plan in force, in times of the day; None: drones start from the depot."""
    day = rows.day
    if day is None:
        return None
    visits = {visit.stop: visit for visit in day.visits}
    return PlanShown(
        title=f"plan {day.plan.revision}",
        stops={
            stop.id: StopShown(
                position=at,
                arrive_us=plan_time_to_epoch_us(day, stop.arrive_s),
                depart_us=plan_time_to_epoch_us(day, stop.depart_s),
                arrived_us=None if stop.id not in visits else visits[stop.id].arrived_us,
                departed_us=None if stop.id not in visits else visits[stop.id].departed_us,
                serves=list(stop.serves),
            )
            for stop in day.plan.stops
            if (at := point_of_location(stop.location)) is not None
        },
        route=[stop.id for stop in day.plan.stops],
        sorties=sorties_shown(day, {row.order.id: row.state for row in rows.orders}),
        end_us=plan_time_to_epoch_us(day, day.plan.makespan_s),
        late_s=_truck_lateness_s(day),
    )


def sorties_shown(day: DayShown, order_states: Mapping[str, OrderState]) -> list[SortieShown]:
    """Return flown sorties at their times, then those of the plan whose order is open."""
    flown = [_flown_sortie_shown(day, row) for row in day.sorties if row.launched_us is not None]
    launched = {(one.order, one.vehicle) for one in flown}
    return flown + [
        SortieShown(
            order=one.order,
            vehicle=one.vehicle,
            launch=one.launch,
            home=one.home,
            launch_us=plan_time_to_epoch_us(day, one.launch_s),
            land_us=plan_time_to_epoch_us(day, one.land_s),
            drop_us=plan_time_to_epoch_us(day, one.drop_s),
            state="planned",
        )
        for one in day.plan.sorties
        if (one.order, one.vehicle) not in launched
        and order_states.get(one.order) in (OrderState.OPEN, OrderState.ASSIGNED)
    ]


def _flown_sortie_shown(day: DayShown, row: SortieRow) -> SortieShown:
    assert row.launched_us is not None
    plan = row.sortie
    is_over = row.is_finished or row.landed_us is not None
    expected_us = row.launched_us + round(1e6 * (plan.land_s - plan.launch_s))
    state = "lost" if row.is_drone_lost_off_site_or_overdue else "landed" if is_over else "flying"
    return SortieShown(
        order=plan.order,
        vehicle=row.vehicle,
        launch=plan.launch,
        home=row.promised_stop,
        launch_us=row.launched_us,
        drop_us=row.launched_us + round(1e6 * (plan.drop_s - plan.launch_s)),
        land_us=row.landed_us or (min(expected_us, day.now_us) if is_over else expected_us),
        state=state,
    )


def _truck_lateness_s(day: DayShown) -> int | None:
    """Return how late the truck is by its last arrival, or by a departure or arrival that is due;
    in steps of a minute. None: no visit yet.
    """
    if not day.visits:
        return None
    last = max(day.visits, key=lambda visit: visit.arrived_us)
    names = [stop.id for stop in day.plan.stops]
    if last.stop not in names:
        return None
    index = names.index(last.stop)
    stop = day.plan.stops[index]
    planned_us = plan_time_to_epoch_us(day, stop.arrive_s)
    due_us = plan_time_to_epoch_us(day, stop.depart_s)
    if last.departed_us is not None:
        rest = day.plan.stops[index + 1 :]
        due_us = plan_time_to_epoch_us(day, rest[0].arrive_s) if rest else None
    late_us = 0 if planned_us is None else last.arrived_us - planned_us
    if due_us is not None:
        late_us = max(late_us, day.now_us - due_us)
    return 60 * round(late_us / 60e6)


def plan_time_to_epoch_us(day: DayShown, plan_s: float) -> int | None:
    """Return the epoch time of a time of the plan; None: the day has not started."""
    return None if day.start_us is None else day.start_us + round(1e6 * plan_s)


def truck_shown(
    vehicle_status: VehicleStatus, day: DayShown | None, received_us: int | None
) -> TruckShown:
    """Return the truck, with the sorties that keep it at its stop."""
    state = vehicle_status.state
    if state is None:
        return TruckShown(phase="not reported yet")
    current_stop = state.stop if state.phase != EN_ROUTE else None
    at = _truck_position(state, day, current_stop)
    return TruckShown(
        phase=state.phase,
        position=at,
        drive=_drive_shown(state, day) if at is None else None,
        stop=state.stop,
        planned_departure_us=_planned_departure_us(day, current_stop),
        binding_sorties=[]
        if day is None or current_stop is None
        else day.binding_sortie_texts(current_stop),
        received_us=received_us,
    )


def _truck_position(state: State, day: DayShown | None, current_stop: str | None) -> Point | None:
    if state.lat_deg is not None and state.lon_deg is not None:
        return state.lat_deg, state.lon_deg
    stops = () if day is None else day.plan.stops
    return next(
        (point_of_location(stop.location) for stop in stops if stop.id == current_stop), None
    )


def _drive_shown(state: State, day: DayShown | None) -> DriveShown | None:
    """Return its drive by the plan in force; None: departure time or stop are unknown."""
    if day is None or not day.visits or state.phase != EN_ROUTE:
        return None
    last_departure = max(day.visits, key=lambda stop_times: stop_times.arrived_us)
    stops = {stop.id: stop for stop in day.plan.stops}
    before, after = stops.get(last_departure.stop), stops.get(state.stop or "")
    if last_departure.departed_us is None or before is None or after is None:
        return None
    start, end = point_of_location(before.location), point_of_location(after.location)
    if start is None or end is None or after.arrive_s < before.depart_s:
        return None
    duration_us = round(1e6 * (after.arrive_s - before.depart_s))
    return DriveShown(
        start=start,
        end=end,
        departure_us=last_departure.departed_us,
        arrive_us=last_departure.departed_us + duration_us,
    )


def _planned_departure_us(day: DayShown | None, current_stop: str | None) -> int | None:
    if day is None or current_stop is None:
        return None
    found = (stop.depart_s for stop in day.plan.stops if stop.id == current_stop)
    depart_s = next(found, None)
    return None if depart_s is None else plan_time_to_epoch_us(day, depart_s)
