"""A plan with its times: route, sorties by drone, and the driver's tasks."""

from dataclasses import dataclass
from typing import Literal

from companion.core.base.errors import LeewayError
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.simulate import IMPOSSIBLE, simulate
from ground_station.core.truck_drones.tables import (
    ARRIVE,
    DELIVERED,
    DEPART,
    FLY,
    KIND,
    LAUNCH,
    LAUNCHED,
    LAYER,
    MEET,
    MET,
    NOWHERE,
    PLACE,
    ROUTE,
    Plan,
    Work,
    tables_of,
    work_for,
)


@dataclass(frozen=True, slots=True)
class Sortie:
    """A drone (numbered over the whole fleet, from 0) takes one parcel from stop to stop."""

    drone: int
    launch: int
    customer: int
    rendezvous: int


@dataclass(frozen=True, slots=True)
class DriverTask:
    """What the driver does at a stop; `drone` is None for the truck's own delivery."""

    what: Literal["deliver", "launch", "recover"]
    node: int
    drone: int | None
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Stop:
    """The truck at a node."""

    node: int
    arrive_s: float
    depart_s: float


@dataclass(frozen=True, slots=True)
class Schedule:
    """A whole day; it ends when the truck and every drone are back."""

    makespan_s: float
    stops: tuple[Stop, ...]
    sorties: tuple[Sortie, ...]
    driver: tuple[DriverTask, ...]

    @property
    def truck_route(self) -> tuple[int, ...]:
        """The nodes in the order of the truck."""
        return tuple(stop.node for stop in self.stops)


@dataclass(frozen=True, slots=True)
class FlightTimes:
    """Times of one customer's drone: take-off from its pad, landing, recovery by the driver. Its
    layer: None where the problem has none.
    """

    customer: int
    kind: int
    launch: int
    meet: int
    launched_s: float
    landed_s: float
    met_s: float
    layer: int | None


def flights_of(problem: TruckAndDrones, plan: Plan) -> tuple[tuple[Stop, ...], list[FlightTimes]]:
    """The truck's stops, and the flights in order of launch."""
    tables = tables_of(problem)
    work = work_for(tables)
    if simulate(tables, plan, work, IMPOSSIBLE) == IMPOSSIBLE:
        raise LeewayError("truck and drones: a plan that cannot be carried out")
    found: list[FlightTimes] = []
    for customer in range(1, problem.end):
        if plan[LAUNCH, customer] == NOWHERE:
            continue
        launched_s, fly_s, met_s = (
            float(work.times_s[row, customer]) for row in (LAUNCHED, FLY, MET)
        )
        kind, launch, meet = (int(plan[row, customer]) for row in (KIND, LAUNCH, MEET))
        layer = int(work.whole[LAYER, customer]) if problem.air is not None else None
        flight = FlightTimes(
            customer, kind, launch, meet, launched_s, launched_s + fly_s, met_s, layer
        )
        found.append(flight)
    found.sort(key=lambda flight: (flight.launched_s, flight.customer))
    return _stops(plan, work, problem.end), found


def schedule_of(problem: TruckAndDrones, plan: Plan) -> Schedule:
    """When everything in this plan happens, and which drone flies what."""
    tables = tables_of(problem)
    work = work_for(tables)
    makespan_s = float(simulate(tables, plan, work, IMPOSSIBLE))
    if makespan_s == IMPOSSIBLE:
        raise LeewayError("truck and drones: a plan that cannot be carried out")
    stops = _stops(plan, work, problem.end)
    drone_of = _drones(problem, plan, work)
    sorties = tuple(
        Sortie(drone, int(plan[LAUNCH, customer]), customer, int(plan[MEET, customer]))
        for customer, drone in drone_of.items()
    )
    tasks = [
        *_deliveries(problem, stops, work),
        *_drone_tasks(problem, plan, work, drone_of),
    ]
    tasks.sort(key=lambda task: (task.start_s, task.end_s))
    return Schedule(makespan_s, stops, sorties, tuple(tasks))


def _stops(plan: Plan, work: Work, end: int) -> tuple[Stop, ...]:
    times_s = work.times_s
    return tuple(
        Stop(int(plan[ROUTE, at]), float(times_s[ARRIVE, at]), float(times_s[DEPART, at]))
        for at in range(int(work.whole[PLACE, end]) + 1)
    )


def _deliveries(problem: TruckAndDrones, stops: tuple[Stop, ...], work: Work) -> list[DriverTask]:
    found = []
    for stop in stops:
        lasts_s = float(problem.deliver_s[stop.node])
        if lasts_s > 0.0:
            start_s = float(work.times_s[DELIVERED, stop.node])
            found.append(DriverTask("deliver", stop.node, None, start_s, start_s + lasts_s))
    return found


def _drone_tasks(
    problem: TruckAndDrones, plan: Plan, work: Work, drone_of: dict[int, int]
) -> list[DriverTask]:
    found = []
    for customer, drone in drone_of.items():
        kind = problem.kinds[int(plan[KIND, customer])]
        launched_s = float(work.times_s[LAUNCHED, customer])
        met_s = float(work.times_s[MET, customer])
        launch, meet = int(plan[LAUNCH, customer]), int(plan[MEET, customer])
        start_s = launched_s - kind.launch_s
        found.append(DriverTask("launch", launch, drone, start_s, launched_s))
        found.append(DriverTask("recover", meet, drone, met_s, met_s + kind.recover_s))
    return found


def _drones(problem: TruckAndDrones, plan: Plan, work: Work) -> dict[int, int]:
    """The drone of each customer: of those aboard, the one with the lowest number.

    In order of launches; a drone is aboard again when its recovery has ended.
    """
    first = 0
    idle: list[list[tuple[int, float]]] = []
    for kind in problem.kinds:
        idle.append([(first + number, 0.0) for number in range(kind.count)])
        first += kind.count
    flown = [int(j) for j in range(1, problem.end) if plan[LAUNCH, j] != NOWHERE]
    flown.sort(key=lambda j: (work.times_s[LAUNCHED, j], j))
    drone_of: dict[int, int] = {}
    for customer in flown:
        kind_number = int(plan[KIND, customer])
        kind, drones = problem.kinds[kind_number], idle[kind_number]
        start_s = work.times_s[LAUNCHED, customer] - kind.launch_s
        drone, since_s = next(one for one in drones if one[1] <= start_s + 1e-6)
        drones.remove((drone, since_s))
        drones.append((drone, float(work.times_s[MET, customer]) + kind.recover_s))
        drones.sort()
        drone_of[customer] = drone
    return drone_of
