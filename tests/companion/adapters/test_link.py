"""MAVLink reception: garbage, foreign, stale and torn frames, clock jumps, signatures."""

import importlib
import math
import os
import random
import socket
import struct
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.adapters.autopilots import link as link_module
from companion.adapters.autopilots.codec import MavlinkCodec, mavlink
from companion.adapters.autopilots.link import TcpLink, UdpLink, open_link
from companion.adapters.autopilots.port import AutopilotPort
from companion.adapters.clock import STEP_THRESHOLD_S, AutopilotClock
from companion.adapters.files.atomic_file import write_json_atomically
from companion.adapters.files.signing_files import (
    STAMPS_NAME,
    SigningStampStore,
    read_signing_key,
    write_signing_key,
)
from companion.core.base.errors import LeewayError, LinkClosedError
from companion.core.mission import events as ev


def sender(system: int = 1, component: int = 1, key: bytes | None = None) -> mavlink.MAVLink:
    """The remote end of the link, implemented by pymavlink."""
    mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    if key is not None:
        mav.signing.secret_key = key
        mav.signing.sign_outgoing = True
        mav.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)
    return mav


def frame(mav: mavlink.MAVLink, message: object) -> bytes:
    data = bytes(message.pack(mav))  # type: ignore[attr-defined]
    mav.seq = (mav.seq + 1) % 256
    return data


def heartbeat(kind: int = 2, autopilot: int = 12, state: int = 3, custom: int = 0) -> object:
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, custom, state, 3)


def attitude(ms: int, roll: float = 0.1) -> object:
    return mavlink.MAVLink_attitude_message(ms, roll, 0.0, 0.0, 0.0, 0.0, 0.0)


def running_clock() -> AutopilotClock:
    """A clock initialised by TIMESYNC: 0 s."""
    clock = AutopilotClock()
    clock.update_from_sync_time(0.0)
    return clock


def port(autopilot: int = 12, system: int = 1) -> tuple[AutopilotPort, list, MavlinkCodec]:
    """Return a port that has identified an autopilot, its list of sent bytes, and its codec."""
    sent: list = []
    made = AutopilotPort(sent.append, AutopilotClock())
    codec = MavlinkCodec(datagrams=True)
    mav = sender(system)
    for _ in range(10):  # enough for an autopilot that never sends its time
        for message in codec.parse_valid_messages(frame(mav, heartbeat(autopilot=autopilot))):
            made.on_message(message)
    assert made.system_id == system
    return made, sent, codec


def hear(made: AutopilotPort, codec: MavlinkCodec, data: bytes) -> list[ev.Event]:
    return [
        event for message in codec.parse_valid_messages(data) for event in made.on_message(message)
    ]


def heard(
    *messages: object, autopilot: int = 12, system: int = 1, component: int = 1
) -> list[ev.Event]:
    """Return the events of a port with an identified autopilot for the messages of a sender."""
    made, _, codec = port(autopilot)
    mav = sender(system, component)
    return [event for message in messages for event in hear(made, codec, frame(mav, message))]


# --- bytes ---------------------------------------------------------------------------------------


@given(st.lists(st.binary(max_size=120), max_size=8))
@settings(max_examples=200, deadline=None)
def test_no_bytes_whatever_break_the_codec_and_the_next_datagram_is_heard(chunks):
    codec = MavlinkCodec(datagrams=True)
    for chunk in chunks:
        codec.parse_valid_messages(chunk)
    good = frame(sender(), attitude(1000))
    assert [m.get_type() for m in codec.parse_valid_messages(good)] == ["ATTITUDE"]


@given(st.integers(0, 39), st.integers(0, 255))
@settings(max_examples=200, deadline=None)
def test_a_frame_with_one_changed_byte_is_never_taken_for_the_message_it_was(index, byte):
    data = bytearray(frame(sender(), attitude(1000)))
    index %= len(data)
    if data[index] == byte:
        return
    data[index] = byte
    heard = MavlinkCodec(datagrams=True).parse_valid_messages(bytes(data))
    assert [m for m in heard if m.get_type() == "ATTITUDE"] == []


