"""False autopilot frames: a receiver accepts each of them, and a seed determines the sequence."""

import math

import numpy as np
import pytest

from sim_bridge.app.link.message_mutation import (
    FIELD_MUTATIONS,
    INT_BITS,
    MUTATIONS,
    MessageMutator,
    integer_limits,
    wrap_or_clip_to_type,
)
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from sim_bridge.autopilot.mavlink.message_table import SPECS


def heard(message: Message, component: int = 1) -> Message:
    """Return the message as received from the autopilot."""
    (arrived,) = Decoder().decode_bytes(Encoder(1, component).encode_next_frame(message))
    return arrived


def telemetry() -> list[Message]:
    fields = {"roll": 0.1, "pitch": 0.2, "yaw": 3.0, "rollspeed": 0.0, "pitchspeed": 0.0}
    attitude = Message("ATTITUDE", time_boot_ms=1000, yawspeed=0.0, **fields)
    beat = Message("HEARTBEAT", type=2, autopilot=12, base_mode=209, custom_mode=7, system_status=4)
    text = Message("STATUSTEXT", severity=4, text="armed")
    return [heard(attitude), heard(beat), heard(text)]


def frames(liar: MessageMutator, rounds: int) -> list[bytes]:
    encoder = Encoder(1, 1)
    told = [
        liar.mutate_random_share_of_messages(message)
        for _ in range(rounds)
        for message in telemetry()
    ]
    return [encoder.encode_next_frame(one) for many in told if many is not None for one in many]


@pytest.mark.parametrize("deed", MUTATIONS)
def test_every_lie_is_a_whole_frame(deed):
    liar = MessageMutator(np.random.default_rng(1), 1.0, (deed,), active=True)
    told = frames(liar, 60)
    assert all(len(Decoder().decode_bytes(frame)) == 1 for frame in told)
    assert bool(told) == (deed != "lost")


def test_any_message_can_be_made_up():
    liar = MessageMutator(np.random.default_rng(2), 1.0, ("inserted",), active=True)
    names = {
        Decoder().decode_bytes(Encoder(1, 1).encode_next_frame(liar.random_message()))[0].msg_name
        for _ in range(1500)
    }
    assert names == set(SPECS)


def test_the_same_seed_tells_the_same_lies():
    one, same, other = (
        frames(MessageMutator(np.random.default_rng(seed), 0.5, MUTATIONS, active=True), 40)
        for seed in (3, 3, 4)
    )
    assert one == same != other


def test_before_and_after_its_time_and_of_other_senders_it_tells_the_truth():
    liar = MessageMutator(np.random.default_rng(1), 1.0, MUTATIONS)
    (attitude, beat, _) = telemetry()
    assert liar.mutate_random_share_of_messages(beat) is None
    assert liar.passed_mode == 7
    liar.active = True
    assert liar.mutate_random_share_of_messages(heard(beat, component=190)) is None
    liar.names = ("HEARTBEAT",)
    assert liar.mutate_random_share_of_messages(attitude) is None
    assert liar.changed_count == 0
    assert liar.mutate_random_share_of_messages(beat) is not None
    assert liar.changed_count == 1


@pytest.mark.parametrize("kind", [*INT_BITS, "f32", "f64"])
@pytest.mark.parametrize("deed", FIELD_MUTATIONS)
def test_a_wrong_number_still_fits_its_type(kind, deed):
    rng = np.random.default_rng(5)
    for _ in range(50):
        value = FIELD_MUTATIONS[deed](rng, kind, 100)
        if kind in INT_BITS:
            low, high = integer_limits(kind)
            assert low <= value <= high
        elif kind == "f32":
            assert not math.isfinite(value) or abs(value) <= 3.403e38


def test_a_number_that_overflows_wraps_around():
    assert wrap_or_clip_to_type("u8", -1) == 255
    assert wrap_or_clip_to_type("i16", 40_000) == 40_000 - 65_536
