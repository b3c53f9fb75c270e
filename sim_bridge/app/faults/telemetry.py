"""A sensor's failure as the companion meets it: in what the autopilot tells of it.

The kinds are those that PX4 can inject into its sensors: off, stuck, garbage, slow, delayed,
intermittent (what is wrong by a fixed amount has rows of its own). The autopilot itself is well.
"""

from collections.abc import Iterator

from sim_bridge.app.faults.case import SAFE, FaultCase, Play
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import tells
from sim_bridge.app.link.tap import Change, with_fields
from sim_bridge.autopilot.mavlink.codec import Message

Ranges = dict[str, tuple[float, float]]
TOLD: dict[str, dict[str, Ranges]] = {
    "attitude": {
        "ATTITUDE": {
            "roll": (-1.0, 1.0),
            "pitch": (-1.0, 1.0),
            "yaw": (-3.0, 3.0),
        },
    },
    "position": {
        "GLOBAL_POSITION_INT": {
            "lat": (554_600_000, 554_800_000),
            "lon": (84_400_000, 84_600_000),
            "alt": (0, 100_000),
            "relative_alt": (-20_000, 100_000),
            "vx": (-1500, 1500),
            "vy": (-1500, 1500),
            "vz": (-500, 500),
        },
    },
    "battery": {
        "BATTERY_STATUS": {
            "current_battery": (0, 9000),
            "current_consumed": (0, 6000),
            "battery_remaining": (0, 100),
        },
        "SYS_STATUS": {
            "voltage_battery": (18_000, 25_000),
            "current_battery": (0, 9000),
            "battery_remaining": (0, 100),
        },
    },
}
"""What the autopilot tells of it: messages, and the fields that fail with a sensor's own range."""

SLOW_S = 2.0
DELAYED_S = 2.0
AWAY_S, BACK_S = 3.0, 3.0
"""Intermittent: so long away, so long back."""


def off(stage: Stage, told: dict[str, Ranges]) -> Change:
    """It is never told again."""
    del stage
    return lambda message: [] if message.msg_name in told else None


def stuck(stage: Stage, told: dict[str, Ranges]) -> Change:
    """The value of the first moment, with fresh times."""
    del stage
    first: dict[str, Message] = {}

    def change(message: Message) -> list[Message] | None:
        if message.msg_name not in told:
            return None
        then = first.setdefault(message.msg_name, message)
        same = {name: getattr(then, name) for name in told[message.msg_name]}
        return [with_fields(message, **same)]

    return change


def garbage(stage: Stage, told: dict[str, Ranges]) -> Change:
    """Any value of the sensor's range, another one each time."""

    def change(message: Message) -> list[Message] | None:
        if message.msg_name not in told:
            return None
        drawn = {n: stage.rng.uniform(*span) for n, span in told[message.msg_name].items()}
        if message.msg_name != "ATTITUDE":
            drawn = {name: round(value) for name, value in drawn.items()}
        return [with_fields(message, **drawn)]

    return change


def slow(stage: Stage, told: dict[str, Ranges]) -> Change:
    """Told once in two seconds."""
    last_s: dict[str, float] = {}

    def change(message: Message) -> list[Message] | None:
        name = message.msg_name
        if name not in told:
            return None
        if stage.t_s - last_s.get(name, -SLOW_S) < SLOW_S:
            return []
        last_s[name] = stage.t_s
        return None

    return change


def intermittent(stage: Stage, told: dict[str, Ranges]) -> Change:
    """Away for three seconds, back for three."""
    began_s = stage.t_s

    def change(message: Message) -> list[Message] | None:
        away = (stage.t_s - began_s) % (AWAY_S + BACK_S) < AWAY_S
        return [] if message.msg_name in told and away else None

    return change


def fails(what: str, kind: str) -> Play:
    """From now on it fails in this way, for good."""
    told = TOLD[what]

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        if kind == "delayed":
            stage.tap.hold_back_s |= dict.fromkeys(told, DELAYED_S)
        else:
            stage.tap.to_companion = KINDS[kind](stage, told)

    return play


KINDS = {
    "off": off,
    "stuck": stuck,
    "garbage": garbage,
    "slow": slow,
    "intermittent": intermittent,
}
SAYS = {
    "off": "is told no more",
    "stuck": "is told as it was, with fresh times",
    "garbage": "is any value of its sensor's range, each time another",
    "slow": "is told once in two seconds",
    "delayed": "is told two seconds late",
    "intermittent": "is away for three seconds, back for three",
}
NUMBERS = {"attitude": 37, "position": 36, "battery": 26}
GROUPS = {
    "attitude": "air and sensors",
    "position": "air and sensors",
    "battery": "energy",
}
MUST_TELL = {
    ("attitude", "off"): ("no fresh attitude",),
    ("position", "off"): ("position lost",),
    ("battery", "off"): ("no fresh battery reading",),
}
"""What is told no more has to be missed, and the operator to hear it."""

CASES = tuple(
    FaultCase(
        NUMBERS[what],
        f"{what}-{kind}",
        GROUPS[what],
        f"{what} {words}, for good",
        fails(what, kind),
        (*SAFE, *map(tells, MUST_TELL.get((what, kind), ()))),
        ("outbound",),
    )
    for what in TOLD
    for kind, words in SAYS.items()
)
