"""The plan that a day with a truck is in, the data that it is made from, how it is made anew."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.adapters.store.day_store import DayStore
from ground_station.app.desk.replanner import NoPlan, Replanner
from ground_station.core.dispatch.day_snapshot import DayRunParams, DayView
from ground_station.core.dispatch.replanning import (
    day_now,
    postponed,
    replan_reason,
    standing,
    unfit,
)
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedStop
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.orders import OrderRow


@dataclass(frozen=True, slots=True)
class Trial:
    """The last plan that came to an end: when, from which situation, and why it was asked for.

    `refused`: nothing came of it, the same reason is not asked again. `died`: so often in a row
    has its planner ended without an answer.
    """

    at_s: float = -1e9
    situation: object = None
    why: str | None = None
    refused: bool = False
    died: int = 0


@dataclass(frozen=True, slots=True)
class _Question:
    view: DayView
    why: str
    wind: Forecast
    """Planned with before."""


@dataclass(slots=True)
class PlanInForce:
    """`plan` and `data` as they are now; `mind` has them made anew, `changed` counts how often."""

    day: DayStore
    data: DayData
    plan: DayPlan
    replanner: Replanner
    say: Callable[[str], None]
    params: DayRunParams = field(default_factory=DayRunParams)
    stops: dict[str, PlannedStop] = field(default_factory=dict)
    """Every stop that any plan ever had, with every pad that it ever had."""
    trial: Trial = field(default_factory=Trial)
    changed: int = 0
    _asked: _Question | None = None

    def __post_init__(self) -> None:
        wind = self.day.wind()
        if wind is not None:
            self.data = self._with_forecast(wind)
        for plan, _ in self.day.plans():
            self._note_stops(plan)

    def _note_stops(self, plan: DayPlan) -> None:
        for stop in plan.stops:
            before = self.stops.get(stop.id)
            pads = {**stop.pads, **(before.pads if before else {})}
            self.stops[stop.id] = msgspec.structs.replace(stop, pads=pads)

    def _with_forecast(self, wind: Forecast) -> DayData:
        day = msgspec.structs.replace(self.data.day, forecast=wind)
        return DayData(
            day, self.data.orders, self.data.no_fly, self.data.airframes, self.data.roads_s
        )

    def note_orders(self, orders: list[OrderRow]) -> None:
        """What the store has taken since is part of the day."""
        if len(orders) != len(self.data.orders):
            data, taken = self.data, [row.order for row in orders]
            self.data = DayData(data.day, taken, data.no_fly, data.airframes, data.roads_s)
            self.changed += 1

    @property
    def is_asked(self) -> bool:
        """A plan is being made."""
        return self._asked is not None

    def mind(self, view: DayView, measured: Callable[[Forecast], Forecast]) -> None:
        """Ask for a new plan when the day departs from this one; take it when it is made.

        `measured` makes of the forecast what is known of the wind by now.
        """
        if self._asked is None:
            self._ask(view, measured)
            return
        made = self.replanner.made()
        if made is None:
            return
        asked, self._asked = self._asked, None
        if self._is_asked_again(made, asked.why, view):
            if self.data.day.forecast != asked.wind:  # else the reason would be gone
                self._plan_with(asked.wind)
        else:
            self._take(made, asked, view)

    def is_wanted(self, view: DayView) -> bool:
        """Whether something asks for a plan that has not been refused, now or after a while."""
        return self._reason(view, replace(self.params, replan_again_s=-math.inf)) is not None

    def _reason(self, view: DayView, params: DayRunParams) -> str | None:
        why = replan_reason(view, params)
        return None if self.trial.refused and why == self.trial.why else why

    def _ask(self, view: DayView, measured: Callable[[Forecast], Forecast]) -> None:
        why = self._reason(view, self.params)
        if why is None:
            return
        wind = self.data.day.forecast
        if "wind" in why:
            self._plan_with(measured(wind))
        self.say(f"a new plan: {why}")
        self._asked = _Question(view, why, wind)
        self.replanner.ask(day_now(self.data, view), self._standing(view))

    def _standing(self, view: DayView) -> DayState:
        drones = [drone.id for drone in self.data.day.drones]
        return standing(view, drones, self.data.day.truck.recover_s)

    def _plan_with(self, wind: Forecast) -> None:
        self.data = self._with_forecast(wind)
        self.changed += 1

    def _is_asked_again(self, made: DayPlan | NoPlan, why: str, view: DayView) -> bool:
        """Whether a planner ended without an answer, and not too often for this reason."""
        if not isinstance(made, NoPlan) or not made.again:
            return False
        times = self.trial.died + 1 if self.trial.why == why else 1
        again = times < self.params.replan_tries
        if again:
            self.trial = replace(self.trial, at_s=view.now_s, why=why, refused=False, died=times)
            wait_s = self.params.replan_again_s
            self.say(f"no new plan ({made.reason}): asked again in {wait_s:.0f} s")
        return again

    def _take(self, made: DayPlan | NoPlan, asked: _Question, view: DayView) -> None:
        start = self._standing(asked.view)
        wrong = made.reason if isinstance(made, NoPlan) else unfit(made, start)
        refused = wrong is not None or isinstance(made, NoPlan)
        self.trial = Trial(view.now_s, asked.view.situation, asked.why, refused)
        if refused or isinstance(made, NoPlan):
            self.say(f"no new plan ({wrong}): the old one goes on")
            return
        wind = self.data.day.forecast if "wind" in asked.why else None
        took_s = max(0.0, view.now_s - asked.view.now_s)
        late = postponed(made, start, asked.view.now_s, took_s)
        self.day.take_plan(late, asked.why, wind)
        in_force = self.day.plan()
        assert in_force is not None
        self.plan = in_force
        self.changed += 1
        self._note_stops(in_force)
        left = f", {len(made.unplanned)} by nobody" if made.unplanned else ""
        self.say(f"plan {made.revision} in force: {len(made.stops)} stops{left}")

    def close(self) -> None:
        """Give up a plan that is being made."""
        self.replanner.close()


def check_plan(data: DayData, plan: DayPlan) -> None:
    """Raise LeewayError where a plan is not one of this day."""
    orders = {order.id for order in data.orders}
    stops = {stop.id: stop for stop in plan.stops}
    wrong: list[str] = []
    if plan.day != data.day.name:
        wrong.append(f"of day {plan.day!r}, expected {data.day.name!r}")
    for sortie in plan.sorties:
        where = f"sortie {sortie.order} by {sortie.vehicle}"
        if data.day.drone(sortie.vehicle) is None:
            wrong.append(f"{where}: no such drone in the day")
        if sortie.order not in orders:
            wrong.append(f"{where}: no such order in the day")
        for stop in (sortie.launch, sortie.home):
            if stop not in stops or sortie.vehicle not in stops[stop].pads:
                wrong.append(f"{where}: expected a stop {stop} with a pad for it")
    wrong += [
        f"stop {stop.id}: no such order {order} in the day"
        for stop in plan.stops
        for order in stop.serves
        if order not in orders
    ]
    if wrong:
        raise LeewayError("\n".join(f"the plan: {words}" for words in wrong))