@given(st.integers(1, 39))
@settings(max_examples=40, deadline=None)
def test_a_torn_datagram_swallows_nothing_of_the_next(cut):
    codec = MavlinkCodec(datagrams=True)
    data = frame(sender(), attitude(1000))
    assert codec.parse_valid_messages(data[: min(cut, len(data) - 1)]) == []
    assert len(codec.parse_valid_messages(data)) == 1
    assert codec.bad_frames == 1


def test_a_byte_stream_may_come_in_any_pieces():
    codec = MavlinkCodec(datagrams=False)
    mav = sender()
    stream = b"".join(frame(mav, attitude(1000 + i)) for i in range(50))
    pieces, rng, at = [], random.Random(1), 0
    while at < len(stream):
        size = rng.randint(1, 23)
        pieces.append(stream[at : at + size])
        at += size
    heard = [m.time_boot_ms for piece in pieces for m in codec.parse_valid_messages(piece)]
    assert heard == [1000 + i for i in range(50)]


def test_garbage_between_frames_costs_only_itself():
    codec = MavlinkCodec(datagrams=True)
    mav = sender()
    data = frame(mav, attitude(1)) + b"\x00\x11\x22" + frame(mav, attitude(2))
    assert [m.time_boot_ms for m in codec.parse_valid_messages(data)] == [1, 2]
    assert codec.bad_frames == 1


# --- accepted senders ----------------------------------------------------------------------------


def test_one_heartbeat_is_nobody_three_are_a_vehicle():
    made = AutopilotPort(lambda m: None, running_clock())
    codec, mav = MavlinkCodec(datagrams=True), sender(7)
    hear(made, codec, frame(mav, heartbeat()))
    hear(made, codec, frame(mav, heartbeat()))
    assert made.system_id is None
    events = hear(made, codec, frame(mav, heartbeat()))
    assert ev.AutopilotDetected(0.0, ev.AutopilotKind.PX4, 7) in events


def test_of_two_vehicles_on_the_link_none_is_chosen():
    made = AutopilotPort(lambda m: None, running_clock())
    codec, first, second = MavlinkCodec(datagrams=True), sender(1), sender(2)
    hear(made, codec, frame(first, heartbeat()) + frame(first, heartbeat()))
    assert made.ambiguous_systems == ()
    hear(made, codec, frame(second, heartbeat()) + frame(second, heartbeat()))
    assert made.ambiguous_systems == (1, 2)
    for mav in (first, second) * 10:
        assert hear(made, codec, frame(mav, heartbeat())) == []
    assert made.system_id is None


def test_a_fast_heartbeat_still_leaves_two_seconds_to_hear_another_computer():
    made = AutopilotPort(lambda m: None, AutopilotClock())
    codec, mav = MavlinkCodec(datagrams=True), sender()
    for ms in range(100_000, 101_900, 100):
        hear(made, codec, frame(mav, heartbeat()) + frame(mav, attitude(ms)))
    assert made.system_id is None
    hear(made, codec, frame(mav, attitude(102_100)) + frame(mav, heartbeat()))
    assert made.system_id == 1


@pytest.mark.parametrize(
    ("system", "component", "message"),
    [
        (2, 1, attitude(5000)),  # another vehicle's autopilot
        (1, 154, attitude(5000)),  # its gimbal
        (255, 190, attitude(5000)),  # a ground station
        (2, 1, heartbeat(custom=5)),
        (1, 190, heartbeat(kind=6, autopilot=8)),
        (1, 192, heartbeat(kind=18, autopilot=8, state=4)),  # a camera's companion computer
        (1, 1, attitude(1000, math.nan)),  # angles are NaN
    ],
)
def test_other_systems_and_components_say_nothing(system, component, message):
    assert heard(message, system=system, component=component) == []


def test_a_chosen_system_is_waited_for_whoever_else_talks():
    made = AutopilotPort(lambda m: None, running_clock(), system_id=3)
    codec = MavlinkCodec(datagrams=True)
    for system in (1, 2, 3):
        mav = sender(system)
        for _ in range(3):
            hear(made, codec, frame(mav, heartbeat()))
    assert made.system_id == 3


