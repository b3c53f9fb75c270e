"""Sensors: spreads as stated, delays, rates, and effects of faults."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from sim_bridge.truth.airframe import Airframe
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.noise import GaussianStream, WanderingBias
from sim_bridge.truth.params import SensorParams, load_airframe
from sim_bridge.truth.sensors import SensorSuite
from sim_bridge.truth.signals import SensorReadings

M100 = load_airframe(Path(__file__).parents[3] / "params" / "truth" / "m100.toml")
RATES = {"gnss_rate_hz", "gnss_latency_s", "gnss_bias_time_s", "tilt_bias_time_s"}
RATES |= {"baro_drift_time_s"}
PERFECT = msgspec.structs.replace(
    M100.sensors,
    **{name: 0.0 for name in SensorParams.__struct_fields__ if name not in RATES},
)


class Bench:
    """A body moved by the test, with its sensors."""

    def __init__(self, params: SensorParams = PERFECT, seed: int = 1, **switches) -> None:
        self.body = Airframe(M100)
        self.battery = Battery(M100.battery)
        self.sensors = SensorSuite(params, np.random.default_rng(seed), **switches)
        self.t_s = 0.0

    def step(self, dt_s: float = 0.01) -> SensorReadings:
        self.t_s += dt_s
        self.body.north_m += self.body.north_mps * dt_s
        return self.sensors.update_and_read_sensors(
            self.t_s,
            self.body,
            (0.0, 0.0, -9.8),
            self.battery,
            touching_ground=False,
            parcel_aboard=True,
        )


def test_perfect_sensors_tell_the_truth() -> None:
    bench = Bench(depot_alt_amsl_m=120.0, pitot=True)
    bench.body.down_m, bench.body.roll_rad, bench.body.yaw_rad = -30.0, 0.1, 3.0
    bench.body.forward_airspeed_mps = 12.0
    readings = [bench.step() for _ in range(30)][-1]
    assert readings.roll_rad == 0.1
    assert readings.yaw_rad == pytest.approx(3.0)
    assert readings.alt_amsl_m == pytest.approx(150.0)
    assert readings.airspeed_mps == pytest.approx(12.0)
    assert readings.voltage_v == pytest.approx(bench.battery.voltage_v)
    assert readings.current_a == 0.0
    assert readings.accel_frd_mps2 == (0.0, 0.0, -9.8)


def test_gnss_is_late_by_its_latency_and_comes_ten_times_a_second() -> None:
    """At 10 m/s a fix shows the vehicle's position 0.12 to 0.22 s ago."""
    bench = Bench()
    bench.body.north_mps = 10.0
    lags, fixes = [], set()
    for _ in range(500):
        readings = bench.step()
        lags.append((bench.body.north_m - readings.pos_ned_m[0]) / 10.0)
        fixes.add(readings.pos_ned_m)
    assert min(lags[50:]) == pytest.approx(0.12, abs=0.011)
    assert max(lags[50:]) == pytest.approx(0.21, abs=0.011)
    assert len(fixes) == pytest.approx(50, abs=2)


def test_an_outage_holds_the_last_fix_and_says_so() -> None:
    bench = Bench()
    bench.body.north_mps = 10.0
    before = [bench.step() for _ in range(100)][-1]
    bench.sensors.gnss_outage = True
    during = [bench.step() for _ in range(500)]
    assert not any(readings.gnss_ok for readings in during)
    assert {readings.pos_ned_m for readings in during} == {before.pos_ned_m}
    bench.sensors.gnss_outage = False
    after = [bench.step() for _ in range(30)][-1]
    assert after.gnss_ok
    assert after.pos_ned_m[0] == pytest.approx(bench.body.north_m, abs=2.5)


def test_positions_that_lie_off_lie_off_by_as_much_as_is_told_and_no_speed_does() -> None:
    there = Bench().step()
    bench = Bench()
    bench.sensors.gnss_offset_ned_m = (30.0, -4.0, 2.0)
    off = bench.step()
    assert np.subtract(off.pos_ned_m, there.pos_ned_m) == pytest.approx([30.0, -4.0, 2.0])
    assert off.vel_ned_mps == there.vel_ned_mps
    assert off.gnss_ok


