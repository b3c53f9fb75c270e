"""The truck, its plan and the orders, for the map."""

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
from ground_station.app.views.operator_alerts import vehicle_alarm_texts
from ground_station.core.fleet.fleet_status import VehicleStatus
from ground_station.core.fleet.truck_state import EN_ROUTE
from ground_station.core.schema.orders import IN_FORCE, OrderState


def orders_shown(rows: DisplayRows) -> dict[str, OrderShown]:
    """Return all orders, each with the vehicle that delivers it."""
    by = {row.order_id: row.vehicle for row in rows.assignments if row.state in IN_FORCE}
    return {
        row.order.id: OrderShown(
            position=(row.order.lat_deg, row.order.lon_deg),
            state=row.state.value,
            mass_kg=row.order.mass_kg,
            vehicle=by.get(row.order.id),
            reason=row.reason,
            note=row.order.note,
        )
        for row in rows.orders
    }


def plan_shown(rows: DisplayRows) -> PlanShown | None:
    """Return the plan in force, in times of the day; None: drones start from the depot."""
    day = rows.day
    if day is None:
        return None
    waiting = {row.order.id for row in rows.orders if row.state is OrderState.OPEN}
    return PlanShown(
        title=f"plan {day.plan.revision}",
        stops={
            stop.id: StopShown(
                position=at,
                arrive_us=plan_time_to_epoch_us(day, stop.arrive_s),
                depart_us=plan_time_to_epoch_us(day, stop.depart_s),
            )
            for stop in day.plan.stops
            if (at := point_of_location(stop.location)) is not None
        },
        route=[stop.id for stop in day.plan.stops],
        next=[
            SortieShown(
                order=sortie.order,
                vehicle=sortie.vehicle,
                launch=sortie.launch,
                home=sortie.home,
                launch_us=plan_time_to_epoch_us(day, sortie.launch_s),
            )
            for sortie in day.next_unassigned_sorties(waiting)
        ],
    )


def plan_time_to_epoch_us(day: DayShown, plan_s: float) -> int | None:
    """Return the epoch time of a time of the plan; None: the day has not started."""
    return None if day.start_us is None else day.start_us + round(1e6 * plan_s)


def truck_shown(vehicle_status: VehicleStatus, day: DayShown | None, t_s: float) -> TruckShown:
    """Return the truck, with the sorties that keep it at its stop."""
    state = vehicle_status.state
    alarms = list(vehicle_alarm_texts(vehicle_status, day, t_s))
    if state is None:
        return TruckShown(phase="no contact", alarms=alarms)
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
        alarms=alarms,
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
