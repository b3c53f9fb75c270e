"""The pack as a source of power, against Ohm's law and the simulator's own pack."""

import math

import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from companion.core.vehicle.pack_model import (
    PEAK_FRAC,
    LoadedVoltage,
    PackPower,
    ResistanceEstimator,
    resistance_ratio,
)
from sim_bridge.truth.battery import Battery
from tests.sim_bridge.truth.test_battery import M100 as TRUTH

PACK = read_airframe("m100").battery
CUTOFF_V = PACK.cells * PACK.cutoff_cell_v


def power(ohm: float, charge: float = 0.6, std_log: float = 0.0) -> PackPower:
    return PackPower(PACK, ohm, std_log, charge, 100.0 * charge, 125.0)


@pytest.mark.parametrize("charge", [0.2, 0.5, 1.0])
def test_the_most_power_is_that_at_the_cut_off_voltage_by_ohms_law(charge: float) -> None:
    power_w = power(0.05).max_power_w(charge)
    current_a = power_w / CUTOFF_V
    open_v = PACK.cells * PACK.resting_cell_voltage_v(charge)
    assert open_v - current_a * 0.05 == pytest.approx(CUTOFF_V)
    assert power(0.05, std_log=0.2).max_power_w(charge, sigmas=1.0) < power_w


@pytest.mark.parametrize("ohm", [0.03, 0.09])
@pytest.mark.parametrize("mean_power_w", [350.0, 500.0, 700.0])
def test_below_the_unusable_energy_the_pack_cannot_give_the_power(ohm, mean_power_w) -> None:
    pack = power(ohm)
    floor_wh = float(pack.unusable_energy_wh(np.array([[mean_power_w]]), np.zeros(1))[0, 0])
    charge = pack.charge_frac - (pack.energy_wh - floor_wh) / pack.wh_per_charge
    peak_w = PEAK_FRAC * mean_power_w
    assert pack.max_power_w(charge - 0.02) < peak_w < pack.max_power_w(charge + 0.02)


def test_a_cold_pack_bears_the_gusts_of_a_flight_at_its_sustained_power() -> None:
    """Draw over the model's as flown against 13 m/s: mean 1.15, peaks of 1.3 for 1.3 s."""
    truth = Battery(TRUTH.battery, charge_frac=0.5, temperature_c=-10.0)
    modelled_w = power(0.079, charge=0.48).sustained_power_w
    for step in range(4000):
        gust = 1.3 if step % 1000 > 870 else 1.13
        truth.discharge_at_power(gust * modelled_w, 0.01)
    assert not truth.cut_off


def test_a_pack_that_cannot_supply_a_hover_even_at_its_best_says_so() -> None:
    doubted = power(0.2, charge=0.3, std_log=0.3)
    most_w = doubted.max_power_w(sigmas=-1.0)
    assert doubted.max_power_w() < 0.9 * most_w
    assert doubted.power_shortage_or_empty(0.99 * most_w) == ""
    assert f"at most {most_w:.0f} W" in doubted.power_shortage_or_empty(1.01 * most_w)


def test_cold_doubles_resistance_as_measured_and_a_doubtful_pack_needs_more() -> None:
    # rcex.cz, 2010: 1.1e-6 exp(3131 / T) ohm at 273 and 293 K.
    assert resistance_ratio(PACK, 0.0) == pytest.approx(math.exp(3131 / 273.15 - 3131 / 293.15))
    need = power(0.05, std_log=0.2).unusable_energy_wh(np.array([[600.0]]), np.array([-2.0, 2.0]))
    assert need[0, 0] < need[0, 1]


def identified(
    temperature_c: float,
    health_frac: float = 1.0,
    *,
    is_temperature_reported: bool = True,
    has_sag: bool = True,
) -> tuple[float, float, float]:
    """Return resistance, its std (log) and the true one after 60 s of a simulated discharge."""
    cell = Battery(
        TRUTH.battery, charge_frac=0.8, temperature_c=temperature_c, health_frac=health_frac
    )
    rest_v, estimator = cell.voltage_v, ResistanceEstimator(PACK, 20.0)
    if is_temperature_reported:
        estimator.update_temperature(temperature_c)
    start_v = PACK.cells * PACK.resting_cell_voltage_v(0.8)
    for step in range(600):
        cell.discharge_at_power(500.0 + 100.0 * (step // 100 % 2), 0.1)
        if step % 2 == 0:
            drop_v = start_v - PACK.cells * PACK.resting_cell_voltage_v(cell.charge_frac)
            voltage_v = cell.voltage_v if has_sag else rest_v
            sample = LoadedVoltage(
                0.1 * step, voltage_v, cell.current_a, 0.05, rest_v - drop_v, drop_v
            )
            estimator.update_from_sample(sample)
    cold = math.exp(2250.0 * (1.0 / (temperature_c + 273.15) - 1.0 / 298.15))
    true_ohm = (TRUTH.battery.resistance_ohm + TRUTH.battery.polarisation_ohm) * cold
    return *estimator.resistance_ohm_and_std_log(), true_ohm * (1.0 + 5.0 * (1.0 - health_frac))


@pytest.mark.parametrize("is_temperature_reported", [True, False])
@pytest.mark.parametrize(("temperature_c", "health"), [(25.0, 1.0), (-10.0, 1.0), (20.0, 0.8)])
def test_resistance_is_identified_within_its_doubt(temperature_c, health, is_temperature_reported):
    ohm, std_log, true_ohm = identified(
        temperature_c, health, is_temperature_reported=is_temperature_reported
    )
    assert std_log < 0.1
    assert abs(math.log(ohm / true_ohm)) < 3.0 * std_log


def test_a_voltage_without_sag_leaves_the_prior_which_is_wider_without_a_temperature() -> None:
    known = identified(20.0, has_sag=False)
    unknown = identified(20.0, is_temperature_reported=False, has_sag=False)
    assert known[0] == unknown[0] == PACK.resistance_ohm
    assert known[1] < 0.5 * unknown[1]


def test_a_checkpoint_is_restored_and_a_damaged_one_refused() -> None:
    estimator, other = ResistanceEstimator(PACK, 20.0), ResistanceEstimator(PACK, 20.0)
    estimator.update_temperature(-10.0)
    other.restore(estimator.snapshot())
    assert other.resistance_ohm_and_std_log() == estimator.resistance_ohm_and_std_log()
    for damage in ({"variance": -1.0}, {"log_ratio": math.nan}, {"variance": "wide"}):
        with pytest.raises(LeewayError):
            other.restore(estimator.snapshot() | damage)