def claim(since_s: float) -> object:
    return mavlink.MAVLink_named_value_float_message(5, b"LW_SINCE", since_s)


@pytest.mark.parametrize(
    ("component", "message", "told"),
    [
        (191, heartbeat(kind=18, autopilot=8, state=4), {}),
        (191, heartbeat(kind=18, autopilot=8, state=3), {"active": False}),
        (  # of another component only if its heartbeat reports flight control
            192,
            mavlink.MAVLink_heartbeat_message(18, 8, 4, 61_500, 4, 3),
            {"component": 192, "has_control": True, "control_since_ms": 61_500},
        ),
        (191, claim(0.0), {}),
        (191, claim(61.5), {"has_control": True, "control_since_ms": 61_500}),
        (191, claim(700_000.1), {"has_control": True, "control_since_ms": 700_000_100}),
    ],
)
def test_another_computer_is_told_of_and_since_when_it_flies(component, message, told):
    expected = ev.OtherCompanionReport(0.0, **({"active": True} | told))
    assert heard(message, component=component) == [expected]


# --- decoded telemetry ---------------------------------------------------------------------------


def place(lat_e7: int, lon_e7: int, alt_mm: int, rel_mm: int = 40_000, *vel_cmps: int) -> object:
    vel = vel_cmps or (0, 0, 0)
    return mavlink.MAVLink_global_position_int_message(
        12_300, lat_e7, lon_e7, alt_mm, rel_mm, *vel, 9000
    )


def test_a_position_comes_in_si_with_its_own_time():
    (event,) = heard(place(554_700_000, 84_500_000, 52_000, 40_000, 120, -340, -50))
    assert event.t_s == pytest.approx(12.3)
    assert (event.lat_deg, event.lon_deg) == pytest.approx((55.47, 8.45))
    assert (event.alt_amsl_m, event.height_rel_m) == (52.0, 40.0)
    assert (event.vel_n_mps, event.vel_e_mps, event.vel_d_mps) == pytest.approx((1.2, -3.4, -0.5))


def status(voltage: int = 22_000, current: int = 2150, remaining: int = 60) -> object:
    return mavlink.MAVLink_sys_status_message(
        0, 0, 0, 0, voltage, current, remaining, 0, 0, 0, 0, 0, 0
    )


@pytest.mark.parametrize(
    ("lat_e7", "lon_e7", "alt_mm"),
    [
        (0, 0, 0),
        (479_000_000, 85_000_000, 2**31 - 1),
        (479_000_000, 85_000_000, 60_000_000),
        (479_000_000, 85_000_000, -(2**31)),
        (479_000_000, 85_000_000, -1_000_001),
        (900_000_001, 85_000_000, 500_000),
        (479_000_000, -1_800_000_001, 500_000),
    ],
)
def test_a_position_that_is_nowhere_on_earth_is_no_position(lat_e7, lon_e7, alt_mm):
    assert heard(place(lat_e7, lon_e7, alt_mm)) == []


def test_unknown_battery_fields_are_none_and_never_minus_one():
    unknown, event = heard(status(65535, -1, -1), status())
    assert unknown == ev.Battery(0.0)
    assert (event.voltage_v, event.current_a, event.remaining_frac) == (22.0, 21.5, 0.6)


def battery(current: int, consumed: int, energy: int, temperature: int = 32767) -> object:
    volts = [3900] * 6 + [65535] * 4
    return mavlink.MAVLink_battery_status_message(
        0, 0, 0, temperature, volts, current, consumed, energy, 55
    )


def test_counters_without_a_current_sensor_are_unknown_as_px4_sih_sends_them():
    # Measured: PX4 SIH sends current -1, consumed 0, energy -1 (all unknown).
    blind, event = heard(battery(-1, 0, -1), battery(2800, 1500, 1200, 2150))
    assert (blind.current_a, blind.consumed_ah, blind.consumed_j) == (None, None, None)
    assert blind.voltage_v == pytest.approx(23.4)
    assert (event.consumed_ah, event.consumed_j) == (1.5, 120_000.0)  # mAh, hJ on the wire
    assert event.temperature_c == 21.5


