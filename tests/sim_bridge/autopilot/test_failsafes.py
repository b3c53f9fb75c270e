"""Failsafes, fences, radio control, loss of GNSS and reboots, in both autopilots.

Expected behaviour: docs/reference/autopilots.md (measured), and each autopilot's published
failsafe documentation (ardupilot.org/copter/docs/failsafe-landing-page.html,
docs.px4.io/main/en/config/safety.html).
"""

import math

import pytest

from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mavlink.message_table import SPECS

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
BOTH = pytest.mark.parametrize("autopilot", [AP, PX4])
RTL = {AP: 6, PX4: 4 << 16 | 5 << 24}
ACCEPTED = 0
DENIED = 2
FAILED = 4


def channels(roll=1500, pitch=1500, throttle=1500, yaw=1500, switch=1100):
    return [roll, pitch, throttle, yaw, switch, 1500, 1500, 1500]


def out_on_a_mission(rig, speed_check=True):
    rig.upload([rig.place(16, 400, 0, 20), rig.place(16, 500, 0, 20)])
    assert rig.set_mode(Mode.AUTO) == ACCEPTED
    rig.step(6.0)
    return rig


# --- battery ----------------------------------------------------------------------------------


def test_ardupilots_battery_failsafe_is_off_by_default(airborne):
    rig = airborne(AP, {"BATT_CAPACITY": 5700})
    rig.ap.params.set("BATT_LOW_MAH", 5690)
    rig.step(3.0)
    assert any("Battery 1 is low" in text for text in rig.texts())
    assert rig.ap.mode is Mode.GUIDED


@pytest.mark.parametrize(("action", "mode"), [(1, Mode.LAND), (2, Mode.RTL)])
def test_ardupilot_acts_on_low_charge_as_told(airborne, action, mode):
    rig = airborne(AP, {"BATT_CAPACITY": 5700, "BATT_LOW_MAH": 5690, "BATT_FS_LOW_ACT": action})
    rig.step(1.0)
    assert rig.ap.mode is mode


def test_ardupilots_low_voltage_has_to_last(airborne):
    rig = airborne(AP, {"BATT_LOW_VOLT": 26.0, "BATT_FS_LOW_ACT": 2, "BATT_LOW_TIMER": 4})
    rig.step(3.0)
    assert rig.ap.mode is Mode.GUIDED
    rig.step(2.0)
    assert rig.ap.mode is Mode.RTL


PX4_PACK = {"BAT1_N_CELLS": 6, "BAT1_V_CHARGED": 4.1, "BAT1_V_EMPTY": 3.4}


@pytest.mark.parametrize(
    ("act", "at_critical", "at_emergency"),
    [(0, Mode.HOLD, Mode.HOLD), (2, Mode.LAND, Mode.LAND), (3, Mode.RTL, Mode.LAND)],
)
def test_px4_acts_on_its_battery_levels_as_told(airborne, act, at_critical, at_emergency):
    settings = {**PX4_PACK, "COM_LOW_BAT_ACT": act, "COM_FAIL_ACT_T": 1.0}
    rig = airborne(PX4, settings)
    rig.step(1.0)
    left = rig.ap.battery.remaining_frac
    rig.ap.params.set("BAT_CRIT_THR", left + 0.05)
    rig.step(0.4)
    assert rig.ap.mode is Mode.HOLD  # it holds first, so that a pilot can intervene
    rig.step(2.0)
    assert rig.ap.mode is at_critical
    rig.ap.params.set("BAT_EMERGEN_THR", left + 0.05)
    rig.step(1.0)
    assert rig.ap.mode is at_emergency


# --- the pilot --------------------------------------------------------------------------------


def test_a_pilots_mode_switch_takes_ardupilot_over(airborne):
    rig = out_on_a_mission(airborne(AP, {"FLTMODE1": 3, "FLTMODE6": 5}))
    rig.ap.set_receiver_channels(channels(switch=1100))
    rig.step(1.0)
    assert rig.ap.mode is Mode.AUTO
    rig.ap.set_receiver_channels(channels(switch=1900))
    rig.step(1.0)
    assert rig.ap.mode is Mode.LOITER
    rig.step(12.0)
    assert rig.speed_mps < 0.8


COMPANION = (1, 191)


