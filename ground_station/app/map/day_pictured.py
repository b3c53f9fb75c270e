"""The truck, its plan and the orders, for the map."""

from companion.fleet.messages import State
from ground_station.app.map.drones_shown import point_of
from ground_station.app.map.picture import (
    DriveShown,
    NextShown,
    OrderShown,
    PlanShown,
    Point,
    StopShown,
    TruckShown,
)
from ground_station.app.views.attention import vehicle_alarms
from ground_station.app.views.watched_rows import DayShown, WatchRows
from ground_station.core.fleet.fleet_status import VehicleStatus
from ground_station.core.fleet.truck_state import DRIVING
from ground_station.core.schema.orders import IN_FORCE, OrderState


def orders_shown(rows: WatchRows) -> dict[str, OrderShown]:
    """All orders, with who brings them."""
    by = {row.order_id: row.vehicle for row in rows.assignments if row.state in IN_FORCE}
    return {
        row.order.id: OrderShown(
            at=(row.order.lat_deg, row.order.lon_deg),
            state=row.state.value,
            mass_kg=row.order.mass_kg,
            vehicle=by.get(row.order.id),
            why=row.why,
            note=row.order.note,
        )
        for row in rows.orders
    }


def plan_shown(rows: WatchRows) -> PlanShown | None:
    """The plan in force, its times as times of the day; None: drones start from the depot."""
    day = rows.day
    if day is None:
        return None
    waiting = {row.order.id for row in rows.orders if row.state is OrderState.OPEN}
    return PlanShown(
        title=f"plan {day.plan.revision}",
        stops={
            stop.id: StopShown(
                at=at,
                arrive_us=time_of(day, stop.arrive_s),
                depart_us=time_of(day, stop.depart_s),
            )
            for stop in day.plan.stops
            if (at := point_of(stop.place)) is not None
        },
        route=[stop.id for stop in day.plan.stops],
        next=[
            NextShown(
                order=sortie.order,
                vehicle=sortie.vehicle,
                launch=sortie.launch,
                home=sortie.home,
                launch_us=time_of(day, sortie.launch_s),
            )
            for sortie in day.following(waiting)
        ],
    )


def time_of(day: DayShown, plan_s: float) -> int | None:
    """When this time of the plan is; None: the day has not begun."""
    return None if day.began_us is None else day.began_us + round(1e6 * plan_s)


def truck_shown(seen: VehicleStatus, day: DayShown | None, t_s: float) -> TruckShown:
    """The truck, and what keeps it where it stands."""
    state = seen.state
    alarms = list(vehicle_alarms(seen, day, t_s))
    if state is None:
        return TruckShown(phase="not heard", alarms=alarms)
    standing = state.stop if state.phase != DRIVING else None
    at = _truck_at(state, day, standing)
    return TruckShown(
        phase=state.phase,
        at=at,
        drive=_drive(state, day) if at is None else None,
        stop=state.stop,
        leaves_us=_leaves_us(day, standing),
        waits_for=[] if day is None or standing is None else day.binding(standing),
        alarms=alarms,
    )


def _truck_at(state: State, day: DayShown | None, standing: str | None) -> Point | None:
    if state.lat_deg is not None and state.lon_deg is not None:
        return state.lat_deg, state.lon_deg
    stops = () if day is None else day.plan.stops
    return next((point_of(stop.place) for stop in stops if stop.id == standing), None)


def _drive(state: State, day: DayShown | None) -> DriveShown | None:
    """Its drive by the plan in force; None: when it left, or from where, is not known."""
    if day is None or not day.visits or state.phase != DRIVING:
        return None
    left = max(day.visits, key=lambda visit: visit.arrived_us)
    stops = {stop.id: stop for stop in day.plan.stops}
    before, after = stops.get(left.stop), stops.get(state.stop or "")
    if left.left_us is None or before is None or after is None:
        return None
    start, end = point_of(before.place), point_of(after.place)
    if start is None or end is None or after.arrive_s < before.depart_s:
        return None
    takes_us = round(1e6 * (after.arrive_s - before.depart_s))
    return DriveShown(start=start, end=end, left_us=left.left_us, arrive_us=left.left_us + takes_us)


def _leaves_us(day: DayShown | None, standing: str | None) -> int | None:
    if day is None or standing is None:
        return None
    found = (stop.depart_s for stop in day.plan.stops if stop.id == standing)
    depart_s = next(found, None)
    return None if depart_s is None else time_of(day, depart_s)