def wind(direction: float, speed: float) -> object:
    return mavlink.MAVLink_wind_message(direction, speed, 0.0)


def parameter(name: str, value: float) -> object:
    return mavlink.MAVLink_param_value_message(name.encode(), value, 9, 1, 0)


def test_arducopters_default_wind_is_no_wind():
    # Measured: direction -180, speed 0 even in a wind of 8 m/s.
    assert heard(wind(-180.0, 0.0), autopilot=3) == []
    assert heard(wind(90.0, 5.0), autopilot=3) == [], "drag fusion is not known to be on"
    (event,) = heard(parameter("EK3_DRAG_BCOEF_X", 20.0), wind(90.0, 5.0), autopilot=3)
    assert (event.to_n_mps, event.to_e_mps) == pytest.approx((0.0, -5.0))  # wind FROM the east


def test_px4_wind_points_where_it_blows_to_and_an_accuracy_of_0_is_unknown():
    known, unknown = (
        mavlink.MAVLink_wind_cov_message(1_000_000, north, -4.0, 0.0, 0.0, 0.0, 40.0, 0.0, 0.0)
        for north in (3.0, math.nan)
    )
    assert heard(known, unknown) == [ev.AutopilotWind(0.0, 3.0, -4.0, None)]


def hud(airspeed: float, throttle: int = 45) -> object:
    return mavlink.MAVLink_vfr_hud_message(airspeed, 9.0, 90, throttle, 50.0, 0.0)


@pytest.mark.parametrize(("autopilot", "sensor"), [(3, "ARSPD_TYPE"), (12, "SYS_HAS_NUM_ASPD")])
def test_vfr_hud_airspeed_counts_only_with_a_sensor(autopilot, sensor):
    # Measured: in these fields ArduCopter sends the ground velocity, PX4 NaN.
    made, _, codec = port(autopilot)
    mav = sender()
    assert [type(e) for e in hear(made, codec, frame(mav, hud(9.0)))] == [ev.Throttle]
    value = 1.0 if autopilot == 3 else struct.unpack("<f", struct.pack("<i", 1))[0]
    kind = 9 if autopilot == 3 else 6
    message = mavlink.MAVLink_param_value_message(sensor.encode(), value, kind, 1, 0)
    hear(made, codec, frame(mav, message))
    events = hear(made, codec, frame(mav, hud(9.0)))
    assert ev.Airspeed(0.0, 9.0) in events
    assert [type(e) for e in hear(made, codec, frame(mav, hud(math.nan)))] == [ev.Throttle]


@pytest.mark.parametrize(
    ("autopilot", "custom", "mode"),
    [
        (3, 3, ev.Mode.MISSION),
        (3, 6, ev.Mode.RTL),
        (3, 0, ev.Mode.OTHER),
        (12, 4 << 16 | 4 << 24, ev.Mode.MISSION),
        (12, 4 << 16 | 5 << 24, ev.Mode.RTL),
        (12, 6 << 16, ev.Mode.GUIDED),
        (12, 3 << 16, ev.Mode.OTHER),
    ],
)
def test_modes_are_the_autopilots_own_numbers(autopilot, custom, mode):
    (event,) = heard(heartbeat(autopilot=autopilot, custom=custom), autopilot=autopilot)
    assert event.mode is mode


def test_px4_tells_its_mode_between_heartbeats_by_current_mode():
    # The remote end uses pymavlink's development dialect; HOLD is main mode 4, sub mode 3.
    development = importlib.import_module("pymavlink.dialects.v20.development")
    mav = development.MAVLink(None, srcSystem=1, srcComponent=1)
    made, _, codec = port(12)
    told = development.MAVLink_current_mode_message(0, 4 << 16 | 3 << 24, 4 << 16 | 4 << 24)
    assert hear(made, codec, bytes(told.pack(mav))) == [
        ev.ModeReport(0.0, ev.Mode.HOLD, "AUTO.HOLD")
    ]


