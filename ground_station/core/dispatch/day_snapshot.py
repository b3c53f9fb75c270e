"""One moment of a day with a truck: the store's rows and the fleet's status."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow, Visit

CLOSED = "closed by the forecast"
"""Why an assignment was withdrawn that says nothing of its drone."""


@dataclass(frozen=True, slots=True)
class TruckStatus:
    """The truck by its last state. Once it is told to drive on it counts as driving there, whether
    it has heard so or not.
    """

    present: bool
    driving: bool
    stop: str


@dataclass(frozen=True, slots=True)
class DroneStatus:
    """A drone by its last state.

    `idle`: on standby, disarmed. `ready`: its assignment waits for the launch. `off_ground`: it has
    left its pad. `silent_s`: since its last state; None: there was none.
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
class DaySnapshot:
    """The day now; `now_s` counts from its beginning.

    `open`: orders without an assignment. `serves`: the driver's own deliveries. `replanning`: a new
    plan is being made. `tried_s`: when the last re-planning ended, and `tried`: from which
    `situation`. `waited_s`: by assignment, how long a drone on its pad has not been ready.
    `wind_off_sigmas`: distance of the measured wind from the planned one, in the forecast's
    standard deviations. `desk_from_s`: since when this desk listens. `held`: drones that are under
    a hold. `closed`: assignments on the ground whose launch the forecast has closed for good, and
    why. `closing`: what it closes of the plan; empty: nothing.
    """

    now_s: float
    began_us: int
    plan: DayPlan
    truck: TruckStatus | None
    drones: Mapping[str, DroneStatus]
    open: frozenset[str]
    sorties: tuple[SortieRow, ...]
    serves: tuple[AssignmentRow, ...]
    visits: Mapping[str, Visit] = field(default_factory=dict)
    replanning: bool = False
    plan_made_s: float = 0.0
    tried_s: float | None = None
    tried: object = None
    waited_s: Mapping[str, float] = field(default_factory=dict)
    wind_off_sigmas: float = 0.0
    desk_from_s: float = 0.0
    held: frozenset[str] = frozenset()
    closed: Mapping[str, str] = field(default_factory=dict)
    closing: str = ""

    def drone(self, vehicle: str) -> DroneStatus:
        """The status of a drone, heard or not."""
        return self.drones.get(vehicle) or DroneStatus(vehicle)

    def day_s(self, epoch_us: int) -> float:
        """A time stamp as seconds of the day."""
        return (epoch_us - self.began_us) / 1e6

    @property
    def index(self) -> int | None:
        """The number of the stop where the truck is or drives to; None: not in the plan."""
        if self.truck is None:
            return None
        ids = [stop.id for stop in self.plan.stops]
        return ids.index(self.truck.stop) if self.truck.stop in ids else None

    @property
    def here(self) -> PlannedStop | None:
        """The stop where the truck stands: heard just now and not told to leave; else None."""
        truck, index = self.truck, self.index
        if truck is None or index is None or not truck.present or truck.driving:
            return None
        return self.plan.stops[index]

    def why_out(self, vehicle: str) -> str | None:
        """Why a drone is out of service; None: it is in service."""
        if self.drone(vehicle).doubtful:
            return "doubtful"
        mine = [row for row in self.sorties if row.vehicle == vehicle]
        if any(row.gone for row in mine):
            return "lost, or away from the truck"
        unflown = (AssignmentState.REFUSED, AssignmentState.WITHDRAWN)
        last = [row.row for row in mine if not row.row.why.startswith(CLOSED)][-2:]
        if len(last) == 2 and all(row.state in unflown for row in last):
            return "came to nothing twice"
        return None

    def free(self, vehicle: str) -> bool:
        """Whether a drone is on the truck, with a fresh pack, and in service."""
        mine = [row for row in self.sorties if row.vehicle == vehicle]
        return all(row.aboard for row in mine) and self.why_out(vehicle) is None

    def pending(self) -> list[PlannedSortie]:
        """Planned sorties that are not begun, in order of launch."""
        begun = [row.sortie for row in self.sorties]
        left = [s for s in self.plan.sorties if s.order in self.open and s not in begun]
        return sorted(left, key=lambda s: s.launch_s)

    @property
    def situation(self) -> object:
        """Everything that a plan depends on, except the time: to compare, nothing else."""
        truck = self.truck
        flights = [
            (row.id, row.row.state, row.aboard, row.gone, row.promised, row.asked)
            for row in self.sorties
        ]
        out = frozenset(vehicle for vehicle in self.drones if self.why_out(vehicle) is not None)
        where = None if truck is None else (truck.stop, truck.driving)
        return where, self.open, tuple(flights), out

    def lands_s(self, row: SortieRow) -> float:
        """Expected touchdown of a sortie: as long after its launch as planned."""
        if row.launched_us is None:
            return self._would_land_s(row.sortie)
        return self.day_s(row.launched_us) + row.sortie.land_s - row.sortie.launch_s

    def _would_land_s(self, sortie: PlannedSortie) -> float:
        return max(self.now_s, sortie.launch_s) + sortie.land_s - sortie.launch_s

    def serving(self) -> bool:
        """Whether the driver is bringing an order."""
        return any(row.state in IN_FORCE for row in self.serves)

    def held_s(self) -> float:
        """How much later than planned the truck leaves its stop because of drones that still land
        there: in the air, on their pads, or planned. Negative: they land earlier than that.
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
        """Whether a drone is on the truck or lands at this stop: nothing may wait for another."""
        mine = [row for row in self.sorties if row.vehicle == vehicle and not row.aboard]
        return self.why_out(vehicle) is None and all(row.promised == stop for row in mine)

    def delay_s(self) -> float:
        """Delay of the truck against the plan; negative: it is early.

        From its last stop it leaves for nowhere: however long it stands there, it is not late.
        """
        index = self.index
        if self.truck is None or index is None:
            return 0.0
        stop = self.plan.stops[index]
        if not self.truck.driving:
            visit = self.visits.get(stop.id)
            arrived_us = visit.arrived_us if visit is not None else None
            begun_s = self._after_plan(arrived_us, stop.arrive_s)
            is_last = index + 1 == len(self.plan.stops)
            return begun_s if is_last else max(begun_s, self.now_s - stop.depart_s)
        before = self.plan.stops[max(index - 1, 0)]
        visit = self.visits.get(before.id)
        left_us = visit.left_us if visit is not None else None
        begun_s = self._after_plan(left_us, before.depart_s)
        return max(begun_s, self.now_s - stop.arrive_s)

    def _after_plan(self, at_us: int | None, planned_s: float) -> float:
        if at_us is None or self.day_s(at_us) < self.plan_made_s:
            return 0.0
        return self.day_s(at_us) - planned_s
