"""Independent check of a reported mFSTSP schedule: validity and makespan.

Written from the rules alone, deliberately without numpy, numba or code of the planner: plain sums
over the problem's files, one node and one sortie at a time.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

TOLERANCE_S = 1e-4
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class CheckedDrone:
    """A drone of a vehicle file, in SI units except the capacity."""

    takeoff_mps: float
    cruise_mps: float
    landing_mps: float
    yaw_rate_degps: float
    cruise_alt_m: float
    capacity_lb: float
    launch_s: float
    recover_s: float
    service_s: float
    battery_j: float


@dataclass(frozen=True, slots=True)
class CheckedProblem:
    """A problem of the files; node 0 is the depot, customers + 1 the depot at the end."""

    positions_deg: Sequence[tuple[float, float]]
    parcels_lb: Sequence[float]
    travel_s: Sequence[Sequence[float]]
    deliver_s: float
    drone: CheckedDrone
    drones: int

    @property
    def end_node(self) -> int:
        """The depot's copy."""
        return len(self.positions_deg)

    def file_row_of_node(self, node: int) -> int:
        """Return the node's row in the files."""
        return 0 if node == self.end_node else node


def schedule_violations(problem: CheckedProblem, reported_schedule: Row) -> list[str]:
    """Return every rule that this row breaks; empty: valid."""
    route, sorties = reported_schedule["truck_route"], reported_schedule["sorties"]
    faults = [*_route_faults(problem, route, sorties)]
    if faults:
        return faults  # the other checks need a valid route
    index_by_node = {node: at for at, node in enumerate(route)}
    faults += _truck_faults(problem, route, reported_schedule["truck"])
    faults += _driver_faults(problem, reported_schedule["truck"], reported_schedule["driver"])
    faults += _task_faults(problem, route, sorties, reported_schedule["driver"])
    if faults:
        return faults
    for sortie in sorties:
        faults += _sortie_faults(problem, sortie, index_by_node, reported_schedule["driver"])
    faults += _drone_faults(problem, sorties, reported_schedule["driver"])
    ends_s = max(
        reported_schedule["truck"][-1]["depart_s"],
        *(task["end_s"] for task in reported_schedule["driver"]),
    )
    if abs(ends_s - reported_schedule["makespan_s"]) > TOLERANCE_S:
        faults.append(
            f"makespan {reported_schedule['makespan_s']:.4f} s, but all are back at {ends_s:.4f} s"
        )
    return faults


def _route_faults(problem: CheckedProblem, route: list[int], sorties: list[Row]) -> Iterable[str]:
    if route[:1] != [0] or route[-1:] != [problem.end_node] or len(route) < 2:
        yield f"the route goes from {route[:1]} to {route[-1:]}, expected 0 to {problem.end_node}"
    served = sorted([*route[1:-1], *(sortie["customer"] for sortie in sorties)])
    if served != list(range(1, problem.end_node)):
        yield f"served: {served}; expected each of 1 to {problem.end_node - 1} once"
    for sortie in sorties:
        for kind in ("launch", "rendezvous"):
            if sortie[kind] not in route:
                yield f"sortie to {sortie['customer']}: {kind} at {sortie[kind]}, no stop"


def _truck_faults(problem: CheckedProblem, route: list[int], stops: list[Row]) -> Iterable[str]:
    if [stop["node"] for stop in stops] != route:
        yield "the truck's times do not follow its route"
        return
    if stops[0]["arrive_s"] < 0.0:
        yield "the truck starts before 0 s"
    for stop in stops:
        if stop["depart_s"] < stop["arrive_s"] - TOLERANCE_S:
            yield f"node {stop['node']}: left before it is reached"
    for one, other in pairwise(stops):
        start, stop = problem.file_row_of_node(one["node"]), problem.file_row_of_node(other["node"])
        least_s = one["depart_s"] + problem.travel_s[start][stop]
        if other["arrive_s"] < least_s - TOLERANCE_S:
            yield f"node {other['node']}: reached {least_s - other['arrive_s']:.4f} s too early"


