"""A plan with its times: route, sorties by drone, and the driver's tasks."""

from dataclasses import dataclass
from typing import Literal

from companion.core.base.errors import LeewayError
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.simulate import INFEASIBLE_S, simulate_cost_s
from ground_station.core.truck_drones.tables import (
    ARRIVE,
    DELIVERED,
    DEPART,
    FLY,
    KIND,
    LAUNCH,
    LAUNCHED,
    LAYER,
    NOWHERE,
    POSITION,
    RECOVERED,
    RENDEZVOUS,
    ROUTE,
    Plan,
    WorkArrays,
    allocate_work_arrays,
    tables_of,
)


@dataclass(frozen=True, slots=True)
class Sortie:
    """Flight of one drone (numbered over the fleet, from 0) via a customer to a rendezvous."""

    drone: int
    launch: int
    customer: int
    rendezvous: int


@dataclass(frozen=True, slots=True)
class DriverTask:
    """A task of the driver at a stop; `drone` is None for the truck's own delivery."""

    what: Literal["deliver", "launch", "recover"]
    node: int
    drone: int | None
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class TruckStop:
    """Stop of the truck at a node."""

    node: int
    arrive_s: float
    depart_s: float


@dataclass(frozen=True, slots=True)
class Schedule:
    """A complete day; it ends when the truck and all drones are back."""

    makespan_s: float
    stops: tuple[TruckStop, ...]
    sorties: tuple[Sortie, ...]
    driver: tuple[DriverTask, ...]

    @property
    def truck_route(self) -> tuple[int, ...]:
        """Nodes in the order of the truck's route."""
        return tuple(stop.node for stop in self.stops)


@dataclass(frozen=True, slots=True)
class FlightTimes:
    """Times of one customer's sortie: launch, landing, recovery. `layer`: None without layers."""

    customer: int
    kind: int
    launch: int
    rendezvous: int
    launched_s: float
    landed_s: float
    recovered_s: float
    layer: int | None


def stops_and_flights_in_launch_order(
    problem: TruckAndDrones, plan: Plan
) -> tuple[tuple[TruckStop, ...], list[FlightTimes]]:
    """Return the truck's stops, and the flights in order of launch."""
    return _stops_and_flights(problem, plan, _simulated_work(problem, plan))


def simulate_schedule(problem: TruckAndDrones, plan: Plan) -> Schedule:
    """Return the times of all tasks of a plan, and the drone of each sortie."""
    work = _simulated_work(problem, plan)
    stops, flights = _stops_and_flights(problem, plan, work)
    tasks: list[DriverTask] = []
    for stop in stops:
        duration_s = float(problem.deliver_s[stop.node])
        if duration_s > 0.0:
            start_s = float(work.times_s[DELIVERED, stop.node])
            tasks.append(DriverTask("deliver", stop.node, None, start_s, start_s + duration_s))
    sorties: list[Sortie] = []
    for flight, drone in zip(flights, _drone_by_flight(problem, flights), strict=True):
        kind = problem.kinds[flight.kind]
        sorties.append(Sortie(drone, flight.launch, flight.customer, flight.rendezvous))
        launch_start_s = flight.launched_s - kind.launch_s
        recovery_end_s = flight.recovered_s + kind.recover_s
        tasks += (
            DriverTask("launch", flight.launch, drone, launch_start_s, flight.launched_s),
            DriverTask("recover", flight.rendezvous, drone, flight.recovered_s, recovery_end_s),
        )
    tasks.sort(key=lambda task: (task.start_s, task.end_s))
    return Schedule(stops[-1].depart_s, stops, tuple(sorties), tuple(tasks))


def _simulated_work(problem: TruckAndDrones, plan: Plan) -> WorkArrays:
    """Return the arrays of a simulation. Raises LeewayError if the plan is infeasible."""
    tables = tables_of(problem)
    work = allocate_work_arrays(tables)
    if simulate_cost_s(tables, plan, work, INFEASIBLE_S) == INFEASIBLE_S:
        raise LeewayError("truck and drones: infeasible plan")
    return work


def _stops_and_flights(
    problem: TruckAndDrones, plan: Plan, work: WorkArrays
) -> tuple[tuple[TruckStop, ...], list[FlightTimes]]:
    times_s, found = work.times_s, list[FlightTimes]()
    for customer in range(1, problem.end_node):
        if plan[LAUNCH, customer] == NOWHERE:
            continue
        launched_s, fly_s, recovered_s = (
            float(times_s[row, customer]) for row in (LAUNCHED, FLY, RECOVERED)
        )
        kind, launch, rendezvous = (int(plan[row, customer]) for row in (KIND, LAUNCH, RENDEZVOUS))
        layer = int(work.whole[LAYER, customer]) if problem.air is not None else None
        flight = FlightTimes(
            customer, kind, launch, rendezvous, launched_s, launched_s + fly_s, recovered_s, layer
        )
        found.append(flight)
    found.sort(key=lambda flight: (flight.launched_s, flight.customer))
    stops = tuple(
        TruckStop(int(plan[ROUTE, at]), float(times_s[ARRIVE, at]), float(times_s[DEPART, at]))
        for at in range(int(work.whole[POSITION, problem.end_node]) + 1)
    )
    return stops, found


def _drone_by_flight(problem: TruckAndDrones, flights: list[FlightTimes]) -> list[int]:
    """Assign to each flight, in order of launch, the available drone with the lowest number; it is
    available again after its recovery.
    """
    free_from_s: list[dict[int, float]] = []
    for kind in problem.kinds:
        first = sum(len(drones) for drones in free_from_s)
        free_from_s.append(dict.fromkeys(range(first, first + kind.count), 0.0))
    found: list[int] = []
    for flight in flights:
        kind, drones = problem.kinds[flight.kind], free_from_s[flight.kind]
        start_s = flight.launched_s - kind.launch_s + 1e-6
        drone = next(number for number, since_s in drones.items() if since_s <= start_s)
        drones[drone] = flight.recovered_s + kind.recover_s
        found.append(drone)
    return found
