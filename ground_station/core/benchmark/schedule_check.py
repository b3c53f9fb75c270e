"""An independent check of a reported mFSTSP schedule: is it allowed, and does it end when it says?

Written from the rules alone, on purpose without numpy, numba or anything of the planner: plain sums
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
    """A drone by its vehicle file; SI but for the capacity."""

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
    """A problem as its files state it; node 0 is the depot, customers + 1 the depot at the end."""

    places_deg: Sequence[tuple[float, float]]
    parcels_lb: Sequence[float]
    travel_s: Sequence[Sequence[float]]
    deliver_s: float
    drone: CheckedDrone
    drones: int

    @property
    def end(self) -> int:
        """The depot's copy."""
        return len(self.places_deg)

    def file_node(self, node: int) -> int:
        """The node's row in the files."""
        return 0 if node == self.end else node


def violations_of(problem: CheckedProblem, row: Row) -> list[str]:
    """Every rule that this row breaks; empty where it is right."""
    route, sorties = row["truck_route"], row["sorties"]
    faults = [*_route_faults(problem, route, sorties)]
    if faults:
        return faults  # the other checks need a valid route
    place = {node: at for at, node in enumerate(route)}
    faults += _truck_faults(problem, route, row["truck"])
    faults += _driver_faults(problem, row["truck"], row["driver"])
    faults += _task_faults(problem, route, sorties, row["driver"])
    if faults:
        return faults
    for sortie in sorties:
        faults += _sortie_faults(problem, sortie, place, row["driver"])
    faults += _drone_faults(problem, sorties, row["driver"])
    ends_s = max(row["truck"][-1]["depart_s"], *(task["end_s"] for task in row["driver"]))
    if abs(ends_s - row["makespan_s"]) > TOLERANCE_S:
        faults.append(f"makespan {row['makespan_s']:.4f} s, but all are back at {ends_s:.4f} s")
    return faults


def _route_faults(problem: CheckedProblem, route: list[int], sorties: list[Row]) -> Iterable[str]:
    if route[:1] != [0] or route[-1:] != [problem.end] or len(route) < 2:
        yield f"the route goes from {route[:1]} to {route[-1:]}, expected 0 to {problem.end}"
    served = sorted([*route[1:-1], *(sortie["customer"] for sortie in sorties)])
    if served != list(range(1, problem.end)):
        yield f"served: {served}; expected each of 1 to {problem.end - 1} once"
    for sortie in sorties:
        for what in ("launch", "rendezvous"):
            if sortie[what] not in route:
                yield f"sortie to {sortie['customer']}: {what} at {sortie[what]}, no stop"


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
        start, stop = problem.file_node(one["node"]), problem.file_node(other["node"])
        least_s = one["depart_s"] + problem.travel_s[start][stop]
        if other["arrive_s"] < least_s - TOLERANCE_S:
            yield f"node {other['node']}: reached {least_s - other['arrive_s']:.4f} s too early"


