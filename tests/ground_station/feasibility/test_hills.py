"""Sorties over hills: heights against analytic terrain, energies against the companion's plan."""

import math
from itertools import product
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.core.base.geo import ObstacleMap, location_to_ground_ned_m
from companion.core.base.location import Location
from companion.core.mission.flight_estimate import CruiseWind
from companion.core.mission.flight_plan import depot_frame
from ground_station.adapters.files.day_files import read_day
from ground_station.app.planning.flight_estimate import estimate_flight_file
from ground_station.core.dispatch.flight_tables import depot_delivery_flight_table
from ground_station.core.feasibility.hills import Hills, hills_of
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.feasibility.reach import (
    Feasible,
    Infeasible,
    SortieFeasibility,
    SortieGeometry,
    route_energy_model_for_day,
)
from ground_station.core.feasibility.sortie_model import WindSortieModel
from ground_station.core.schema.day import Day, Forecast
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.orders import Order, order_location

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
DEPOT = Location(lat_deg=47.2, lon_deg=9.3, alt_amsl_m=400.0)
CLEARANCE_M, SPARE_M = 20.0, 8.0
"""The mission's default, and the planner's margin (docs/how-to/fly-over-ground.md)."""
RIDGE_M = 150.0
CALM = Forecast()


def ground_m(north_m, east_m):
    """Height above the depot: a ridge 600 m east of it that runs north."""
    return RIDGE_M * np.exp(-(((east_m - 600.0) / 120.0) ** 2)) * np.exp(-((north_m / 1500.0) ** 2))


def made(depot: Location = DEPOT, hole: bool = False) -> SiteElevation:
    """Sample that terrain on a grid of one arc second, 2 km around the depot."""
    lat = depot.lat_deg + np.arange(-65, 66) / 3600.0
    lon = depot.lon_deg + np.arange(-95, 96) / 3600.0
    north = (lat - depot.lat_deg) * 111_200.0
    east = (lon - depot.lon_deg) * 111_300.0 * math.cos(math.radians(depot.lat_deg))
    amsl = depot.alt_amsl_m + ground_m(north[:, None], east[None, :])
    if hole:
        amsl[:, east > 300.0] = np.nan
    return SiteElevation(lat, lon, amsl, "made")


def least(a, b, hole: bool = False) -> float:
    hills = Hills(made(hole=hole), DEPOT, CLEARANCE_M)
    (found,) = hills.min_flight_height_above_depot_m(np.array([a]), np.array([b]))
    return float(found)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ((0.0, 0.0), (0.0, 1200.0)),
        ((0.0, 0.0), (300.0, 500.0)),
        ((-900.0, -300.0), (1100.0, 640.0)),
        ((0.0, -600.0), (0.0, -601.0)),
    ],
)
def test_a_line_is_flown_at_the_clearance_over_the_highest_ground_beside_it(a, b):
    share = np.linspace(0.0, 1.0, 2001)
    north, east = (a[i] + share * (b[i] - a[i]) for i in (0, 1))
    around = [(n, e) for n, e in product(np.arange(-70.0, 71.0, 10.0), repeat=2)]
    under = float(ground_m(north, east).max())
    about = max(float(ground_m(north + n, east + e).max()) for n, e in around)
    found = least(a, b) - CLEARANCE_M - SPARE_M
    assert under - 1.0 <= found <= about + 0.1  # a 21 to 31 m grid misses the ridge by 0.9 m


def test_lines_are_judged_each_by_itself_and_both_ways_alike():
    hills = Hills(made(), DEPOT, CLEARANCE_M)
    a = np.array([(0.0, 0.0), (0.0, 0.0), (0.0, 1200.0)])
    b = np.array([(0.0, 1200.0), (200.0, -900.0), (0.0, 0.0)])
    over, away, back = hills.min_flight_height_above_depot_m(a, b)
    assert over == back == pytest.approx(RIDGE_M + CLEARANCE_M + SPARE_M, abs=1.0)
    assert away < 0.2 * over


def test_ground_that_nobody_knows_counts_for_nothing():
    assert least((0.0, 400.0), (0.0, 900.0), hole=True) == -math.inf
    assert least((0.0, 5000.0), (0.0, 6000.0)) == -math.inf
    assert least((0.0, 0.0), (0.0, 900.0), hole=True) < 60.0


def hilly_day(forecast: Forecast = CALM) -> Day:
    depot = msgspec.structs.replace(
        DAY.day.depot, lat_deg=DEPOT.lat_deg, lon_deg=DEPOT.lon_deg, alt_amsl_m=DEPOT.alt_amsl_m
    )
    return msgspec.structs.replace(DAY.day, depot=depot, forecast=forecast, rally=[])


def order_at(north_m: float, east_m: float, kg: float = 0.3) -> Order:
    lat = DEPOT.lat_deg + north_m / 111_200.0
    lon = DEPOT.lon_deg + east_m / (111_300.0 * math.cos(math.radians(DEPOT.lat_deg)))
    up = float(ground_m(north_m, east_m))
    return Order(id="H-1", lat_deg=lat, lon_deg=lon, alt_amsl_m=DEPOT.alt_amsl_m + up, mass_kg=kg)


