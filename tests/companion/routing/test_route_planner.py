"""The waypoint graph and the first BER on it."""

import math
from dataclasses import replace
from itertools import pairwise, permutations

import networkx as nx
import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Obstacle, ObstacleMap, horizontal_distance_m
from companion.core.return_budget.remaining_from_plan import (
    remaining_delivery,
    remaining_outbound,
    remaining_return,
)
from companion.core.routing.leg_energy import LegKind, RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute, Plan, PlanRequest
from companion.core.routing.shortest_paths import RouteFinder, path_vertices_in_first_problem
from companion.core.routing.smooth_route import max_route_turn_rad
from companion.core.routing.waypoint_graph import (
    SightLines,
    SiteMap,
    WaypointGraph,
    split_route_into_legs,
)
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.forecast import WindForecast

M100 = read_airframe("m100")
ROUTE = RouteEnergy(M100)
WALL = Obstacle("wall", ((-300.0, 600.0), (250.0, 600.0), (250.0, 640.0), (-300.0, 640.0)), 80.0)
SHED = Obstacle("shed", ((-50.0, 300.0), (50.0, 300.0), (50.0, 340.0), (-50.0, 340.0)), 20.0)


def site(*obstacles: Obstacle, customer: tuple = (0.0, 1200.0, -5.0)) -> SiteMap:
    return SiteMap(
        frame=LocalFrame(0.9, 0.1, 0.0),
        depot_ned_m=(0.0, 0.0, 0.0),
        customer_ned_m=customer,
        rally_ned_m=(("quay", (200.0, 500.0, -2.0)),),
        obstacles=ObstacleMap(obstacles, clearance_m=15.0, clearance_up_m=8.0),
    )


def request(where: SiteMap, left_wh: float | None = 110.0, **changes: object) -> PlanRequest:
    energy = None if left_wh is None else EnergyBelief(0.0, left_wh, 3.0, 118.0, "test")
    asked = PlanRequest(where, 40.0, 6.0, 150.0, 0.6, 10.0, 6.0, energy, 0.15)
    return replace(asked, **changes)


def steady(north: float, east: float) -> WindForecast:
    mean = np.tile([north, east], (3, 1))
    return WindForecast(np.array([0.0, 60.0, 300.0]), mean, 0.2 * np.eye(3), 0.1 * np.eye(2))


def test_legs_are_no_longer_than_asked_and_a_way_keeps_its_corners() -> None:
    corners = [(0.0, 0.0, -40.0), (310.0, 0.0, -40.0), (310.0, 450.0, -40.0)]
    way = split_route_into_legs(corners, 150.0)
    assert [round(horizontal_distance_m(a, b), 6) for a, b in pairwise(way)] == [103.333333] * 3 + [
        150.0
    ] * 3
    assert set(corners) <= set(way)


def test_every_line_of_the_graph_keeps_clear_and_every_other_does_not() -> None:
    where = site(WALL, SHED)
    graph = SightLines(where, 40.0).cached_visibility_graph()
    seen = set(zip(graph.tail.tolist(), graph.head.tolist(), strict=True))
    for a, b in permutations(range(len(graph.vertices_ned_m)), 2):
        clear = (
            where.obstacles.first_blocking_obstacle(
                graph.vertices_ned_m[a], graph.vertices_ned_m[b]
            )
            is None
        )
        assert ((a, b) in seen) == clear


def test_the_graph_is_directed_both_ways_and_connected() -> None:
    graph = in_networkx(SightLines(site(WALL), 40.0).cached_visibility_graph())
    assert nx.is_strongly_connected(graph)
    assert all(graph.has_edge(b, a) for a, b in graph.edges)


def in_networkx(graph: WaypointGraph) -> "nx.DiGraph[int]":
    made: nx.DiGraph[int] = nx.DiGraph()
    edges = zip(
        graph.tail.tolist(), graph.head.tolist(), graph.edge_lengths_m().tolist(), strict=True
    )
    made.add_weighted_edges_from(edges, weight="length_m")
    return made


