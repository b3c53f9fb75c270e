"""The planner's sortie tables against `SortieFeasibility`, and routes around obstacles against a
graph.
"""

import math
from itertools import pairwise, product
from pathlib import Path

import msgspec
import networkx as nx
import numpy as np
import pytest

from companion.core.base.geo import Obstacle, ObstacleMap
from companion.core.base.location import Location
from companion.core.mission.flight_file import Mission
from companion.core.mission.flight_plan import depot_frame
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.waypoint_graph import SightLines, SiteMap
from companion.core.vehicle.airframe import Airframe
from ground_station.adapters.files.params import read_airframe
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes, Price
from ground_station.core.feasibility.reach import SortieFeasibility, SortieGeometry
from ground_station.core.feasibility.sortie_model import WindSortieModel
from ground_station.core.schema.day import Drone, Forecast

NOTHING = ObstacleMap((), 15.0, 8.0)


@pytest.fixture(scope="module")
def m100() -> Airframe:
    return read_airframe("m100", Path())


def reach_of(airframe: Airframe, wind_mps: float, charge_frac: float) -> SortieFeasibility:
    drone = Drone(id="d1", airframe="m100", charge_frac=charge_frac)
    forecast = Forecast(speed_mps=wind_mps, from_deg=215.0, std_mps=2.0)
    return SortieFeasibility(
        drone, airframe, Mission(max_loss=0.01), forecast, RouteEnergy(airframe)
    )


@pytest.mark.sample
@pytest.mark.parametrize(("wind_mps", "charge_frac"), [(0.0, 1.0), (6.0, 0.8), (11.0, 1.0)])
def test_what_the_tables_allow_reach_allows_at_the_same_wind_and_stops(m100, wind_mps, charge_frac):
    rng = np.random.default_rng(int(wind_mps))
    count = 7
    ned_m = np.column_stack(
        [rng.uniform(-2500.0, 2500.0, (count, 2)), rng.uniform(-15.0, 15.0, count)]
    )
    payload_kg = rng.uniform(0.0, 1.0, count)
    height_m = rng.choice([40.0, 64.0, 100.0], count)
    reach = reach_of(m100, wind_mps, charge_frac)
    ways = ObstacleRoutes(NOTHING, ned_m[:, :2], 40.0)
    legs = WindSortieModel(ned_m, payload_kg, height_m, [reach], ways).leg_tables(0)
    places = [tuple(row) for row in ned_m.tolist()]
    allowed = agreed = 0
    for i, j, k in product(range(count), repeat=3):
        if j in (i, k):
            continue
        asked = (float(payload_kg[j]), places[i], places[j], places[k], float(height_m[j]))
        truly = reach.sortie_need_if_feasible(SortieGeometry(*asked)) is not None
        table = legs.out_hover_s[i, j] + legs.back_hover_s[j, k] <= legs.endurance_hover_s
        assert truly or not table, (i, j, k)
        allowed += truly
        agreed += table
        need = reach.sortie_need(SortieGeometry(*asked))
        if need.flyable:
            # Mean of two courses half a degree apart, at the lower speed of both.
            assert legs.out_s[i, j] + legs.back_s[j, k] == pytest.approx(need.time_s, rel=0.02)
    # Both results occur. The bound ignores that a wind error that costs in one direction gains in
    # the other: near the edge it refuses up to a third of what Reach accepts.
    assert 0 < allowed < count * (count - 1) ** 2
    assert agreed >= 0.65 * allowed


def test_a_higher_flight_takes_as_much_more_as_reach_says(m100):
    ned_m = np.array([[0.0, 0.0, 0.0], [600.0, -300.0, 0.0]])
    reach = reach_of(m100, 6.0, 1.0)
    ways = ObstacleRoutes(NOTHING, ned_m[:, :2], 40.0)
    model = WindSortieModel(ned_m, np.array([0.0, 0.5]), np.full(2, 64.0), [reach], ways)
    added_s, added_hover_s = model.extra_climb_time_and_hover_s(0, 12.0)
    low, high = (
        reach.sortie_need(
            SortieGeometry(0.5, (0.0, 0.0, 0.0), (600.0, -300.0, 0.0), (0.0, 0.0, 0.0), height_m)
        )
        for height_m in (64.0, 76.0)
    )
    assert added_s == pytest.approx(high.time_s - low.time_s, rel=0.01)
    hover_wh_per_s = low.mean_wh / low.time_s  # a flight draws about as much as hover
    more_wh = high.mean_wh - low.mean_wh
    assert 0.7 * more_wh < added_hover_s * hover_wh_per_s < 2.0 * more_wh