def planned_wh(tmp_path: Path, elevation: SiteElevation | None, order: Order) -> float:
    """Return the delivery's energy by the companion's own planner, in calm air."""
    day = hilly_day()
    table = depot_delivery_flight_table(day, day.drones[0], order, elevation)
    file = tmp_path / "flight.toml"
    file.write_bytes(msgspec.toml.encode(table))
    return estimate_flight_file(file, CruiseWind(0.0, 0.0, 1.0), 1.0).planned.plan.energy_wh


def priced_wh(elevation: SiteElevation | None, order: Order) -> float:
    day = hilly_day()
    drone = day.drones[0]
    airframe = DAY.airframes[drone.airframe]
    energy = route_energy_model_for_day(day, airframe)
    reach = SortieFeasibility(
        drone, airframe, day.mission, day.forecast, energy, hills_of(day, elevation)
    )
    customer = location_to_ground_ned_m(depot_frame(day.depot.location), order_location(order))
    return reach.sortie_need(
        SortieGeometry(order.mass_kg, (0.0, 0.0, 0.0), customer, (0.0, 0.0, 0.0))
    ).mean_wh


def test_climbs_cost_at_the_desk_what_the_companions_plan_says(tmp_path):
    order = order_at(0.0, 1150.0)
    flat, hilly = (priced_wh(ground, order) for ground in (None, made()))
    own_flat, own_hilly = (planned_wh(tmp_path, ground, order) for ground in (None, made()))
    # 140 m up and down, twice: a third of the flight's energy.
    assert own_hilly > 1.15 * own_flat
    assert flat == pytest.approx(own_flat, rel=0.06)
    assert hilly == pytest.approx(own_hilly, rel=0.06)
    assert hilly - flat == pytest.approx(own_hilly - own_flat, rel=0.12)


@pytest.mark.sample
def test_what_the_tables_allow_over_hills_reach_allows():
    day = hilly_day(Forecast(speed_mps=6.0, from_deg=215.0, std_mps=2.0))
    drone, elevation = day.drones[0], made()
    airframe = DAY.airframes[drone.airframe]
    hills = hills_of(day, elevation)
    rng = np.random.default_rng(3)
    count = 7
    ne = rng.uniform((-1200.0, -300.0), (1200.0, 1500.0), (count, 2))
    ned_m = np.column_stack([ne, -ground_m(ne[:, 0], ne[:, 1])])
    payload_kg = rng.uniform(0.0, 1.0, count)
    height_m = np.full(count, day.mission.cruise_height_m + 24.0)
    reach = SortieFeasibility(
        drone, airframe, day.mission, day.forecast, route_energy_model_for_day(day, airframe), hills
    )
    ways = ObstacleRoutes(ObstacleMap((), 15.0, 8.0), ned_m[:, :2], 40.0)
    flat = SortieFeasibility(
        drone, airframe, day.mission, day.forecast, route_energy_model_for_day(day, airframe)
    )
    legs, level = (
        WindSortieModel(ned_m, payload_kg, height_m, [one], ways).leg_tables(0)
        for one in (reach, flat)
    )
    assert (legs.out_s >= level.out_s).all()
    assert (legs.out_s > level.out_s + 10.0).any()
    places = [tuple(row) for row in ned_m.tolist()]
    for i, j, k in product(range(count), repeat=3):
        if j in (i, k):
            continue
        asked = (float(payload_kg[j]), places[i], places[j], places[k], float(height_m[j]))
        table = legs.out_hover_s[i, j] + legs.back_hover_s[j, k] <= legs.endurance_hover_s
        assert reach.sortie_need_if_feasible(SortieGeometry(*asked)) is not None or not table, (
            i,
            j,
            k,
        )
        need = reach.sortie_need(SortieGeometry(*asked))
        if need.flyable:
            assert legs.out_s[i, j] + legs.back_s[j, k] == pytest.approx(need.time_s, rel=0.02)


def test_an_order_behind_the_ridge_is_refused_with_a_charge_that_does_on_level_ground():
    day, order = hilly_day(), order_at(0.0, 1500.0, 0.5)
    drone = day.drones[0]
    airframe = DAY.airframes[drone.airframe]
    customer = location_to_ground_ned_m(depot_frame(day.depot.location), order_location(order))
    level, ridge = (
        SortieFeasibility(
            drone,
            airframe,
            day.mission,
            day.forecast,
            route_energy_model_for_day(day, airframe),
            hills_of(day, elevation),
        )
        for elevation in (None, made())
    )
    told = [
        (
            level.check_delivery(0.5, customer, charge_frac=c),
            ridge.check_delivery(0.5, customer, charge_frac=c),
        )
        for c in np.linspace(0.2, 1.0, 33)
    ]
    assert any(isinstance(a, Feasible) and isinstance(b, Infeasible) for a, b in told)
    assert not any(isinstance(a, Infeasible) and isinstance(b, Feasible) for a, b in told)
