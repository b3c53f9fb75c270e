"""When a day with a truck is planned anew, from which state, and whether the new plan may be taken.

Promises bind whatever the plan is; a new plan goes on behind the last of them.
"""

from collections.abc import Mapping

import msgspec

from companion.core.base.place import Place
from ground_station.core.dispatch.day_snapshot import DayRunParams, DayView
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.orders import Service
from ground_station.core.schema.sortie_rows import SortieRow


def replan_reason(view: DayView, params: DayRunParams) -> str | None:
    """Why the plan in force will not do; None: it will.

    The same words while the same is wrong: a reason for which no plan was found is not tried again,
    and does not keep a day from ending.
    """
    if view.truck is None or view.index is None or view.replanning:
        return None
    if view.now_s - view.tried_s < params.replan_again_s:
        return None
    for sortie in view.pending():
        why = view.out(sortie.vehicle)
        if why is not None:
            return f"{sortie.vehicle} is out of service ({why})"
    left_out = sorted(view.open - _work_ahead(view) - {line.order for line in view.plan.unplanned})
    if left_out:
        return f"{left_out[0]} is open and not in the plan"
    if view.delay_s() > params.late_s and view.situation != view.tried:
        return f"the truck is more than {params.late_s:.0f} s late"
    if view.wind_off_sigmas > params.wind_sigmas:
        return f"the wind is {params.wind_sigmas:g} standard deviations from the forecast, or more"
    return None


def _work_ahead(view: DayView) -> set[str]:
    """Orders that the plan still brings."""
    index = view.index or 0
    ahead = view.plan.stops[index:]
    serves = {order for stop in ahead for order in stop.serves}
    stops = {stop.id for stop in ahead}
    return serves | {s.order for s in view.pending() if s.launch in stops}


def standing(view: DayView, drones: list[str], recover_s: float) -> DayState:
    """What of the day stands: stops done and promised with times as expected, and what flies."""
    held = [row for row in view.sorties if not (row.aboard or row.gone)]
    last = max([view.index or 0, *(_last_index(row, view) for row in held)])
    delay_s = view.delay_s()
    stops = [_expected(view, n, delay_s) for n in range(last + 1)]
    serves = {order for stop in stops[view.index or 0 :] for order in stop.serves}
    flying = tuple(_expected_flight(row, view) for row in held if not row.over)
    left = sorted(view.open - serves - {sortie.order for sortie in flying})
    free = {drone: view.now_s for drone in drones if view.free(drone)}
    for row in held:
        if view.out(row.vehicle) is None:
            lands_s = view.now_s if row.over else _expected_flight(row, view).land_s
            free[row.vehicle] = max(view.now_s, lands_s) + recover_s
    return DayState(tuple(stops), flying, tuple(left), free, view.plan.revision + 1)


def _last_index(row: SortieRow, view: DayView) -> int:
    ids = [stop.id for stop in view.plan.stops]
    bound = [s for s in (row.sortie.launch, row.promised, row.asked) if s in ids]
    return max((ids.index(s) for s in bound), default=0)


def _expected(view: DayView, number: int, delay_s: float) -> PlannedStop:
    """A stop with the times that it had, or is expected to have."""
    stop, index = view.plan.stops[number], view.index or 0
    visit = view.visits.get(stop.id)
    if number < index and visit is not None:
        left_s = view.day_s(visit.left_us or visit.arrived_us)
        return _timed(stop, view.day_s(visit.arrived_us), left_s)
    if number == index and view.truck is not None and not view.truck.driving:
        return _timed(stop, view.now_s, max(view.now_s, stop.depart_s + min(0.0, delay_s)))
    arrive_s = max(view.now_s, stop.arrive_s + delay_s)
    return _timed(stop, arrive_s, arrive_s + stop.depart_s - stop.arrive_s)