@pytest.mark.parametrize(("autopilot", "seq", "total", "index", "count"), [
    (3, 5, 40, 4, 40), (3, 0, 0, None, None), (12, 5, 40, 5, 40), (12, 0, 65535, 0, 0),
])  # fmt: skip
def test_mission_items_are_counted_as_ours_and_an_empty_mission_is_unknown(
    autopilot, seq, total, index, count
):
    message = mavlink.MAVLink_mission_current_message(seq, total, 3, 1)
    (event,) = heard(message, autopilot=autopilot)
    assert (event.index, event.total, event.in_mission) == (index, count, True)


# --- the clock -----------------------------------------------------------------------------------


@pytest.fixture
def clock() -> AutopilotClock:
    """A clock whose latest time stamp is 100 s."""
    made = AutopilotClock()
    assert made.update_from_boot_time(100.0).t_s == 100.0, (
        "core time is the autopilot's time since boot"
    )
    return made


def test_one_wild_stamp_moves_nothing(clock):
    assert clock.update_from_boot_time(99_999.0).t_s is None
    assert clock.update_from_boot_time(3.0).t_s is None
    reading = clock.update_from_boot_time(100.1)
    assert (reading.t_s, reading.step_back_s, reading.step_forward_s) == (
        pytest.approx(100.1),
        0.0,
        0.0,
    )


def test_a_late_message_keeps_its_own_time_and_moves_nothing(clock):
    assert clock.update_from_boot_time(99.6).t_s == pytest.approx(99.6)
    assert clock.t_s == 100.0


@given(st.lists(st.floats(0.0, 1e6), min_size=1, max_size=60))
@settings(max_examples=200, deadline=None)
def test_whatever_the_stamps_core_time_never_goes_back(stamps):
    clock, last = AutopilotClock(), 0.0
    for stamp in stamps:
        clock.update_from_boot_time(stamp)
        assert clock.t_s >= last
        last = clock.t_s


@pytest.mark.parametrize(
    ("stamps_s", "back_s", "ahead_s", "now_s"),
    [
        ([3.0 + 0.1 * i for i in range(6)], [96.8], [], 100.3),  # a reboot is reported once
        ([160.0 + 0.1 * i for i in range(4)], [], [60.2], 160.3),  # time passes in a telemetry gap
        ([4.2e6 + 0.1 * i for i in range(4)], [], [4.2e6 - 99.8], 100.1),  # the clock is wrong
        ([21_700.0 + 0.1 * i for i in range(4)], [], [21_600.2], 100.1),
    ],
)
def test_core_time_goes_on_after_a_reboot_and_a_silence(clock, stamps_s, back_s, ahead_s, now_s):
    readings = [clock.update_from_boot_time(stamp_s) for stamp_s in stamps_s]
    assert [r.step_back_s for r in readings if r.step_back_s] == pytest.approx(back_s)
    assert [r.step_forward_s for r in readings if r.step_forward_s] == pytest.approx(ahead_s)
    assert clock.t_s == pytest.approx(now_s)


@pytest.mark.parametrize("gap_s", [0.1, 1.0, 60.0])
def test_the_32_bit_wrap_of_the_time_since_boot_is_no_step(gap_s):
    clock, wrap_s = AutopilotClock(), 2.0**32 / 1000.0
    stamps = [wrap_s - 1.0 + 0.1 * k for k in range(10)]
    stamps += [stamps[-1] + gap_s + 0.1 * k for k in range(10)]
    readings = [clock.update_from_boot_time(round(s % wrap_s, 3)) for s in stamps]
    assert not any(reading.step_back_s for reading in readings)
    assert clock.t_s == pytest.approx(stamps[-1], abs=0.02)
    late = clock.update_from_boot_time(round((stamps[-1] - 0.5) % wrap_s, 3))
    assert late.t_s == pytest.approx(stamps[-1] - 0.5, abs=0.02)
    rebooted = [clock.update_from_boot_time(3.0 + 0.1 * k) for k in range(4)]
    is_wrap = stamps[-1] - wrap_s < 2.0  # 3 s after boot is a gap of some seconds then
    assert any(reading.step_back_s for reading in rebooted) is not is_wrap


