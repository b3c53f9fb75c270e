"""Garbage, foreign senders and wild numbers: the autopilot responds correctly, or not at all."""

import math
import random

import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_bridge.autopilot.base.geodesy import LocalFrame
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.autopilot.mavlink.codec import Encoder, Message
from sim_bridge.autopilot.mavlink.enums import Cmd
from sim_bridge.autopilot.mavlink.message_table import SPECS

AP, PX4 = AutopilotKind.ARDUPILOT, AutopilotKind.PX4
BOTH = pytest.mark.parametrize("autopilot", [AP, PX4])


@BOTH
def test_random_bytes_do_nothing(make_rig, autopilot):
    rig = make_rig(autopilot)
    rig.step(0.2)
    noise = random.Random(7)
    for _ in range(200):
        rig.ap.process_received_datagram(0, noise.randbytes(noise.randrange(1, 300)))
    rig.step(0.2)
    assert not rig.ap.is_armed


@BOTH
def test_truncated_and_damaged_frames_do_nothing(make_rig, autopilot):
    rig = make_rig(autopilot)
    rig.step(0.2)
    rig.set_mode(Mode.GUIDED if autopilot is AP else Mode.HOLD)
    fields = {f"param{i}": 0.0 for i in range(2, 8)}
    frame = Encoder(255, 190).encode_next_frame(
        Message(
            "COMMAND_LONG",
            target_system=1,
            target_component=1,
            command=400,
            confirmation=0,
            param1=1.0,
            **fields,
        )
    )
    for at in range(len(frame)):
        rig.ap.process_received_datagram(0, frame[:at])
        rig.ap.process_received_datagram(
            0, frame[:at] + bytes([frame[at] ^ 0x10]) + frame[at + 1 :]
        )
    assert not rig.ap.is_armed
    rig.ap.process_received_datagram(0, frame)
    assert rig.ap.is_armed


@BOTH
@pytest.mark.parametrize(("system", "component"), [(2, 1), (1, 191), (255, 190)])
def test_what_is_meant_for_others_is_left_alone(make_rig, autopilot, system, component):
    rig = make_rig(autopilot)
    rig.step(0.2)
    rig.companion_heartbeat()
    rig.set_mode(Mode.GUIDED if autopilot is AP else Mode.HOLD)
    rig.forget()
    params = {f"param{i}": 0.0 for i in range(2, 8)}
    rig.send(
        "COMMAND_LONG",
        target_system=system,
        target_component=component,
        command=400,
        confirmation=0,
        param1=1.0,
        **params,
    )
    rig.send("MISSION_COUNT", target_system=system, target_component=component, count=3)
    assert not rig.ap.is_armed
    assert [m.msg_name for m in rig.hear() if m.msg_name != "HEARTBEAT"] == []


@BOTH
def test_messages_between_others_are_passed_on_between_links(make_rig, autopilot):
    rig = make_rig(autopilot)
    rig.ap.add_link(1)
    rig.step(0.1)
    heartbeat = {"type": 18, "autopilot": 8, "base_mode": 0, "custom_mode": 0, "system_status": 4}
    companion = Encoder(1, 191)
    rig.ap.process_received_datagram(
        1, companion.encode_next_frame(Message("HEARTBEAT", **heartbeat))
    )
    rig.gcs_heartbeat()
    rig.ap.take_frames_to_send()
    params = {f"param{i}": 0.0 for i in range(1, 8)}
    rig.send(
        "COMMAND_LONG",
        target_system=1,
        target_component=191,
        command=31010,
        confirmation=0,
        **params,
    )
    assert any(link == 1 for link, _ in rig.ap.take_frames_to_send())


@BOTH
def test_a_dead_link_that_nobody_reads_only_loses_messages(make_rig, autopilot):
    rig = make_rig(autopilot)
    rig.ap.add_link(7)
    rig.step(1.0)
    rig.ap.drop_link(7)
    rig.ap.take_frames_to_send()
    rig.step(1.0)
    assert all(link == 0 for link, _ in rig.ap.take_frames_to_send())


WILD = st.one_of(
    st.floats(width=32),
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1.0, -1.0, 3.4e38, 2147483648.0]),
)
NUMBERS = st.one_of(
    st.integers(0, 65535),
    st.sampled_from([int(number) for number in Cmd]),
)
_RIGS = {}


def shared_rig(make_rig, autopilot):
    """Return one flying rig for all examples: none of them may break it."""
    if autopilot not in _RIGS:
        _RIGS[autopilot] = make_rig(autopilot)
        _RIGS[autopilot].take_off(10.0)
    return _RIGS[autopilot]