def _driver_faults(problem: CheckedProblem, stops: list[Row], tasks: list[Row]) -> Iterable[str]:
    stop_at = {stop["node"]: stop for stop in stops}
    task_duration_s = {
        "deliver": problem.deliver_s,
        "launch": problem.drone.launch_s,
        "recover": problem.drone.recover_s,
    }
    for task in tasks:
        stop = stop_at.get(task["node"])
        name = f"{task['what']} at {task['node']} from {task['start_s']:.4f} s"
        if stop is None:
            yield f"{name}: the truck does not stop there"
            continue
        if abs(task["end_s"] - task["start_s"] - task_duration_s[task["what"]]) > TOLERANCE_S:
            yield f"{name}: takes {task['end_s'] - task['start_s']:.4f} s"
        early = task["start_s"] < stop["arrive_s"] - TOLERANCE_S
        if early or task["end_s"] > stop["depart_s"] + TOLERANCE_S:
            yield f"{name}: the truck is not there"
    in_time = sorted(tasks, key=lambda task: task["start_s"])
    for one, other in pairwise(in_time):
        if other["start_s"] < one["end_s"] - TOLERANCE_S:
            yield f"the driver does two things at {other['start_s']:.4f} s"


def _task_faults(
    problem: CheckedProblem, route: list[int], sorties: list[Row], tasks: list[Row]
) -> Iterable[str]:
    expected_tasks = [("deliver", node, None) for node in route[1:-1]]
    for sortie in sorties:
        expected_tasks.append(("launch", sortie["launch"], sortie["drone"]))
        expected_tasks.append(("recover", sortie["rendezvous"], sortie["drone"]))
    found = [(task["what"], task["node"], task["drone"]) for task in tasks]
    if sorted(map(str, expected_tasks)) != sorted(map(str, found)):
        missing = sorted({str(task) for task in expected_tasks} ^ {str(task) for task in found})
        yield f"the driver's tasks are not those of route and sorties: {missing[:4]}"


def _task_time_s(tasks: list[Row], kind: str, node: int, drone: object, time_key: str) -> float:
    return next(
        task[time_key]
        for task in tasks
        if (task["what"], task["node"], task["drone"]) == (kind, node, drone)
    )


def _sortie_faults(
    problem: CheckedProblem, sortie: Row, index_by_node: dict[int, int], tasks: list[Row]
) -> Iterable[str]:
    launch, customer, rendezvous = sortie["launch"], sortie["customer"], sortie["rendezvous"]
    name = f"sortie {launch}-{customer}-{rendezvous}"
    if index_by_node[launch] >= index_by_node[rendezvous]:
        yield f"{name}: recovered before its launch"
    parcel_lb = problem.parcels_lb[customer]
    if parcel_lb > problem.drone.capacity_lb:
        yield f"{name}: {parcel_lb:g} lb, the drone carries {problem.drone.capacity_lb:g}"
    least_s, most_s = sortie_duration_limits_s(problem, launch, customer, rendezvous)
    launched_s = _task_time_s(tasks, "launch", launch, sortie["drone"], "end_s")
    recovered_s = _task_time_s(tasks, "recover", rendezvous, sortie["drone"], "start_s")
    if not least_s - TOLERANCE_S <= recovered_s - launched_s <= most_s + TOLERANCE_S:
        yield (
            f"{name}: recovered {recovered_s - launched_s:.4f} s after its launch, "
            f"expected {least_s:.4f} to {most_s:.4f} s"
        )