@pytest.mark.parametrize("modulus_s", [2.0**32 / 1e9, 2.0**32 / 1e6])
def test_a_wrap_of_timesync_neither_steps_nor_stops_the_clock(modulus_s):
    clock = AutopilotClock()
    for k in range(200):
        assert clock.update_from_boot_time(100.0 + 0.1 * k).step_back_s == 0.0
        clock.update_from_sync_time((100.05 + 0.1 * k) % modulus_s)
        assert clock.t_s == pytest.approx(100.0 + 0.1 * k, abs=0.31)


def test_timesync_that_counts_otherwise_never_fakes_a_reboot():
    clock = AutopilotClock()
    for i in range(50):
        assert clock.update_from_boot_time(3.0 + 0.1 * i).step_back_s == 0.0
        clock.update_from_sync_time(1e6 + 0.1 * i)
    assert clock.t_s == pytest.approx(7.9, abs=0.2)


@pytest.mark.parametrize("late_s", [0.0, 0.5, 1.1, 1.9])
def test_a_late_first_answer_leaves_telemetry_as_old_as_it_is(late_s):
    """Flown with ArduPilot on a busy machine: the first TIMESYNC response was late. A second one
    would make all positions appear as old as that delay: position lost.
    """
    clock = AutopilotClock()
    clock.update_from_sync_time(33.0)
    for stamp in range(340 + round(late_s * 10), 560):
        clock.update_from_boot_time(stamp / 10.0)
    before_s = clock.t_s
    clock.update_from_sync_time(56.0)
    assert clock.t_s - before_s <= 0.1
    for stamp in range(560, 570):
        reading = clock.update_from_boot_time(stamp / 10.0)
    assert reading.t_s == pytest.approx(clock.t_s, abs=0.3)


def test_a_count_that_was_laid_late_catches_up_with_the_other():
    clock = AutopilotClock()
    clock.update_from_sync_time(33.0)
    clock.update_from_boot_time(34.5)  # its own time stamp is 1.5 s after that response
    for tenth in range(346, 380):
        clock.update_from_boot_time(tenth / 10.0)
        if tenth % 10 == 6:
            clock.update_from_sync_time(tenth / 10.0)  # responses are now immediate, at 1 Hz
    assert clock.update_from_boot_time(38.0).t_s == pytest.approx(clock.t_s, abs=0.3)
    assert clock.t_s < 38.0 + 0.3


def test_one_late_message_lays_no_count_anew():
    clock = AutopilotClock()
    for tenth in range(100, 200):
        clock.update_from_boot_time(tenth / 10.0)
        if tenth % 20 == 0:
            assert clock.update_from_boot_time(tenth / 10.0 - 0.9).t_s == pytest.approx(
                tenth / 10.0 - 0.9
            )
    assert clock.t_s == pytest.approx(19.9)


@pytest.mark.parametrize(("stamp_s", "now_s"), [(4.0, 110.0), (115.0, 115.0)])
def test_after_a_restart_core_time_starts_no_earlier_than_the_checkpoint(stamp_s, now_s):
    clock = AutopilotClock()
    clock.set_minimum_start_time(110.0)
    clock.update_from_boot_time(stamp_s)  # 4 s: the autopilot rebooted in the gap
    assert clock.t_s == now_s


def test_the_port_tells_of_steps():
    back = [attitude(3000 + 100 * i) for i in range(5)]
    ahead = [attitude(round(1e3 * (9 + STEP_THRESHOLD_S)) + 100 * i) for i in range(5)]
    events = heard(attitude(500_000), *back, *ahead)
    assert sum(isinstance(e, ev.ClockSteppedBack) for e in events) == 1
    assert sum(isinstance(e, ev.ClockJumpedForward) for e in events) == 1


# --- signing -------------------------------------------------------------------------------------

KEY = bytes(range(32))


