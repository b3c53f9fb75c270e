"""The tap on the companion's link: frames that it passes, drops, changes and delays."""

import pytest

from sim_bridge.app.link.tap import SlowLine, Tap, message_with_changed_fields
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message


@pytest.fixture
def autopilot() -> Encoder:
    return Encoder(1, 1)


def heartbeat(base_mode: int = 209) -> Message:
    return Message(
        "HEARTBEAT",
        type=2,
        autopilot=12,
        base_mode=base_mode,
        custom_mode=0,
        system_status=4,
        mavlink_version=3,
    )


def named(frames: list[bytes]) -> list[str]:
    return [message.msg_name for frame in frames for message in Decoder().decode_bytes(frame)]


def test_untouched_frames_pass_byte_for_byte(autopilot):
    frames = [
        autopilot.encode_next_frame(heartbeat()),
        autopilot.encode_next_frame(Message("MISSION_CURRENT", seq=3)),
    ]
    assert Tap().transmit_to_companion(frames, 0.0) == frames
    assert Tap().transmit_to_autopilot(b"".join(frames)) == b"".join(frames)


def test_a_changed_message_comes_from_the_same_sender_with_one_field_changed(autopilot):
    tap = Tap(to_companion=lambda message: [message_with_changed_fields(message, base_mode=81)])
    (frame,) = tap.transmit_to_companion([autopilot.encode_next_frame(heartbeat())], 0.0)
    (message,) = Decoder().decode_bytes(frame)
    assert (message.src_system, message.src_component) == (1, 1)
    assert message == heartbeat(81)


def test_a_lost_message_is_gone_and_its_neighbours_are_not(autopilot):
    def lose(message: Message) -> list[Message] | None:
        return [] if message.msg_name == "HEARTBEAT" else None

    frames = [
        autopilot.encode_next_frame(heartbeat()),
        autopilot.encode_next_frame(Message("MISSION_CURRENT", seq=3)),
    ]
    assert Tap(to_companion=lose).transmit_to_companion(frames, 0.0) == frames[1:]
    assert Tap(to_autopilot=lose).transmit_to_autopilot(b"".join(frames)) == frames[1]


def test_what_is_held_back_comes_later_and_once(autopilot):
    tap = Tap(delay_s_by_name={"MISSION_CURRENT": 2.0})
    frames = [
        autopilot.encode_next_frame(heartbeat()),
        autopilot.encode_next_frame(Message("MISSION_CURRENT", seq=3)),
    ]
    assert tap.transmit_to_companion(frames, 10.0) == frames[:1]
    assert tap.transmit_to_companion([], 11.9) == []
    assert tap.transmit_to_companion([], 12.0) == frames[1:]
    assert tap.transmit_to_companion([], 13.0) == []


def test_added_frames_reach_the_companion_once(autopilot):
    tap, frame = Tap(), autopilot.encode_next_frame(heartbeat())
    tap.injected_frames.append(frame)
    assert named(tap.transmit_to_companion([], 0.0)) == ["HEARTBEAT"]
    assert tap.transmit_to_companion([], 0.1) == []


def test_a_slow_radio_carries_its_bytes_in_order_and_loses_what_its_buffer_cannot_hold(autopilot):
    frames = [autopilot.encode_next_frame(Message("MISSION_CURRENT", seq=k)) for k in range(1, 6)]
    size = len(frames[0])
    tap = Tap(radio=SlowLine(bytes_per_s=10.0 * size, buffer_bytes=3 * size))
    assert tap.transmit_to_companion(frames, 1.0) == []
    assert tap.transmit_to_companion([], 1.1) == frames[:1]
    assert tap.transmit_to_companion([], 1.3) == frames[1:3]
    assert tap.transmit_to_companion(frames[:1], 9.0) == []  # a silent line accumulates no capacity
    assert tap.transmit_to_companion([], 9.15) == frames[:1]