def _drone_faults(problem: CheckedProblem, sorties: list[Row], tasks: list[Row]) -> Iterable[str]:
    drones = {sortie["drone"] for sortie in sorties}
    if len(drones) > problem.drones:
        yield f"{len(drones)} drones fly, there are {problem.drones}"
    for drone in drones:
        own = sorted((t for t in tasks if t["drone"] == drone), key=lambda t: t["start_s"])
        expected = ["launch", "recover"] * (len(own) // 2)
        if [task["what"] for task in own] != expected:
            yield f"drone {drone}: launched while in the air, or recovered while on the truck"
        drone_sorties = sorted(
            (sortie for sortie in sorties if sortie["drone"] == drone),
            key=lambda s: _task_time_s(tasks, "launch", s["launch"], drone, "start_s"),
        )
        flown = [
            node for sortie in drone_sorties for node in (sortie["launch"], sortie["rendezvous"])
        ]
        if flown != [task["node"] for task in own]:
            yield f"drone {drone}: its tasks are not those of its sorties, in their order"


def sortie_duration_limits_s(
    problem: CheckedProblem, launch: int, customer: int, rendezvous: int
) -> tuple[float, float]:
    """Return the least and most time from launch end to recovery start (Etype 1)."""
    drone = problem.drone
    up_s = drone.cruise_alt_m / drone.takeoff_mps + 180.0 / drone.yaw_rate_degps
    down_s = drone.cruise_alt_m / drone.landing_mps
    out_s = _great_circle_distance_m(problem, launch, customer) / drone.cruise_mps
    back_s = _great_circle_distance_m(problem, customer, rendezvous) / drone.cruise_mps
    parcel_kg = problem.parcels_lb[customer] * 0.453592
    need_j = 0.0
    for load_kg, flight_s in ((parcel_kg, out_s), (0.0, back_s)):
        static_thrust_n = _thrust_n(load_kg, 0.0)
        cruise_thrust_n = _thrust_n(load_kg, drone.cruise_mps)
        need_j += up_s * (
            _induced_power_w(static_thrust_n, drone.takeoff_mps) + 0.3177 * static_thrust_n**1.5
        )
        need_j += down_s * (
            _induced_power_w(static_thrust_n, drone.landing_mps) + 0.3177 * static_thrust_n**1.5
        )
        rotors_w = _induced_power_w(cruise_thrust_n, 0.0) + 0.3177 * cruise_thrust_n**1.5
        need_j += flight_s * (rotors_w + 0.0296 * drone.cruise_mps**3)
    hover_n = _thrust_n(0.0, 0.0)
    hover_w = _induced_power_w(hover_n, 0.0) + 0.3177 * hover_n**1.5
    least_s = 2.0 * (up_s + down_s) + out_s + back_s + drone.service_s
    return least_s, least_s + (drone.battery_j - need_j) / hover_w


def _thrust_n(load_kg: float, speed_mps: float) -> float:
    lift_n = 0.0279 * (speed_mps * math.cos(math.radians(10.0))) ** 2
    return math.sqrt(((1.5 + load_kg) * 9.8 - lift_n) ** 2 + (0.0296 * speed_mps**2) ** 2)


def _induced_power_w(thrust_n: float, climb_mps: float) -> float:
    half = climb_mps / 2.0
    return 0.8554 * thrust_n * (half + math.sqrt(half**2 + thrust_n / 0.3051**2))


def _great_circle_distance_m(problem: CheckedProblem, start: int, stop: int) -> float:
    """Return the great-circle distance (Vincenty's form on a sphere, stable at all angles)."""
    lat_1, lon_1 = map(math.radians, problem.positions_deg[problem.file_row_of_node(start)])
    lat_2, lon_2 = map(math.radians, problem.positions_deg[problem.file_row_of_node(stop)])
    delta_lon = lon_2 - lon_1
    sin_distance = math.hypot(
        math.cos(lat_2) * math.sin(delta_lon),
        math.cos(lat_1) * math.sin(lat_2) - math.sin(lat_1) * math.cos(lat_2) * math.cos(delta_lon),
    )
    cos_distance = math.sin(lat_1) * math.sin(lat_2) + math.cos(lat_1) * math.cos(lat_2) * math.cos(
        delta_lon
    )
    return 6_378_100.0 * math.atan2(sin_distance, cos_distance)