def test_errors_have_the_spread_that_is_stated() -> None:
    """Over 300 vehicles, standard deviations within 15 % (3 standard errors)."""
    rolls, norths, heights, headings = [], [], [], []
    for seed in range(300):
        readings = Bench(M100.sensors, seed).step()
        rolls.append(readings.roll_rad)
        norths.append(readings.pos_ned_m[0])
        heights.append(readings.alt_amsl_m)
        headings.append(readings.yaw_rad)
    p = M100.sensors
    expected = [
        math.radians(math.hypot(p.tilt_bias_deg, p.tilt_noise_deg)),
        math.hypot(p.gnss_horizontal_bias_m, p.gnss_position_noise_m),
        math.hypot(p.baro_drift_m, p.baro_noise_m),
        math.radians(math.hypot(p.heading_bias_deg, p.heading_noise_deg)),
    ]
    spreads = [np.std(values) for values in (rolls, norths, heights, headings)]
    assert spreads == pytest.approx(expected, rel=0.15)


@pytest.mark.sample
def test_biases_wander_with_their_correlation_time() -> None:
    """Ornstein-Uhlenbeck: after one correlation time exp(-1) of the bias is left, on average."""
    first, later = [], []
    std_rad, time_s = math.radians(M100.sensors.tilt_bias_deg), M100.sensors.tilt_bias_time_s
    for seed in range(400):
        bias = WanderingBias(std_rad, time_s, GaussianStream(np.random.default_rng(seed)))
        first.append(bias.value)
        for _ in range(int(time_s / 0.1)):
            bias.advance_and_get_value(0.1)
        later.append(bias.value)
    assert np.corrcoef(first, later)[0, 1] == pytest.approx(math.exp(-1), abs=0.15)


def test_a_pitot_feels_only_wind_from_ahead() -> None:
    bench = Bench(pitot=True)
    bench.body.forward_airspeed_mps = -8.0
    assert [bench.step() for _ in range(20)][-1].airspeed_mps == 0.0


def test_a_pitot_is_poor_at_low_speed() -> None:
    """Noise is in pressure: dV = dp / (rho V), so six times the noise at a sixth of the speed."""

    def spread(speed: float) -> float:
        bench = Bench(msgspec.structs.replace(PERFECT, pitot_noise_pa=2.0), pitot=True)
        bench.body.forward_airspeed_mps = speed
        return float(np.std([bench.step(0.1).airspeed_mps for _ in range(3000)]))

    assert spread(18.0) == pytest.approx(2.0 / (1.225 * 18.0), rel=0.1)
    assert spread(6.0) == pytest.approx(2.0 / (1.225 * 6.0), rel=0.1)


def test_a_stuck_pitot_holds_and_an_iced_one_reads_nothing() -> None:
    bench = Bench(pitot=True)
    bench.body.forward_airspeed_mps = 10.0
    for _ in range(20):
        bench.step()
    bench.sensors.pitot_stuck = True
    bench.body.forward_airspeed_mps = 15.0
    assert [bench.step() for _ in range(20)][-1].airspeed_mps == pytest.approx(10.0)
    bench.sensors.pitot_stuck, bench.sensors.pitot_iced = False, True
    assert [bench.step() for _ in range(20)][-1].airspeed_mps == 0.0


def test_sensors_that_are_absent_or_failed_say_none() -> None:
    bench = Bench(voltage_sensor=False, current_sensor=False)
    readings = bench.step()
    assert readings.voltage_v is None
    assert readings.current_a is None
    assert readings.airspeed_mps is None
    bench = Bench()
    assert bench.step().current_a == 0.0
    bench.sensors.current_failed = bench.sensors.voltage_failed = True
    readings = [bench.step() for _ in range(20)][-1]
    assert readings.current_a is None
    assert readings.voltage_v is None


def test_the_barometer_tells_the_pressure_of_its_height_and_its_board_is_warmer_than_the_air():
    # ISO 2533, table 5: 701.09 hPa at 3,000 m, 692.8 at 3,095 m.
    bench = Bench(M100.sensors, depot_alt_amsl_m=3000.0, air_temperature_c=40.0)
    assert bench.step().air_pressure_pa == pytest.approx(70_109.0, rel=4e-4)
    bench.body.down_m = -95.0
    readings = [bench.step() for _ in range(30)][-1]
    assert readings.air_pressure_pa == pytest.approx(69_280.0, rel=5e-4)
    warmth_c = [
        Bench(M100.sensors, seed, air_temperature_c=40.0).step().board_temperature_c - 40.0
        for seed in range(60)
    ]
    assert np.mean(warmth_c) == pytest.approx(13.0, abs=2.0)
    assert np.std(warmth_c) == pytest.approx(4.0, abs=1.2)