@BOTH
@settings(max_examples=60, deadline=None, suppress_health_check=[])
@given(number=NUMBERS, params=st.lists(WILD, min_size=7, max_size=7))
def test_no_command_with_whatever_numbers_breaks_it(make_rig_class, autopilot, number, params):
    rig = shared_rig(make_rig_class, autopilot)
    rig.command(number, *params)
    rig.send(
        "COMMAND_INT",
        frame=6,
        command=number,
        current=0,
        autocontinue=0,
        **{f"param{i + 1}": params[i] for i in range(4)},
        x=2**31 - 1,
        y=-(2**31),
        z=params[6],
    )
    rig.step(0.06)
    assert math.isfinite(rig.ap.actuation.thrust_frac)


ITEMS = st.lists(
    st.fixed_dictionaries(
        {
            "command": st.sampled_from([16, 17, 19, 20, 21, 22, 93, 112, 115, 177, 178, 211, 183]),
            "frame": st.sampled_from([0, 2, 3, 5, 6, 10]),
            "param1": WILD,
            "param2": WILD,
            "param3": WILD,
            "param4": WILD,
            "x": st.sampled_from([0, 554_700_000, 554_705_000, 2**31 - 1, -(2**31)]),
            "y": st.sampled_from([0, 84_500_000, 2**31 - 1]),
            "z": WILD,
        }
    ),
    min_size=1,
    max_size=5,
)


@BOTH
@settings(max_examples=60, deadline=None, suppress_health_check=[])
@given(items=ITEMS)
def test_no_mission_with_whatever_numbers_breaks_it(make_rig_class, autopilot, items):
    rig = shared_rig(make_rig_class, autopilot)
    rig.upload(items)
    for message in rig.download():
        assert message.msg_name == "MISSION_ITEM_INT"
    rig.set_mode(Mode.AUTO)
    for seq in range(3):
        rig.send("MISSION_SET_CURRENT", seq=seq)
        rig.step(0.06)
    assert math.isfinite(rig.ap.actuation.thrust_frac)


@BOTH
def test_every_message_that_it_can_stream_can_be_built_at_any_moment(make_rig, autopilot):
    rig = make_rig(autopilot, boot_age_s=0.0)
    rig.step(0.02)
    for name in rig.ap.behaviour.streams:
        rig.command(511, SPECS[name].id, 100_000)
        rig.command(512, SPECS[name].id)
    rig.step(0.3)
    rig.vehicle.sensors.gnss_outage = True
    rig.vehicle.sensors.voltage_failed = True
    rig.step(0.3)
    assert rig.hear()


@BOTH
def test_timesync_is_answered_and_lockstep_answers_are_noted(make_rig, autopilot):
    rig = make_rig(autopilot)
    rig.step(0.5)
    rig.send("TIMESYNC", tc1=0, ts1=123456789)
    answer = rig.last("TIMESYNC")
    assert answer.ts1 == 123456789
    assert answer.tc1 == pytest.approx(rig.ap.state.time_boot_ns, abs=1_000_000)
    rig.ap.send_timesync_request(0, 700_000_000)
    request = rig.last("TIMESYNC")
    assert (request.tc1, request.ts1) == (0, 700_000_000)
    rig.send("TIMESYNC", sender=(1, 191), tc1=5, ts1=700_000_000)
    assert rig.ap.last_timesync_echo_by_sender[0, 1, 191] == 700_000_000


@pytest.mark.parametrize("place", [(55.47, 8.45, 12.0), (-33.9, 151.2, 40.0), (0.0, 0.0, 0.0)])
def test_metres_and_degrees_agree_with_pymap3d(place):
    frame = LocalFrame(*place)
    for north, east in ((0.0, 0.0), (120.0, -45.0), (5_000.0, 8_000.0), (-20_000.0, 30_000.0)):
        lat, lon = frame.to_lat_lon_deg(north, east)
        reference = pymap3d.geodetic2ned(lat, lon, place[2], *place)
        assert (north, east) == pytest.approx((float(reference[0]), float(reference[1])), abs=2e-3)
        assert frame.to_ne_m(lat, lon) == pytest.approx((north, east), abs=2e-3)


@BOTH
def test_the_same_inputs_give_the_same_frames(make_rig, autopilot):
    frames = []
    for _ in range(2):
        rig = make_rig(autopilot)
        rig.take_off(5.0)
        rig.hear()
        frames.append([m.wire_bytes for m in rig.heard])
    assert frames[0] == frames[1]
