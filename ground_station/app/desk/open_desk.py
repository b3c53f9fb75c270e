"""A desk ready to run, and when it is through: for `dispatch`, and for simulated days."""

from collections.abc import Callable

from companion.core.base.errors import LeewayError
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import WallClock
from ground_station.app.desk.active_plan import PlanInForce, check_plan
from ground_station.app.desk.desk import Desk, DeskOptions
from ground_station.app.desk.replanner import Replanner, ReplannerBeside
from ground_station.app.desk.truck_dispatcher import DayDesk
from ground_station.core.dispatch.depot_assignment import Chooser
from ground_station.core.fleet.fleet_link import Clock, Fleet, LaterClock
from ground_station.core.fleet.fleet_status import Picture
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.orders import IN_FORCE, OrderRow, OrderState, Service

Say = Callable[[str], None]


def open_desk(
    data: DayData,
    plan: DayPlan | None,
    store: Store,
    fleet: Fleet,
    say: Say,
    options: DeskOptions,
    clock: Clock | None = None,
    replanner: Replanner | None = None,
) -> Desk:
    """A desk over a store that knows the day's orders; with a plan, one of drones on a truck.

    Where the store has a plan in force (after a restart, or a new plan), that goes on. Raises
    LeewayError where the plan is not one of this day, or not the one that the store began with.
    """
    clock = clock or WallClock()
    picture = Picture(data.airframes)
    if plan is None:
        if DayStore(store.database, clock.epoch_us).plan() is not None:
            raise LeewayError("this store holds a day with a truck: expected --plan")
        chooser = Chooser(data.day, data.airframes)
        return Desk(store, fleet, say, options, data, chooser, picture, clock)
    if not (options.assigns and options.launches):
        raise LeewayError(
            "a day with a truck is run whole: expected no --no-assign, no --no-launch"
        )
    replanner = replanner or ReplannerBeside(clock)
    day = _day_desk(data, plan, store, say, options, clock, replanner)
    return Desk(store, fleet, say, options, data, None, picture, clock, day)


def _day_desk(
    data: DayData,
    plan: DayPlan,
    store: Store,
    say: Say,
    options: DeskOptions,
    clock: Clock,
    replanner: Replanner,
) -> DayDesk:
    check_plan(data, plan)
    newest_us = DayStore(store.database, clock.epoch_us).newest_us()
    behind_us = 0 if newest_us is None else newest_us - clock.epoch_us()
    if behind_us > 0:
        say(
            f"the clock is {behind_us / 1e6:.0f} s behind the store's last entry: goes on from that"
        )
        clock = LaterClock(clock, behind_us)
    day = DayStore(store.database, clock.epoch_us)
    if not day.take_plan(plan, "as given"):
        kept = day.plans()
        if all(before != plan for before, _ in kept):
            raise LeewayError("this store holds another plan: expected that, or an empty store")
        say(f"plan {kept[-1][0].revision} goes on ({kept[-1][1]})")
    in_force = day.plan()
    assert in_force is not None
    plans = PlanInForce(day, data, in_force, replanner, say)
    return DayDesk(store, day, plans, clock, say, options.by)


def is_done(desk: Desk, impossible: frozenset[str] = frozenset()) -> bool:
    """Nothing is open or under way that this desk can bring on; `impossible`: by no drone."""
    if desk.store.outbox():
        return False
    if desk.day is not None:
        return desk.day.is_over
    return all(
        row.state not in (OrderState.OPEN, OrderState.ASSIGNED)
        or row.order.service is Service.TRUCK
        or (row.state is OrderState.OPEN and row.order.id in impossible)
        for row in desk.store.orders()
    )


def is_idle(desk: Desk, idle_s: float) -> bool:
    """For so long nothing has happened that brings the day on."""
    return desk.clock.monotonic_s() - desk.moved_s > idle_s


def left_over(desk: Desk) -> list[OrderRow]:
    """Orders that are neither delivered nor cancelled."""
    done = (OrderState.DELIVERED, OrderState.CANCELLED)
    return [row for row in desk.store.orders() if row.state not in done]


def why_left(desk: Desk, row: OrderRow) -> str:
    """What keeps an order from being brought, as far as the desk knows."""
    if row.why:
        return row.why
    for held in desk.store.assignments(in_force=True):
        if held.order_id == row.order.id and held.state in IN_FORCE:
            return f"{held.state.value} with {held.vehicle}"
    if desk.day is not None:
        for line in desk.day.plans.plan.unplanned:
            if line.order == row.order.id:
                return f"{line.why}; possible with {line.remedy}"
    return "nobody took it"