def test_more_deviation_of_the_power_model_or_the_pack_shortens_the_reach(m100):
    change = msgspec.structs.replace
    rotor = change(m100.power_rotor, model_std_frac=0.15)
    pack = change(m100.battery, usable_std_frac=0.15)
    ned_m = np.array([[0.0, 0.0, 0.0], [1500.0, 0.0, 0.0]])
    spare_s = []
    for airframe in (m100, change(m100, power_rotor=rotor), change(m100, battery=pack)):
        reach = reach_of(airframe, 5.0, 1.0)
        tables = WindSortieModel(
            ned_m,
            np.zeros(2),
            np.full(2, 40.0),
            [reach],
            ObstacleRoutes(NOTHING, ned_m[:, :2], 40.0),
        ).leg_tables(0)
        sortie_s = tables.out_hover_s[0, 1] + tables.back_hover_s[1, 0]
        spare_s.append(tables.endurance_hover_s - sortie_s)
    assert spare_s[1] < spare_s[0]
    assert spare_s[2] < spare_s[0]


def box(name: str, north: float, east: float, half_m: float, height_m: float) -> Obstacle:
    corners = [(-1, -1), (-1, 1), (1, 1), (1, -1), (-1, -1)]
    ring = tuple((north + half_m * a, east + half_m * b) for a, b in corners)
    return Obstacle(name, ring, height_m)


def test_ways_around_obstacles_are_as_long_as_on_the_companions_own_graph():
    obstacles = ObstacleMap(
        (box("a", 300.0, 0.0, 60.0, 90.0), box("b", 520.0, 90.0, 50.0, 90.0)), 15.0, 8.0
    )
    customer = (800.0, 60.0, 0.0)
    ways = ObstacleRoutes(obstacles, np.array([[0.0, 0.0], customer[:2]]), 40.0)
    assert ways.blocked[0, 1]
    points = [(0.0, 0.0), *ways.waypoints_between(0, 1), customer[:2]]
    length_m = sum(math.dist(a, b) for a, b in pairwise(points))
    frame = depot_frame(Location(lat_deg=55.0, lon_deg=8.0, alt_amsl_m=0.0))
    graph = SightLines(
        SiteMap(frame, (0.0, 0.0, 0.0), customer, (), obstacles), 40.0
    ).cached_visibility_graph()
    edges = zip(
        graph.tail.tolist(), graph.head.tolist(), graph.edge_lengths_m().tolist(), strict=True
    )
    oracle: nx.DiGraph[int] = nx.DiGraph()
    oracle.add_weighted_edges_from(edges, weight="length_m")
    shortest_m = nx.shortest_path_length(oracle, graph.depot, graph.customer, weight="length_m")
    assert length_m == pytest.approx(shortest_m, abs=0.01)
    assert length_m > math.dist(points[0], points[-1]) + 1.0


def test_bends_are_the_corners_of_the_ways():
    obstacles = ObstacleMap((box("house", 0.0, 300.0, 60.0, 80.0),), 15.0, 8.0)
    ne_m = np.array([[0.0, 0.0], [10.0, 600.0], [400.0, 300.0]])
    ways = ObstacleRoutes(obstacles, ne_m, 40.0)
    bends = ways.corner_indices_by_start_and_end()
    for start, end in product(range(3), repeat=2):
        corners = [corner for corner in bends[start, end].tolist() if corner >= 0]
        assert [tuple(ways.corners_ne_m[k].tolist()) for k in corners] == list(
            ways.waypoints_between(start, end)
        )
    assert len(ways.waypoints_between(0, 1)) >= 1
    assert ObstacleRoutes(NOTHING, ne_m, 40.0).corner_indices_by_start_and_end().size == 0


def test_what_is_lower_than_the_flight_is_flown_over_and_what_is_built_in_has_no_way():
    low = ObstacleMap((box("shed", 300.0, 0.0, 60.0, 20.0),), 15.0, 8.0)
    places = np.array([[0.0, 0.0], [600.0, 0.0]])
    assert not ObstacleRoutes(low, places, 40.0).blocked.any()
    high = ObstacleMap((box("tower", 600.0, 0.0, 60.0, 90.0),), 15.0, 8.0)
    ways = ObstacleRoutes(high, places, 40.0)
    assert ways.obstructed.tolist() == [False, True]

    def metres(a_ne_m, b_ne_m):
        away_m = np.hypot(*np.moveaxis(b_ne_m[None] - a_ne_m[:, None], 2, 0))
        return Price(away_m, away_m, away_m)

    assert np.isinf(ways.price_routes(metres).energy_wh[0, 1])
