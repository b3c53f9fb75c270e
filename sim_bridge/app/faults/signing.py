"""Faults of a link that is signed: frames that are sent again, and a wall clock that is wrong."""

from collections.abc import Iterator
from itertools import cycle, islice

from sim_bridge.app.faults.case import FLYING, SAFE, FaultCase, Play
from sim_bridge.app.faults.host import killed
from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import delivers, notes, stays_in_hand
from sim_bridge.app.flight.vehicle_process import COMMANDING, COMPANION_LINK
from sim_bridge.app.link.tap import Change, as_it_is
from sim_bridge.autopilot.mavlink.codec import Message

HOUR_S = 3600
TELLING = {"HEARTBEAT", "MISSION_CURRENT", "EXTENDED_SYS_STATE", "BATTERY_STATUS", "COMMAND_ACK"}
"""What the companion would take for a disarm, another mode, a landing, or energy that rises."""

AT_ONCE = 4
"""Old frames each way in each exchange of 0.1 s: as many as a busy link carries new ones."""

REFUSED = "the autopilot refused what was sent again"
CLOCK_FILE = "clock_off_s"


def replayed(stage: Stage) -> Iterator[None]:
    """Who listened since power-up sends it all again: orders, and what the autopilot told."""
    told: list[bytes] = []
    ordered: list[bytes] = []
    stage.tap.to_companion = _recorded(told, TELLING)
    stage.tap.to_autopilot = _recorded(ordered, COMMANDING)
    yield from stage.reached()
    again_told, again_ordered = cycle(list(told)), cycle(list(ordered))
    while True:
        stage.tap.added += islice(again_told, AT_ONCE)
        for frame in islice(again_ordered, AT_ONCE):
            stage.craft.autopilot.receive(COMPANION_LINK, frame)
        _note_refusals(stage)
        yield


def _recorded(frames: list[bytes], names: set[str]) -> Change:
    """Keeps the frames of these messages, and changes none."""

    def keep(message: Message) -> list[Message] | None:
        if message.msg_name in names:
            frames.append(message.wire_bytes)
        return as_it_is(message)

    return keep


def _note_refusals(stage: Stage) -> None:
    """The autopilot refuses what is signed rightly, and was heard before."""
    counts = stage.craft.autopilot.radio.links[COMPANION_LINK].decoder.counts
    if counts.rejected and not stage.notes:
        stage.notes.append(REFUSED)


CLOCK_STEPS = f"""\
import pathlib, sys, time
OFF_S = pathlib.Path(sys.argv[-1]) / "{CLOCK_FILE}"
def off(real=time.time_ns):
    return real() + (int(OFF_S.read_text()) * 10**9 if OFF_S.exists() else 0)
time.time_ns = off
"""
"""The companion's wall clock is right until its run folder says by how much it is not."""


def clock_steps(off_s: int) -> Play:
    """The wall clock is set in flight, as by the first answer of a time server."""

    def play(stage: Stage) -> Iterator[None]:
        yield from stage.reached()
        _set_clock(stage, off_s)

    return play


def back_with_clock(off_s: int) -> Play:
    """Killed; as it is back its wall clock is off, as of a computer without a clock's battery."""
    return killed(comes_back=True, meanwhile=lambda stage: _set_clock(stage, off_s))


def _set_clock(stage: Stage, off_s: int) -> None:
    (stage.craft.run_dir / CLOCK_FILE).write_text(str(off_s))


GROUP = "link"
CASES = (
    FaultCase(
        45,
        "clock-steps-ahead",
        GROUP,
        "signed; the companion's wall clock is set an hour ahead in flight",
        clock_steps(HOUR_S),
        (*SAFE, delivers),
        FLYING,
        before_companion=CLOCK_STEPS,
        signed=True,
    ),
    FaultCase(
        45,
        "clock-steps-back",
        GROUP,
        "signed; the companion's wall clock is set back by an hour in flight",
        clock_steps(-HOUR_S),
        (*SAFE, delivers),
        FLYING,
        before_companion=CLOCK_STEPS,
        signed=True,
    ),
    FaultCase(
        45,
        "back-an-hour-ahead",
        GROUP,
        "signed; killed in mid-air, and back with a wall clock that is an hour ahead",
        back_with_clock(HOUR_S),
        SAFE,
        FLYING,
        before_companion=CLOCK_STEPS,
        signed=True,
    ),
    FaultCase(
        45,
        "back-an-hour-behind",
        GROUP,
        "signed; killed in mid-air, and back with a wall clock that is an hour behind",
        back_with_clock(-HOUR_S),
        SAFE,
        FLYING,
        before_companion=CLOCK_STEPS,
        signed=True,
    ),
    FaultCase(
        54,
        "replayed-frames",
        GROUP,
        "signed; everything that was told and ordered since power-up is sent again, both ways",
        replayed,
        (*SAFE, delivers, stays_in_hand, notes(REFUSED)),
        FLYING,
        signed=True,
    ),
)
