"""The paper's power model and the multirotor's, against closed forms."""

import math

import msgspec
import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import (
    GRAVITY_MPS2,
    drag_with_nose_into_wind_n,
    induced_velocity_mps,
    level_airspeed_at_max_tilt_mps,
    multirotor_power_w,
    paper_power_w,
    paper_thrust_n,
)

M100, OCTO8 = read_airframe("m100"), read_airframe("octo8")
MASS = M100.mass.empty_kg


def test_the_papers_power_is_its_equations_by_hand() -> None:
    # Equations 12 and 13 at 10 m/s, 5 degrees up.
    mass, drag, paper = M100.mass.empty_kg, M100.drag, M100.power_paper
    force = drag.linear_forward_n_per_mps * 10.0 + drag.quadratic_forward_n_per_mps2 * 100.0
    thrust = force + mass * 9.80665 * math.sin(math.radians(5.0))
    power = paper_power_w(M100, mass, 10.0, math.radians(5.0))
    assert power == pytest.approx(paper.constant_w + thrust * 10.0 / paper.thrust_power_coefficient)


def test_the_papers_thrust_is_never_negative() -> None:
    assert paper_thrust_n(M100, MASS, 5.0, math.radians(-60.0)) == 0.0
    assert paper_power_w(M100, MASS, 5.0, math.radians(-60.0)) == M100.power_paper.constant_w


@pytest.mark.parametrize(
    ("edgewise", "climb", "expected"),
    [
        (0.0, 0.0, lambda u, c: 5.0),  # momentum theory's, in hover
        # Leishman 2.86: v / v_h = -V_c / 2 v_h + sqrt((V_c / 2 v_h)^2 + 1).
        (0.0, np.array([1.0, 3.0, 8.0]), lambda u, c: -c / 2.0 + np.sqrt((c / 2.0) ** 2 + 25.0)),
        (  # Leishman 2.131 for a level disc: v^2 = -V^2 / 2 + sqrt(V^4 / 4 + v_h^4).
            np.array([0.5, 5.0, 15.0, 40.0]),
            0.0,
            lambda u, c: np.sqrt(-(u**2) / 2.0 + np.sqrt(u**4 / 4.0 + 5.0**4)),
        ),
    ],
    ids=["hover", "climb", "edgewise"],
)
def test_induced_velocity_is_the_closed_form(edgewise, climb, expected) -> None:
    found = induced_velocity_mps(5.0, edgewise, climb)
    np.testing.assert_allclose(found, expected(edgewise, climb), rtol=1e-7)


def test_hover_power_is_ideal_power_over_its_losses() -> None:
    # T^1.5 / sqrt(2 rho A) is the ideal; the induced factor, profile and drive come on top.
    weight = MASS * GRAVITY_MPS2
    ideal = weight**1.5 / math.sqrt(2.0 * 1.225 * M100.power_rotor.disc_area_m2)
    power = float(multirotor_power_w(M100, MASS, 0.0))
    rotor = M100.power_rotor
    profile = rotor.solidity * rotor.blade_drag_coefficient / 8.0
    tip = math.sqrt(weight / (rotor.thrust_coefficient * 1.225 * rotor.disc_area_m2))
    shaft = rotor.induced_factor * ideal + profile * 1.225 * rotor.disc_area_m2 * tip**3
    assert power == pytest.approx(shaft / rotor.drive_efficiency + rotor.avionics_w, rel=1e-9)


def test_climbing_costs_at_least_the_potential_energy_less_the_inflow_it_saves() -> None:
    level = float(multirotor_power_w(M100, MASS, 0.0))
    climb = float(multirotor_power_w(M100, MASS, 0.0, 3.0))
    potential = MASS * GRAVITY_MPS2 * 3.0 / M100.power_rotor.drive_efficiency
    assert 0.3 * potential < climb - level < potential
    assert float(multirotor_power_w(M100, MASS, 0.0, -3.0)) == level


def along_the_bodys_axes(vertical: float | None, **drag: float) -> Airframe:
    """An octocopter of round numbers: 10 kg empty, rotors of 1.3 m^2, blades without drag."""
    changed = msgspec.structs.replace
    none = {"linear_forward_n_per_mps": 0.0, "quadratic_forward_n_per_mps2": 0.0}
    own = changed(OCTO8.drag, **(none | drag), vertical_quadratic_n_per_mps2=vertical)
    rotor = changed(
        OCTO8.power_rotor, blade_drag_coefficient=0.0, drive_efficiency=1.0, avionics_w=0.0
    )
    return changed(OCTO8, drag=own, power_rotor=rotor)


