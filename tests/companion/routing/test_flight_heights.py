"""Plans over known ground: each possible flight line is checked by sampling its ground."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.adapters.files.params import read_airframe, read_flight_with_terrain_heights
from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, Obstacle, ObstacleMap, horizontal_distance_m
from companion.core.exports.ground_plan import plan_flight_without_vehicle
from companion.core.ground.ground_table import GroundTable
from companion.core.mission.flight_file import Flight, Terrain, with_terrain_heights
from companion.core.mission.flight_plan import VERTICAL_CLEARANCE_M, FlightPlan, route_properties
from companion.core.mission.mission_items import POSITIONED_KINDS, Part
from companion.core.return_budget.remaining_from_plan import remaining_outbound
from companion.core.return_budget.remaining_mission import merge_straight_cruise_legs
from companion.core.routing import route_planner
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy

ROOT = Path(__file__).parents[3]
HILLS = read_flight_with_terrain_heights(ROOT / "params" / "flights" / "hills.toml")
M100 = read_airframe("m100")
ENERGY = RouteEnergy(M100)
HIGHEST_M = 69.7
"""Of the shipped hills, on the lattice (params/sites/hills.csv, its largest up_m)."""


def planned(flight: Flight = HILLS) -> FlightPlan:
    return plan_flight_without_vehicle(flight, ENERGY, None)


def level() -> Flight:
    site = msgspec.structs.replace(HILLS.site, terrain=Terrain())
    return msgspec.structs.replace(HILLS, site=site)


def changed(**mission: float) -> Flight:
    return msgspec.structs.replace(HILLS, mission=msgspec.structs.replace(HILLS.mission, **mission))


def made_up_m(north_m: float, east_m: float) -> float:
    """The formula at the head of params/flights/hills.toml."""
    first = 70.0 * math.exp(-(((east_m + 520) / 212) ** 2) - ((north_m + 60) / 566) ** 2)
    return first + 45.0 * math.exp(-(((east_m + 980) / 170) ** 2) - ((north_m + 250) / 424) ** 2)


def over_ground_m(flown: FlightPlan, a: Ned, b: Ned) -> float:
    """The least height of the line's LOWER end over ground within 15 m of it, sampled."""
    assert flown.site.ground is not None
    steps = max(int(horizontal_distance_m(a, b) / 5.0), 2)
    line = np.linspace(a[:2], b[:2], steps)
    ring = np.linspace(0.0, 2.0 * np.pi, 9)
    off = 15.0 * np.stack([np.cos(ring), np.sin(ring)], axis=-1)
    places = (line[:, None, :] + np.concatenate([np.zeros((1, 2)), off])).reshape(-1, 2)
    return min(-a[2], -b[2]) - float(flown.site.ground.strip.ground_heights_m(places).max())


def flown_lines(flown: FlightPlan) -> list[tuple[Ned, Ned]]:
    """Return legs out and back, to the return route from each waypoint, and to landing sites."""
    plan = flown.plan
    lines = [*itertools.pairwise(plan.outbound_ned_m)]
    lines += itertools.pairwise((plan.return_route_start_ned_m, *plan.return_ned_m))
    lines += [
        (here, plan.return_ned_m[entry])
        for here, entry in zip(plan.outbound_ned_m, plan.entry, strict=True)
    ]
    for (a, b), entry in zip(itertools.pairwise(plan.outbound_ned_m), plan.entry, strict=False):
        for share in (0.21, 0.5, 0.83):  # turning round on the leg, at the lower of its heights
            north, east = (p + share * (q - p) for p, q in zip(a[:2], b[:2], strict=True))
            lines.append(((north, east, max(a[2], b[2])), plan.return_ned_m[entry]))
    for rally in plan.rally:
        above = rally.arrival_point_above_site(plan.return_ned_m[-1])
        lines += [(plan.outbound_ned_m[i], above) for i in rally.from_outbound]
        lines += [(plan.return_ned_m[i], above) for i in rally.from_return]
    return [(a, b) for a, b in lines if horizontal_distance_m(a, b) > 1.0]


