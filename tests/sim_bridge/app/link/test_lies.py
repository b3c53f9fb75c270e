"""Lies of an autopilot: each is a frame that a receiver takes, and the same seed tells the same."""

import math

import numpy as np
import pytest

from sim_bridge.app.link.lies import DEEDS, FIELD_DEEDS, INT_BITS, Liar, fitted, limits
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from sim_bridge.autopilot.mavlink.message_table import SPECS


def heard(message: Message, component: int = 1) -> Message:
    """As it arrives from the autopilot."""
    (arrived,) = Decoder().feed(Encoder(1, component).encode(message))
    return arrived


def telemetry() -> list[Message]:
    fields = {"roll": 0.1, "pitch": 0.2, "yaw": 3.0, "rollspeed": 0.0, "pitchspeed": 0.0}
    attitude = Message("ATTITUDE", time_boot_ms=1000, yawspeed=0.0, **fields)
    beat = Message("HEARTBEAT", type=2, autopilot=12, base_mode=209, custom_mode=7, system_status=4)
    text = Message("STATUSTEXT", severity=4, text="armed")
    return [heard(attitude), heard(beat), heard(text)]


def frames(liar: Liar, rounds: int) -> list[bytes]:
    encoder = Encoder(1, 1)
    told = [liar.change(message) for _ in range(rounds) for message in telemetry()]
    return [encoder.encode(one) for many in told if many is not None for one in many]


@pytest.mark.parametrize("deed", DEEDS)
def test_every_lie_is_a_whole_frame(deed):
    liar = Liar(np.random.default_rng(1), 1.0, (deed,), active=True)
    told = frames(liar, 60)
    assert all(len(Decoder().feed(frame)) == 1 for frame in told)
    assert bool(told) == (deed != "lost")


def test_any_message_can_be_made_up():
    liar = Liar(np.random.default_rng(2), 1.0, ("inserted",), active=True)
    names = {Decoder().feed(Encoder(1, 1).encode(liar.made_up()))[0].msg_name for _ in range(1500)}
    assert names == set(SPECS)


def test_the_same_seed_tells_the_same_lies():
    one, same, other = (
        frames(Liar(np.random.default_rng(seed), 0.5, DEEDS, active=True), 40) for seed in (3, 3, 4)
    )
    assert one == same != other


def test_before_and_after_its_time_and_of_other_senders_it_tells_the_truth():
    liar = Liar(np.random.default_rng(1), 1.0, DEEDS)
    (attitude, beat, _) = telemetry()
    assert liar.change(beat) is None
    assert liar.passed_mode == 7
    liar.active = True
    assert liar.change(heard(beat, component=190)) is None
    liar.names = ("HEARTBEAT",)
    assert liar.change(attitude) is None
    assert liar.told == 0
    assert liar.change(beat) is not None
    assert liar.told == 1


@pytest.mark.parametrize("kind", [*INT_BITS, "f32", "f64"])
@pytest.mark.parametrize("deed", FIELD_DEEDS)
def test_a_wrong_number_still_fits_its_type(kind, deed):
    rng = np.random.default_rng(5)
    for _ in range(50):
        value = FIELD_DEEDS[deed](rng, kind, 100)
        if kind in INT_BITS:
            low, high = limits(kind)
            assert low <= value <= high
        elif kind == "f32":
            assert not math.isfinite(value) or abs(value) <= 3.403e38


def test_a_number_that_overflows_wraps_around():
    assert fitted("u8", -1) == 255
    assert fitted("i16", 40_000) == 40_000 - 65_536
