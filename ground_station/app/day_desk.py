"""A day with a truck at the running desk: what the store and the picture say becomes a `DayView`,
what `DayRun` decides becomes transactions, and plans are made anew.

Nothing here must survive a kill: plan, promises and orders to the truck are the store's.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import msgspec

from companion.core.errors import LeewayError
from companion.core.messages import State
from companion.core.route_energy import RouteEnergy
from ground_station.adapters.day_store import DayStore
from ground_station.adapters.store import Store
from ground_station.app.replanner import NoPlan, Replanner
from ground_station.core.airspace import Airspace
from ground_station.core.choosing import sortie_table
from ground_station.core.day import Forecast
from ground_station.core.day_data import DayData
from ground_station.core.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.day_replan import (
    candidate_pads,
    day_now,
    postponed,
    replan_reason,
    standing,
    unfit,
)
from ground_station.core.day_run import (
    AskHome,
    Away,
    DayDeed,
    DayRun,
    DriveOn,
    HomeIs,
    Lapse,
    LaunchFlight,
    PutDroneOut,
    RecoverDrone,
    SendMission,
    ServeHere,
    TakeBack,
    distance_m,
)
from ground_station.core.day_view import DayRunParams, DayView, DroneView, TruckView
from ground_station.core.fleet import Clock
from ground_station.core.measured_wind import MeasuredWind
from ground_station.core.orders import AssignmentRow, AssignmentState, OrderState
from ground_station.core.picture import STANDBY, Picture, VehicleSeen
from ground_station.core.reach import Reach
from ground_station.core.sorties import SortieRow, Visit
from ground_station.core.truck import DRIVING, TRUCK

CHARGE_READ_FRAC = 0.05
"""How well a resting voltage tells a charge; the companion finds out for itself before it flies."""

OFF_PAD_M = 30.0
OFF_GROUND_M = 2.0
READY = "ready"


ROWS_S = 5.0
"""So old may be what was read of the store, where this desk has heard and done nothing since."""


@dataclass(frozen=True, slots=True)
class _Rows:
    """What was read of the store at `read_s`."""

    read_s: float
    open: frozenset[str]
    sorties: tuple[SortieRow, ...]
    serves: tuple[AssignmentRow, ...]
    told: str | None
    visits: dict[str, Visit]
    plan_made_us: int


@dataclass(slots=True)
class DayDesk:
    """The truck's part of one desk."""

    store: Store
    day: DayStore
    data: DayData
    plan: DayPlan
    clock: Clock
    replanner: Replanner
    say: Callable[[str], None]
    by: str = "desk"
    params: DayRunParams = field(default_factory=DayRunParams)
    view: DayView | None = None
    holds: list[str] = field(default_factory=list)
    _stops: dict[str, PlannedStop] = field(default_factory=dict)
    _orders: int = -1
    _airspace: Airspace | None = None
    _reach: dict[str, Reach] = field(default_factory=dict)
    _asked: tuple[DayView, str, Forecast] | None = None
    _refused: str | None = None
    _died: tuple[str, int] = ("", 0)
    _wind: MeasuredWind = field(default_factory=MeasuredWind)
    _energy_wh: dict[str, tuple[float, float]] = field(default_factory=dict)
    _off_ground: set[str] = field(default_factory=set)
    _truck_stop: tuple[str, bool] | None = None
    _tried_s: float = -1e9
    _tried: object = None
    _waits_s: dict[str, float] = field(default_factory=dict)
    _began_us: int | None = None
    _rows: _Rows | None = None
    _from_us: int = 0

    def __post_init__(self) -> None:
        self._from_us = self.clock.epoch_us()
        wind = self.day.wind()
        if wind is not None:
            self.data = self._with_forecast(wind)
        for plan, _ in self.day.plans():
            self._note_stops(plan)

    def _note_stops(self, plan: DayPlan) -> None:
        for stop in plan.stops:
            before = self._stops.get(stop.id)
            pads = {**stop.pads, **(before.pads if before else {})}
            self._stops[stop.id] = msgspec.structs.replace(stop, pads=pads)

    def _with_forecast(self, wind: Forecast) -> DayData:
        day = msgspec.structs.replace(self.data.day, forecast=wind)
        return DayData(
            day, self.data.orders, self.data.no_fly, self.data.airframes, self.data.roads_s
        )

    # --- the picture ---------------------------------------------------------------------------

    def hear(self, state: State) -> None:
        """Take what a member tells."""
        if state.vehicle == TRUCK:
            self._hear_truck(state)
            return
        if state.armed and state.assignment:
            if state.wind_to_n_mps is not None and state.wind_to_e_mps is not None:
                t_s = self.clock.monotonic_s()
                self._wind.hear(t_s, state.wind_to_n_mps, state.wind_to_e_mps)
            if state.energy_left_wh is not None:
                first = self._energy_wh.get(state.assignment, (state.energy_left_wh, 0.0))[0]
                self._energy_wh[state.assignment] = (first, state.energy_left_wh)
            if (state.height_rel_m or 0.0) > OFF_GROUND_M:
                self._off_ground.add(state.assignment)

    def _hear_truck(self, state: State) -> None:
        """Its arrivals and departures, for the plan's times."""
        if state.stop is None:
            return
        now = (state.stop, state.phase == DRIVING)
        if now != self._truck_stop:
            self.day.truck_is(None if now[1] else state.stop)
            self._rows = None
            self._truck_stop = now

    def look(self, picture: Picture) -> DayView:
        """The day as it is now."""
        now_s = self.clock.monotonic_s()
        truck = picture.vehicles.get(TRUCK)
        began_us = self._begun_us(truck is not None and truck.present(now_s))
        rows = self._rows = self._rows or self._read(now_s)
        drones = {d.id: self._drone_view(picture.of(d.id), now_s) for d in self.data.day.drones}
        return DayView(
            now_s=max(0.0, (self.clock.epoch_us() - began_us) / 1e6),
            began_us=began_us,
            plan=self.plan,
            truck=_truck_view(truck, now_s),
            drones=drones,
            open=rows.open,
            sorties=rows.sorties,
            serves=rows.serves,
            told=rows.told,
            visits=rows.visits,
            replanning=self._asked is not None,
            plan_made_s=max(0.0, (rows.plan_made_us - began_us) / 1e6),
            tried_s=self._tried_s,
            tried=self._tried,
            waited_s=self._waited(rows.sorties, drones, now_s),
            wind_off_sigmas=self._wind.off_sigmas(now_s, self.data.day.forecast),
            desk_from_s=(self._from_us - began_us) / 1e6,
        )

    def _begun_us(self, truck_here: bool) -> int:
        """The day begins when its truck is first heard."""
        if self._began_us is None:
            self._began_us = self.day.begin() if truck_here else self.day.began_us()
        return self.clock.epoch_us() if self._began_us is None else self._began_us

    def _read(self, now_s: float) -> _Rows:
        orders = self.store.orders()
        return _Rows(
            read_s=now_s,
            open=frozenset(r.order.id for r in orders if r.state is OrderState.OPEN),
            sorties=tuple(self.day.sorties()),
            serves=tuple(r for r in self.store.assignments() if r.vehicle == TRUCK),
            told=self.day.told(),
            visits={visit.stop: visit for visit in self.day.visits()},
            plan_made_us=self.day.plan_made_us(),
        )

    def _waited(
        self, sorties: tuple[SortieRow, ...], drones: dict[str, DroneView], now_s: float
    ) -> dict[str, float]:
        """How long each drone on its pad has not been ready, as far as this desk has seen."""
        waiting = (AssignmentState.ORDERED, AssignmentState.ABOARD)
        on_pads = [r for r in sorties if r.placed and r.row.state in waiting]
        late = [r.id for r in on_pads if r.vehicle in drones and not drones[r.vehicle].ready]
        self._waits_s = {id_: self._waits_s.get(id_, now_s) for id_ in late}
        return {id_: now_s - since_s for id_, since_s in self._waits_s.items()}

    def _drone_view(self, seen: VehicleSeen, now_s: float) -> DroneView:
        state = seen.state
        if state is None:
            return DroneView(seen.vehicle)
        airframe = self.data.airframes.get(state.airframe)
        charge = None
        if airframe is not None and state.voltage_v and state.armed is False:
            charge = airframe.battery.charge_frac_at_rest(state.voltage_v)
        return DroneView(
            vehicle=seen.vehicle,
            present=seen.present(now_s),
            doubtful=bool(seen.doubts),
            idle=state.phase == STANDBY and not state.armed,
            ready=state.phase == READY and not state.armed,
            off_ground=state.assignment in self._off_ground or self._left_pad(state),
            assignment=state.assignment,
            home=state.home,
            lat_deg=state.lat_deg,
            lon_deg=state.lon_deg,
            charge_frac=charge,
            silent_s=seen.silent_s(now_s),
        )

    def _left_pad(self, state: State) -> bool:
        """Through a restart of the desk too: it is elsewhere than where it started."""
        rows = self.view.sorties if self.view is not None else ()
        row = next((row for row in rows if row.id == state.assignment), None)
        if row is None:
            return False
        away_m = distance_m(state.lat_deg, state.lon_deg, row.pads[row.sortie.launch])
        return away_m is not None and away_m > OFF_PAD_M

    # --- what follows --------------------------------------------------------------------------

    def turn(self, picture: Picture, *, stirred: bool) -> bool:
        """Do what is due; whether anything was. `stirred`: the store may have changed."""
        rows, now_s = self._rows, self.clock.monotonic_s()
        if stirred or (rows is not None and now_s - rows.read_s > ROWS_S):
            self._rows = None
        view = self.look(picture)
        truck = view.truck
        self.view = view
        self._note_energies(view)
        if truck is None:
            return False
        run = DayRun(self.params, self._may_launch, self._charged)
        self._mind_plan(view)
        if self._asked is not None and not view.replanning:
            view = self.view = replace(view, replanning=True)  # asked just now: the truck stays
        deeds = run.decide(view)
        for deed in deeds:
            self._carry_out(deed)
        if deeds:
            self._rows = None
        self.holds = run.holds(view)
        return bool(deeds) or view.replanning or (truck.present and self._under_way(view))

    def _under_way(self, view: DayView) -> bool:
        return view.here is None or bool(self.holds)

    def _note_energies(self, view: DayView) -> None:
        for row in view.sorties:
            if row.over and row.id in self._energy_wh:
                first, last = self._energy_wh.pop(row.id)
                self.day.note(row.id, used_wh=max(0.0, first - last))

    def _carry_out(self, deed: DayDeed) -> None:
        """One transaction; what is to be said of it, where it was one."""
        words = self._done(deed)
        if words:
            self.say(words)

    def _done(self, deed: DayDeed) -> str | None:
        day, by = self.day, self.by
        match deed:
            case PutDroneOut():
                return self._put_out(deed.sortie)
            case SendMission():
                done = day.release(deed.assignment)
                return f"{deed.assignment}: on its pad" if done else None
            case LaunchFlight():
                done = self.store.launch(deed.assignment, by)
                return f"{deed.assignment}: launch ordered" if done else None
            case TakeBack():
                done = day.withdraw(deed.assignment, by, deed.why)
                return f"{deed.assignment}: withdrawn: {deed.why}" if done else None
            case RecoverDrone():
                done = day.recover(deed.assignment, deed.pad, by)
                return f"{deed.assignment}: to be taken aboard" if done else None
            case AskHome():
                done = day.ask_home(deed.assignment, deed.stop, by)
                return f"{deed.assignment}: asked to {deed.stop}: {deed.why}" if done else None
            case HomeIs():
                done = day.home_is(deed.assignment, deed.stop)
                return f"{deed.assignment}: its home is {deed.stop} now" if done else None
            case Lapse():
                day.note(deed.assignment, lapsed=True)
                return f"{deed.assignment}: not heard for longer than it can fly: look for it"
            case Away():
                day.note(deed.assignment, away=True)
                return f"{deed.assignment}: down, but at none of the truck's stops: fetch it"
            case ServeHere():
                id_ = self.day.serve(deed.order, by)
                return f"truck: to bring {deed.order} ({id_})" if id_ else None
            case DriveOn():
                done = day.drive(deed.here, deed.stop, by)
                return f"truck: from {deed.here} to {deed.stop.id}" if done else None

    def _put_out(self, sortie: PlannedSortie) -> str | None:
        data = self._data()
        order = next((o for o in data.orders if o.id == sortie.order), None)
        drone = data.day.drone(sortie.vehicle)
        if order is None or drone is None:
            return None
        pads = candidate_pads(self.plan, sortie, self._stops)
        table = sortie_table(data.day, drone, order, sortie, pads)
        id_ = self.day.assign(
            sortie, pads, lambda assignment: table | {"name": assignment}, data.no_fly, self.by
        )
        return f"{sortie.vehicle}: {sortie.order} ({id_}), home {sortie.home}" if id_ else None

    # --- the day's data ------------------------------------------------------------------------

    def _data(self) -> DayData:
        """With every order that the store knows."""
        orders = self.store.orders()
        if len(orders) != self._orders:
            self._orders = len(orders)
            data = self.data
            taken = [row.order for row in orders]
            self.data = DayData(data.day, taken, data.no_fly, data.airframes, data.roads_s)
            self._airspace = None
        return self.data

    def _may_launch(self, sortie: PlannedSortie, in_air: Sequence[PlannedSortie]) -> str | None:
        if self._airspace is None:
            self._airspace = Airspace(self._data())
        try:
            return self._airspace.may_launch(sortie, in_air, self._stops)
        except KeyError as missing:  # a pad that no plan has: nobody can say that they stay apart
            return f"unknown pad {missing}"

    def _charged(self, sortie: PlannedSortie, charge_frac: float) -> bool:
        reach = self._reach.get(sortie.vehicle) or self._reach_of(sortie.vehicle)
        order = next((o for o in self._data().orders if o.id == sortie.order), None)
        if order is None:
            return False
        read_frac = min(1.0, charge_frac + CHARGE_READ_FRAC)
        return reach.budget_wh(order.mass_kg, read_frac)[0] >= sortie.sure_wh

    def _reach_of(self, vehicle: str) -> Reach:
        day, drone = self.data.day, self.data.day.drone(vehicle)
        assert drone is not None
        airframe = self.data.airframes[drone.airframe]
        energy = RouteEnergy(airframe, cruise_airspeed_mps=day.mission.cruise_airspeed_mps)
        self._reach[vehicle] = Reach(drone, airframe, day.mission, day.forecast, energy)
        return self._reach[vehicle]

    # --- the plan ------------------------------------------------------------------------------

    def _mind_plan(self, view: DayView) -> None:
        """Ask for a new plan when the day departs from this one; take it when it is made."""
        if self._asked is not None:
            made = self.replanner.made()
            if made is not None:
                before, why, wind = self._asked
                self._asked = None
                if self._is_asked_again(made, why):
                    self._tried_s = view.now_s
                    if self.data.day.forecast != wind:  # else the reason would be gone
                        self._plan_with(wind)
                else:
                    self._take(made, before, view, why)
            return
        why = replan_reason(view, self.params)
        if why is None or why == self._refused:
            return
        wind = self.data.day.forecast
        if "wind" in why:
            self._plan_with(self._wind.forecast(self.clock.monotonic_s(), wind))
        self.say(f"a new plan: {why}")
        self._asked = (view, why, wind)
        start = standing(view, [d.id for d in self.data.day.drones], self.data.day.truck.recover_s)
        self.replanner.ask(day_now(self._data(), view), start)

    def _plan_with(self, wind: Forecast) -> None:
        self.data = self._with_forecast(wind)
        self._reach.clear()

    def _is_asked_again(self, made: DayPlan | NoPlan, why: str) -> bool:
        """Whether a planner ended without an answer, and not too often for this reason."""
        if not isinstance(made, NoPlan) or not made.again:
            return False
        times = self._died[1] + 1 if self._died[0] == why else 1
        self._died = (why, times)
        again = times < self.params.replan_tries
        if again:
            wait_s = self.params.replan_again_s
            self.say(f"no new plan ({made.reason}): asked again in {wait_s:.0f} s")
        return again

    def _take(self, made: DayPlan | NoPlan, before: DayView, view: DayView, why: str) -> None:
        drones = [d.id for d in self.data.day.drones]
        start = standing(before, drones, self.data.day.truck.recover_s)
        wrong = made.reason if isinstance(made, NoPlan) else unfit(made, start)
        self._tried_s, self._tried = view.now_s, before.situation
        if wrong is not None or isinstance(made, NoPlan):
            self._refused = why
            self.say(f"no new plan ({wrong}): the old one goes on")
            return
        wind = self.data.day.forecast if "wind" in why else None
        took_s = max(0.0, view.now_s - before.now_s)
        self.day.take_plan(postponed(made, start, before.now_s, took_s), why, wind)
        in_force = self.day.plan()
        assert in_force is not None
        self.plan, self._refused, self._rows, self._died = in_force, None, None, ("", 0)
        self._note_stops(in_force)
        left = f", {len(made.unplanned)} by nobody" if made.unplanned else ""
        self.say(f"plan {made.revision} in force: {len(made.stops)} stops{left}")

    @property
    def is_over(self) -> bool:
        """The truck stands at its last stop and nothing is left that the plan would do."""
        view = self.view
        if view is None or view.here is None or view.replanning or self.holds:
            return False
        taken_meanwhile = self._read(view.now_s).open != view.open
        if taken_meanwhile:
            return False
        last = view.plan.stops[-1].id == view.here.id
        under_way = any(not (row.aboard or row.gone) for row in view.sorties)
        why = replan_reason(view, replace(self.params, replan_again_s=-math.inf))
        return last and not under_way and why in (None, self._refused)

    def close(self) -> None:
        """Give up a plan that is being made."""
        self.replanner.close()


def _truck_view(seen: VehicleSeen | None, now_s: float) -> TruckView | None:
    state = seen.state if seen is not None else None
    if seen is None or state is None or state.stop is None:
        return None
    return TruckView(seen.present(now_s), state.phase == DRIVING, state.stop)


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
