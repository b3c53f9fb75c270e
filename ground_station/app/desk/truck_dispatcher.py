"""A day with a truck at the running desk: what it sees becomes what `DayRun` decides, and that
becomes transactions; plans are made anew.

Nothing here must survive a kill: plan, promises and orders to the truck are the store's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from companion.core.routing.leg_energy import RouteEnergy
from companion.fleet.messages import State
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.active_plan import PlanInForce
from ground_station.app.desk.day_tracker import DaySight
from ground_station.core.dispatch.day_snapshot import DayView
from ground_station.core.dispatch.depot_assignment import sortie_table
from ground_station.core.dispatch.dispatch_rules import (
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
)
from ground_station.core.dispatch.replanning import candidate_pads
from ground_station.core.feasibility.reach import Reach
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import Picture
from ground_station.core.planning.airspace import Airspace
from ground_station.core.schema.day_plan import PlannedSortie

CHARGE_READ_FRAC = 0.05
"""How well a resting voltage tells a charge; the companion finds out for itself before it flies."""


@dataclass(slots=True)
class DayDesk:
    """The truck's part of one desk."""

    store: Store
    day: DayStore
    plans: PlanInForce
    clock: Clock
    say: Callable[[str], None]
    by: str = "desk"
    holds: list[str] = field(default_factory=list)
    _sight: DaySight = field(init=False)
    _made_for: int = -1
    _airspace: Airspace | None = None
    _reach: dict[str, Reach] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._sight = DaySight(self.store, self.day, self.plans, self.clock)

    @property
    def view(self) -> DayView | None:
        """The day as it was seen last."""
        return self._sight.view

    def hear(self, state: State) -> None:
        """Take what a member tells."""
        self._sight.hear(state)

    def turn(self, picture: Picture, *, stirred: bool) -> bool:
        """Do what is due; whether anything was. `stirred`: the store may have changed."""
        sight = self._sight
        if stirred:
            sight.forget_rows()
        sight.forget_old_rows()
        view = sight.look(picture)
        truck = view.truck
        self._note_energies(view)
        if truck is None:
            return False
        self.plans.mind(view, sight.measured_wind)
        self._forget_what_was_made_for_another_plan()
        if self.plans.is_asked and not view.replanning:
            view = sight.view = replace(view, replanning=True)  # asked just now: the truck stays
        run = DayRun(self.plans.params, self._may_launch, self._charged)
        deeds = run.decide(view)
        for deed in deeds:
            self._carry_out(deed)
        if deeds:
            sight.forget_rows()
        self.holds = run.holds(view)
        under_way = view.here is None or bool(self.holds)
        return bool(deeds) or view.replanning or (truck.present and under_way)

    def _forget_what_was_made_for_another_plan(self) -> None:
        if self._made_for != self.plans.changed:
            self._made_for, self._airspace = self.plans.changed, None
            self._reach.clear()
            self._sight.forget_rows()

    def _note_energies(self, view: DayView) -> None:
        for row in view.sorties:
            used_wh = self._sight.energy_used_wh(row.id) if row.over else None
            if used_wh is not None:
                self.day.note(row.id, used_wh=used_wh)

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
        data = self.plans.data
        order = next((o for o in data.orders if o.id == sortie.order), None)
        drone = data.day.drone(sortie.vehicle)
        if order is None or drone is None:
            return None
        pads = candidate_pads(self.plans.plan, sortie, self.plans.stops)
        table = sortie_table(data.day, drone, order, sortie, pads)
        id_ = self.day.assign(
            sortie, pads, lambda assignment: table | {"name": assignment}, data.no_fly, self.by
        )
        return f"{sortie.vehicle}: {sortie.order} ({id_}), home {sortie.home}" if id_ else None

    def _may_launch(self, sortie: PlannedSortie, in_air: Sequence[PlannedSortie]) -> str | None:
        if self._airspace is None:
            self._airspace = Airspace(self.plans.data)
        try:
            return self._airspace.may_launch(sortie, in_air, self.plans.stops)
        except KeyError as missing:  # a pad that no plan has: nobody can say that they stay apart
            return f"unknown pad {missing}"

    def _charged(self, sortie: PlannedSortie, charge_frac: float) -> bool:
        reach = self._reach.get(sortie.vehicle) or self._reach_of(sortie.vehicle)
        order = next((o for o in self.plans.data.orders if o.id == sortie.order), None)
        if order is None:
            return False
        read_frac = min(1.0, charge_frac + CHARGE_READ_FRAC)
        return reach.budget_wh(order.mass_kg, read_frac)[0] >= sortie.sure_wh

    def _reach_of(self, vehicle: str) -> Reach:
        data = self.plans.data
        day, drone = data.day, data.day.drone(vehicle)
        assert drone is not None
        airframe = data.airframes[drone.airframe]
        energy = RouteEnergy(airframe, cruise_airspeed_mps=day.mission.cruise_airspeed_mps)
        self._reach[vehicle] = Reach(drone, airframe, day.mission, day.forecast, energy)
        return self._reach[vehicle]

    @property
    def is_over(self) -> bool:
        """The truck stands at its last stop and nothing is left that the plan would do."""
        view = self.view
        if view is None or view.here is None or view.replanning or self.holds:
            return False
        taken_meanwhile = self._sight.still_open() != view.open
        if taken_meanwhile:
            return False
        last = view.plan.stops[-1].id == view.here.id
        under_way = any(not (row.aboard or row.gone) for row in view.sorties)
        return last and not under_way and not self.plans.is_wanted(view)

    def close(self) -> None:
        """Give up a plan that is being made."""
        self.plans.close()
