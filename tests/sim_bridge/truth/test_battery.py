"""The pack against closed forms, its label, and conservation of energy."""

import math
from pathlib import Path

import msgspec
import pytest

from sim_bridge.truth.battery import Battery, open_circuit_cell_v
from sim_bridge.truth.params import load_airframe

M100 = load_airframe(Path(__file__).parents[3] / "params" / "truth" / "m100.toml")
PACK = M100.battery
IDEAL = msgspec.structs.replace(
    PACK, resistance_ohm=0.0, polarisation_ohm=0.0, cutoff_cell_v=2.66, cutoff_delay_s=0.0
)
# Integral over charge of Chen and Rincon-Mora's eq. 2, by hand
CURVE_MEAN_V = 3.685 + 0.2156 / 2 - 0.1178 / 3 + 0.3201 / 4 - 1.031 / 35 * (1 - math.exp(-35))


def test_open_circuit_voltage_is_the_published_curve() -> None:
    """Chen and Rincon-Mora (2006), eq. 2, at full, half and no charge."""
    assert open_circuit_cell_v(1.0) == pytest.approx(4.1029, abs=1e-4)
    assert open_circuit_cell_v(0.5) == pytest.approx(3.8034, abs=1e-3)
    assert open_circuit_cell_v(0.0) == pytest.approx(2.654, abs=1e-3)


def test_full_pack_holds_what_its_label_says() -> None:
    """DJI TB48D: 129.96 Wh on the label, which is measured under load: at rest 2 to 3 % more.

    The mean of the curve is Chen and Rincon-Mora's plus a third of the rise to 4.35 V.
    """
    mean_v = CURVE_MEAN_V + (4.35 - 4.1029) / 3.0
    assert pytest.approx(129.96 * 1.02, rel=0.01) == 6 * 5.7 * mean_v
    assert Battery(IDEAL).usable_wh(0.0) == pytest.approx(6 * 5.7 * mean_v, rel=0.002)


def test_a_full_pack_rests_at_its_data_sheets_voltage() -> None:
    """DJI TB48D: 26.1 V fully charged."""
    assert Battery(PACK).voltage_v == pytest.approx(26.1, abs=0.01)


def test_terminal_voltage_is_ohms_law() -> None:
    """V = E - I R with V I = P, at the first instant (no polarisation yet)."""
    battery = Battery(PACK)
    battery.discharge_at_power(500.0, 1e-6)
    source_v = 26.1  # DJI TB48D, fully charged
    ohm = PACK.resistance_ohm * (1 + 0.1562 / 0.07446 * math.exp(-24.37))
    assert battery.voltage_v * battery.current_a == pytest.approx(500.0, rel=1e-9)
    assert battery.voltage_v == pytest.approx(source_v - battery.current_a * ohm, rel=1e-9)


def test_chemical_energy_is_delivered_lost_or_stored() -> None:
    """Conservation through a varying draw, to 0.01 % of what flowed."""
    battery = Battery(PACK, temperature_c=5.0, health_frac=0.9)
    for step in range(40_000):
        battery.discharge_at_power(450.0 + 400.0 * math.sin(step * 0.003), 0.01)
    parts_j = battery.delivered_j + battery.lost_j + battery.polarisation_energy_j
    assert battery.chemical_j == pytest.approx(parts_j, rel=1e-4)
    assert battery.lost_j > 0.01 * battery.delivered_j


def test_charge_falls_by_what_flows() -> None:
    """Coulomb count: 10 A through 5.7 Ah for 6 minutes is 1.0 / 5.7 of it."""
    battery = Battery(IDEAL)
    used_c = 0.0
    for _ in range(36_000):
        battery.discharge_at_power(10.0 * battery.voltage_v, 0.01)
        used_c += battery.current_a * 0.01
    assert 1.0 - battery.charge_frac == pytest.approx(used_c / (5.7 * 3600), rel=1e-6)
    assert 1.0 - battery.charge_frac == pytest.approx(1.0 / 5.7, rel=0.01)