def test_the_shipped_ground_is_its_formulas():
    table = HILLS.site.terrain.heights
    assert table is not None
    here_m = made_up_m(0.0, 0.0)
    for north, row in zip(table.longitudinal_m, table.up_m, strict=True):
        for east, up in zip(table.lateral_m, row, strict=True):
            assert up == pytest.approx(made_up_m(north, east) - here_m, abs=0.051)
    assert max(up for row in table.up_m for up in row if up is not None) == HIGHEST_M


def test_every_line_over_the_hills_keeps_the_clearance_and_a_level_plan_would_not():
    flown = planned()
    least_m = min(over_ground_m(flown, a, b) for a, b in flown_lines(flown))
    assert least_m >= HILLS.mission.clearance_m + VERTICAL_CLEARANCE_M
    # The canary: the same lines at cruise height go through the first hill.
    low = [((*a[:2], -40.0), (*b[:2], -40.0)) for a, b in flown_lines(flown)]
    assert min(over_ground_m(flown, a, b) for a, b in low) < -20.0


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_on_any_ground_no_line_of_a_plan_is_nearer_than_the_clearance(seed):
    rng = np.random.default_rng(seed)
    axis = np.linspace(-700.0, 700.0, 15)
    up = rng.uniform(-20.0, 150.0, (15, 15))
    up[6:9, 6:9] = 0.0  # about the depot
    customer = rng.uniform(-350.0, 350.0, 2)
    table = GroundTable(longitudinal_m=axis.tolist(), lateral_m=axis.tolist(), up_m=up.tolist())
    flight = with_terrain_heights(HILLS, table)
    place = {"north_m": float(customer[0]), "east_m": float(customer[1])}
    known = planned_ground(flight, customer)
    place = msgspec.structs.replace(flight.site.customer, up_m=known, **place)
    site = msgspec.structs.replace(flight.site, customer=place, rally=[])
    mission = msgspec.structs.replace(flight.mission, cruise_height_m=max(40.0, known + 15.0))
    flown = planned(msgspec.structs.replace(flight, site=site, mission=mission))
    for a, b in flown_lines(flown):
        assert over_ground_m(flown, a, b) >= 20.0 + VERTICAL_CLEARANCE_M
        assert min(-a[2], -b[2]) >= mission.cruise_height_m
    assert unkept(flown) == []


def planned_ground(flight: Flight, ne_m: np.ndarray) -> float:
    from scipy.interpolate import RegularGridInterpolator

    table = flight.site.terrain.heights
    assert table is not None
    look = RegularGridInterpolator((table.longitudinal_m, table.lateral_m), np.array(table.up_m))
    return float(look(ne_m)[0])


def test_heights_of_items_are_above_home_and_each_waypoints_own():
    flown = planned()
    spots = [
        item.spot for item in flown.mission.items if item.kind in POSITIONED_KINDS and item.spot
    ]
    heights = {round(spot.height_rel_m) for spot in spots}
    assert max(heights) == round(HIGHEST_M + 20.0 + VERTICAL_CLEARANCE_M)
    assert {i.part for i in flown.mission.items if i.spot} >= {Part.OUTBOUND, Part.RETURN}
    outward = [
        flown.mission_position_to_ned_m(flown.mission.items[i].spot) for i in flown.mission.outbound
    ]
    for spot, point in zip(outward, flown.plan.outbound_ned_m, strict=True):
        assert spot == pytest.approx(point, abs=0.02)


def test_an_autopilots_own_return_is_over_the_highest_ground_on_any_straight_way_home():
    facts = route_properties(HILLS, M100, planned())
    assert facts.min_clear_rtl_height_m == pytest.approx(HIGHEST_M + 20.0 + VERTICAL_CLEARANCE_M)
    assert route_properties(level(), M100, planned(level())).min_clear_rtl_height_m == 0.0