def test_a_mode_is_a_persons_by_radio_or_by_another_systems_order_and_no_failsafes(airborne):
    for kind in (AP, PX4):
        rig = airborne(kind)
        assert rig.set_mode(Mode.HOLD if kind is PX4 else Mode.LOITER) == ACCEPTED
        assert rig.ap.is_under_external_control
        rig.ap.behaviour.commander.set_mode(Mode.LAND)  # as its failsafes do
        assert not rig.ap.is_under_external_control
        rig.send("SET_MODE", sender=COMPANION, target_system=1, base_mode=1, custom_mode=RTL[kind])
        assert rig.ap.mode is Mode.RTL
        assert not rig.ap.is_under_external_control


def test_a_mode_is_a_persons_by_the_switch_and_by_the_sticks(airborne):
    switched = out_on_a_mission(airborne(AP, {"FLTMODE1": 3, "FLTMODE6": 5}))
    moved = out_on_a_mission(airborne(PX4))
    for rig, taken in ((switched, channels(switch=1900)), (moved, channels(roll=1750))):
        rig.ap.set_receiver_channels(channels())
        rig.step(1.0)
        rig.ap.behaviour.commander.set_mode(Mode.RTL)
        assert not rig.ap.is_under_external_control
        rig.ap.set_receiver_channels(taken)
        rig.step(1.0)
        assert rig.ap.mode is Mode.LOITER
        assert rig.ap.is_under_external_control


def test_a_mode_switch_that_does_not_move_changes_nothing(airborne):
    rig = airborne(AP, {"FLTMODE1": 4, "FLTMODE6": 5})
    rig.ap.set_receiver_channels(channels(switch=1100))
    rig.step(1.0)
    rig.set_mode(Mode.LAND)
    rig.step(1.0)
    assert rig.ap.mode is Mode.LAND


def test_moved_sticks_take_px4_over_from_a_mission(airborne):
    rig = out_on_a_mission(airborne(PX4))
    rig.ap.set_receiver_channels(channels())
    rig.step(1.0)
    assert rig.ap.mode is Mode.AUTO
    rig.ap.set_receiver_channels(channels(roll=1750))
    rig.step(0.5)
    assert rig.ap.mode is Mode.LOITER
    east = rig.ne_m[1]
    rig.step(5.0)
    assert abs(rig.ne_m[1] - east) + abs(rig.ne_m[0]) > 5.0


def test_slow_movements_of_sticks_take_nothing_over(airborne):
    rig = out_on_a_mission(airborne(PX4))
    for pulse_us in range(1500, 1801, 10):  # 0.8 of the travel in 3 s; MAN_OVERRIDE_SPD is 1 a s
        rig.ap.set_receiver_channels(channels(roll=pulse_us))
        rig.step(0.1)
    assert rig.ap.mode is Mode.AUTO


def test_px4_has_a_mode_switch_only_where_one_is_mapped(airborne):
    for mapped, mode in ((0, Mode.AUTO), (5, Mode.LOITER)):
        rig = out_on_a_mission(airborne(PX4, {"RC_MAP_FLTMODE": mapped, "COM_FLTMODE6": 2}))
        rig.ap.set_receiver_channels(channels(switch=1900))
        rig.step(1.0)
        assert rig.ap.mode is mode


def test_overrides_by_mavlink_count_only_from_ardupilots_own_ground_station(airborne):
    override = {f"chan{i + 1}_raw": value for i, value in enumerate(channels(switch=1900))}
    rig = airborne(AP, {"FLTMODE6": 5})
    for _ in range(5):
        rig.send("RC_CHANNELS_OVERRIDE", sender=(7, 190), **override)
        rig.step(0.2)
    assert rig.ap.mode is Mode.GUIDED
    for _ in range(5):
        rig.send("RC_CHANNELS_OVERRIDE", **override)
        rig.step(0.2)
    assert rig.ap.mode is Mode.LOITER


@BOTH
def test_losing_the_radio_brings_it_home(airborne, autopilot):
    rig = airborne(autopilot, {"FLTMODE1": 4} if autopilot is AP else {"COM_FAIL_ACT_T": 2.0})
    rig.ap.set_receiver_channels(channels())
    rig.step(1.0)
    rig.ap.set_receiver_channels(None)
    rig.step(0.9 if autopilot is AP else 1.0)
    assert rig.ap.mode is (Mode.GUIDED if autopilot is AP else Mode.HOLD)
    rig.step(3.0)
    assert rig.ap.mode is Mode.RTL


def test_never_having_had_a_radio_is_not_losing_it(airborne):
    for autopilot in (AP, PX4):
        rig = airborne(autopilot)
        rig.step(10.0)
        assert rig.ap.mode in (Mode.GUIDED, Mode.HOLD)