@pytest.mark.parametrize(
    ("draw_w", "temperature_c", "health_frac"), [(300, 25, 1.0), (600, 25, 1.0), (480, 0, 0.9)]
)
def test_usable_energy_is_what_a_constant_draw_then_delivers(
    draw_w: float, temperature_c: float, health_frac: float
) -> None:
    """Stepped to cut-off; within 1.5 % (a rested pack starts without polarisation)."""
    battery = Battery(PACK, temperature_c=temperature_c, health_frac=health_frac)
    promised_wh = battery.usable_wh(draw_w)
    while not battery.cut_off:
        battery.discharge_at_power(draw_w, 0.1)
    assert battery.delivered_j / 3600 == pytest.approx(promised_wh, rel=0.015)
    assert battery.usable_wh(draw_w) == 0.0


def test_usable_energy_falls_by_what_is_used() -> None:
    """Half-way down at the same draw, used plus remaining equals the initial energy, to 1 %."""
    battery = Battery(PACK)
    promised_wh = battery.usable_wh(480.0)
    for _ in range(4000):
        battery.discharge_at_power(480.0, 0.1)
    left_wh = battery.usable_wh(480.0)
    assert battery.delivered_j / 3600 + left_wh == pytest.approx(promised_wh, rel=0.01)


def test_cold_and_age_take_resistance_as_stated() -> None:
    """The shipped numbers: doubled at 0 deg C, doubled again at 0.8 of capacity."""
    sag_v = {}
    for key, temperature_c, health in (("new", 25, 1.0), ("cold", 0, 1.0), ("old", 25, 0.8)):
        battery = Battery(PACK, temperature_c=temperature_c, health_frac=health)
        rest_v = battery.voltage_v
        battery.discharge_at_power(100.0, 1e-6)
        sag_v[key] = (rest_v - battery.voltage_v) / battery.current_a
    assert sag_v["cold"] / sag_v["new"] == pytest.approx(2.0, rel=0.02)
    assert sag_v["old"] / sag_v["new"] == pytest.approx(2.0, rel=0.02)


def test_after_cut_off_nothing_flows_though_voltage_recovers() -> None:
    battery = Battery(PACK, charge_frac=0.03)
    for _ in range(10_000):
        battery.discharge_at_power(700.0, 0.01)
    assert battery.cut_off
    before_j = battery.delivered_j
    battery.discharge_at_power(700.0, 0.01)
    assert battery.current_a == 0.0
    assert battery.delivered_j == before_j
    assert battery.voltage_v > 6 * 2.5


def test_a_short_dip_does_not_trip_the_protection() -> None:
    battery = Battery(PACK, charge_frac=0.06)
    battery.discharge_at_power(1500.0, 0.5)
    battery.discharge_at_power(100.0, 0.5)
    battery.discharge_at_power(1500.0, 0.5)
    assert not battery.cut_off


def test_a_draw_beyond_the_packs_power_collapses_it() -> None:
    """P_max = E^2 / 4 R (maximum power transfer)."""
    battery = Battery(PACK)
    battery.discharge_at_power(1e5, 0.01)
    assert battery.voltage_v == pytest.approx(26.1 / 2, rel=1e-6)
    for _ in range(120):
        battery.discharge_at_power(1e5, 0.01)
    assert battery.cut_off


def test_a_shorted_cell_takes_its_share_of_voltage_and_energy_and_no_more() -> None:
    whole, hurt = Battery(PACK), Battery(PACK)
    hurt.short_one_cell()
    left = (PACK.cells - 1) / PACK.cells
    assert hurt.settled_loaded_voltage_v(0.8, 0.0) == pytest.approx(
        left * whole.settled_loaded_voltage_v(0.8, 0.0)
    )
    hurt.discharge_at_power(100.0, 1.0)
    assert not hurt.cut_off
    assert 0.75 * left < hurt.usable_wh(300.0) / whole.usable_wh(300.0) < left
