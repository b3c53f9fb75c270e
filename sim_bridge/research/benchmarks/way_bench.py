"""What planning one delivery costs on the vehicle, by how many towers stand on the way.

CPU seconds of one core from an airframe and a drawn site to the plan, tables and all.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.adapters.files.params import read_airframe
from companion.core.base.geo import LocalFrame, Obstacle, ObstacleMap
from companion.core.mission.flight_plan import CLEARANCE_M, CLEARANCE_UP_M, DROP_S
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute, PlanRequest
from companion.core.routing.waypoint_graph import SightLines, SiteMap
from sim_bridge.adapters.wall_clock import cpu_s
from sim_bridge.research.results.sheet import Sheet

TOWERS = (0, 20, 100, 400)
TRIP_M, ASIDE_M, CRUISE_HEIGHT_M, TOWER_M = 3600.0, 1200.0, 40.0, 75.0
WIDTHS_M = (20.0, 80.0)
FREE_M = 120.0  # about depot and customer


@dataclass(frozen=True)
class Planned:
    """One site: how many corners and places its lines join, CPU seconds, whether there is a way."""

    towers: int
    seed: int
    knots: int
    planning_s: float
    found: bool


def towers(count: int, seed: int) -> SiteMap:
    """Eight-cornered towers about a straight trip of `TRIP_M`, none near its ends."""
    rng = np.random.default_rng([seed, count])
    customer = (0.0, TRIP_M, 0.0)
    found: list[Obstacle] = []
    while len(found) < count:
        north, east = float(rng.uniform(-ASIDE_M, ASIDE_M)), float(rng.uniform(0.0, TRIP_M))
        if min(math.hypot(north, east), math.hypot(north, east - TRIP_M)) < FREE_M:
            continue
        half_m = float(rng.uniform(*WIDTHS_M)) / 2.0
        turns = np.arange(8) * (math.pi / 4.0)
        ring = tuple(
            (north + half_m * math.cos(turn), east + half_m * math.sin(turn)) for turn in turns
        )
        found.append(Obstacle(f"tower {len(found)}", ring, TOWER_M))
    obstacles = ObstacleMap(tuple(found), CLEARANCE_M, CLEARANCE_UP_M)
    return SiteMap(LocalFrame(0.968, 0.147, 0.0), (0.0, 0.0, 0.0), customer, (), obstacles)


def plan(count: int, seed: int) -> Planned:
    """Plan the trip once."""
    site, airframe = towers(count, seed), read_airframe("m100")
    began_s = cpu_s()
    request = PlanRequest(site, CRUISE_HEIGHT_M, 6.0, 300.0, 0.2, 10.0, DROP_S, None, 0.15)
    found = BerPlanner(RouteEnergy(airframe)).plan(request)
    spent_s = cpu_s() - began_s
    knots = len(SightLines(site, CRUISE_HEIGHT_M).knots_ned_m)
    return Planned(count, seed, knots, spent_s, not isinstance(found, NoRoute))


def sheet(rows: list[Planned]) -> Sheet:
    """Medians and ranges over the seeds."""
    cells: list[list[str]] = []
    for count in TOWERS:
        some = [row for row in rows if row.towers == count]
        spent = [row.planning_s for row in some]
        cells.append(
            [
                f"{count}",
                f"{np.median([row.knots for row in some]):.0f}",
                f"{np.median(spent):.2f}",
                f"{min(spent):.2f} to {max(spent):.2f}",
                f"{sum(row.found for row in some)} of {len(some)}",
            ]
        )
    note = (
        f"CPU time of one core. A trip of {TRIP_M:g} m at {CRUISE_HEIGHT_M:g} m among towers of"
        f" {TOWER_M:g} m, {WIDTHS_M[0]:g} to {WIDTHS_M[1]:g} m wide, drawn within {ASIDE_M:g} m of"
        f" it; {len({row.seed for row in rows})} sites each."
    )
    head = ["towers", "corners and places", "planning s", "range s", "ways found"]
    return Sheet("Planning a way among towers", head, cells, note)