def test_with_a_key_only_rightly_signed_frames_are_heard():
    codec = MavlinkCodec(datagrams=True, signing_key=KEY)
    forger = sender(key=bytes(32))
    forger.signing.timestamp += 10**9  # a future time stamp must not block the true sender
    for mav in (sender(), sender(key=bytes(32)), forger):
        assert codec.parse_valid_messages(frame(mav, attitude(1))) == []
    signed = frame(sender(key=KEY), attitude(1))
    assert len(codec.parse_valid_messages(signed)) == 1
    assert codec.parse_valid_messages(signed) == [], "a replay"


def test_what_goes_out_is_signed_and_pymavlink_believes_it():
    codec = MavlinkCodec(datagrams=True, signing_key=KEY)
    listener = sender(key=KEY)
    heard = listener.parse_buffer(codec.pack(heartbeat()))
    assert heard is not None
    assert heard[0].get_type() == "HEARTBEAT"


def test_a_new_key_takes_the_place_of_none_that_is_there(tmp_path):
    write_signing_key(tmp_path / "key", KEY)
    with pytest.raises(LeewayError, match="File exists"):
        write_signing_key(tmp_path / "key", bytes(32))
    assert read_signing_key(tmp_path / "key") == KEY


@pytest.mark.parametrize(
    ("content", "mode", "words"),
    [
        (KEY, 0o600, ""),
        (KEY.hex().encode() + b"\n", 0o600, ""),
        (b"no key", 0o600, "expected 32 bytes"),
        (None, 0o600, "key"),
        *((KEY, mode, "group or others may read it") for mode in (0o640, 0o604, 0o660, 0o666)),
    ],
)
def test_a_key_file_holds_32_bytes_or_64_digits_that_only_its_owner_reads(
    tmp_path, content, mode, words
):
    path = tmp_path / "key"
    if content is not None:
        path.write_bytes(content)
        path.chmod(mode)
    if not words:
        assert read_signing_key(path) == KEY
        return
    with pytest.raises(LeewayError, match=words):
        read_signing_key(path)


def test_a_key_may_lie_among_systemds_credentials(tmp_path, monkeypatch):
    named = Path("${CREDENTIALS_DIRECTORY}/key")
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    with pytest.raises(LeewayError, match="LoadCredential"):
        read_signing_key(named)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    write_signing_key(tmp_path / "key", KEY)
    assert read_signing_key(named) == KEY


def restarted(folder: Path) -> tuple[MavlinkCodec, SigningStampStore]:
    codec = MavlinkCodec(datagrams=True, signing_key=KEY)
    return codec, SigningStampStore(folder, codec)


def signed_ago(seconds: float) -> bytes:
    mav = sender(key=KEY)
    mav.signing.timestamp -= round(seconds * 1e5)
    return frame(mav, attitude(1))


def heard_before_a_restart(folder: Path) -> bytes:
    """Return a frame 50 s old; a later frame of its stream was received and stored."""
    write_json_atomically(folder / STAMPS_NAME, {"9/9/9": 1})  # of an earlier process
    codec, stamps = restarted(folder)
    old = signed_ago(50.0)
    assert len(codec.parse_valid_messages(old)) == 1
    assert len(codec.parse_valid_messages(signed_ago(1.0))) == 1
    write = stamps.take_due_write(0.0)
    assert write is not None
    write()
    assert stamps.take_due_write(0.5) is None
    return old


def test_a_frame_of_50_s_ago_is_refused_after_a_restart_too(tmp_path):
    old = heard_before_a_restart(tmp_path)
    codec, _ = restarted(tmp_path)
    assert codec.parse_valid_messages(old) == []
    assert len(codec.parse_valid_messages(signed_ago(0.0))) == 1


