"""The whole vehicle: ground, parcel, battery, determinism."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from sim_bridge.autopilot.base.readings import AttitudeSetpoint
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.params import SensorParams, load_airframe
from sim_bridge.truth.terrain import PlaneTerrain
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import SteadyWind, WindField
from sim_bridge.truth.wind_params import build_mean_wind, build_wind_field, parse_wind

G = 9.80665
M100 = load_airframe(Path(__file__).parents[3] / "params" / "truth" / "m100.toml")
NO_BIAS = msgspec.structs.replace(
    M100,
    sensors=msgspec.structs.replace(
        M100.sensors,
        **{
            name: 0.0
            for name in SensorParams.__struct_fields__
            if name.startswith(("tilt_bias_deg", "heading_bias", "accel"))
        },
    ),
)
OFF = AttitudeSetpoint()


def _vehicle(speed: float = 0.0, from_deg: float = 0.0, **options) -> Vehicle:
    wind = WindField(SteadyWind(speed, from_deg))
    return Vehicle(NO_BIAS, wind, np.random.default_rng(3), **options)


def _hover_frac(vehicle: Vehicle) -> float:
    """Thrust share at which lift is weight, from the static maximum and the voltage's square."""
    rise = vehicle.battery.voltage_v / (6 * 3.8)
    return vehicle.mass_kg * G / (M100.rotors.static_thrust_max_n * rise * rise)


def _fly(vehicle: Vehicle, seconds: float, factor: float) -> None:
    """Level, at a multiple of hover thrust."""
    for _ in range(round(seconds / 0.01)):
        frac = factor * _hover_frac(vehicle)
        vehicle.advance_and_read_sensors(AttitudeSetpoint(thrust_frac=frac, motors_on=True), 0.01)


def test_it_stands_where_it_is_put_even_in_wind() -> None:
    vehicle = _vehicle(12.0, start_ne_m=(5.0, -3.0), terrain=PlaneTerrain(0.1))
    for _ in range(300):
        readings = vehicle.advance_and_read_sensors(OFF, 0.01)
    truth = vehicle.truth
    assert truth.pos_ned_m == pytest.approx((5.0, -3.0, -0.5))
    assert readings.touching_ground
    assert not truth.airborne
    assert readings.accel_frd_mps2 == pytest.approx((0.0, 0.0, -G))


def test_it_leaves_the_ground_only_when_thrust_beats_weight() -> None:
    vehicle = _vehicle()
    _fly(vehicle, 3.0, 0.97)
    assert not vehicle.truth.airborne
    _fly(vehicle, 3.0, 1.05)
    assert vehicle.truth.airborne


@pytest.mark.sample
def test_a_soft_landing_is_no_crash_and_a_fall_is() -> None:
    soft, hard = _vehicle(), _vehicle()
    for vehicle, sink_factor in ((soft, 0.985), (hard, 0.0)):
        _fly(vehicle, 3.0, 1.08)
        _fly(vehicle, 40.0, sink_factor)
    assert not soft.truth.airborne
    assert not soft.truth.crashed
    assert hard.truth.crashed
    assert hard.truth.motors_failed
    _fly(hard, 2.0, 1.5)
    assert not hard.truth.airborne


def test_touching_down_at_speed_is_a_crash() -> None:
    vehicle = _vehicle()
    _fly(vehicle, 2.0, 1.1)
    for _ in range(800):
        command = AttitudeSetpoint(
            pitch_rad=-0.3, thrust_frac=0.98 * _hover_frac(vehicle), motors_on=True
        )
        vehicle.advance_and_read_sensors(command, 0.01)
    assert vehicle.truth.crashed


def test_a_released_parcel_takes_its_weight_along() -> None:
    vehicle = _vehicle(payload_kg=0.8)
    _fly(vehicle, 2.0, 1.05)
    assert vehicle.mass_kg == pytest.approx(4.45)
    frac = _hover_frac(vehicle)
    vehicle.advance_and_read_sensors(
        AttitudeSetpoint(thrust_frac=frac, motors_on=True, release=True), 0.01
    )
    readings = vehicle.advance_and_read_sensors(
        AttitudeSetpoint(thrust_frac=frac, motors_on=True), 0.01
    )
    assert not readings.parcel_aboard
    assert not vehicle.truth.parcel_aboard
    # Newton: the same thrust on 3.65 of 4.45 kg
    assert readings.accel_frd_mps2[2] == pytest.approx(-G * 4.45 / 3.65, abs=0.6)


