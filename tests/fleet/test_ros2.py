"""ROS 2 messages of the bridge, read by rosbags, ros2-pyterfaces and zenoh-ros2-sdk."""

import json
import math
import threading
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st

from ground_station.adapters.ros2_session import RosSession
from ground_station.core.fleet.ros2_messages import (
    DIAGNOSTICS,
    FLOAT64,
    TWIST,
    TYPE_HASHES,
    RosMessage,
    diagnostics_message,
    topic_name_of,
    vehicle_messages,
)
from tests.fleet.programs import program
from tests.fleet.secure_site import SecureSite
from tests.fleet.zenoh_net import FLEET, free_port
from tests.ground_station.desk_parts import a_state

rosbags = pytest.importorskip("rosbags.typesys")
STORE = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
NAMES = {
    TWIST: "geometry_msgs/msg/TwistWithCovarianceStamped",
    FLOAT64: "std_msgs/msg/Float64",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
EPOCH_US = 1_782_907_200_123_456
NUMBERS = st.floats(-1e6, 1e6)
STATES = st.builds(
    a_state,
    vehicle=st.sampled_from(("d1", "drone-7", "7th")),
    phase=st.sampled_from(("standby", "outbound", "return")),
    order=st.none() | st.sampled_from(("H-1", "Order_17.b")),
    margin_wh=st.none() | NUMBERS,
    p_home=st.none() | st.floats(0.0, 1.0),
    p_success=st.none() | st.floats(0.0, 1.0),
    voltage_v=st.none() | NUMBERS,
    energy_left_wh=st.none() | NUMBERS,
    wind_to_n_mps=NUMBERS,
    wind_to_e_mps=NUMBERS,
    wind_cov_m2ps2=st.tuples(NUMBERS, NUMBERS, NUMBERS),
)


def read(message: RosMessage) -> Any:
    """Decode with rosbags, and compare the bytes that it would write."""
    found = STORE.deserialize_cdr(message.cdr, NAMES[message.type_name])
    assert bytes(STORE.serialize_cdr(found, NAMES[message.type_name])) == message.cdr
    return found


def test_type_hashes_are_those_of_the_definitions():
    for type_name, name in NAMES.items():
        assert STORE.hash_rihs01(name) == TYPE_HASHES[type_name]


@settings(max_examples=80, deadline=None)
@given(STATES)
def test_wind_and_values_are_read_by_rosbags(state):
    by_topic = {m.topic: m for m in vehicle_messages(state, EPOCH_US)}
    prefix = f"leeway/{topic_name_of(state.vehicle)}"
    wind = read(by_topic.pop(f"{prefix}/wind"))
    assert (wind.header.stamp.sec, wind.header.stamp.nanosec) == (1_782_907_200, 123_456_000)
    assert wind.header.frame_id == "map"
    linear = wind.twist.twist.linear
    assert (linear.x, linear.y, linear.z) == (state.wind_to_e_mps, state.wind_to_n_mps, 0.0)
    nn, ne, ee = state.wind_cov_m2ps2
    assert [wind.twist.covariance[k] for k in (0, 1, 6, 7)] == [ee, ne, ne, nn]
    assert math.isclose(sum(map(abs, wind.twist.covariance)), abs(ee) + 2 * abs(ne) + abs(nn))
    for name in ("margin_wh", "p_home", "p_success", "energy_left_wh"):
        message = by_topic.pop(f"{prefix}/{name}", None)
        assert (None if message is None else read(message).data) == getattr(state, name)
    assert not by_topic


@settings(max_examples=80, deadline=None)
@given(st.lists(st.tuples(STATES, st.booleans()), max_size=3), st.sampled_from((1e-4, 0.01)))
def test_diagnostics_are_read_by_rosbags(states, max_loss):
    newest = {state.vehicle: (state, stale) for state, stale in states}
    found = read(diagnostics_message(newest, EPOCH_US, max_loss))
    assert [one.hardware_id for one in found.status] == sorted(newest)
    for one in found.status:
        state, is_stale = newest[one.hardware_id]
        is_low = state.p_home is not None and state.p_home < 1.0 - max_loss
        is_negative = state.margin_wh is not None and state.margin_wh <= 0.0
        assert one.level == (3 if is_stale else 2 if is_low else 1 if is_negative else 0)
        values = {pair.key: pair.value for pair in one.values}
        assert values["phase"] == state.phase
        assert values.get("order") == state.order


def test_bytes_equal_those_of_ros2_pyterfaces():
    others = pytest.importorskip("ros2_pyterfaces.cyclone.all_msgs")
    state = a_state(
        phase="return", margin_wh=-2.5, p_home=0.42, wind_to_n_mps=3.0, wind_to_e_mps=-4.0
    )
    messages = [*vehicle_messages(state, EPOCH_US)]
    messages.append(diagnostics_message({"d1": (state, False)}, EPOCH_US, 0.01))
    assert len(messages) == 4
    for message in messages:
        kind = getattr(others, NAMES[message.type_name].rsplit("/", 1)[1])
        assert bytes(kind.deserialize(message.cdr).serialize()) == message.cdr


class Router:
    """A zenoh router, as ROS 2's `rmw_zenohd` is one."""

    def __init__(self, port: int) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"router"')
        config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(config)

    def close(self) -> None:
        self.session.close()


def until(condition, within_s: float = 20.0) -> None:
    end_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end_s
        threading.Event().wait(0.1)


@pytest.mark.sample
def test_another_program_for_ros_2_lists_and_receives_the_topics():
    sdk = pytest.importorskip("zenoh_ros2_sdk")
    port, received = free_port(), []
    state = a_state(p_home=0.75, wind_to_n_mps=3.0, wind_to_e_mps=-4.0)
    with (
        closing(Router(port)),
        closing(RosSession(f"tcp/127.0.0.1:{port}", 0, is_humble=False)) as ros,
    ):
        subscriber = sdk.ROS2Subscriber(
            "/leeway/d1/p_home",
            NAMES[FLOAT64],
            received.append,
            msg_definition="float64 data",
            router_ip="127.0.0.1",
            router_port=port,
        )
        assert subscriber.type_hash == TYPE_HASHES[FLOAT64]

        def publish_until_received() -> bool:
            for message in vehicle_messages(state, EPOCH_US):
                ros.publish(message, EPOCH_US)
            return bool(received)

        until(publish_until_received)
        assert received[0].data == 0.75
        listed = dict(sdk.get_topic_names_and_types(router_ip="127.0.0.1", router_port=port))
        assert listed["/leeway/d1/wind"] == [NAMES[TWIST]]
        assert listed["/leeway/d1/p_home"] == [NAMES[FLOAT64]]
        subscriber.close()


@pytest.mark.sample
def test_the_bridge_publishes_what_a_fleet_says_and_survives_its_router(tmp_path: Path):
    site, port = SecureSite(tmp_path / "pki"), free_port()
    levels: list[int] = []

    def listen(router: Router):
        def keep(sample: zenoh.Sample) -> None:
            (status,) = STORE.deserialize_cdr(
                sample.payload.to_bytes(), NAMES[DIAGNOSTICS]
            ).status or [None]
            if status is not None:
                assert status.hardware_id == "d1"
                levels.append(status.level)

        key = f"7/diagnostics/{DIAGNOSTICS}/{TYPE_HASHES[DIAGNOSTICS]}"
        return router.session.declare_subscriber(key, keep)

    options = ("--fleet", FLEET, "--identity", site.home("otto"), "--domain", "7")
    with closing(site.person("desk")):
        router = Router(port)
        listen(router)
        with program("ros2", *options, "--ros", f"tcp/127.0.0.1:{port}") as bridge:
            with closing(site.vehicle("d1", tmp_path / "d1")):
                bridge.said("d1: first state")
                until(lambda: 0 in levels)
                router.close()
                levels.clear()
                router = Router(port)
                listen(router)
                until(lambda: 0 in levels)
            until(lambda: 3 in levels)  # not heard for 10 s
            assert bridge.end() == 0
        router.close()
