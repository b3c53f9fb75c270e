"""Invariants of rotors and battery for any numbers."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_bridge.truth.battery import Battery, open_circuit_cell_v
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.rotor_power import RotorSet, induced_velocity_ratio
from sim_bridge.truth.steady_flight import SteadyFlight

M100 = load_airframe(Path(__file__).parents[2] / "params" / "truth" / "m100.toml")
ROTORS = RotorSet(M100.rotors, 1.225)
FLIGHT = SteadyFlight(M100)


@given(st.floats(-8.0, 8.0), st.floats(0.0, 8.0))
def test_inflow_solves_the_momentum_equation_outside_the_ring(descent, inplane) -> None:
    """x sqrt(mu^2 + (x - d)^2) = 1, and x between 0 and what a ring can hold."""
    x = induced_velocity_ratio(descent, inplane)
    assert 0.0 < x < 2.3
    if 1.5 * inplane**2 + (2 * descent - 3) ** 2 >= 1.0:
        # 2.5e-2: near its double root, at axial descent of 2 v_h, the equation is flat
        assert x * math.hypot(inplane, x - descent) == pytest.approx(1.0, abs=2.5e-2)


@given(st.floats(0.0, 80.0), st.floats(0.0, 30.0), st.floats(-1.0, 1.0))
def test_rotors_never_charge_the_battery(thrust_n, airspeed, along) -> None:
    power_w = ROTORS.electrical_power_w(thrust_n, airspeed, along * thrust_n * airspeed)
    assert power_w >= M100.rotors.avionics_w
    assert math.isfinite(power_w)


@given(st.floats(0.0, 20.0), st.floats(0.0, 0.9), st.floats(0.05, 0.1))
def test_a_heavier_vehicle_needs_more_power_at_any_speed(airspeed, payload_kg, more_kg) -> None:
    lighter = FLIGHT.level_flight_power_w(airspeed, max(payload_kg, 1e-6))
    assert FLIGHT.level_flight_power_w(airspeed, payload_kg + more_kg) > lighter


@given(st.floats(0.0, 20.0), st.floats(0.1, 5.0))
def test_climbing_costs_more_than_level_flight(airspeed, climb) -> None:
    climbing = FLIGHT.steady_state(airspeed, climb_mps=climb).power_w
    assert climbing > FLIGHT.level_flight_power_w(airspeed)


@given(st.floats(0.0, 0.99), st.floats(0.001, 0.01))
def test_resting_voltage_rises_with_charge(charge, more) -> None:
    assert open_circuit_cell_v(charge + more) > open_circuit_cell_v(charge)


@given(
    st.floats(0.05, 1.0),
    st.floats(50.0, 900.0),
    st.floats(1.0, 400.0),
    st.floats(-15.0, 45.0),
    st.floats(0.6, 1.0),
)
def test_a_harder_draw_never_gets_more_out(charge, draw_w, more_w, temperature_c, health) -> None:
    battery = Battery(
        M100.battery, charge_frac=charge, temperature_c=temperature_c, health_frac=health
    )
    usable_wh = battery.usable_wh(draw_w)
    assert 0.0 <= battery.usable_wh(draw_w + more_w) <= usable_wh + 1e-6
    # resting voltage falls with charge, so charge times voltage now bounds what is left
    assert usable_wh <= battery.voltage_v * 5.7 * charge * health + 1e-6


@given(st.lists(st.tuples(st.floats(0.0, 1500.0), st.floats(0.01, 20.0)), max_size=30))
def test_charge_only_falls_and_energy_is_conserved(draws) -> None:
    battery = Battery(M100.battery, charge_frac=0.5)
    for power_w, seconds in draws:
        before = battery.charge_frac
        for _ in range(20):
            battery.discharge_at_power(power_w, seconds / 20)
        assert battery.charge_frac <= before
    parts_j = battery.delivered_j + battery.lost_j + battery.polarisation_energy_j
    assert battery.chemical_j == pytest.approx(parts_j, rel=2e-3, abs=1e-6)
