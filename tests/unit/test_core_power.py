"""Row 3: the paper's power model and the multirotor's, against closed forms."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from companion.core.airframe import Airframe, airframe_from_dict
from companion.core.power import (
    GRAVITY_MPS2,
    air_density_kgpm3,
    drag_n,
    induced_velocity_mps,
    max_airspeed_mps,
    multirotor_power_w,
    paper_power_w,
    paper_thrust_n,
)

ROOT = Path(__file__).parents[2]


def airframe(name: str) -> Airframe:
    return airframe_from_dict(
        tomllib.loads((ROOT / "params" / "airframes" / f"{name}.toml").read_text())
    )


M100, OCTO8 = airframe("m100"), airframe("octo8")
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


def test_the_papers_level_power_hardly_feels_payload_and_the_multirotors_does() -> None:
    paper = [float(paper_power_w(OCTO8, OCTO8.mass_kg(kg), 15.0)) for kg in (0.0, 8.0)]
    rotor = [float(multirotor_power_w(OCTO8, OCTO8.mass_kg(kg), 15.0)) for kg in (0.0, 8.0)]
    assert paper[1] / paper[0] < 1.15
    assert rotor[1] / rotor[0] > 1.5


def test_induced_velocity_in_hover_is_the_momentum_theorys() -> None:
    assert induced_velocity_mps(5.3, 0.0, 0.0) == pytest.approx(5.3)


def test_induced_velocity_in_climb_is_the_closed_form() -> None:
    # Leishman 2.86: v / v_h = -V_c / 2 v_h + sqrt((V_c / 2 v_h)^2 + 1).
    climb = np.array([1.0, 3.0, 8.0])
    expected = -climb / 2.0 + np.sqrt((climb / 2.0) ** 2 + 5.0**2)
    np.testing.assert_allclose(induced_velocity_mps(5.0, 0.0, climb), expected, rtol=1e-9)


def test_induced_velocity_edgewise_is_the_closed_form() -> None:
    # Leishman 2.131 for a level disc: v^2 = -V^2 / 2 + sqrt(V^4 / 4 + v_h^4).
    speed = np.array([0.5, 5.0, 15.0, 40.0])
    expected = np.sqrt(-(speed**2) / 2.0 + np.sqrt(speed**4 / 4.0 + 5.0**4))
    np.testing.assert_allclose(induced_velocity_mps(5.0, speed, 0.0), expected, rtol=1e-7)


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


@pytest.mark.parametrize("payload_kg", [0.0, 8.0])
def test_energy_per_km_of_the_octocopter_is_u_shaped(payload_kg: float) -> None:
    speed = np.arange(2.0, 30.0, 0.5)
    per_km = multirotor_power_w(OCTO8, OCTO8.mass_kg(payload_kg), speed) / (3.6 * speed)
    best = int(np.argmin(per_km))
    assert 0 < best < speed.size - 1
    assert np.all(np.diff(per_km[: best + 1]) < 0.0)
    assert np.all(np.diff(per_km[best:]) > 0.0)


def test_the_best_speed_rises_with_payload_and_in_headwind_falls_over_ground() -> None:
    # evaluation.md 5: "U-shaped; the best speed rises with payload and with headwind falls in
    # ground terms".
    speed = np.arange(2.0, 30.0, 0.1)

    def best_airspeed(payload_kg: float, headwind: float) -> float:
        power = multirotor_power_w(OCTO8, OCTO8.mass_kg(payload_kg), speed)
        ground = speed - headwind
        per_m = np.where(ground > 0.1, power / np.maximum(ground, 0.1), np.inf)
        return float(speed[np.argmin(per_m)])

    assert best_airspeed(8.0, 0.0) > best_airspeed(0.0, 0.0) + 2.0
    assert best_airspeed(0.0, 6.0) > best_airspeed(0.0, 0.0)
    assert best_airspeed(0.0, 6.0) - 6.0 < best_airspeed(0.0, 0.0)


def test_top_speed_balances_drag_and_tilt() -> None:
    for payload in (0.0, 1.0):
        mass = M100.mass_kg(payload)
        speed = max_airspeed_mps(M100, mass)
        force = mass * GRAVITY_MPS2 * math.tan(math.radians(35.0))
        assert float(drag_n(M100, mass, speed)) == pytest.approx(force)


def test_air_density_is_the_standard_atmospheres() -> None:
    # ISO 2533: 1.225 kg/m^3 at sea level and 15 degrees; 1.112 at 1,000 m and 8.5 degrees.
    assert air_density_kgpm3(0.0, 15.0) == pytest.approx(1.225, abs=0.001)
    assert air_density_kgpm3(1000.0, 8.5) == pytest.approx(1.112, abs=0.001)


def test_thin_air_costs_more() -> None:
    assert float(multirotor_power_w(M100, MASS, 0.0, 0.0, 1.0)) > float(
        multirotor_power_w(M100, MASS, 0.0, 0.0, 1.225)
    )
