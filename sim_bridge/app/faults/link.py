"""Faults of the link between autopilot and companion: loss, silence, strangers."""

from collections.abc import Iterator

import numpy as np

from sim_bridge.app.faults.case import FLYING, SAFE, FaultCase, Play
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import delivers
from sim_bridge.app.link.bad_link import BadLink
from sim_bridge.app.link.tap import SlowLine
from sim_bridge.autopilot.mavlink.codec import Message

SHARE = 0.3
RADIO_BYTES_PER_S = 5760.0  # 57,600 baud, ten bits a byte
RADIO_BUFFER_BYTES = 2048  # as of the 3DR/SiK radios' firmware
FOR_EVER_S = 1e9
TIME = "TIMESYNC"  # what simulated time stands still for: not the link's


def lossy(stage: Stage) -> Iterator[None]:
    """Of all messages, both ways, 30 % are lost and 30 % doubled; attitude is late at times."""
    yield from stage.reached()
    rng, tap = stage.rng, stage.tap

    def change(message: Message) -> list[Message] | None:
        if message.msg_name == TIME:
            return None
        return [message] * int(rng.choice([0, 1, 2], p=[SHARE, 1.0 - 2.0 * SHARE, SHARE]))

    tap.to_companion = tap.to_autopilot = change
    while True:
        late = rng.random() < SHARE
        tap.hold_back_s = {"ATTITUDE": rng.uniform(0.1, 0.4)} if late else {}
        yield


def silent(duration_s: float) -> Play:
    """The autopilot is not heard, and does not hear."""

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        stage.craft.link_silent_until_s = stage.craft.t_s + duration_s

    return play


def slow_radio(stage: Stage) -> Iterator[None]:
    """A radio of 57,600 baud lies between autopilot and companion; what does not fit is lost."""
    yield from stage.reached()
    stage.tap.radio = SlowLine(RADIO_BYTES_PER_S, RADIO_BUFFER_BYTES)


def strangers(stage: Stage) -> Iterator[None]:
    """Garbage, torn frames, other systems and fields without meaning between the messages."""
    yield from stage.reached()
    seed = int(stage.rng.integers(2**31))
    stage.craft.bad_link = BadLink(stage.craft.number, np.random.default_rng(seed))


GROUP = "link"
CASES = (
    FaultCase(
        50,
        "lossy-link",
        GROUP,
        "30 % of all messages are lost, 30 % doubled; attitude is late at times",
        lossy,
        SAFE,
        FLYING,
    ),
    FaultCase(
        51,
        "silence-1-s",
        GROUP,
        "a second of silence",
        silent(1.0),
        (*SAFE, delivers),
        FLYING,
    ),
    FaultCase(
        51,
        "silence-10-s",
        GROUP,
        "ten seconds of silence",
        silent(10.0),
        SAFE,
        FLYING,
    ),
    FaultCase(
        51,
        "silence-60-s",
        GROUP,
        "a minute of silence",
        silent(60.0),
        SAFE,
        FLYING,
    ),
    FaultCase(
        51,
        "silence-for-good",
        GROUP,
        "silence for good: the mission aboard brings it home",
        silent(FOR_EVER_S),
        SAFE,
        FLYING,
    ),
    FaultCase(
        52,
        "strangers",
        GROUP,
        "garbage, torn frames, other systems and fields without meaning",
        strangers,
        (*SAFE, delivers),
        ("ready", *FLYING),
    ),
    FaultCase(
        55,
        "slow-radio",
        GROUP,
        "the companion hears the autopilot through a radio of 57,600 baud",
        slow_radio,
        SAFE,
        ("ready", *FLYING),
    ),
)
