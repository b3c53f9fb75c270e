"""Air density: against the standard atmosphere's tables, and from a vehicle's telemetry."""

import math

import pytest

from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from companion.core.vehicle.air import (
    BOARD_HEATING_C,
    Air,
    air_from_best_available_source,
    standard_air,
    standard_pressure_pa,
)

M100 = read_airframe("m100")
HOT_AND_HIGH_PA = 70_109.0  # ISO 2533, table 5: 3,000 m


@pytest.mark.parametrize(
    ("alt_m", "pressure_pa", "temperature_c", "density"),
    [
        (0.0, 101_325.0, 15.0, 1.2250),
        (1000.0, 89_875.0, 8.5, 1.1116),
        (3000.0, 70_109.0, -4.5, 0.9091),
    ],
)
def test_nothing_measured_is_the_standard_atmosphere(alt_m, pressure_pa, temperature_c, density):
    # ISO 2533, tables 1 and 5.
    air = standard_air(alt_m)
    assert air.pressure_pa == pytest.approx(pressure_pa, rel=2e-4)
    assert air.temperature_c == pytest.approx(temperature_c, abs=0.01)
    assert air.density_kgpm3 == pytest.approx(density, rel=3e-4)


@pytest.mark.parametrize("alt_m", [-1_000.1, 11_000.1, 60_000.0, math.nan])
def test_a_height_at_which_nothing_flies_has_no_air(alt_m):
    with pytest.raises(LeewayError, match="height above sea"):
        air_from_best_available_source(alt_m, None, None, None)


def test_a_stated_temperature_goes_before_the_boards_and_with_the_measured_pressure():
    air = air_from_best_available_source(3000.0, HOT_AND_HIGH_PA - 900.0, 70.0, 40.0)
    # Ideal gas, R = 287.053 J/(kg K).
    assert air.density_kgpm3 == pytest.approx(69_209.0 / (287.053 * 313.15), rel=1e-5)


def test_the_air_is_cooler_than_the_board_that_the_barometer_sits_on():
    air = air_from_best_available_source(3000.0, HOT_AND_HIGH_PA, 40.0 + BOARD_HEATING_C, None)
    assert air.temperature_c == pytest.approx(40.0)
    assert air.density_kgpm3 == pytest.approx(0.780, abs=0.001)


@pytest.mark.parametrize("measured_pa", [701.09, 101_325.0, 0.0, -1.0, math.inf, math.nan])
def test_a_pressure_that_is_not_of_this_height_is_left_out(measured_pa):
    air = air_from_best_available_source(3000.0, measured_pa, 55.0, 40.0)
    assert air.pressure_pa == standard_pressure_pa(3000.0)


@pytest.mark.parametrize("board_c", [None, math.nan, math.inf, -90.0, 327.67])
def test_a_board_temperature_that_cannot_be_one_leaves_the_standard_atmospheres(board_c):
    assert air_from_best_available_source(
        1500.0, 84_560.0, board_c, None
    ).temperature_c == pytest.approx(5.25)


def test_the_words_say_density_and_where_it_is_from():
    assert str(Air(70_109.0, 40.0, "barometer, temperature stated")) == (
        "air 0.780 kg/m3: 701 hPa, 40 C (barometer, temperature stated)"
    )


def test_drag_goes_with_density_and_that_of_rotors_with_its_root():
    # Rotor drag goes with density times tip speed, tip speed with density^-1/2 at one thrust.
    mass_kg = M100.mass.empty_kg
    linear, quadratic = (
        M100.linear_drag_forward_right_n_per_mps(mass_kg, 0.784),
        M100.quadratic_drag_forward_right_n_per_mps2(mass_kg, 0.784),
    )
    assert linear[0] == pytest.approx(0.8 * M100.drag.linear_forward_n_per_mps)
    assert quadratic[1] == pytest.approx(0.64 * M100.drag.quadratic_right_n_per_mps2)


def test_air_too_thin_to_carry_the_parcel_is_said():
    # (3.65 + 1) kg at 35 degrees is 55.7 N; 0.0087 * rho * 4 pi 0.165^2 * 204^2 is that at 0.449.
    assert M100.overload_reason_or_empty(1.0, 0.46) == ""
    assert "needs 56 N of thrust" in M100.overload_reason_or_empty(1.0, 0.44)
    assert M100.overload_reason_or_empty(0.0, 0.44) == ""
