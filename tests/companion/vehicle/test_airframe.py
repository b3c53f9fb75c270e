"""airframe/1: strict, and the shipped files hold what their sources say."""

import copy
import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe, airframe_from_dict
from companion.core.vehicle.energy_ledger import charge_frac_at_loaded_cutoff_voltage
from companion.core.vehicle.power import level_airspeed_at_max_tilt_mps, multirotor_power_w

ROOT = Path(__file__).parents[3]
SHIPPED = sorted((ROOT / "params" / "airframes").glob("*.toml"))
MEASURED = ROOT.parent / "shared" / "data" / "energy" / "measured_power.csv"


def table(name: str) -> dict:
    return tomllib.loads((ROOT / "params" / "airframes" / f"{name}.toml").read_text())


def airframe(name: str) -> Airframe:
    return airframe_from_dict(table(name), name)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_every_shipped_airframe_loads_under_its_own_name(path: Path) -> None:
    assert airframe_from_dict(tomllib.loads(path.read_text()), path.name).name == path.stem


def test_an_unknown_key_is_refused_by_name() -> None:
    broken = table("m100")
    broken["drag"]["linear_forwards_n_per_mps"] = 0.2
    with pytest.raises(LeewayError, match=r"m100\.toml: .*linear_forwards_n_per_mps"):
        airframe_from_dict(broken, "m100.toml")


def test_a_missing_key_is_refused_by_name() -> None:
    broken = table("m100")
    del broken["battery"]["cells"]
    with pytest.raises(LeewayError, match="cells"):
        airframe_from_dict(broken)


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("mass", "empty_kg", 0.0),
        ("mass", "empty_kg", float("nan")),
        ("speeds", "max_tilt_deg", 80.0),
        ("drag", "gain_std_frac", 0.0),
        ("drag", "vertical_quadratic_n_per_mps2", -0.1),
        ("power_rotor", "drive_efficiency", 1.2),
        ("power_paper", "thrust_power_coefficient", float("inf")),
        ("battery", "usable_frac", 1.4),
        ("battery", "ocv_cell_v", [3.3, 3.2]),
        ("battery", "ocv_charge_frac", [0.1, 1.0]),
        ("battery", "usable_temperature_frac", [0.5]),
    ],
)
def test_a_number_out_of_range_is_refused_by_key(section: str, key: str, value: object) -> None:
    broken = copy.deepcopy(table("m100"))
    broken[section][key] = value
    with pytest.raises(LeewayError, match=key):
        airframe_from_dict(broken)


def test_ten_times_the_mass_on_the_same_rotors_is_refused_with_thrust_needed_and_given() -> None:
    heavy = table("m100")
    heavy["mass"]["empty_kg"] = 36.5
    # (36.5 + 1) kg * 9.80665 / cos 35 deg = 449 N; 0.0087 * 1.225 * 4 pi 0.165^2 * 204^2 = 152 N.
    words = r"heavy\.toml: mass\.empty_kg = 36\.5 .*needs 449 N .*expected at most 152 N"
    with pytest.raises(LeewayError, match=words):
        airframe_from_dict(heavy, "heavy.toml")


def test_a_pack_that_cannot_carry_the_hover_is_refused_with_both_powers() -> None:
    weak = table("m100")
    weak["battery"]["resistance_ohm"] = 1.0
    # 19.8 V * (26.1 - 19.8) V / 1 ohm = 125 W; 1.396 / 0.892 of momentum theory's 234 W = 366 W.
    with pytest.raises(LeewayError, match=r"at least 366 W to hover, expected at most 125 W"):
        airframe_from_dict(weak)


def test_drag_that_is_nothing_at_all_is_refused() -> None:
    broken = table("m100")
    broken["drag"]["linear_right_n_per_mps"] = 0.0
    broken["drag"]["quadratic_right_n_per_mps2"] = 0.0
    with pytest.raises(LeewayError, match="linear_right_n_per_mps"):
        airframe_from_dict(broken)


def test_the_m100_fitted_out_is_a_little_slower_than_the_bare_types_published_top_speed() -> None:
    # DJI Matrice 100 specifications: 22 m/s, 35 degrees, bare. Companion, radio and gripper add
    # weight (tilt thrust) and area: between a tenth slower and just as fast.
    m100 = airframe("m100")
    assert 0.9 * 22.0 <= level_airspeed_at_max_tilt_mps(m100, m100.flying_mass_kg(0.0)) <= 22.0


def test_the_m100_draws_what_the_field_logs_measured() -> None:
    if not MEASURED.exists():
        pytest.skip(f"{MEASURED} is not here")
    lines = MEASURED.read_text().splitlines()
    rows = [r for r in csv.DictReader(lines) if r["vehicle"] == "DJI Matrice 100"]
    speed = np.array([float(r["airspeed_mps"]) for r in rows])
    measured = np.array([float(r["power_w"]) for r in rows])
    m100 = airframe("m100")
    power = multirotor_power_w(m100, m100.flying_mass_kg(0.0), speed)
    assert power[0] == pytest.approx(473.0, rel=0.02)
    relative = power / measured - 1.0
    assert np.abs(relative).max() < 0.08
    assert np.sqrt(np.mean(relative**2)) < m100.power_rotor.model_std_frac


def test_usable_energy_falls_with_draw_cold_and_age() -> None:
    battery = airframe("m100").battery
    full = battery.usable_energy_of_full_pack_wh(400.0, 20.0, 1.0)
    assert full == pytest.approx(130.0 * battery.usable_frac)
    assert battery.usable_energy_of_full_pack_wh(650.0, 20.0, 1.0) < full
    assert battery.usable_energy_of_full_pack_wh(400.0, -5.0, 1.0) < 0.8 * full
    assert battery.usable_energy_of_full_pack_wh(400.0, 20.0, 0.7) == pytest.approx(0.7 * full)


def test_charge_at_rest_follows_the_open_circuit_table() -> None:
    battery = airframe("m100").battery
    assert battery.charge_frac_from_resting_voltage(6 * 4.35) == 1.0
    assert battery.charge_frac_from_resting_voltage(6 * 3.87) == pytest.approx(0.5)
    assert battery.charge_frac_from_resting_voltage(6 * 3.0) == 0.0
    # 600 W at 19.8 V sag 45 mOhm by 1.36 V, 0.227 V a cell: 3.527 V at rest is 4 % of charge.
    assert charge_frac_at_loaded_cutoff_voltage(battery, 600.0) == pytest.approx(0.0415, abs=0.002)