def test_a_stuck_gripper_keeps_the_parcel() -> None:
    vehicle = _vehicle(payload_kg=0.8)
    vehicle.release_fails = True
    readings = vehicle.advance_and_read_sensors(AttitudeSetpoint(release=True), 0.01)
    assert readings.parcel_aboard
    assert vehicle.mass_kg == pytest.approx(4.45)


def test_an_empty_battery_brings_it_down() -> None:
    vehicle = _vehicle(charge_frac=0.05)
    _fly(vehicle, 4.0, 1.1)
    assert vehicle.truth.airborne
    for _ in range(6000):
        _fly(vehicle, 0.01, 1.0)
        if vehicle.truth.motors_failed:
            break
    truth = vehicle.truth
    assert truth.motors_failed
    assert truth.usable_wh == 0.0
    _fly(vehicle, 30.0, 1.0)
    assert vehicle.truth.crashed


def test_energy_used_is_power_over_time() -> None:
    """Sum of the truth's own power, to 0.1 %."""
    vehicle = _vehicle()
    total_j = 0.0
    for _ in range(1000):
        _fly(vehicle, 0.01, 1.02)
        total_j += vehicle.truth.power_w * 0.01
    assert vehicle.truth.energy_used_wh == pytest.approx(total_j / 3600, rel=1e-3)


def test_a_payload_beyond_the_airframe_is_refused() -> None:
    with pytest.raises(TruthError, match="payload_kg"):
        _vehicle(payload_kg=1.2)


def test_same_seed_same_flight() -> None:
    """Bit for bit, with turbulence and every noise on; another seed differs."""

    def fly(seed: int) -> list:
        params = parse_wind(
            {"kind": "steady", "speed_mps": 7.0, "from_deg": 200.0, "turbulence": "dryden"}
        )
        gusts, noise = np.random.default_rng(seed).spawn(2)
        field = build_wind_field(params, build_mean_wind(params, Path()), gusts)
        vehicle = Vehicle(M100, field, noise, payload_kg=0.5, pitot=True)
        command = AttitudeSetpoint(thrust_frac=0.6, pitch_rad=-0.1, motors_on=True)
        return [vehicle.advance_and_read_sensors(command, 0.01) for _ in range(300)] + [
            vehicle.truth
        ]

    assert fly(4) == fly(4)
    assert fly(4)[-1] != fly(5)[-1]


def test_hot_and_high_takes_more_power() -> None:
    """Momentum theory: induced power goes with density to the -1/2."""
    low, high = _vehicle(), _vehicle(depot_alt_amsl_m=3000.0, temperature_c=20.0)
    assert high.hover_power_without_parcel_w > 1.1 * low.hover_power_without_parcel_w


def test_a_spin_turns_it_whatever_the_autopilot_asks() -> None:
    vehicle = _vehicle()
    _fly(vehicle, 2.0, 1.2)
    vehicle.yaw_spin_rps = 1.0
    before = vehicle.truth.yaw_rad
    _fly(vehicle, 2.0, 1.0)
    assert vehicle.truth.yaw_rad - before == pytest.approx(2.0, abs=0.2)
    vehicle.yaw_spin_rps = None
    _fly(vehicle, 4.0, 1.0)
    assert vehicle.truth.yaw_rad == pytest.approx(0.0, abs=0.05)


def test_ice_lets_the_same_wind_push_twice_as_hard() -> None:
    def pushed_mps(times: float) -> float:
        vehicle = _vehicle(8.0, from_deg=180.0)
        vehicle.drag_factor = times
        _fly(vehicle, 0.3, 1.5)
        north, _, _ = vehicle.truth.vel_ned_mps
        return north

    assert pushed_mps(2.0) == pytest.approx(2.0 * pushed_mps(1.0), rel=0.1)


def test_a_parcel_is_put_on_and_taken_off_on_the_ground_only() -> None:
    vehicle = _vehicle()
    bare_kg = vehicle.mass_kg
    vehicle.load_parcel(0.5)
    assert vehicle.mass_kg == pytest.approx(bare_kg + 0.5)
    vehicle.load_parcel(0.0)
    assert (vehicle.mass_kg, vehicle.parcel_aboard) == (bare_kg, False)
    with pytest.raises(TruthError, match="payload_kg = 99"):
        vehicle.load_parcel(99.0)
    _fly(vehicle, 1.0, 1.3)
    assert vehicle.is_airborne
    with pytest.raises(TruthError, match="in the air, expected on the ground"):
        vehicle.load_parcel(0.5)