def _driver_faults(problem: CheckedProblem, stops: list[Row], tasks: list[Row]) -> Iterable[str]:
    stop_at = {stop["node"]: stop for stop in stops}
    lasts_s = {
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
        if abs(task["end_s"] - task["start_s"] - lasts_s[task["what"]]) > TOLERANCE_S:
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
    wanted = [("deliver", node, None) for node in route[1:-1]]
    for sortie in sorties:
        wanted.append(("launch", sortie["launch"], sortie["drone"]))
        wanted.append(("recover", sortie["rendezvous"], sortie["drone"]))
    found = [(task["what"], task["node"], task["drone"]) for task in tasks]
    if sorted(map(str, wanted)) != sorted(map(str, found)):
        missing = sorted({str(task) for task in wanted} ^ {str(task) for task in found})
        yield f"the driver's tasks are not those of route and sorties: {missing[:4]}"


def _task_end(tasks: list[Row], what: str, node: int, drone: object, key: str) -> float:
    return next(
        task[key]
        for task in tasks
        if (task["what"], task["node"], task["drone"]) == (what, node, drone)
    )


def _sortie_faults(
    problem: CheckedProblem, sortie: Row, place: dict[int, int], tasks: list[Row]
) -> Iterable[str]:
    launch, customer, meet = sortie["launch"], sortie["customer"], sortie["rendezvous"]
    name = f"sortie {launch}-{customer}-{meet}"
    if place[launch] >= place[meet]:
        yield f"{name}: met before it is launched"
    parcel_lb = problem.parcels_lb[customer]
    if parcel_lb > problem.drone.capacity_lb:
        yield f"{name}: {parcel_lb:g} lb, the drone carries {problem.drone.capacity_lb:g}"
    least_s, most_s = sortie_window_s(problem, launch, customer, meet)
    launched_s = _task_end(tasks, "launch", launch, sortie["drone"], "end_s")
    met_s = _task_end(tasks, "recover", meet, sortie["drone"], "start_s")
    if not least_s - TOLERANCE_S <= met_s - launched_s <= most_s + TOLERANCE_S:
        yield (
            f"{name}: met {met_s - launched_s:.4f} s after its launch, "
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
            yield f"drone {drone}: launched while it is in the air, or met while it is aboard"
        ours = sorted(
            (sortie for sortie in sorties if sortie["drone"] == drone),
            key=lambda s: _task_end(tasks, "launch", s["launch"], drone, "start_s"),
        )
        flown = [node for sortie in ours for node in (sortie["launch"], sortie["rendezvous"])]
        if flown != [task["node"] for task in own]:
            yield f"drone {drone}: its tasks are not those of its sorties, in their order"


def sortie_window_s(
    problem: CheckedProblem, launch: int, customer: int, meet: int
) -> tuple[float, float]:
    """Least and most time from the end of the launch to the start of the recovery (Etype 1)."""
    drone = problem.drone
    up_s = drone.cruise_alt_m / drone.takeoff_mps + 180.0 / drone.yaw_rate_degps
    down_s = drone.cruise_alt_m / drone.landing_mps
    out_s = _distance_m(problem, launch, customer) / drone.cruise_mps
    back_s = _distance_m(problem, customer, meet) / drone.cruise_mps
    parcel_kg = problem.parcels_lb[customer] * 0.453592
    need_j = 0.0
    for load_kg, flight_s in ((parcel_kg, out_s), (0.0, back_s)):
        still_n = _thrust_n(load_kg, 0.0)
        moving_n = _thrust_n(load_kg, drone.cruise_mps)
        need_j += up_s * (_induced_w(still_n, drone.takeoff_mps) + 0.3177 * still_n**1.5)
        need_j += down_s * (_induced_w(still_n, drone.landing_mps) + 0.3177 * still_n**1.5)
        flying_w = _induced_w(moving_n, 0.0) + 0.3177 * moving_n**1.5
        need_j += flight_s * (flying_w + 0.0296 * drone.cruise_mps**3)
    hover_n = _thrust_n(0.0, 0.0)
    hover_w = _induced_w(hover_n, 0.0) + 0.3177 * hover_n**1.5
    least_s = 2.0 * (up_s + down_s) + out_s + back_s + drone.service_s
    return least_s, least_s + (drone.battery_j - need_j) / hover_w


def _thrust_n(load_kg: float, speed_mps: float) -> float:
    lift_n = 0.0279 * (speed_mps * math.cos(math.radians(10.0))) ** 2
    return math.sqrt(((1.5 + load_kg) * 9.8 - lift_n) ** 2 + (0.0296 * speed_mps**2) ** 2)


def _induced_w(thrust_n: float, climb_mps: float) -> float:
    half = climb_mps / 2.0
    return 0.8554 * thrust_n * (half + math.sqrt(half**2 + thrust_n / 0.3051**2))


def _distance_m(problem: CheckedProblem, start: int, stop: int) -> float:
    """Great circle by the spherical law of cosines' stable form (Vincenty on a sphere)."""
    lat_1, lon_1 = map(math.radians, problem.places_deg[problem.file_node(start)])
    lat_2, lon_2 = map(math.radians, problem.places_deg[problem.file_node(stop)])
    turn = lon_2 - lon_1
    across = math.hypot(
        math.cos(lat_2) * math.sin(turn),
        math.cos(lat_1) * math.sin(lat_2) - math.sin(lat_1) * math.cos(lat_2) * math.cos(turn),
    )
    along = math.sin(lat_1) * math.sin(lat_2) + math.cos(lat_1) * math.cos(lat_2) * math.cos(turn)
    return 6_378_100.0 * math.atan2(across, along)
