"""Telemetry, wind and battery as measured (docs/reference/autopilots.md)."""

import math

import pytest

from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.wind import axis_airspeed_from_drag_mps
from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing, LinkKind
from sim_bridge.autopilot.mavlink.message_table import SPECS
from sim_bridge.truth.atmosphere import air_pressure_pa

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
DENIED, FAILED, ACCEPTED = 2, 4, 0


def rate_hz(rig, name, seconds):
    return len(rig.all(name)) / seconds


def listen(rig, seconds):
    rig.DT_S = 0.01
    rig.step(0.5)
    rig.forget()
    rig.step(seconds)
    rig.hear()


PX4_ONBOARD_HZ = {
    "ATTITUDE": 100.0,
    "GLOBAL_POSITION_INT": 50.0,
    "LOCAL_POSITION_NED": 30.0,
    "VFR_HUD": 10.0,
    "SYS_STATUS": 5.0,
    "BATTERY_STATUS": 0.5,
    "HEARTBEAT": 1.0,
    "MISSION_CURRENT": 1.0,
    "SCALED_PRESSURE": 1.0,
}  # measured on the onboard link


@pytest.mark.parametrize(("name", "hz"), PX4_ONBOARD_HZ.items())
def test_px4_streams_its_onboard_profile_unasked(make_rig, name, hz):
    rig = make_rig(PX4)
    listen(rig, 4.0)
    assert rate_hz(rig, name, 4.0) == pytest.approx(hz, rel=0.04, abs=0.26)


def test_px4_sends_less_on_a_ground_station_link(make_rig):
    rig = make_rig(PX4, link=LinkKind.GCS)
    listen(rig, 2.0)
    assert rate_hz(rig, "ATTITUDE", 2.0) < 30.0


def test_ardupilot_tells_a_mode_change_at_once(make_rig):
    rig = make_rig(AP)
    rig.step(1.3)
    assert rig.set_mode(Mode.GUIDED) == ACCEPTED
    assert rig.last("HEARTBEAT").custom_mode == 4


def test_px4_refuses_an_interval_for_its_heartbeat(make_rig):
    rig = make_rig(PX4)
    rig.step(0.2)
    assert rig.command(511, SPECS["HEARTBEAT"].id, 500_000) == FAILED


def test_global_position_heading_is_in_centidegrees_and_heights_in_millimetres(airborne):
    rig = airborne(PX4)
    rig.step(0.2)
    message = rig.last("GLOBAL_POSITION_INT")
    yaw_deg = math.degrees(rig.vehicle.truth.yaw_rad) % 360.0
    assert abs((message.hdg / 100.0 - yaw_deg + 180.0) % 360.0 - 180.0) < 8.0  # compass bias
    assert message.relative_alt / 1000.0 == pytest.approx(rig.height_m, abs=2.5)
    assert message.alt / 1000.0 == pytest.approx(12.0 + rig.height_m, abs=4.0)


def test_long_texts_come_in_chunks_with_one_id(make_rig):
    rig = make_rig(AP)
    rig.step(0.2)
    rig.forget()
    rig.ap.radio.send_status_text(4, "a" * 60)
    first, second = rig.all("STATUSTEXT")
    assert (first.text + second.text, first.chunk_seq, second.chunk_seq) == ("a" * 60, 0, 1)
    assert first.id == second.id != 0


# --- wind and airspeed ------------------------------------------------------------------------

# Drag model of the simulated M100: parasite area 0.068 m2 (0.075 across) on 3.65 kg, rotor drag
# 0.30 N s/m (params/truth/m100.toml), so BCOEF = m / area, MCOEF = k / m.
M100_DRAG = (3.65 / 0.068, 3.65 / 0.075, 0.30 / 3.65)
AP_DRAG = dict(
    zip(("EK3_DRAG_BCOEF_X", "EK3_DRAG_BCOEF_Y", "EK3_DRAG_MCOEF"), M100_DRAG, strict=True)
)
PX4_DRAG = {
    "EKF2_DRAG_CTRL": 1.0,
    **dict(zip(("EKF2_BCOEF_X", "EKF2_BCOEF_Y", "EKF2_MCOEF"), M100_DRAG, strict=True)),
}


def in_wind(make_rig, autopilot, settings=None, **options):
    """Return a rig hovering for 20 s in 6 m/s that blow to the south-east (from 315 degrees)."""
    to = 6.0 * math.sqrt(0.5)
    rig = make_rig(autopilot, settings, wind_to_ne_mps=(-to, to), **options)
    rig.take_off(10.0)
    for name in ("WIND", "WIND_COV", "VFR_HUD", "HIGH_LATENCY2", "AIRSPEED"):
        rig.command(511, SPECS[name].id, 500_000)
    rig.step(20.0)
    return rig


