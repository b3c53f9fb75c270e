"""Faults of a signed link: replayed frames and a wrong wall clock."""

from collections.abc import Iterator
from itertools import cycle, islice

from sim_bridge.app.faults.fault import (
    AIRBORNE_PHASES_BEFORE_LANDING,
    SAFETY_RULES,
    FaultGroup,
    expect_startup_effect,
)
from sim_bridge.app.faults.host import kill_companion_and_restart_if
from sim_bridge.app.faults.verdict import (
    check_control_retained,
    check_delivered,
    check_procedure_made_note,
)
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.link.tap import INJECTED, MessageChange, pass_unchanged
from sim_bridge.app.world.companion_link import COMMAND_MESSAGES, COMPANION_LINK
from sim_bridge.autopilot.mavlink.codec import Message

FAULTS = FaultGroup("link")

ONE_HOUR_S = 3600
REPORT_MESSAGES = {
    "HEARTBEAT",
    "MISSION_CURRENT",
    "EXTENDED_SYS_STATE",
    "BATTERY_STATUS",
    "COMMAND_ACK",
}
"""Messages whose replay would indicate a disarm, mode change, landing or energy increase."""

REPLAYED_PER_EXCHANGE = 4
"""Replayed frames in each direction and exchange of 0.1 s: as many as a busy link carries."""

REPLAY_REFUSED_NOTE = "the autopilot refused replayed frames"
CLOCK_OFFSET_FILE = "clock_off_s"


@FAULTS.register_procedure(
    54,
    "replayed-frames",
    AIRBORNE_PHASES_BEFORE_LANDING,
    (
        *SAFETY_RULES,
        check_delivered,
        check_control_retained,
        check_procedure_made_note(REPLAY_REFUSED_NOTE),
    ),
    signed=True,
)
def replay_signed_frames_both_directions(stage: FaultContext) -> Iterator[None]:
    """Signed link: all reports and commands since power-up are replayed in both directions."""
    reports: list[bytes] = []
    commands: list[bytes] = []
    stage.tap.to_companion = _build_frame_recorder(reports, REPORT_MESSAGES)
    stage.tap.to_autopilot = _build_frame_recorder(commands, COMMAND_MESSAGES)
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_messages_changed(INJECTED)
    replayed_reports, replayed_commands = cycle(list(reports)), cycle(list(commands))
    while True:
        stage.tap.injected_frames += islice(replayed_reports, REPLAYED_PER_EXCHANGE)
        for frame in islice(replayed_commands, REPLAYED_PER_EXCHANGE):
            stage.craft.autopilot.process_received_datagram(COMPANION_LINK, frame)
        _note_if_replay_refused(stage)
        yield


def _build_frame_recorder(frames: list[bytes], message_names: set[str]) -> MessageChange:
    """Return a tap that records the frames of these messages and changes none."""

    def record_frame(message: Message) -> list[Message] | None:
        if message.msg_name in message_names:
            frames.append(message.wire_bytes)
        return pass_unchanged(message)

    return record_frame


def _note_if_replay_refused(stage: FaultContext) -> None:
    """Note that the autopilot refuses correctly signed frames that it has received before."""
    counts = stage.craft.autopilot.radio.links[COMPANION_LINK].decoder.counts
    if counts.rejected and not stage.notes:
        stage.notes.append(REPLAY_REFUSED_NOTE)


CLOCK_OFFSET_CODE = f"""\
import pathlib, sys, time
OFF_S = pathlib.Path(sys.argv[-1]) / "{CLOCK_OFFSET_FILE}"
def off(real=time.time_ns):
    if not OFF_S.exists():
        return real()
    record_fault_effect()
    return real() + int(OFF_S.read_text()) * 10**9
time.time_ns = off
"""
"""Adds the seconds in the run folder's `clock_offset_s`, if present, to the companion's wall clock.
"""


def step_companion_wall_clock(clock_offset_s: int) -> FaultProcedure:
    """Return a procedure: the wall clock steps in flight, as at a time server's first reply."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        _write_clock_offset_file(stage, clock_offset_s)

    return procedure


def restart_companion_with_clock_offset(clock_offset_s: int) -> FaultProcedure:
    """Return a procedure: restart with a clock error, as of a computer without a clock battery."""
    return kill_companion_and_restart_if(
        restarts=True, during_outage=lambda stage: _write_clock_offset_file(stage, clock_offset_s)
    )


def _write_clock_offset_file(stage: FaultContext, clock_offset_s: int) -> None:
    expect_startup_effect(stage)
    (stage.craft.run_dir / CLOCK_OFFSET_FILE).write_text(str(clock_offset_s))


for name, direction, clock_offset_s in (
    ("ahead", "forward", ONE_HOUR_S),
    ("back", "back", -ONE_HOUR_S),
):
    FAULTS.add_case(
        45,
        f"clock-steps-{name}",
        f"Signed link: the companion's wall clock is set {direction} by an hour in flight.",
        step_companion_wall_clock(clock_offset_s),
        AIRBORNE_PHASES_BEFORE_LANDING,
        (*SAFETY_RULES, check_delivered),
        before_companion=CLOCK_OFFSET_CODE,
        signed=True,
    )
for name, rate, clock_offset_s in (("ahead", "fast", ONE_HOUR_S), ("behind", "slow", -ONE_HOUR_S)):
    FAULTS.add_case(
        45,
        f"back-an-hour-{name}",
        "Signed link: the companion is killed in flight and restarts with its clock an hour"
        f" {rate}.",
        restart_companion_with_clock_offset(clock_offset_s),
        AIRBORNE_PHASES_BEFORE_LANDING,
        before_companion=CLOCK_OFFSET_CODE,
        signed=True,
    )
