"""A plan with its times: route, sorties by drone, and the driver's tasks."""

from dataclasses import dataclass
from typing import Literal

from companion.core.base.errors import LeewayError
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.simulate import INFEASIBLE_S, simulate_makespan_s
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
    tables = tables_of(problem)
    work = allocate_work_arrays(tables)
    if simulate_makespan_s(tables, plan, work, INFEASIBLE_S) == INFEASIBLE_S:
        raise LeewayError("truck and drones: infeasible plan")
    found: list[FlightTimes] = []
    for customer in range(1, problem.end_node):
        if plan[LAUNCH, customer] == NOWHERE:
            continue
        launched_s, fly_s, recovered_s = (
            float(work.times_s[row, customer]) for row in (LAUNCHED, FLY, RECOVERED)
        )
        kind, launch, rendezvous = (int(plan[row, customer]) for row in (KIND, LAUNCH, RENDEZVOUS))
        layer = int(work.whole[LAYER, customer]) if problem.air is not None else None
        flight = FlightTimes(
            customer, kind, launch, rendezvous, launched_s, launched_s + fly_s, recovered_s, layer
        )
        found.append(flight)
    found.sort(key=lambda flight: (flight.launched_s, flight.customer))
    return _truck_stops(plan, work, problem.end_node), found


def simulate_schedule(problem: TruckAndDrones, plan: Plan) -> Schedule:
    """Return the times of all tasks of a plan, and the drone of each sortie."""
    tables = tables_of(problem)
    work = allocate_work_arrays(tables)
    makespan_s = float(simulate_makespan_s(tables, plan, work, INFEASIBLE_S))
    if makespan_s == INFEASIBLE_S:
        raise LeewayError("truck and drones: infeasible plan")
    stops = _truck_stops(plan, work, problem.end_node)
    drone_of = _drone_by_customer(problem, plan, work)
    sorties = tuple(
        Sortie(drone, int(plan[LAUNCH, customer]), customer, int(plan[RENDEZVOUS, customer]))
        for customer, drone in drone_of.items()
    )
    tasks = [
        *_delivery_tasks(problem, stops, work),
        *_launch_and_recovery_tasks(problem, plan, work, drone_of),
    ]
    tasks.sort(key=lambda task: (task.start_s, task.end_s))
    return Schedule(makespan_s, stops, sorties, tuple(tasks))


def _truck_stops(plan: Plan, work: WorkArrays, end: int) -> tuple[TruckStop, ...]:
    times_s = work.times_s
    return tuple(
        TruckStop(int(plan[ROUTE, at]), float(times_s[ARRIVE, at]), float(times_s[DEPART, at]))
        for at in range(int(work.whole[POSITION, end]) + 1)
    )


def _delivery_tasks(
    problem: TruckAndDrones, stops: tuple[TruckStop, ...], work: WorkArrays
) -> list[DriverTask]:
    found = []
    for stop in stops:
        duration_s = float(problem.deliver_s[stop.node])
        if duration_s > 0.0:
            start_s = float(work.times_s[DELIVERED, stop.node])
            found.append(DriverTask("deliver", stop.node, None, start_s, start_s + duration_s))
    return found


def _launch_and_recovery_tasks(
    problem: TruckAndDrones, plan: Plan, work: WorkArrays, drone_by_customer: dict[int, int]
) -> list[DriverTask]:
    found = []
    for customer, drone in drone_by_customer.items():
        kind = problem.kinds[int(plan[KIND, customer])]
        launched_s = float(work.times_s[LAUNCHED, customer])
        recovered_s = float(work.times_s[RECOVERED, customer])
        launch, rendezvous = int(plan[LAUNCH, customer]), int(plan[RENDEZVOUS, customer])
        start_s = launched_s - kind.launch_s
        found.append(DriverTask("launch", launch, drone, start_s, launched_s))
        found.append(
            DriverTask("recover", rendezvous, drone, recovered_s, recovered_s + kind.recover_s)
        )
    return found


def _drone_by_customer(problem: TruckAndDrones, plan: Plan, work: WorkArrays) -> dict[int, int]:
    """Assign to each customer the available drone with the lowest number.

    In order of launch; a drone is available again after its recovery.
    """
    first = 0
    idle: list[list[tuple[int, float]]] = []
    for kind in problem.kinds:
        idle.append([(first + number, 0.0) for number in range(kind.count)])
        first += kind.count
    flown = [int(j) for j in range(1, problem.end_node) if plan[LAUNCH, j] != NOWHERE]
    flown.sort(key=lambda j: (work.times_s[LAUNCHED, j], j))
    drone_of: dict[int, int] = {}
    for customer in flown:
        kind_number = int(plan[KIND, customer])
        kind, drones = problem.kinds[kind_number], idle[kind_number]
        start_s = work.times_s[LAUNCHED, customer] - kind.launch_s
        drone, since_s = next(one for one in drones if one[1] <= start_s + 1e-6)
        drones.remove((drone, since_s))
        drones.append((drone, float(work.times_s[RECOVERED, customer]) + kind.recover_s))
        drones.sort()
        drone_of[customer] = drone
    return drone_of