def shortest(graph: WaypointGraph) -> list[int] | None:
    planned = graph.to_energy_graph(ROUTE, 0.0)
    routes = RouteFinder(planned).find_routes_to_goal(
        graph.customer, graph.edge_lengths_m()[:, None]
    )
    return path_vertices_in_first_problem(planned, routes, graph.depot)


def test_the_planners_graph_is_the_sites() -> None:
    graph = SightLines(site(WALL, SHED), 40.0).cached_visibility_graph()
    planned = graph.to_energy_graph(ROUTE, 0.5)
    np.testing.assert_allclose(planned.edge_length_m, graph.edge_lengths_m())
    first = planned.vertices_m[0]
    north, east, down = graph.vertices_ned_m[0]
    assert tuple(first) == (east, north, -down)
    assert (np.diff(graph.tail) >= 0).all()  # what EnergyGraph's slices rest on


def test_the_shortest_path_is_networkxs() -> None:
    graph = SightLines(site(WALL, SHED), 40.0).cached_visibility_graph()
    path = shortest(graph)
    assert path is not None
    oracle = nx.shortest_path_length(
        in_networkx(graph), graph.depot, graph.customer, weight="length_m"
    )
    flown = sum(
        horizontal_distance_m(graph.vertices_ned_m[a], graph.vertices_ned_m[b])
        for a, b in pairwise(path)
    )
    assert flown == pytest.approx(oracle)
    # Round the wall's end at north 250: at least hypot(600, 265) + hypot(560, 265) long.
    assert 1265.0 < flown < 1340.0


def test_what_is_lower_than_the_cruise_height_is_flown_over() -> None:
    graph = SightLines(site(SHED), 40.0).cached_visibility_graph()
    path = shortest(graph)
    assert path is not None
    assert all(abs(graph.vertices_ned_m[v][0]) < 1e-9 for v in path)


def test_a_customer_inside_an_obstacle_is_refused_by_name() -> None:
    with pytest.raises(LeewayError, match="customer: within 15 m of wall"):
        SightLines(site(WALL, customer=(0.0, 650.0, 0.0)), 40.0).cached_visibility_graph()


def test_no_path_leads_over_a_closed_edge() -> None:
    graph = SightLines(site(), 40.0).cached_visibility_graph()
    planned = graph.to_energy_graph(ROUTE, 0.0)
    cost = np.where(graph.head == graph.customer, np.inf, 1.0)
    routes = RouteFinder(planned).find_routes_to_goal(graph.customer, cost[:, None])
    assert path_vertices_in_first_problem(planned, routes, graph.depot) is None


def planned(where: SiteMap, **changes: object) -> Plan:
    plan = BerPlanner(ROUTE).plan(request(where, **changes))
    assert isinstance(plan, Plan)
    return plan


def test_a_plan_goes_out_and_home_in_clear_legs() -> None:
    where = site(WALL, SHED)
    plan = planned(where)
    assert plan.outbound_ned_m[-1] == (0.0, 1200.0, -40.0)
    assert plan.return_ned_m[-1] == (0.0, 0.0, -40.0)
    out = [(0.0, 0.0, -40.0), *plan.outbound_ned_m]
    back = [plan.outbound_ned_m[-1], *plan.return_ned_m]
    for a, b in [*pairwise(out), *pairwise(back)]:
        assert where.obstacles.first_blocking_obstacle(a, b) is None


def test_safety_rule_2_every_outbound_waypoint_joins_the_way_home_in_a_clear_line() -> None:
    where = site(WALL, SHED)
    plan = planned(where)
    assert len(plan.entry) == len(plan.outbound_ned_m)
    for point, entry in zip(plan.outbound_ned_m, plan.entry, strict=True):
        assert where.obstacles.first_blocking_obstacle(point, plan.return_ned_m[entry]) is None