def test_ardupilots_drag_wind_says_where_it_blows_from(make_rig):
    rig = in_wind(make_rig, AP, AP_DRAG)
    wind = rig.last("WIND")
    assert wind.speed == pytest.approx(6.0, abs=1.2)
    assert wind.direction % 360.0 == pytest.approx(315.0, abs=15.0)
    assert rig.last("VFR_HUD").airspeed == pytest.approx(6.0, abs=1.2)
    assert 2.0 * rig.last("HIGH_LATENCY2").wind_heading == pytest.approx(315.0, abs=15.0)


def test_px4s_drag_wind_says_where_it_blows_to_and_settles_in_fifteen_seconds(make_rig):
    rig = in_wind(make_rig, PX4, PX4_DRAG)
    wind = rig.last("WIND_COV")
    to = 6.0 * math.sqrt(0.5)
    assert (wind.wind_x, wind.wind_y) == pytest.approx((-to, to), abs=1.0)
    assert (wind.wind_z, wind.var_vert, wind.horiz_accuracy, wind.vert_accuracy) == (0, 0, 0, 0)
    high = rig.last("HIGH_LATENCY2")
    assert 2.0 * high.wind_heading == pytest.approx(135.0, abs=15.0)
    assert high.airspeed == 0


def test_wrong_drag_coefficients_give_a_wrong_wind(make_rig):
    heavy = {**PX4_DRAG, "EKF2_BCOEF_X": 200.0, "EKF2_BCOEF_Y": 200.0, "EKF2_MCOEF": 0.0}
    rig = in_wind(make_rig, PX4, heavy)
    wind = rig.last("WIND_COV")
    assert math.hypot(wind.wind_x, wind.wind_y) > 8.0


def test_drag_parameters_set_in_flight_do_nothing_before_a_reboot(airborne):
    rig = airborne(AP, AP_DRAG)
    rig.step(3.0)
    assert rig.ap.wind.estimator is None


def test_ardupilots_airspeed_sensor_feeds_the_forward_axis_and_no_wind(make_rig):
    rig = in_wind(make_rig, AP, {"ARSPD_TYPE": 1}, pitot=True)
    readings = rig.ap.state.readings
    assert rig.last("VFR_HUD").airspeed == pytest.approx(readings.airspeed_mps, abs=3.0)
    assert rig.all("AIRSPEED")
    assert rig.last("WIND").speed == 0.0


@pytest.mark.parametrize("speed_mps", [-9.0, -0.5, 0.0, 3.0, 14.0])
def test_the_drag_formula_is_inverted_exactly(speed_mps):
    # forward: a = -(rho / 2) v |v| / BCOEF - MCOEF v (PX4 EKF2 drag fusion)
    bcoef, mcoef = 40.0, 0.1
    accel = -0.5 * 1.225 * speed_mps * abs(speed_mps) / bcoef - mcoef * speed_mps
    assert axis_airspeed_from_drag_mps(accel, bcoef, mcoef) == pytest.approx(speed_mps, abs=1e-9)


# --- battery ----------------------------------------------------------------------------------


def test_px4_sih_knows_no_current_no_charge_and_counts_a_timer(make_rig):
    rig = make_rig(PX4, battery_sensing=BatterySensing.SIH_TIMER)
    rig.take_off(5.0)
    rig.step(2.5)
    status = rig.last("BATTERY_STATUS")
    assert status.current_battery == -1
    assert status.current_consumed == 0
    assert status.energy_consumed == -1
    assert status.time_remaining == 0
    assert rig.last("SYS_STATUS").current_battery == -1
    first = rig.last("SYS_STATUS")
    rig.step(5.0)
    second = rig.last("SYS_STATUS")
    assert second.battery_remaining < first.battery_remaining
    assert second.voltage_battery < first.voltage_battery
    rig.step(40.0)  # beyond SIM_BAT_MIN_PCT, after which the voltage is constant
    third = rig.last("SYS_STATUS")
    rig.step(5.0)
    assert rig.last("SYS_STATUS").voltage_battery == third.voltage_battery


def test_px4_with_a_power_module_knows_current_and_charge_but_no_energy(airborne):
    rig = airborne(PX4)
    rig.step(5.0)
    status = rig.last("BATTERY_STATUS")
    assert status.current_battery / 100.0 == pytest.approx(rig.ap.state.readings.current_a, rel=0.2)
    assert status.current_consumed > 50
    assert status.energy_consumed == -1