def test_what_stands_on_a_straight_way_home_from_amid_a_leg_counts_for_an_autopilots_own_return():
    """A corner with legs of 800 m; no straight line home from a waypoint crosses the shed."""
    flown = planned(level())
    out = ((0.0, 0.0, -40.0), (800.0, 0.0, -40.0), (800.0, 800.0, -40.0))
    shed = Obstacle("shed", ((595.0, 295.0), (605.0, 295.0), (605.0, 305.0), (595.0, 305.0)), 75.0)
    site = replace(flown.site, obstacles=ObstacleMap((shed,), 15.0, VERTICAL_CLEARANCE_M))
    plan = replace(flown.plan, outbound_ned_m=out, return_ned_m=out[::-1], away_ned_m=(), rally=())
    assert all(
        site.obstacles.max_obstacle_height_near_line_m(p, plan.depot_ned_m) == 0.0 for p in out
    )
    facts = route_properties(level(), M100, replace(flown, site=site, plan=plan))
    assert facts.highest_obstacle_m == 75.0


def unkept(flown: FlightPlan) -> list[str]:
    """Return the legs of the onboard mission whose height the vehicle misses at the mission's
    speed.

    As PX4 1.18 flies them: full climb or sink rate from the leg's start, without slowing down. Legs
    on which it stops, over home, do not count."""
    plan, speeds = flown.plan, M100.speeds
    back = (plan.return_route_start_ned_m, *plan.return_ned_m)
    into = zip(plan.outbound_ned_m, (plan.return_ned_m[e] for e in plan.entry), strict=True)
    over_home = plan.return_ned_m[-1]
    lines = [*itertools.pairwise(back), *((a, b) for a, b in into)]
    found: list[str] = []
    for a, b in lines:
        flown_s = horizontal_distance_m(a, b) / plan.home_ground_speed_mps
        if b == over_home or horizontal_distance_m(a, b) <= 20.0:
            continue
        needed_s = max((a[2] - b[2]) / speeds.climb_mps, (b[2] - a[2]) / speeds.descent_mps)
        if needed_s > 0.81 * flown_s:
            found.append(f"{a} to {b}: {needed_s:.1f} s in {flown_s:.1f}")
    return found


def ridge() -> Flight:
    """The shipped flight with its first hill three times as steep."""
    table = HILLS.site.terrain.heights
    assert table is not None
    rows = [
        [up + 90.0 * math.exp(-(((east + 645.0) / 80.0) ** 2)) for east, up in
         zip(table.lateral_m, row, strict=True)]
        for row in table.up_m
    ]  # fmt: skip
    site = msgspec.structs.replace(HILLS.site, rally=[])
    flight = msgspec.structs.replace(HILLS, site=site)
    return with_terrain_heights(flight, msgspec.structs.replace(table, up_m=rows))


def test_the_mission_aboard_is_in_height_at_its_waypoints_though_nobody_slows_it_down(monkeypatch):
    assert unkept(planned()) == []
    steep = planned(ridge())
    assert unkept(steep) == []
    least_m = min(over_ground_m(steep, a, b) for a, b in flown_lines(steep))
    assert least_m >= HILLS.mission.clearance_m + VERTICAL_CLEARANCE_M
    # The canary: only as high as the ground asks, it would be passed out of height.
    monkeypatch.setattr(
        route_planner, "raise_waypoints_to_limit_return_slopes", lambda ways, *_: ways
    )
    low = planned(ridge())
    assert unkept(low) != []
    pairs = zip(low.plan.return_ned_m, steep.plan.return_ned_m, strict=True)
    assert all(b[2] <= a[2] for a, b in pairs)
    highest_m = max(-p[2] for p in low.plan.return_ned_m)
    assert max(-p[2] for p in steep.plan.return_ned_m) == pytest.approx(highest_m)


def test_a_flight_with_sloping_legs_says_so_and_layers_are_no_slopes():
    assert route_properties(HILLS, M100, planned()).is_sloped
    assert not route_properties(level(), M100, planned(level())).is_sloped
    mission = msgspec.structs.replace(HILLS.mission, return_height_m=55.0)
    layered = msgspec.structs.replace(level(), mission=mission)
    assert not route_properties(layered, M100, planned(layered)).is_sloped


def test_without_known_ground_a_plan_is_level_as_ever():
    plan = planned(level()).plan
    assert {p[2] for p in (*plan.outbound_ned_m, *plan.return_ned_m)} == {-40.0}
    assert not plan.has_waypoints_at_different_heights
    assert {rally.height_m for rally in plan.rally} == {None}
    assert planned().plan.energy_wh > plan.energy_wh  # climbs are paid for


