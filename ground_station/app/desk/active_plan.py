"""The active plan of a day with a truck, the data that it was made from, and how it is replaced."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.adapters.store.day_store import DayStore
from ground_station.app.desk.replanner import NoPlan, Replanner
from ground_station.core.dispatch.day_snapshot import DaySnapshot
from ground_station.core.dispatch.dispatch_rules import DispatchParams
from ground_station.core.dispatch.replan_times import ReplanResult, ReplanTimes
from ground_station.core.dispatch.replanning import (
    ReplanReason,
    broken_promise,
    day_now,
    replan_reason,
    shifted,
    standing_state,
)
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import DayPlan, PlannedStop
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.orders import OrderRow


@dataclass(frozen=True, slots=True)
class ReplanAttempt:
    """The last re-planning that has ended: when, from which situation, and for which reason.

    `refused`: no new plan came of it, so the same reason is not tried again. `died`: how often in a
    row its planner has ended without an answer.
    """

    at_s: float | None = None
    situation: object = None
    why: ReplanReason | None = None
    refused: bool = False
    died: int = 0


@dataclass(frozen=True, slots=True)
class _Request:
    snapshot: DaySnapshot
    why: ReplanReason
    wind: Forecast
    """The forecast before it."""


@dataclass(slots=True)
class ActivePlan:
    """`plan` and `data` as they are now. `review` replaces both, `note_orders` the data; `version`
    counts how often.
    """

    day: DayStore
    data: DayData
    plan: DayPlan
    replanner: Replanner
    say: Callable[[str], None]
    params: DispatchParams = field(default_factory=DispatchParams)
    stops: dict[str, PlannedStop] = field(default_factory=dict)
    """All stops of all plans of the day, each with all its pads."""
    attempt: ReplanAttempt = field(default_factory=ReplanAttempt)
    version: int = 0
    replans: ReplanTimes = field(default_factory=ReplanTimes)
    _request: _Request | None = None

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
        return replace(self.data, day=day)

    def note_orders(self, orders: list[OrderRow]) -> None:
        """Orders that the store has taken meanwhile are part of the day."""
        if len(orders) != len(self.data.orders):
            self.data = replace(self.data, orders=[row.order for row in orders])
            self.version += 1

    def note_plan(self, newest: DayPlan | None) -> None:
        """The store's newest plan is ours, too, where another desk of this day has made it."""
        if newest is None or newest.revision <= self.plan.revision:
            return
        wind = self.day.wind()
        if wind is not None:
            self.data = self._with_forecast(wind)
        self.plan = newest
        self.version += 1
        self._note_stops(newest)
        self.say(f"plan {newest.revision} in force, made by another desk")

    @property
    def is_replanning(self) -> bool:
        """Whether a new plan is being made."""
        return self._request is not None

    def review(
        self,
        snapshot: DaySnapshot,
        measured: Callable[[Forecast], Forecast],
        forecast: DayForecast | None = None,
    ) -> None:
        """Ask for a new plan when the day departs from this one; take it when it is made.

        `measured` returns the forecast by the wind that the fleet measures now. `forecast`: one
        that is followed, in the day's time: each sortie of a new plan has its own wind.
        """
        if self._request is None:
            self._request_plan(snapshot, measured, forecast)
            return
        made = self.replanner.made()
        if made is None:
            return
        request, self._request = self._request, None
        took_s = max(0.0, snapshot.now_s - request.snapshot.now_s)
        if self._asks_again(made, request.why, snapshot):
            self.replans.ended(ReplanResult.DIED, took_s)
            if self.data.day.forecast != request.wind:
                self._plan_with(request.wind)  # so that the wind stays a reason
        else:
            result = self._take(made, request, snapshot, took_s)
            self.replans.ended(result, took_s)

    def is_wanted(self, snapshot: DaySnapshot) -> bool:
        """Whether there is a reason for a new plan that has not been refused, now or later."""
        return self._reason(replace(snapshot, tried_s=None)) is not None

    def _reason(self, snapshot: DaySnapshot) -> ReplanReason | None:
        why = replan_reason(snapshot, self.params)
        return None if self.attempt.refused and why == self.attempt.why else why

    def _request_plan(
        self,
        snapshot: DaySnapshot,
        measured: Callable[[Forecast], Forecast],
        forecast: DayForecast | None,
    ) -> None:
        why = self._reason(snapshot)
        if why is None:
            return
        wind = self.data.day.forecast
        if why.cause.is_of_wind:
            self._plan_with(measured(wind))
        self.say(f"a new plan: {why.words}")
        self._request = _Request(snapshot, why, wind)
        data = replace(day_now(self.data, snapshot), forecast=forecast)
        self.replanner.ask(data, self._standing_state(snapshot))

    def _standing_state(self, snapshot: DaySnapshot) -> DayState:
        drones = [drone.id for drone in self.data.day.drones]
        return standing_state(snapshot, drones, self.data.day.truck.recover_s)

    def _plan_with(self, wind: Forecast) -> None:
        self.data = self._with_forecast(wind)
        self.version += 1

    def _asks_again(self, made: DayPlan | NoPlan, why: ReplanReason, snapshot: DaySnapshot) -> bool:
        """Whether the planner has ended without an answer, and is asked once more."""
        if not isinstance(made, NoPlan) or not made.again:
            return False
        times = self.attempt.died + 1 if self.attempt.why == why else 1
        again = times < self.params.replan_tries
        if again:
            self.attempt = replace(
                self.attempt, at_s=snapshot.now_s, why=why, refused=False, died=times
            )
            wait_s = self.params.replan_again_s
            self.say(f"no new plan ({made.reason}): asked again in {wait_s:.0f} s")
        return again

    def _take(
        self, made: DayPlan | NoPlan, request: _Request, snapshot: DaySnapshot, took_s: float
    ) -> ReplanResult:
        start = self._standing_state(request.snapshot)
        wrong = made.reason if isinstance(made, NoPlan) else broken_promise(made, start)
        refused = wrong is not None or isinstance(made, NoPlan)
        attempt = ReplanAttempt(snapshot.now_s, request.snapshot.situation, request.why, refused)
        if refused or isinstance(made, NoPlan):
            self.attempt = attempt
            self.say(f"no new plan ({wrong}): the old one goes on")
            return ReplanResult.REFUSED
        wind = self.data.day.forecast if request.why.cause.is_of_wind else None
        late = shifted(made, start, request.snapshot.now_s, took_s)
        self.day.take_plan(late, request.why.words, wind)
        in_force = self.day.plan()
        self.attempt = attempt  # only now: a plan that the store did not take is asked for again
        assert in_force is not None
        if in_force.revision < late.revision:
            self.say("no new plan (another desk has promised a stop that is not in it)")
            return ReplanResult.REFUSED
        self.plan = in_force
        self.version += 1
        self._note_stops(in_force)
        left = f", {len(made.unplanned)} by nobody" if made.unplanned else ""
        self.say(f"plan {made.revision} in force: {len(made.stops)} stops{left}")
        return ReplanResult.TAKEN

    def close(self) -> None:
        """Give up the plan that is being made."""
        self.replanner.close()


def check_plan(data: DayData, plan: DayPlan) -> None:
    """Raise LeewayError, with everything that is wrong, where a plan does not fit the day."""
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