@pytest.mark.parametrize("record", ["absent", "torn", "empty"])
@pytest.mark.parametrize("guarded", [True, False], ids=["refused", "canary: received again"])
def test_without_its_stamps_a_restart_refuses_a_frame_of_50_s_ago(
    tmp_path, monkeypatch, record, guarded
):
    if not guarded:
        monkeypatch.setattr(MavlinkCodec, "refuse_streams_signed_before_start", lambda self: None)
    old, path = heard_before_a_restart(tmp_path), tmp_path / STAMPS_NAME
    content = path.read_bytes()
    path.unlink()
    if record != "absent":
        path.write_bytes(content[:40] if record == "torn" else b"")
    codec, stamps = restarted(tmp_path)
    assert len(codec.parse_valid_messages(old)) == (0 if guarded else 1)
    assert len(codec.parse_valid_messages(signed_ago(0.0))) == 1
    line = "frames signed before this start are refused"
    assert (line in stamps.error_text) is (record != "absent")
    assert "\n" not in stamps.error_text


# --- links ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "url", ["udp", "udpin:localhost", "tcp:host:x", "udpin:h:0", "udpin:h:70000", "ftp:h:1", ""]
)
def test_a_link_url_that_is_none_says_what_one_looks_like(url):
    with pytest.raises(LeewayError, match=r"expected"):
        open_link(url)


def test_a_listening_link_answers_only_whom_it_is_told_to():
    link = UdpLink("127.0.0.1", 0, listen=True)
    try:
        here = link.address
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
            peer.settimeout(2.0)
            peer.sendto(b"hello", here)
            incoming = link.receive(2.0)
            assert incoming is not None
            assert incoming.data == b"hello"
            link.send(b"lost")
            link.set_reply_peer(incoming.peer)
            link.send(b"answer")
            assert peer.recv(100) == b"answer"
    finally:
        link.close()


def test_a_calling_link_survives_that_nobody_listens_yet():
    link = open_link("udpout:127.0.0.1:9")
    try:
        for _ in range(5):
            link.send(b"anybody?")
        assert link.receive(0.05) is None
    finally:
        link.close()


def test_tcp_calls_again_after_the_line_broke():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        link = TcpLink("127.0.0.1", server.getsockname()[1])
        try:
            for word in (b"one", b"two"):
                line, _ = server.accept()
                line.sendall(word)
                incoming = link.receive(3.0)
                assert incoming is not None
                assert incoming.data == word
                line.close()
        finally:
            link.close()


def test_after_settling_all_that_had_arrived_waits_in_the_queue():
    link = UdpLink("127.0.0.1", 0, listen=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for _ in range(200):
            other.sendto(b"x", link.address)
        link.wait_until_arrived_data_queued()
        assert link.queued_chunk_count() == 200
    link.close()


# --- a port that another client holds ------------------------------------------------------------


def test_a_udp_port_that_another_client_holds_is_told_with_what_to_do():
    first = UdpLink("127.0.0.1", 0, listen=True)
    try:
        with pytest.raises(LeewayError, match=r"another client uses this port.*--out"):
            open_link(f"udpin:127.0.0.1:{first.address[1]}")
    finally:
        first.close()


def test_a_tcp_port_that_nobody_answers_is_told_with_what_to_do(monkeypatch):
    monkeypatch.setattr(link_module, "CONNECT_TIMEOUT_S", 0.0)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(LeewayError, match=r"another client uses.*5762.*--out"):
        open_link(f"tcp:127.0.0.1:{port}")


def test_a_serial_port_that_another_companion_holds_is_told_with_what_to_do():
    master, slave = os.openpty()
    url = f"serial:{os.ttyname(slave)}:57600"
    first = open_link(url)
    try:
        with pytest.raises(LeewayError, match=r"another program uses it.*--out"):
            open_link(url)
    finally:
        first.close()
        os.close(slave)
        os.close(master)


def test_a_link_without_a_thread_to_read_it_stays_shut_and_gives_its_port_back(monkeypatch):
    with monkeypatch.context() as patch:

        def no_thread(thread: threading.Thread) -> None:
            raise RuntimeError("can't start new thread")

        patch.setattr(threading.Thread, "start", no_thread)
        with pytest.raises(LinkClosedError, match=r"reader thread.*can't start new thread"):
            open_link("udpin:127.0.0.1:14998")
    open_link("udpin:127.0.0.1:14998").close()