def _timed(stop: PlannedStop, arrive_s: float, depart_s: float) -> PlannedStop:
    arrive_s = max(0.0, arrive_s)
    return msgspec.structs.replace(stop, arrive_s=arrive_s, depart_s=max(arrive_s, depart_s))


def _expected_flight(row: SortieRow, view: DayView) -> PlannedSortie:
    sortie = row.sortie
    if row.launched_us is None:
        launch_s = max(view.now_s, sortie.launch_s)
    else:
        launch_s = max(0.0, view.day_s(row.launched_us))
    return msgspec.structs.replace(
        sortie,
        home=row.promised,
        others=[row.asked] if row.asked else [],
        launch_s=launch_s,
        land_s=max(view.now_s, launch_s + sortie.land_s - sortie.launch_s),
    )


def unfit(plan: DayPlan, start: DayState) -> str | None:
    """Why a new plan may not be taken (it breaks what stands); None: it may."""
    if plan.revision != start.revision:
        return f"revision {plan.revision}, expected {start.revision}"
    ids = [stop.id for stop in plan.stops]
    if len(set(ids)) < len(ids):
        return "a stop of the same name twice"
    kept = [stop.id for stop in start.stops]
    if ids[: len(kept)] != kept:
        return f"its stops begin {', '.join(ids[: len(kept)])}, promised are {', '.join(kept)}"
    places = {stop.id: stop.place for stop in start.stops}
    if any(stop.id in places and stop.place != places[stop.id] for stop in plan.stops):
        return "a promised stop is moved"
    missing = {s.order for s in start.flying} - {s.order for s in plan.sorties}
    if missing:
        return f"{', '.join(sorted(missing))} in the air is not in it"
    known = set(ids)
    lost = [s.order for s in plan.sorties if s.launch not in known or s.home not in known]
    return f"{lost[0]} has no such stop" if lost else None


def postponed(plan: DayPlan, start: DayState, asked_s: float, by_s: float) -> DayPlan:
    """The plan that was asked for at `asked_s`, taken `by_s` later: what had not begun then comes
    as much later, for the truck stays while a plan is made. Else a slow machine's plans are late
    the moment they are there, and made anew for ever.
    """
    flying = {sortie.order for sortie in start.flying}
    stops = [
        _timed(
            stop,
            stop.arrive_s + (by_s if stop.arrive_s > asked_s else 0.0),
            stop.depart_s + (by_s if stop.depart_s >= asked_s else 0.0),
        )
        for stop in plan.stops
    ]
    sorties = [
        s
        if s.order in flying
        else msgspec.structs.replace(s, launch_s=s.launch_s + by_s, land_s=s.land_s + by_s)
        for s in plan.sorties
    ]
    return msgspec.structs.replace(
        plan, stops=stops, sorties=sorties, makespan_s=plan.makespan_s + by_s
    )


def candidate_pads(
    plan: DayPlan, sortie: PlannedSortie, stops: Mapping[str, PlannedStop]
) -> dict[str, Place]:
    """Where a flight may be asked to land, by stop: home, launch, and the next stop behind its home
    that has a pad for it. More would make the mission aboard long.
    """
    ids = [stop.id for stop in plan.stops]
    behind = plan.stops[ids.index(sortie.home) + 1 :] if sortie.home in ids else []
    following = [stop.id for stop in behind if sortie.vehicle in stop.pads][:1]
    wanted = dict.fromkeys([sortie.home, sortie.launch, *following])
    return {stop: stops[stop].pads[sortie.vehicle] for stop in wanted}


def day_now(data: DayData, view: DayView) -> DayData:
    """The day's data to plan the rest with: what a drone has brought back goes by the truck, where
    it may.
    """
    came_back = {row.sortie.order for row in view.sorties if row.over and not row.row.delivered}
    orders = [
        msgspec.structs.replace(order, service=Service.TRUCK)
        if order.id in came_back and order.service is Service.ANY
        else order
        for order in data.orders
    ]
    return DayData(data.day, orders, data.no_fly, data.airframes, data.roads_s)
