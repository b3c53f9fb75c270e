"""Dispatch of a day with a truck: drones ride on it, start from its stops and come back to it.

Each turn takes a snapshot of the day, lets `DispatchRules` decide, and carries out the actions as
transactions. Plan, promises and the truck's orders are in the store; nothing here must survive.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from companion.fleet.messages import State
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.active_plan import ActivePlan
from ground_station.app.desk.day_tracker import DayTracker
from ground_station.app.desk.dispatcher import Progress
from ground_station.app.desk.forecast_watch import ForecastWatch
from ground_station.core.dispatch.day_snapshot import DaySnapshot
from ground_station.core.dispatch.dispatch_actions import (
    AuthoriseLaunch,
    ConfirmHomeChange,
    DeclareOffSite,
    DeclareOverdue,
    DispatchAction,
    DriveToStop,
    ForgetHomeChange,
    PutDroneOut,
    RecoverDrone,
    RequestHomeChange,
    SendMission,
    ServeOrder,
    WithdrawAssignment,
)
from ground_station.core.dispatch.dispatch_rules import DispatchRules
from ground_station.core.dispatch.flight_tables import (
    NeighbourKeys,
    no_keys,
    sortie_table,
    with_neighbour_keys,
)
from ground_station.core.dispatch.replanning import candidate_pads
from ground_station.core.feasibility.reach import Reach, day_energy
from ground_station.core.fleet.desk_figures import ReplanFigures
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.planning.airspace import Airspace
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.orders import AssignmentRow
from ground_station.core.site_wind.site_wind import SiteWind

CHARGE_ERROR_FRAC = 0.05
"""Error of a charge read from the resting voltage; the companion checks it before the flight."""


@dataclass(slots=True)
class TruckDispatcher:
    """`Dispatcher` for a day with a truck. `wind`: what the fleet tells of it; None: the forecast
    stays. `forecast`: watches over one that is followed. `holds`: why the truck
    does not leave its stop now.
    """

    store: Store
    day: DayStore
    active: ActivePlan
    clock: Clock
    say: Callable[[str], None]
    by: str = "desk"
    wind: SiteWind | None = None
    forecast: ForecastWatch | None = None
    neighbour_keys: NeighbourKeys = no_keys
    holds: list[str] = field(default_factory=list)
    _tracker: DayTracker = field(init=False)
    _made_for: int | None = None
    _airspace: Airspace | None = None
    _reach: dict[str, Reach] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._tracker = DayTracker(
            self.store, self.day, self.active, self.clock, self.wind, self.forecast
        )

    @property
    def snapshot(self) -> DaySnapshot | None:
        """The last snapshot of the day."""
        return self._tracker.snapshot

    def begin(self) -> None:
        """Nothing: the store has everything."""

    def on_state(self, state: State) -> None:
        """Take a state that a drone or the truck has published."""
        self._tracker.on_state(state)

    def on_ready(self, assignment: AssignmentRow) -> None:
        """Nothing: launches are due by the plan, in `turn`."""

    def turn(self, status: FleetStatus, *, changed: bool) -> Progress:
        """Do everything that is due now."""
        tracker = self._tracker
        if changed:
            tracker.reload()
        tracker.reload_old()
        snapshot = tracker.observe(status)
        truck = snapshot.truck
        self._note_energies(snapshot)
        if truck is None:
            return Progress.NONE
        self.active.review(snapshot, tracker.forecast_now, tracker.day_forecast)
        self._forget_other_plans()
        if self.active.is_replanning and not snapshot.replanning:
            # Asked for just now: the truck stays from this turn on.
            snapshot = tracker.snapshot = replace(snapshot, replanning=True)
        rules = DispatchRules(self.active.params, self._launch_conflict, self._charged)
        actions = rules.decide(snapshot)
        for action in actions:
            self._carry_out(action)
        if actions:
            tracker.reload()
        self.holds = rules.holds(snapshot)
        waits = truck.present and (snapshot.here is None or bool(self.holds))
        under_way = bool(actions) or snapshot.replanning or waits
        return Progress.UNDER_WAY if under_way else Progress.NONE

    def _forget_other_plans(self) -> None:
        """What was worked out for an earlier plan."""
        if self._made_for != self.active.version:
            self._made_for, self._airspace = self.active.version, None
            self._reach.clear()
            self._tracker.reload()

    def _note_energies(self, snapshot: DaySnapshot) -> None:
        for row in snapshot.sorties:
            used_wh = self._tracker.energy_used_wh(row.id) if row.over else None
            if used_wh is not None:
                self.day.note(row.id, used_wh=used_wh)

    def _carry_out(self, action: DispatchAction) -> None:
        """One transaction, and what the operator should be told of it."""
        words = self._done(action)
        if words:
            self.say(words)

    def _done(self, action: DispatchAction) -> str | None:
        day, by = self.day, self.by
        match action:
            case PutDroneOut():
                return self._put_out(action.sortie)
            case SendMission():
                done = day.release(action.assignment)
                return f"{action.assignment}: on its pad" if done else None
            case AuthoriseLaunch():
                done = self.store.launch(action.assignment, by)
                return f"{action.assignment}: launch ordered" if done else None
            case WithdrawAssignment():
                done = day.withdraw(action.assignment, by, action.why)
                return f"{action.assignment}: withdrawn: {action.why}" if done else None
            case RecoverDrone():
                done = day.recover(action.assignment, action.pad, by)
                return f"{action.assignment}: recovery ordered" if done else None
            case RequestHomeChange():
                id_, stop = action.assignment, action.stop
                done = day.ask_home(id_, stop, by)
                return f"{id_}: asked to land at {stop}: {action.why}" if done else None
            case ConfirmHomeChange():
                done = day.home_is(action.assignment, action.stop)
                return f"{action.assignment}: its home is now {action.stop}" if done else None
            case ForgetHomeChange():
                done = day.forget_home(action.assignment, action.stop)
                return f"{action.assignment}: is down, not at {action.stop}" if done else None
            case DeclareOverdue():
                day.overdue(action.assignment)
                return f"{action.assignment}: overdue: not heard for longer than it can fly"
            case DeclareOffSite():
                day.note(action.assignment, away=True)
                return f"{action.assignment}: down, but at none of the truck's stops: fetch it"
            case ServeOrder():
                id_ = self.day.serve(action.order, by)
                return f"truck: to bring {action.order} ({id_})" if id_ else None
            case DriveToStop():
                done = day.drive(action.here, action.stop, by)
                return f"truck: from {action.here} to {action.stop.id}" if done else None

    def _put_out(self, sortie: PlannedSortie) -> str | None:
        data = self.active.data
        order = next((o for o in data.orders if o.id == sortie.order), None)
        drone = data.day.drone(sortie.vehicle)
        if order is None or drone is None:
            return None
        pads = candidate_pads(self.active.plan, sortie, self.active.stops)
        table = sortie_table(data.day, drone, order, sortie, pads, data.elevation)
        table = with_neighbour_keys(table, self.neighbour_keys)
        id_ = self.day.assign(
            sortie, pads, lambda assignment: table | {"name": assignment}, data.no_fly, self.by
        )
        return f"{sortie.vehicle}: {sortie.order} ({id_}), home {sortie.home}" if id_ else None

    def _launch_conflict(
        self, sortie: PlannedSortie, in_air: Sequence[PlannedSortie]
    ) -> str | None:
        if self._airspace is None:
            self._airspace = Airspace(self.active.data)
        try:
            return self._airspace.launch_conflict(sortie, in_air, self.active.stops)
        except KeyError as missing:  # a pad of no plan: separation cannot be checked
            return f"unknown pad {missing}"

    def _charged(self, sortie: PlannedSortie, charge_frac: float) -> bool:
        reach = self._reach.get(sortie.vehicle) or self._reach_of(sortie.vehicle)
        order = next((o for o in self.active.data.orders if o.id == sortie.order), None)
        if order is None:
            return False
        read_frac = min(1.0, charge_frac + CHARGE_ERROR_FRAC)
        return reach.budget_wh(order.mass_kg, read_frac)[0] >= sortie.sure_wh

    def _reach_of(self, vehicle: str) -> Reach:
        data = self.active.data
        day, drone = data.day, data.day.drone(vehicle)
        assert drone is not None
        airframe = data.airframes[drone.airframe]
        energy = day_energy(day, airframe)
        self._reach[vehicle] = Reach(drone, airframe, day.mission, day.forecast, energy)
        return self._reach[vehicle]

    @property
    def is_done(self) -> bool:
        """Whether the truck stands at its last stop and nothing of the plan is left."""
        snapshot = self.snapshot
        if snapshot is None or snapshot.here is None or snapshot.replanning or self.holds:
            return False
        if self._tracker.still_open() != snapshot.open:  # new orders have come
            return False
        last = snapshot.plan.stops[-1].id == snapshot.here.id
        under_way = any(not (row.aboard or row.gone) for row in snapshot.sorties)
        return last and not under_way and not self.active.is_wanted(snapshot)

    @property
    def replans(self) -> ReplanFigures:
        """The plans made anew."""
        return ReplanFigures(dict(self.active.replans.by_result), self.active.is_replanning)

    def why_left(self, order_id: str) -> str | None:
        """What the plan says of an order that nobody can bring."""
        for line in self.active.plan.unplanned:
            if line.order == order_id:
                return f"{line.why}; possible with {line.remedy}"
        return None

    def close(self) -> None:
        """Give up the plan that is being made."""
        self.active.close()
