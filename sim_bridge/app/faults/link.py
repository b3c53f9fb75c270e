"""Faults of the link between autopilot and companion: loss, silence, strangers."""

from collections.abc import Iterator

import numpy as np

from sim_bridge.app.faults.case import FLYING, IN_THE_AIR, SAFE, FaultCase, Play
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import delivers
from sim_bridge.app.link.bad_link import BadLink
from sim_bridge.app.link.lies import FIELD_DEEDS, Liar
from sim_bridge.app.link.tap import SlowLine, as_it_is
from sim_bridge.autopilot.mavlink.codec import Encoder, Message

SHARE = 0.3
RADIO_BYTES_PER_S = 5760.0  # 57,600 baud, ten bits a byte
RADIO_BUFFER_BYTES = 2048  # as of the 3DR/SiK radios' firmware
OTHER_MODE = {"px4": 3 << 16, "ardupilot": 5}  # POSCTL, LOITER
AUTOPILOT = {"px4": 12, "ardupilot": 3}
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


def namesake(stage: Stage) -> Iterator[None]:
    """A neighbour with our system id is heard too: in another mode, a kilometre away."""
    yield from stage.reached()
    namesake, craft = Encoder(stage.craft.number, 1), stage.craft
    custom_mode = OTHER_MODE[craft.autopilot_kind]
    lat_deg, lon_deg = (craft.depot.lat_deg or 0.0) + 0.009, craft.depot.lon_deg or 0.0
    while True:
        beat = Message(
            "HEARTBEAT",
            type=2,
            autopilot=AUTOPILOT[craft.autopilot_kind],
            base_mode=209,
            custom_mode=custom_mode,
            system_status=4,
            mavlink_version=3,
        )
        place = Message(
            "GLOBAL_POSITION_INT",
            time_boot_ms=craft.autopilot.time_boot_ms,
            lat=round(lat_deg * 1e7),
            lon=round(lon_deg * 1e7),
            alt=80_000,
            relative_alt=68_000,
            vx=0,
            vy=0,
            vz=0,
            hdg=0,
        )
        stage.tap.added += [namesake.encode(beat), namesake.encode(place)]
        yield from stage.wait(1.0)


def strangers(stage: Stage) -> Iterator[None]:
    """Garbage, torn frames, other systems and fields without meaning between the messages."""
    yield from stage.reached()
    seed = int(stage.rng.integers(2**31))
    stage.craft.bad_link = BadLink(stage.craft.number, np.random.default_rng(seed))


def fields_mutated(stage: Stage) -> Iterator[None]:
    """For some seconds one message in twenty has up to three fields that are anything else."""
    yield from stage.reached()
    liar = Liar(stage.rng, MUTATED_SHARE, tuple(FIELD_DEEDS), active=True)
    stage.tap.to_companion = liar.change
    yield from stage.wait(stage.rng.uniform(*MUTATED_FOR_S))
    stage.tap.to_companion = as_it_is


MUTATED_SHARE = 0.05
MUTATED_FOR_S = (3.0, 10.0)

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
        IN_THE_AIR,
    ),
    FaultCase(
        51,
        "silence-10-s",
        GROUP,
        "ten seconds of silence",
        silent(10.0),
        SAFE,
        IN_THE_AIR,
    ),
    FaultCase(
        51,
        "silence-60-s",
        GROUP,
        "a minute of silence",
        silent(60.0),
        SAFE,
        IN_THE_AIR,
    ),
    FaultCase(
        51,
        "silence-for-good",
        GROUP,
        "silence for good: the mission aboard brings it home",
        silent(FOR_EVER_S),
        SAFE,
        IN_THE_AIR,
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
        53,
        "fields-mutated",
        GROUP,
        "for 3 to 10 s one message in twenty has fields that are extreme, NaN, off, or anything",
        fields_mutated,
        SAFE,
        IN_THE_AIR,
    ),
    FaultCase(
        8,
        "namesake",
        GROUP,
        "a neighbour with our system id is heard on our link: in another mode, a kilometre away",
        namesake,
        SAFE,
        FLYING,
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
