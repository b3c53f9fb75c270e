"""What the desk knows of a day with a truck, now: the store's rows and the live picture."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow, Visit


@dataclass(frozen=True, slots=True)
class DayRunParams:
    """When the desk departs from the plan. `late_s`: the truck is so much later than planned;
    `silent_s`: a drone says nothing; `take_off_s`: a launched drone leaves the ground in this time;
    `lapse_s`: after its launch no drone can still be in the air (its time limit, and more);
    `ready_s`: put on its pad, a drone is ready in this time, or taken back; `replan_tries`: so
    often a planner whose process ends without an answer is asked about one reason,
    `replan_again_s` apart.
    """

    late_s: float = 120.0
    silent_s: float = 60.0
    take_off_s: float = 60.0
    lapse_s: float = 2100.0
    move_home_s: float = 60.0
    replan_again_s: float = 60.0
    replan_tries: int = 3
    launches: int = 3
    ready_s: float = 300.0
    wind_sigmas: float = 2.0


@dataclass(frozen=True, slots=True)
class TruckView:
    """The truck as it was last heard."""

    present: bool
    driving: bool
    stop: str


@dataclass(frozen=True, slots=True)
class DroneView:
    """A drone as it was last heard. `idle`: stands by, disarmed; `ready`: its assignment waits for
    its launch; `off_ground`: it has left its pad. `silent_s` None: never heard.
    """

    vehicle: str
    present: bool = False
    doubtful: bool = False
    idle: bool = False
    ready: bool = False
    off_ground: bool = False
    assignment: str | None = None
    home: str | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    charge_frac: float | None = None
    silent_s: float | None = None


@dataclass(frozen=True, slots=True)
class DayView:
    """The day now. `now_s`: since it began; `open`: orders that nobody has; `told`: the stop that
    the truck was last told to drive to. `wind_off_sigmas`: how far the measured wind is from the
    planned one, in the forecast's standard deviations; `tried_s`: when a new plan was made last,
    and `tried` from what (`situation` then);
    `desk_from_s`: since when this desk listens;
    `waited_s`: how long each drone on its pad has not been ready, by assignment.
    """

    now_s: float
    began_us: int
    plan: DayPlan
    truck: TruckView | None
    drones: Mapping[str, DroneView]
    open: frozenset[str]
    sorties: tuple[SortieRow, ...]
    serves: tuple[AssignmentRow, ...]
    told: str | None
    visits: Mapping[str, Visit] = field(default_factory=dict)
    replanning: bool = False
    plan_made_s: float = 0.0
    tried_s: float = -1e9
    tried: object = None
    waited_s: Mapping[str, float] = field(default_factory=dict)
    wind_off_sigmas: float = 0.0
    desk_from_s: float = 0.0

    def drone(self, vehicle: str) -> DroneView:
        """A drone, heard or not."""
        return self.drones.get(vehicle) or DroneView(vehicle)

    def day_s(self, epoch_us: int) -> float:
        """A stamp as seconds of the day."""
        return (epoch_us - self.began_us) / 1e6

    @property
    def index(self) -> int | None:
        """Where in the plan the truck stands, or drives to; None: not in it, or not heard."""
        if self.truck is None:
            return None
        ids = [stop.id for stop in self.plan.stops]
        return ids.index(self.truck.stop) if self.truck.stop in ids else None

    @property
    def here(self) -> PlannedStop | None:
        """The stop where the truck stands, heard just now, and not told to leave; else None."""
        truck, index = self.truck, self.index
        if truck is None or index is None or not truck.present or truck.driving:
            return None
        return self.plan.stops[index] if self.told in (None, truck.stop) else None

    def out(self, vehicle: str) -> str | None:
        """Why a drone is out of service; None: it is not."""
        if self.drone(vehicle).doubtful:
            return "doubtful"
        mine = [row for row in self.sorties if row.vehicle == vehicle]
        if any(row.gone for row in mine):
            return "lost, or away from the truck"
        unflown = (AssignmentState.REFUSED, AssignmentState.WITHDRAWN)
        last = [row.row.state for row in mine[-2:]]
        if len(last) == 2 and all(state in unflown for state in last):
            return "came to nothing twice"
        return None

    def free(self, vehicle: str) -> bool:
        """It is on the truck with a fresh pack."""
        mine = [row for row in self.sorties if row.vehicle == vehicle]
        return all(row.aboard for row in mine) and self.out(vehicle) is None

    def pending(self) -> list[PlannedSortie]:
        """Planned flights that are still to be begun, as they are to be launched."""
        begun = [row.sortie for row in self.sorties]
        left = [s for s in self.plan.sorties if s.order in self.open and s not in begun]
        return sorted(left, key=lambda s: s.launch_s)

    @property
    def situation(self) -> object:
        """All that a plan is made from, but for the clock: where the truck is, what is open, what
        became of each flight, who is out of service."""
        truck = self.truck
        flights = [
            (row.id, row.row.state, row.aboard, row.gone, row.promised, row.asked)
            for row in self.sorties
        ]
        out = frozenset(vehicle for vehicle in self.drones if self.out(vehicle) is not None)
        where = None if truck is None else (truck.stop, truck.driving)
        return where, self.open, tuple(flights), out

    def lands_s(self, row: SortieRow) -> float:
        """When a flight is expected to be down: as long after its launch as planned."""
        if row.launched_us is None:
            return self._would_land_s(row.sortie)
        return self.day_s(row.launched_us) + row.sortie.land_s - row.sortie.launch_s

    def _would_land_s(self, sortie: PlannedSortie) -> float:
        return max(self.now_s, sortie.launch_s) + sortie.land_s - sortie.launch_s

    def serving(self) -> bool:
        """The driver has orders in hand."""
        return any(row.state in IN_FORCE for row in self.serves)

    def held_s(self) -> float:
        """How much later than planned the truck leaves where it stands, for flights that are still
        to land there: in the air, on their pads, or planned (negative: none so late).
        """
        here = self.here
        if here is None:
            return 0.0
        rows = [row for row in self.sorties if not (row.over or row.gone)]
        lands_s = [self.lands_s(row) for row in rows if row.promised == here.id]
        again = [s for s in self.pending() if s.launch == s.home == here.id]
        lands_s += [self._would_land_s(s) for s in again if self._is_or_comes(s.vehicle, here.id)]
        return max(lands_s, default=here.depart_s) - here.depart_s

    def _is_or_comes(self, vehicle: str, stop: str) -> bool:
        """Whether a drone is on the truck, or ends its flight at this stop: else no plan can use it
        here, and nothing may wait for it.
        """
        mine = [row for row in self.sorties if row.vehicle == vehicle and not row.aboard]
        return self.out(vehicle) is None and all(row.promised == stop for row in mine)

    def delay_s(self) -> float:
        """How much later (negative: earlier) the truck is than planned."""
        index = self.index
        if self.truck is None or index is None:
            return 0.0
        stop = self.plan.stops[index]
        if not self.truck.driving:
            visit = self.visits.get(stop.id)
            arrived_us = visit.arrived_us if visit is not None else None
            begun_s = self._after_plan(arrived_us, stop.arrive_s)
            return max(begun_s, self.now_s - stop.depart_s)
        before = self.plan.stops[max(index - 1, 0)]
        visit = self.visits.get(before.id)
        left_us = visit.left_us if visit is not None else None
        begun_s = self._after_plan(left_us, before.depart_s)
        return max(begun_s, self.now_s - stop.arrive_s)

    def _after_plan(self, at_us: int | None, planned_s: float) -> float:
        if at_us is None or self.day_s(at_us) < self.plan_made_s:
            return 0.0
        return self.day_s(at_us) - planned_s