def test_ardupilot_may_go_on_with_a_mission_without_radio(airborne):
    rig = out_on_a_mission(airborne(AP, {"FS_OPTIONS": 1, "FLTMODE1": 3}))
    rig.ap.set_receiver_channels(channels())
    rig.step(1.0)
    rig.ap.set_receiver_channels(None)
    rig.step(3.0)
    assert rig.ap.mode is Mode.AUTO


@pytest.mark.parametrize(
    ("autopilot", "settings", "mode"),
    [
        (AP, {}, Mode.GUIDED),
        (AP, {"FS_GCS_ENABLE": 1}, Mode.RTL),
        (AP, {"FS_GCS_ENABLE": 5}, Mode.LAND),
        (PX4, {}, Mode.HOLD),
        (PX4, {"NAV_DLL_ACT": 2}, Mode.RTL),
        (PX4, {"NAV_DLL_ACT": 3}, Mode.LAND),
    ],
)
def test_losing_the_ground_station_does_as_the_parameter_says(airborne, autopilot, settings, mode):
    rig = airborne(autopilot)
    rig.gcs_heartbeat()
    for name, value in settings.items():
        rig.ap.params.set(name, value)
    rig.step(4.0)
    before = rig.ap.mode
    assert before in (Mode.GUIDED, Mode.HOLD)
    rig.step(13.0)
    assert rig.ap.mode is mode


def test_a_companions_heartbeat_is_no_ground_station(airborne):
    rig = airborne(PX4, {"COM_FAIL_ACT_T": 0.0})
    rig.gcs_heartbeat()
    rig.ap.params.set("NAV_DLL_ACT", 2)
    rig.step(5.0)
    assert rig.ap.mode is Mode.HOLD
    for _ in range(12):
        rig.companion_heartbeat()
        rig.step(1.0)
    assert rig.ap.mode is Mode.RTL


# --- GNSS -------------------------------------------------------------------------------------


@BOTH
def test_five_seconds_without_gnss_are_borne(airborne, autopilot):
    rig = out_on_a_mission(airborne(autopilot))
    rig.vehicle.sensors.gnss_outage = True
    rig.step(5.0)
    rig.vehicle.sensors.gnss_outage = False
    rig.step(2.0)
    assert rig.ap.mode is Mode.AUTO


def test_ardupilot_lands_without_a_position_and_stays_in_land(airborne):
    rig = out_on_a_mission(airborne(AP))
    rig.vehicle.sensors.gnss_outage = True
    rig.step(12.0)
    assert rig.ap.mode is Mode.LAND
    assert "EKF Failsafe: changed to LAND Mode" in rig.texts()
    rig.command(512, SPECS["EKF_STATUS_REPORT"].id)
    assert rig.last("EKF_STATUS_REPORT").flags == 167
    rig.vehicle.sensors.gnss_outage = False
    rig.step(3.0)
    assert rig.ap.mode is Mode.LAND
    assert rig.until(lambda: not rig.ap.is_armed, 60.0)
    assert not rig.vehicle.truth.motors_failed


def test_px4_descends_without_a_position_and_takes_its_mission_up_again(airborne):
    rig = out_on_a_mission(airborne(PX4))
    rig.vehicle.sensors.gnss_outage = True
    rig.step(9.0)
    assert rig.ap.mode is Mode.DESCEND
    rig.step(1.1)
    assert rig.last("HEARTBEAT").custom_mode == 4 << 16 | 6 << 24  # reported as LAND
    height = rig.height_m
    rig.step(3.0)
    assert rig.height_m < height - 1.0
    rig.vehicle.sensors.gnss_outage = False
    rig.step(2.0)
    assert rig.ap.mode is Mode.AUTO


@BOTH
def test_without_gnss_for_good_it_comes_down_whole(airborne, autopilot):
    rig = airborne(autopilot)
    rig.vehicle.sensors.gnss_outage = True
    assert rig.until(lambda: not rig.vehicle.truth.airborne, 90.0)
    assert not rig.vehicle.truth.motors_failed


