"""Faults about who flies: lost acknowledgements, people who disarm and take over."""

from collections.abc import Iterator

from sim_bridge.app.faults.case import FaultCase
from sim_bridge.app.faults.people import Station
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import (
    comes_home,
    hands_off,
    stays_disarmed,
    tells,
)
from sim_bridge.app.link.tap import Change, as_it_is, with_fields
from sim_bridge.autopilot.mavlink.codec import Message

ARM_DISARM = 400
ARMED_FLAG = 128

TOLD_PILOT_S = 0.3
"""A mode change by the pilot is told at once: the exchange that carries it, and the next."""

TOLD_S = 1.2
"""Disarming is told in the next heartbeat, within a second, and the exchange that carries it."""

FLYING = ("climb", "outbound", "drop", "return")


def _loses(name: str, command: int | None = None) -> Change:
    def change(message: Message) -> list[Message] | None:
        lost = message.msg_name == name and command in (None, message.command)
        return [] if lost else None

    return change


def arm_ack_lost(stage: Stage) -> Iterator[None]:
    """The acknowledgement of ARM never comes; a person disarms soon after arming."""
    stage.tap.to_companion = _loses("COMMAND_ACK", ARM_DISARM)
    station = Station(stage)
    yield from stage.until(lambda: stage.armed)
    yield from stage.wait(stage.rng.uniform(0.3, 1.5))
    stage.begin()
    station.disarm(by_force=True)
    stage.taken_over(TOLD_S)


def acks_lost(stage: Stage) -> Iterator[None]:
    """No acknowledgement of a command comes any more; then the pilot takes over."""
    yield from stage.reached()
    stage.tap.to_companion = _loses("COMMAND_ACK")
    yield from stage.wait(stage.rng.uniform(1.0, 6.0))
    stage.craft.pilot_takes_over()
    stage.taken_over(TOLD_PILOT_S)


def false_disarmed(stage: Stage) -> Iterator[None]:
    """One heartbeat says disarmed, and a second of silence follows."""
    yield from stage.reached()
    told: list[Message] = []

    def change(message: Message) -> list[Message] | None:
        if told or message.msg_name != "HEARTBEAT":
            return [] if told else None
        told.append(message)
        return [with_fields(message, base_mode=message.base_mode & ~ARMED_FLAG)]

    stage.tap.to_companion = change
    yield from stage.until(lambda: bool(told))
    yield from stage.wait(1.0)
    stage.tap.to_companion = as_it_is


def kill_switch(stage: Stage) -> Iterator[None]:
    """Somebody stops the motors, in the air."""
    station = Station(stage)
    yield from stage.reached()
    station.disarm(by_force=True)
    stage.taken_over(TOLD_S)


GROUP = "authority"
CASES = (
    FaultCase(
        1,
        "arm-ack-lost",
        GROUP,
        "the acknowledgement of ARM is lost; a person disarms 0.3 to 1.5 s after arming",
        arm_ack_lost,
        (hands_off, stays_disarmed),
        ("ready",),
        ends_after_s=20.0,
    ),
    FaultCase(
        2,
        "acks-lost",
        GROUP,
        "every acknowledgement is lost, then the pilot takes over",
        acks_lost,
        (hands_off,),
        (*FLYING, "land"),
        ends_after_s=15.0,
    ),
    FaultCase(
        7,
        "false-disarmed",
        GROUP,
        "one false heartbeat says disarmed, and a second of silence follows",
        false_disarmed,
        (comes_home,),
        FLYING,
    ),
    FaultCase(
        9,
        "kill-switch",
        GROUP,
        "the motors are stopped in the air: told within 2.5 s, and nothing is commanded",
        kill_switch,
        (hands_off, tells("hands off", "disarm", within_s=2.5)),
        FLYING,
        ends_after_s=15.0,
    ),
)