def test_px4_knows_no_percentage_without_the_number_of_cells(make_rig):
    rig = make_rig(PX4)
    rig.step(2.2)
    assert rig.last("SYS_STATUS").battery_remaining == -1


def test_px4_reads_charge_from_cells_and_capacity(make_rig):
    rig = make_rig(PX4, {"BAT1_N_CELLS": 6, "BAT1_CAPACITY": 5700})
    rig.step(2.2)
    status = rig.last("BATTERY_STATUS")
    assert status.voltages[5] == pytest.approx(rig.ap.state.readings.voltage_v * 1000 / 6, abs=60)
    assert status.voltages[6] == 65535
    assert 80 <= status.battery_remaining <= 100


def test_ardupilot_integrates_current_and_takes_capacity_from_its_parameter(airborne):
    rig = airborne(AP, {"BATT_CAPACITY": 5700})
    rig.command(511, SPECS["BATTERY_STATUS"].id, 500_000)
    rig.command(511, SPECS["SYS_STATUS"].id, 500_000)
    rig.step(1.0)
    before, at_s = rig.last("BATTERY_STATUS"), rig.ap.t_s
    rig.step(10.0)
    after = rig.last("BATTERY_STATUS")
    mean_a = rig.ap.state.readings.current_a
    drawn_mah = mean_a * (rig.ap.t_s - at_s) / 3.6
    assert after.current_consumed - before.current_consumed == pytest.approx(drawn_mah, rel=0.15)
    drawn_hj = drawn_mah * 3.6 * rig.ap.state.readings.voltage_v / 100.0
    assert after.energy_consumed - before.energy_consumed == pytest.approx(drawn_hj, rel=0.15)
    assert after.time_remaining == 0
    left = 100.0 * (1.0 - after.current_consumed / 5700.0)
    assert after.battery_remaining == pytest.approx(left, abs=1.5)
    assert abs(after.battery_remaining - rig.last("SYS_STATUS").battery_remaining) <= 1


@pytest.mark.parametrize("autopilot", [AP, PX4])
def test_a_dead_current_sensor_makes_current_unknown(airborne, autopilot):
    rig = airborne(autopilot)
    rig.vehicle.sensors.current_failed = True
    rig.command(511, SPECS["BATTERY_STATUS"].id, 500_000)
    rig.step(3.0)
    status = rig.last("BATTERY_STATUS")
    assert (status.current_battery, status.current_consumed) == (-1, -1)


# --- boot -------------------------------------------------------------------------------------


def test_ardupilots_prearm_bit_comes_before_its_position_and_guided_will_not_arm(make_rig):
    # measured: bit true at 36 s in STABILIZE, EKF flags from 167 to 831 at about 42 s
    rig = make_rig(AP, boot_age_s=0.0)
    rig.DT_S = 0.05
    for name in ("SYS_STATUS", "EKF_STATUS_REPORT"):
        rig.command(511, SPECS[name].id, 500_000)
    rig.step(30.0)
    assert not rig.last("SYS_STATUS").onboard_control_sensors_health & 0x10000000
    rig.step(8.0)
    assert rig.last("SYS_STATUS").onboard_control_sensors_health & 0x10000000
    assert rig.last("EKF_STATUS_REPORT").flags == 167
    rig.set_mode(Mode.GUIDED)
    assert rig.command(400, 1) == FAILED
    rig.step(6.0)
    assert rig.last("EKF_STATUS_REPORT").flags == 831
    assert rig.command(400, 1) == ACCEPTED


@pytest.mark.parametrize("autopilot", [AP, PX4])
def test_there_is_no_position_before_the_estimator_has_one(make_rig, autopilot):
    rig = make_rig(autopilot, boot_age_s=0.0)
    rig.step(1.0)
    rig.command(511, SPECS["GLOBAL_POSITION_INT"].id, 100_000)
    rig.step(2.0)
    assert rig.all("GLOBAL_POSITION_INT") == []


@pytest.mark.parametrize("autopilot", [AP, PX4])
def test_scaled_pressure_is_the_barometers_in_hectopascal_with_its_boards_temperature(
    make_rig, autopilot
):
    rig = make_rig(autopilot)
    rig.step(0.2)
    assert rig.command(511, SPECS["SCALED_PRESSURE"].id, 1_000_000) == ACCEPTED
    rig.step(2.0)
    said, sensors = rig.last("SCALED_PRESSURE"), rig.vehicle.sensors
    # ISO 2533 at the rig's 12 m; a barometer drifts by a metre or two, 0.12 hPa each.
    assert said.press_abs == pytest.approx(air_pressure_pa(12.0) / 100.0, abs=0.5)
    assert said.temperature == pytest.approx(100.0 * sensors.board_temperature_c, abs=0.5)