# --- fences -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("autopilot", "settings", "mode"),
    [
        (AP, {"FENCE_ENABLE": 0, "FENCE_RADIUS": 40}, Mode.AUTO),
        (AP, {"FENCE_ENABLE": 1, "FENCE_RADIUS": 40}, Mode.RTL),
        (AP, {"FENCE_ENABLE": 1, "FENCE_RADIUS": 40, "FENCE_ACTION": 2}, Mode.LAND),
        (PX4, {"GF_MAX_HOR_DIST": 0}, Mode.AUTO),
        (PX4, {"GF_MAX_HOR_DIST": 40}, Mode.HOLD),
        (PX4, {"GF_MAX_HOR_DIST": 40, "GF_ACTION": 3}, Mode.RTL),
    ],
)
def test_leaving_the_cylinder_does_what_the_parameter_says(airborne, autopilot, settings, mode):
    rig = airborne(autopilot)
    rig.upload([rig.place(16, 120, 0, 20), rig.place(16, 200, 0, 20)])
    rig.set_mode(Mode.AUTO)
    rig.step(1.0)
    for name, value in settings.items():
        rig.ap.params.set(name, value)
    rig.until(lambda: rig.ne_m[0] > 45.0 or rig.ap.mode is not Mode.AUTO, 30.0)
    rig.step(0.5)
    assert rig.ap.mode is mode


@BOTH
@pytest.mark.parametrize("is_inclusion", [True, False])
def test_an_uploaded_polygon_bounds_the_flight(airborne, autopilot, is_inclusion):
    rig = airborne(autopilot, {"FENCE_ENABLE": 1} if autopilot is AP else {"GF_ACTION": 3})
    near, far = (-40, 40) if is_inclusion else (40, 90)
    corners = [(near, -40), (near, 40), (far, 40), (far, -40)]
    command = 5001 if is_inclusion else 5002
    rig.upload([rig.place(16, 120, 0, 20), rig.place(16, 200, 0, 20)])
    rig.set_mode(Mode.AUTO)
    fence = [rig.place(command, n, e, 0, param1=4.0) for n, e in corners]
    assert rig.upload(fence, mission_type=1) == ACCEPTED
    rig.step(1.0)
    assert rig.ap.mode is Mode.AUTO
    rig.until(lambda: rig.ne_m[0] > 45.0 or rig.ap.mode is not Mode.AUTO, 30.0)
    rig.step(0.5)
    assert rig.ap.mode is Mode.RTL


def test_px4_will_not_fly_a_mission_through_its_fence(make_rig):
    rig = make_rig(PX4, {"GF_MAX_HOR_DIST": 50})
    rig.step(0.2)
    rig.gcs_heartbeat()
    rig.upload([rig.place(22, 0, 0, 10), rig.place(16, 80, 0, 10)])
    assert any("Geofence violation" in text for text in rig.texts())


# --- reboots ----------------------------------------------------------------------------------


@BOTH
def test_a_reboot_on_the_ground_keeps_parameters_and_mission_and_nothing_else(make_rig, autopilot):
    rig = make_rig(autopilot)
    rig.step(0.5)
    rig.upload([rig.place(22, 0, 0, 10), rig.place(16, 50, 0, 10)])
    name = "RTL_ALT" if autopilot is AP else "RTL_RETURN_ALT"
    rig.ap.params.set(name, 44)
    rig.command(511, SPECS["SERVO_OUTPUT_RAW"].id, 100_000)
    assert rig.command(246, 1) == ACCEPTED
    rig.forget()
    rig.step(2.0)
    assert rig.ap.time_boot_ms == pytest.approx(2000, abs=50)
    assert rig.ap.params[name] == 44
    assert rig.all("SERVO_OUTPUT_RAW") == []
    assert len(rig.download()) == (3 if autopilot is AP else 2)
    rig.set_mode(Mode.GUIDED if autopilot is AP else Mode.HOLD)
    assert rig.command(400, 1) != ACCEPTED  # no position yet


@BOTH
def test_it_does_not_reboot_on_command_while_armed(airborne, autopilot):
    rig = airborne(autopilot)
    # PX4 at 83c4f4e580 answers DENIED (measured), ArduCopter FAILED (its source).
    assert rig.command(246, 1) == (FAILED if autopilot is AP else DENIED)
    assert rig.ap.is_armed


@BOTH
def test_a_watchdog_reboot_in_flight_flies_on_and_forgets_what_was_drawn(airborne, autopilot):
    rig = out_on_a_mission(airborne(autopilot))
    index, drawn = rig.ap.executor.index, rig.ap.battery.consumed_mah
    rig.ap.reboot()
    rig.step(3.0)
    assert rig.ap.is_armed
    assert rig.ap.mode is Mode.AUTO
    assert rig.ap.executor.index == index
    assert rig.ap.time_boot_ms < 3100
    assert rig.ap.battery.consumed_mah < 0.5 * drawn
    assert rig.height_m == pytest.approx(20.0, abs=2.5)
    north = rig.ne_m[0]
    rig.step(5.0)
    assert rig.ne_m[0] > north + 10.0
    assert math.hypot(*rig.ap.state.home_ned_m[:2]) < 3.0