def test_rally_points_are_offered_only_in_clear_sight() -> None:
    where = site(WALL, SHED)
    plan = planned(where)
    (quay,) = plan.rally
    over = (200.0, 500.0, -40.0)
    for i, point in enumerate(plan.outbound_ned_m):
        assert (i in quay.from_outbound) == (
            where.obstacles.first_blocking_obstacle(point, over) is None
        )
    assert len(plan.outbound_ned_m) - 1 not in quay.from_outbound  # behind the wall


def test_energy_and_time_are_the_legs_to_the_ground() -> None:
    calm, blown = (
        planned(site(), forecast=steady(0.0, 0.0)),
        planned(site(), forecast=steady(0.0, -9.0)),
    )
    # 2,400 m at 14 m/s, and about 130 s of climbs, settling, drop and landing.
    assert 2400.0 / 14.0 + 90.0 < calm.time_s < 2400.0 / 14.0 + 170.0
    assert blown.energy_wh > 1.02 * calm.energy_wh
    assert calm.route_std_wh < blown.route_std_wh


def test_return_ok_refuses_what_the_battery_cannot_bring_back() -> None:
    plan = planned(site())
    answer = BerPlanner(ROUTE).plan(request(site(), left_wh=plan.energy_wh))
    assert isinstance(answer, NoRoute)
    assert "out of range" in answer.reason
    # kappa = 1.15 on the way back: enough at about need + 15 % of half of it + the reserve.
    enough = 1.09 * plan.energy_wh + 0.15 * 118.0
    assert isinstance(BerPlanner(ROUTE).plan(request(site(), left_wh=enough)), Plan)


def test_a_wind_over_the_airspeed_is_no_route_with_a_reason() -> None:
    answer = BerPlanner(ROUTE).plan(request(site(), forecast=steady(0.0, -28.0)))
    assert isinstance(answer, NoRoute)
    assert "28.0 m/s" in answer.reason


def test_a_parcel_that_the_rotors_cannot_carry_in_thin_air_is_no_route() -> None:
    energy = RouteEnergy(M100, 0.44)
    answer = BerPlanner(energy).plan(request(site(), left_wh=None, payload_kg=1.0))
    assert isinstance(answer, NoRoute)
    assert "parcel 1 kg in air of 0.44 kg/m3: needs 56 N" in answer.reason


def test_a_parcel_over_the_limit_is_no_route() -> None:
    answer = BerPlanner(ROUTE).plan(request(site(), payload_kg=9.0))
    assert isinstance(answer, NoRoute)
    assert "9 kg" in answer.reason


def test_the_home_speed_without_commands_rises_with_a_headwind_to_come_home_against() -> None:
    calm = planned(site(), forecast=steady(0.0, 0.0)).home_ground_speed_mps
    against = planned(site(), forecast=steady(0.0, 10.0)).home_ground_speed_mps
    assert against < calm  # over ground slower, as the airspeed is dear
    assert 10.0 + against > calm  # but through the air faster


def test_what_is_ahead_ends_on_the_ground_by_every_way() -> None:
    plan = planned(site(WALL, SHED))
    cases = [
        remaining_outbound(plan, (0.0, 0.0, 0.0), 0, 0.6, 6.0, 6.0, 10.0),
        remaining_outbound(plan, plan.outbound_ned_m[2], 3, 0.6, 6.0, 6.0),
        remaining_delivery(plan, plan.outbound_ned_m[-1], 0.6, 6.0, 6.0),
        remaining_return(plan, plan.outbound_ned_m[-1], 0, 0.0, True),
        remaining_return(plan, (1.0, 2.0, -20.0), None, 0.0, True),
        remaining_return(
            plan, plan.return_ned_m[-3], len(plan.return_ned_m) - 2, 0.0, True, "quay"
        ),
    ]
    for ahead in cases:
        for ways in (ahead.current_return_routes, *(s.return_routes for s in ahead.stages)):
            for way in ways:
                ground = {"depot": plan.depot_ned_m, "quay": (200.0, 500.0, -2.0)}[way.landing]
                for legs in (way.leg_sequence, way.unattended_sequence):
                    assert legs[-1].kind is LegKind.LAND
                    assert legs[-1].to_ned_m == ground
                    joined = all(a.to_ned_m == b.from_ned_m for a, b in pairwise(legs))
                    assert joined