def refused(flight: Flight) -> str:
    with pytest.raises(LeewayError) as told:
        planned(flight)
    return str(told.value)


def test_a_flight_is_refused_with_the_place_and_the_figure():
    table = HILLS.site.terrain.heights
    assert table is not None

    def with_up(row: int, column: int, up_m: float | None) -> Flight:
        rows = [list(r) for r in table.up_m]
        rows[row][column] = up_m
        return with_terrain_heights(HILLS, msgspec.structs.replace(table, up_m=rows))

    north, east = table.longitudinal_m.index(-90.0), table.lateral_m.index(-600.0)
    words = refused(with_up(north, east, None))
    assert words == ("no route: no terrain height is known -90 m north, -600 m east of the depot")
    words = refused(with_up(north, east, 480.0))
    assert "-90 m north, -600 m east of the depot is 480 m above it and requires 508 m" in words
    short = GroundTable(
        longitudinal_m=table.longitudinal_m,
        lateral_m=[-900.0, 300.0],
        up_m=[[0.0, 0.0]] * len(table.longitudinal_m),
    )
    assert "customer: ground height unknown" in refused(with_terrain_heights(HILLS, short))
    site = HILLS.site
    sunk = msgspec.structs.replace(site.customer, up_m=-30.0)
    wrong = msgspec.structs.replace(site, customer=sunk)
    words = refused(msgspec.structs.replace(HILLS, site=wrong))
    assert "customer: ground stated -30 m above the depot, terrain has 1 m" in words


def test_in_flight_nothing_is_in_sight_through_a_hill():
    flown = planned()
    behind, home = (-140.0, -860.0, -50.0), (0.0, 0.0, -50.0)
    assert not flown.is_line_clear(behind, home)
    assert flown.is_line_clear((*behind[:2], -95.0), (*home[:2], -95.0))
    entry = flown.shortest_clear_return_item((-70.0, -430.0, -90.0))
    assert entry in flown.mission.returning


def test_a_climb_along_a_leg_takes_its_time_and_its_energy():
    a, b = (0.0, 0.0, -40.0), (60.0, 0.0, -100.0)
    flat = Leg(LegKind.CRUISE, a, (60.0, 0.0, -40.0), 0.6)
    costs = ENERGY.leg_costs_wind_major((Leg(LegKind.CRUISE, a, b, 0.6), flat), np.zeros((1, 2)))
    # 60 m at the airframe's climb speed is longer than 60 m at cruise; m g h over the efficiency.
    assert costs.time_s[0, 0] >= 60.0 / M100.speeds.climb_mps
    lifted_wh = (
        60.0 * M100.flying_mass_kg(0.6) * 9.80665 / M100.power_rotor.drive_efficiency / 3600.0
    )
    assert costs.energy_wh[0, 0] - costs.energy_wh[0, 1] >= lifted_wh


def test_two_legs_over_a_ridge_are_not_priced_as_one_level_leg():
    up = Leg(LegKind.CRUISE, (0.0, 0.0, -40.0), (100.0, 0.0, -90.0), 0.0)
    down = Leg(LegKind.CRUISE, (100.0, 0.0, -90.0), (200.0, 0.0, -40.0), 0.0)
    assert merge_straight_cruise_legs((up, down)) == [up, down]
    flat = replace(up, to_ned_m=(100.0, 0.0, -40.0))
    assert (
        len(merge_straight_cruise_legs((flat, replace(down, from_ned_m=(100.0, 0.0, -40.0))))) == 1
    )


def test_the_gate_prices_every_climb_that_is_ahead():
    flown = planned()
    over = flown.plan.outbound_ned_m[0]
    ahead = remaining_outbound(flown.plan, over, 1, 0.6, 6.0, 12.0)
    legs = [
        leg for stage in ahead.stages for leg in stage.leg_sequence if leg.kind is LegKind.CRUISE
    ]
    climbs = sum(max(leg.from_ned_m[2] - leg.to_ned_m[2], 0.0) for leg in legs)
    points = flown.plan.outbound_ned_m
    paid = sum(max(a[2] - b[2], 0.0) for a, b in itertools.pairwise(points))
    assert climbs == pytest.approx(paid)
    assert paid > 30.0