def induced_w(airframe: Airframe, thrust_n: float, edgewise: float, through: float) -> float:
    area = 1.225 * airframe.power_rotor.disc_area_m2
    velocity = induced_velocity_mps(math.sqrt(thrust_n / (2.0 * area)), edgewise, through)
    return airframe.power_rotor.induced_factor * thrust_n * float(velocity)


def test_a_climb_against_drag_from_above_pays_it_in_thrust_and_in_work() -> None:
    # Straight up at 5 m/s: T = m g + k V^2, plus T V on top of the induced power.
    vehicle = along_the_bodys_axes(0.2, quadratic_forward_n_per_mps2=0.1)
    thrust = 10.0 * GRAVITY_MPS2 + 0.2 * 25.0
    expected = induced_w(vehicle, thrust, 0.0, 5.0) + thrust * 5.0
    assert float(multirotor_power_w(vehicle, 10.0, 0.0, 5.0)) == pytest.approx(expected)


def test_rotors_own_drag_leans_the_vehicle_and_does_no_work_of_its_own() -> None:
    # 2 N per m/s at 10 m/s: tan(tilt) = 20 N / m g, T = m g cos(tilt), nothing but induced power.
    vehicle = along_the_bodys_axes(0.0, linear_forward_n_per_mps=2.0)
    mass = OCTO8.mass.empty_kg
    weight = mass * GRAVITY_MPS2
    tilt = math.atan(20.0 / weight)
    expected = induced_w(
        vehicle, weight * math.cos(tilt), 10.0 * math.cos(tilt), 10.0 * math.sin(tilt)
    )
    assert float(multirotor_power_w(vehicle, mass, 10.0)) == pytest.approx(expected)


def test_parasite_power_along_the_bodys_axes_is_thrust_times_the_way_through_the_air() -> None:
    # Level at 15 m/s, two drags, solved here by bisection on the balance of forces along the
    # horizontal and the vertical; the work is that of thrust, all of it parasite.
    vehicle = along_the_bodys_axes(0.25, quadratic_forward_n_per_mps2=0.1)
    mass, speed = OCTO8.mass.empty_kg, 15.0
    low, high = 0.0, 1.5
    thrust = 0.0
    for _ in range(60):
        tilt = 0.5 * (low + high)
        front = 0.1 * speed * speed * math.cos(tilt)  # backward along the body
        top = 0.25 * speed * speed * math.sin(tilt)  # downward along the body
        thrust = (mass * GRAVITY_MPS2 - front * math.sin(tilt) + top * math.cos(tilt)) / math.cos(
            tilt
        )
        pulled = (thrust - top) * math.sin(tilt) - front * math.cos(tilt)
        low, high = (tilt, high) if pulled < 0.0 else (low, tilt)
    work = thrust * math.sin(tilt) * speed
    expected = work + induced_w(vehicle, thrust, speed * math.cos(tilt), speed * math.sin(tilt))
    assert float(multirotor_power_w(vehicle, mass, speed)) == pytest.approx(expected, rel=1e-6)


def test_hover_in_still_air_does_not_feel_drag_from_above() -> None:
    drag = msgspec.structs.replace(M100.drag, vertical_quadratic_n_per_mps2=0.1)
    vehicle = msgspec.structs.replace(M100, drag=drag)
    assert multirotor_power_w(vehicle, MASS, 0.0) == multirotor_power_w(M100, MASS, 0.0)


def test_top_speed_balances_drag_and_tilt() -> None:
    for payload in (0.0, 1.0):
        mass = M100.flying_mass_kg(payload)
        speed = level_airspeed_at_max_tilt_mps(M100, mass)
        force = mass * GRAVITY_MPS2 * math.tan(math.radians(35.0))
        assert float(drag_with_nose_into_wind_n(M100, mass, speed)) == pytest.approx(force)


def test_a_hover_costs_the_inverse_root_of_density_more_in_thin_air() -> None:
    # Momentum theory and C_T, C_P of a rotor: induced and profile power both go with rho^-1/2.
    thick, thin = (float(multirotor_power_w(M100, MASS, 0.0, 0.0, rho)) for rho in (1.2, 0.8))
    avionics = M100.power_rotor.avionics_w
    assert thin > thick
    assert (thin - avionics) / (thick - avionics) == pytest.approx(math.sqrt(1.2 / 0.8))


def test_top_speed_grows_in_thin_air_and_drag_there_balances_the_same_tilt() -> None:
    thick, thin = (level_airspeed_at_max_tilt_mps(M100, MASS, rho) for rho in (1.225, 0.8))
    # Drag all quadratic, or all linear, would make it (1.225 / 0.8)^1/2 = 1.24 times as fast.
    assert 1.2 < thin / thick < 1.24
    force = MASS * GRAVITY_MPS2 * math.tan(math.radians(35.0))
    assert float(drag_with_nose_into_wind_n(M100, MASS, thin, 0.8)) == pytest.approx(force)