def test_a_rally_point_out_of_sight_is_reached_along_the_way_home() -> None:
    # The wall hides the quay from everything east of it; the way home passes the wall's end.
    plan = planned(site(WALL))
    quay = plan.rally[0]
    customer = len(plan.outbound_ned_m) - 1
    assert customer not in quay.from_outbound
    ahead = remaining_delivery(plan, plan.outbound_ned_m[-1], 0.6, 6.0, 6.0)
    depot, via = ahead.stages[-1].return_routes
    assert (depot.landing, via.landing) == ("depot", "quay")
    turn = next(leg.to_ned_m for leg in via.leg_sequence[::-1] if leg.to_ned_m in plan.return_ned_m)
    over = (200.0, 500.0, turn[2])
    assert site(WALL).obstacles.first_blocking_obstacle(turn, over) is None
    flown = sum(horizontal_distance_m(leg.from_ned_m, leg.to_ned_m) for leg in via.leg_sequence)
    # Round the wall's end at north 250, 560 m away over 265 m, and back to the quay.
    assert 560.0 < flown < 850.0
    for leg in via.leg_sequence:
        assert site(WALL).obstacles.first_blocking_obstacle(leg.from_ned_m, leg.to_ned_m) is None


def test_stages_join_and_the_last_one_delivers_at_drop_height() -> None:
    plan = planned(site(WALL))
    ahead = remaining_outbound(plan, (0.0, 0.0, 0.0), 0, 0.6, 6.0, 6.0, 10.0)
    assert [s.delivers for s in ahead.stages] == [False] * len(plan.outbound_ned_m) + [True]
    legs = [leg for stage in ahead.stages for leg in stage.leg_sequence]
    assert all(a.to_ned_m == b.from_ned_m for a, b in pairwise(legs))
    assert legs[0].kind is LegKind.CLIMB
    # Safety rule 8: 6 m above the CUSTOMER's ground, which is 5 m above the depot's.
    assert legs[-1].to_ned_m[2] == pytest.approx(-11.0)
    assert all(leg.payload_kg == 0.6 for leg in legs)
    home = ahead.stages[-1].return_routes[0].leg_sequence
    assert home[0].kind is LegKind.CLIMB
    assert all(leg.payload_kg == 0.0 for leg in home)
    assert math.isclose(home[0].from_ned_m[2], -11.0)


def test_a_rally_point_that_can_be_reached_is_a_way_back_that_holds_return_ok() -> None:
    near = replace(site(WALL), rally_ned_m=(("quay", (-20.0, 1050.0, -2.0)),))
    without = replace(site(WALL), rally_ned_m=())
    whole = planned(site(WALL))
    # Enough for four fifths of the trip and the reserve: not back to the depot, but to a quay
    # 150 m from the customer.
    left = 0.82 * whole.energy_wh + 0.15 * 118.0
    assert isinstance(BerPlanner(ROUTE).plan(request(without, left_wh=left)), NoRoute)
    assert isinstance(BerPlanner(ROUTE).plan(request(near, left_wh=left)), Plan)


def test_the_way_home_is_rounded_where_the_operator_allows_it_and_it_costs_less() -> None:
    where = site(WALL)
    sharp, smooth = (planned(where, corner_tolerance_m=m, leg_length_m=600.0) for m in (None, 25.0))
    assert smooth.outbound_ned_m == sharp.outbound_ned_m
    assert smooth.energy_wh < sharp.energy_wh
    over = sharp.outbound_ned_m[-1]
    turns = [max_route_turn_rad([over, *plan.return_ned_m]) for plan in (sharp, smooth)]
    assert turns[1] < 0.7 * turns[0]
    for a, b in pairwise([over, *smooth.return_ned_m]):
        assert where.obstacles.first_blocking_obstacle(a, b) is None
    assert len(smooth.entry) == len(smooth.outbound_ned_m)
