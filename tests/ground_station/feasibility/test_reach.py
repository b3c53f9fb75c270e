"""Orders that a drone can deliver, and changes that would make an order feasible."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.base.geo import Ned
from companion.core.mission.flight_file import Mission
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.airframe import Airframe
from ground_station.adapters.files.params import read_airframe
from ground_station.core.feasibility.reach import (
    DISTANCE_TOLERANCE_M,
    Feasible,
    Infeasible,
    SortieFeasibility,
    find_max_feasible_distance_m,
    route_energy_model_for_day,
)
from ground_station.core.schema.day import Day, Depot, Drone, Forecast


@pytest.fixture(scope="module")
def m100() -> Airframe:
    return read_airframe("m100", Path())


def a_reach(m100: Airframe, charge: float = 1.0, **wind: float) -> SortieFeasibility:
    drone = Drone(id="d1", airframe="m100", charge_frac=charge)
    return SortieFeasibility(drone, m100, Mission(), Forecast(**wind), RouteEnergy(m100))


def at(north_m: float, east_m: float = 0.0) -> Ned:
    return (north_m, east_m, 0.0)


def test_reach_shrinks_with_wind_load_and_an_emptier_battery(m100):
    def spare(reach: SortieFeasibility, payload_kg: float = 0.5) -> float:
        found = reach.check_delivery(payload_kg, at(800.0))
        assert isinstance(found, Feasible)
        return found.spare_wh

    calm = spare(a_reach(m100))
    assert spare(a_reach(m100, speed_mps=7.0)) < calm
    assert spare(a_reach(m100), payload_kg=1.0) < calm
    assert spare(a_reach(m100, charge=0.8)) < calm


def test_an_order_out_of_reach_says_what_would_make_it_possible(m100):
    far = a_reach(m100).check_delivery(0.5, at(20_000.0))
    assert isinstance(far, Infeasible)
    assert "Wh short" in far.reason
    radius_m = float(far.remedy.split("within ")[1].split(" m")[0])
    stop = at(20_000.0 - radius_m + 1.0)
    assert isinstance(a_reach(m100).check_delivery(0.5, at(20_000.0), stop, stop), Feasible)
    beyond = at(20_000.0 - radius_m - 50.0)
    assert isinstance(a_reach(m100).check_delivery(0.5, at(20_000.0), beyond, beyond), Infeasible)
    heavy = a_reach(m100).check_delivery(50.0, at(100.0))
    assert isinstance(heavy, Infeasible)
    assert "the truck" in heavy.remedy
    low = a_reach(m100, charge=0.25).check_delivery(0.5, at(1000.0))
    assert isinstance(low, Infeasible)
    assert low.remedy == "a full battery"
    storm = a_reach(m100, speed_mps=35.0).check_delivery(0.5, at(500.0))
    assert isinstance(storm, Infeasible)


@pytest.mark.parametrize(("stated_c", "density"), [(40.0, 0.780), (None, 0.909)])
def test_the_desk_prices_in_the_air_of_its_depot(m100, stated_c, density):
    # ISO 2533 at 3,000 m: 701.1 hPa, and 268.65 K if no temperature is forecast.
    depot = Depot(lat_deg=46.0, lon_deg=8.0, alt_amsl_m=3000.0)
    day = Day(
        format="day/1",
        depot=depot,
        drones=[Drone(id="d1", airframe="m100")],
        forecast=Forecast(air_temperature_c=stated_c),
    )
    energy = route_energy_model_for_day(day, m100)
    assert energy.density_kgpm3 == pytest.approx(density, abs=0.001)
    assert energy.hover_power_w(0.0) > 1.1 * RouteEnergy(m100).hover_power_w(0.0)


def test_a_parcel_that_thin_air_does_not_carry_is_refused_with_its_reason(m100):
    drone = Drone(id="d1", airframe="m100")
    reach = SortieFeasibility(drone, m100, Mission(), Forecast(), RouteEnergy(m100, 0.44))
    found = reach.check_delivery(1.0, at(200.0))
    assert isinstance(found, Infeasible)
    assert "in air of 0.44 kg/m3" in found.reason
    assert not reach.can_lift(1.0)


@given(
    zero=st.floats(0.5, 4999.0),
    bend=st.floats(0.0, 3.0),
    wall=st.floats(1.0, 1.5),
)
def test_the_last_place_that_fits_is_found_within_a_metre_and_few_tries(zero, bend, wall):
    """Closed form, for curved functions and with a limit beyond which no flight is possible."""
    tries = 0

    def spare(metres: float) -> float:
        nonlocal tries
        tries += 1
        if metres > wall * zero:
            return -math.inf
        return (zero - metres) * (1.0 + bend * metres / 5000.0)

    found = find_max_feasible_distance_m(spare, 5000.0)
    assert zero - DISTANCE_TOLERANCE_M <= found <= zero
    assert tries <= 26  # bisection alone, in both phases: 2 log2(5000)
