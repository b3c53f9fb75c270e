"""Re-planning of a day with a truck: when, from which state, and whether a new plan is acceptable.

Promises bind whatever the plan says: a new plan begins after the last promised stop.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

import msgspec

from companion.core.base.place import Place
from ground_station.core.dispatch.day_snapshot import DaySnapshot
from ground_station.core.dispatch.dispatch_rules import DispatchParams
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.orders import Service
from ground_station.core.schema.sortie_rows import SortieRow


class ReplanCause(Enum):
    """What has departed from the plan."""

    DRONE_OUT = "drone out"
    ORDER_LEFT_OUT = "order left out"
    TRUCK_LATE = "truck late"
    WIND = "wind"
    FORECAST = "forecast"

    @property
    def is_of_wind(self) -> bool:
        """Whether the next plan is made for another wind."""
        return self in (ReplanCause.WIND, ReplanCause.FORECAST)


@dataclass(frozen=True, slots=True)
class ReplanReason:
    """Why the day needs a new plan, and the words for the dispatcher.

    Equal as long as the same thing is wrong. So a reason for which no plan was found is not tried
    again, and does not keep the day from ending.
    """

    cause: ReplanCause
    words: str


def replan_reason(day: DaySnapshot, params: DispatchParams) -> ReplanReason | None:
    """Why the day needs a new plan; None: it does not."""
    if day.truck is None or day.index is None or day.replanning:
        return None
    if day.tried_s is not None and day.now_s - day.tried_s < params.replan_again_s:
        return None
    for sortie in day.pending():
        why = day.why_out(sortie.vehicle)
        if why is not None:
            words = f"{sortie.vehicle} is out of service ({why})"
            return ReplanReason(ReplanCause.DRONE_OUT, words)
    left_out = sorted(day.open - _work_ahead(day) - {line.order for line in day.plan.unplanned})
    if left_out:
        words = f"{left_out[0]} is open and not in the plan"
        return ReplanReason(ReplanCause.ORDER_LEFT_OUT, words)
    if day.delay_s() > params.late_s and day.situation != day.tried:
        words = f"the truck is more than {params.late_s:.0f} s late"
        return ReplanReason(ReplanCause.TRUCK_LATE, words)
    if day.wind_off_sigmas > params.wind_sigmas:
        sigmas = f"{params.wind_sigmas:g} standard deviations"
        return ReplanReason(ReplanCause.WIND, f"the wind is {sigmas} from the forecast, or more")
    rested = day.tried_s is None or day.now_s - day.tried_s >= params.forecast_again_s
    if day.closing and rested:
        return ReplanReason(ReplanCause.FORECAST, day.closing)
    return None


def _work_ahead(day: DaySnapshot) -> set[str]:
    """Orders that the plan still delivers."""
    index = day.index or 0
    ahead = day.plan.stops[index:]
    serves = {order for stop in ahead for order in stop.serves}
    stops = {stop.id for stop in ahead}
    return serves | {s.order for s in day.pending() if s.launch in stops}


def standing_state(day: DaySnapshot, drones: list[str], recover_s: float) -> DayState:
    """The part of the day that stays: past and promised stops, and the sorties in the air."""
    held = [row for row in day.sorties if not (row.aboard or row.gone)]
    last = max([day.index or 0, *(_last_index(row, day) for row in held)])
    delay_s = day.delay_s()
    stops = [_expected(day, n, delay_s) for n in range(last + 1)]
    serves = {order for stop in stops[day.index or 0 :] for order in stop.serves}
    flying = tuple(_expected_flight(row, day) for row in held if not row.over)
    left = sorted(day.open - serves - {sortie.order for sortie in flying})
    free = {drone: day.now_s for drone in drones if day.free(drone)}
    for row in held:
        if day.why_out(row.vehicle) is None:
            lands_s = day.now_s if row.over else _expected_flight(row, day).land_s
            free[row.vehicle] = max(day.now_s, lands_s) + recover_s
    return DayState(tuple(stops), flying, tuple(left), free, day.plan.revision + 1)


def _last_index(row: SortieRow, day: DaySnapshot) -> int:
    ids = [stop.id for stop in day.plan.stops]
    bound = [s for s in (row.sortie.launch, row.promised, row.asked) if s in ids]
    return max((ids.index(s) for s in bound), default=0)


def _expected(day: DaySnapshot, number: int, delay_s: float) -> PlannedStop:
    """A stop with its actual times, or those expected now."""
    stop, index = day.plan.stops[number], day.index or 0
    visit = day.visits.get(stop.id)
    if number < index and visit is not None:
        left_s = day.day_s(visit.left_us or visit.arrived_us)
        return _timed(stop, day.day_s(visit.arrived_us), left_s)
    if number == index and day.truck is not None and not day.truck.driving:
        return _timed(stop, day.now_s, max(day.now_s, stop.depart_s + min(0.0, delay_s)))
    arrive_s = max(day.now_s, stop.arrive_s + delay_s)
    return _timed(stop, arrive_s, arrive_s + stop.depart_s - stop.arrive_s)


def _timed(stop: PlannedStop, arrive_s: float, depart_s: float) -> PlannedStop:
    arrive_s = max(0.0, arrive_s)
    return msgspec.structs.replace(stop, arrive_s=arrive_s, depart_s=max(arrive_s, depart_s))


def _expected_flight(row: SortieRow, day: DaySnapshot) -> PlannedSortie:
    sortie = row.sortie
    if row.launched_us is None:
        launch_s = max(day.now_s, sortie.launch_s)
    else:
        launch_s = max(0.0, day.day_s(row.launched_us))
    return msgspec.structs.replace(
        sortie,
        home=row.promised,
        others=[row.asked] if row.asked else [],
        launch_s=launch_s,
        land_s=max(day.now_s, launch_s + sortie.land_s - sortie.launch_s),
    )


def broken_promise(plan: DayPlan, start: DayState) -> str | None:
    """Why a new plan is not acceptable (it breaks a promise); None: it is."""
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


def shifted(plan: DayPlan, start: DayState, asked_s: float, by_s: float) -> DayPlan:
    """The plan that was asked for at `asked_s`, shifted by the time `by_s` that it took to make.

    The truck stays while a plan is made, so everything that had not begun comes later. Without the
    shift a slow machine's plans would be late at once, and be made again for ever.
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
    """Pads where a sortie may land, by stop: its home, its launch, and the next stop after its home
    that has a pad for it. More would make the mission aboard too long.
    """
    ids = [stop.id for stop in plan.stops]
    behind = plan.stops[ids.index(sortie.home) + 1 :] if sortie.home in ids else []
    following = [stop.id for stop in behind if sortie.vehicle in stop.pads][:1]
    wanted = dict.fromkeys([sortie.home, sortie.launch, *following])
    return {stop: stops[stop].pads[sortie.vehicle] for stop in wanted}


def day_now(data: DayData, day: DaySnapshot) -> DayData:
    """The day's data for re-planning: a parcel that came back goes by the truck, where it may."""
    came_back = {row.sortie.order for row in day.sorties if row.over and not row.row.delivered}
    orders = [
        msgspec.structs.replace(order, service=Service.TRUCK)
        if order.id in came_back and order.service is Service.ANY
        else order
        for order in data.orders
    ]
    return replace(data, orders=orders)
