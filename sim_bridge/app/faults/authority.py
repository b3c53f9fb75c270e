"""Faults of flight authority: lost acknowledgements, disarming, takeovers, two computers."""

import threading
from collections.abc import Iterator
from pathlib import Path

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.computers import (
    SECOND_REFUSED_NOTE,
    connect_payload_computer,
    copy_run_dir_to_sibling,
    expect_payload_heartbeats,
    run_second_companion_while_first_stalls,
    send_onboard_computer_heartbeat,
)
from sim_bridge.app.faults.fault import AIRBORNE_PHASES, AIRBORNE_PHASES_BEFORE_LANDING, FaultGroup
from sim_bridge.app.faults.verdict import (
    check_alert_sent,
    check_delivered,
    check_disarmed_at_end,
    check_landed_intact_by_pilot,
    check_no_commands_after_takeover,
    check_procedure_made_note,
    check_returned_home,
    check_returned_if_p_home_was_high,
)
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.link.client_messages import (
    COMPANION_COMPONENT,
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    MODE_PARAMS,
)
from sim_bridge.app.link.tap import MessageChange, message_with_changed_fields, pass_unchanged
from sim_bridge.app.world.station import Station
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd, ModeFlag

FAULTS = FaultGroup("authority")

ARMED_FLAG = 128

DISARM_REPORTED_S = 1.2
"""Latency of a disarm report: a heartbeat interval of 1 s and the exchange that carries it."""


def _build_message_dropper(message_name: str, command: int | None = None) -> MessageChange:
    def drop_if_matching(message: Message) -> list[Message] | None:
        lost = message.msg_name == message_name and command in (None, message.command)
        return [] if lost else None

    return drop_if_matching


@FAULTS.register_procedure(
    1,
    "arm-ack-lost",
    ("ready",),
    (check_no_commands_after_takeover, check_disarmed_at_end),
    ends_after_s=20.0,
)
def drop_arm_ack_then_disarm_by_person(stage: FaultContext) -> Iterator[None]:
    """The acknowledgement of ARM is lost, and a person disarms 0.3 to 1.5 s after arming, but not
    before a heartbeat has reported it: otherwise nothing shows the person's command.
    """
    stage.expect_messages_changed("COMMAND_ACK")
    drop_ack = _build_message_dropper("COMMAND_ACK", Cmd.COMPONENT_ARM_DISARM)
    armed_reports: list[float] = []

    def drop_ack_and_watch_heartbeats(message: Message) -> list[Message] | None:
        if message.msg_name == "HEARTBEAT" and message.base_mode & ModeFlag.ARMED:
            armed_reports.append(stage.t_s)
        return drop_ack(message)

    stage.tap.to_companion = drop_ack_and_watch_heartbeats
    station = Station(stage.craft.link)
    yield from stage.wait_until(lambda: stage.is_armed)
    yield from stage.wait(stage.rng.uniform(0.3, 1.5))
    yield from stage.wait_until(lambda: bool(armed_reports))
    stage.expect_effect("the vehicle is disarmed", lambda: not stage.is_armed)
    stage.record_fault_start()
    station.send_disarm_command(by_force=True)
    stage.record_take_over(DISARM_REPORTED_S)


@FAULTS.register_procedure(
    2,
    "acks-lost",
    AIRBORNE_PHASES_BEFORE_LANDING,
    (check_no_commands_after_takeover,),
    ends_after_s=15.0,
)
def drop_all_acks_then_take_over(stage: FaultContext) -> Iterator[None]:
    """All acknowledgements are lost, then the pilot takes over during the retries."""
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_messages_changed("COMMAND_ACK")
    stage.tap.to_companion = _build_message_dropper("COMMAND_ACK")
    yield from stage.wait_until(lambda: stage.tap.changed_counts["COMMAND_ACK"] > 0)
    yield from stage.wait(stage.rng.uniform(0.1, 4.0))
    stage.take_over_by_pilot()


@FAULTS.register_procedure(
    2,
    "pilot-lands",
    ("outbound", "drop", "return"),
    (
        check_no_commands_after_takeover,
        check_alert_sent(Alert.CONTROL_RELEASED),
        check_landed_intact_by_pilot,
    ),
)
def take_over_and_land_by_pilot(stage: FaultContext) -> Iterator[None]:
    """The pilot takes over and lands on the spot: truth and companion report no loss."""
    if stage.craft.autopilot_kind == "ardupilot":
        Station(stage.craft.link).send_parameter_to_autopilot("FLTMODE6", LOITER_MODE_NUMBER)
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.take_over_by_pilot()
    yield from stage.wait(PILOT_HOVER_S)
    stage.craft.set_pilot_throttle(throttle_us=THROTTLE_DOWN)
    yield from stage.wait_until(lambda: stage.craft.record.landed_s is not None)
    stage.craft.set_pilot_throttle(throttle_us=THROTTLE_OFF)


LOITER_MODE_NUMBER = 5.0
PILOT_HOVER_S = 3.0
"""Time from the takeover to the pilot's descent."""

THROTTLE_DOWN, THROTTLE_OFF = 1300, 1100
"""Throttle PWM: descent at half the pilot's maximum rate; off, on the ground."""


@FAULTS.register_procedure(
    7, "false-disarmed", AIRBORNE_PHASES, (check_returned_home, check_delivered)
)
def report_disarmed_once_then_silence(stage: FaultContext) -> Iterator[None]:
    """One false heartbeat reports disarmed, followed by one second of silence."""
    yield from stage.wait_for_phase_and_record_fault_start()
    altered: list[Message] = []

    def alter_first_heartbeat_then_drop_all(message: Message) -> list[Message] | None:
        if altered or message.msg_name != "HEARTBEAT":
            return [] if altered else None
        altered.append(message)
        return [message_with_changed_fields(message, base_mode=message.base_mode & ~ARMED_FLAG)]

    stage.expect_messages_changed("HEARTBEAT")
    stage.tap.to_companion = alter_first_heartbeat_then_drop_all
    yield from stage.wait_until(lambda: bool(altered))
    yield from stage.wait(1.0)
    stage.tap.to_companion = pass_unchanged


@FAULTS.register_procedure(
    9,
    "kill-switch",
    ("ready", *AIRBORNE_PHASES),
    (
        check_no_commands_after_takeover,
        check_alert_sent(Alert.CONTROL_RELEASED, Alert.DISARMED_IN_AIR, within_s=2.5),
    ),
    ends_after_s=15.0,
)
def force_disarm_by_station(stage: FaultContext) -> Iterator[None]:
    """The motors are stopped: an alert within 2.5 s and no further commands."""
    station = Station(stage.craft.link)
    yield from stage.wait_for_phase_and_record_fault_start()
    yield from stage.wait_until(lambda: stage.is_armed)
    stage.expect_effect("the motors are stopped", lambda: not stage.is_armed)
    stage.record_fault_start()
    station.send_disarm_command(by_force=True)
    stage.record_take_over(DISARM_REPORTED_S)


CLOCK_WITHOUT_SUSPENSION = """\
import time
def monotonic(clock_s=time.monotonic, last=[0.0, 0.0]):
    now_s = clock_s()
    last[1] += now_s - last[0] if now_s - last[0] > 0.4 else 0.0
    last[0] = now_s
    return now_s - last[1]
time.monotonic = monotonic
"""
"""Python code: the loop reads the clock ten times a second, so a longer gap is a suspension."""

SUSPENSION_WALL_S = 0.8


def stall_companion_during_takeover(duration_s: float) -> FaultProcedure:
    """Return a procedure: the companion process is stopped, and the pilot takes over meanwhile."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        takeover_delay_s = stage.rng.uniform(0.1, 0.9) * duration_s
        stage.stall_companion()
        yield from stage.wait(takeover_delay_s)
        stage.take_over_by_pilot()
        yield from stage.wait(duration_s - takeover_delay_s)
        stage.resume_companion()

    return procedure


@FAULTS.register_procedure(
    73,
    "computer-suspends",
    AIRBORNE_PHASES_BEFORE_LANDING,
    (check_no_commands_after_takeover, check_alert_sent(Alert.CONTROL_RELEASED)),
    before_companion=CLOCK_WITHOUT_SUSPENSION,
    ends_after_s=20.0,
)
def suspend_computer_during_takeover(stage: FaultContext) -> Iterator[None]:
    """The computer is suspended for 10 s, CLOCK_MONOTONIC stands still, a pilot takes over (A11).

    Before, another station moves home: received telemetry of the suspension calls for a command.
    """
    station, autopilot = Station(stage.craft.link), stage.craft.autopilot
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_effect("a pilot has control", lambda: autopilot.is_under_external_control)
    stage.stall_companion()
    yield from stage.wait(6.0)
    station.send_set_home_at_offset(stage.craft.depot, up_m=25.0)
    takeover_before_end_s = stage.rng.uniform(0.3, 0.7)
    yield from stage.wait(4.0 - takeover_before_end_s)
    stage.craft.start_pilot_override()
    stage.record_take_over()
    yield from stage.wait(takeover_before_end_s)
    threading.Event().wait(SUSPENSION_WALL_S)  # simulated time is faster
    stage.resume_companion()


def _same_run_dir(run_dir: Path) -> Path:
    return run_dir


def _unused_sibling_run_dir(run_dir: Path) -> Path:
    return run_dir.with_name(f"{run_dir.name}-second")


@FAULTS.register_procedure(
    5,
    "payload-computer",
    ("ready", *AIRBORNE_PHASES_BEFORE_LANDING),
    (check_returned_home, check_delivered, check_returned_if_p_home_was_high),
)
def send_payload_heartbeats_forever(stage: FaultContext) -> Iterator[None]:
    """Another onboard computer (component 192) sends heartbeats, which have no effect."""
    payload = connect_payload_computer(stage)
    yield from stage.wait_for_phase_and_record_fault_start()
    expect_payload_heartbeats(stage)
    while True:
        send_onboard_computer_heartbeat(payload)
        yield from stage.wait(1.0)


@FAULTS.register_procedure(
    5,
    "payload-computer-flies",
    AIRBORNE_PHASES_BEFORE_LANDING,
    (
        check_returned_home,
        check_no_commands_after_takeover,
        check_alert_sent(Alert.PASSIVE, within_s=0.5),
    ),
)
def claim_control_by_payload_computer(stage: FaultContext) -> Iterator[None]:
    """Another onboard computer (192) claims control and sends commands: control is released."""
    payload = connect_payload_computer(stage)
    yield from stage.wait_for_phase_and_record_fault_start()
    since_s = stage.t_s
    expect_payload_heartbeats(stage)
    accepted = (1, Cmd.DO_CHANGE_SPEED, 0)
    stage.expect_change("its speed is accepted", lambda: payload.reply_counts[accepted])
    stage.record_take_over()
    while True:
        send_onboard_computer_heartbeat(payload, control_since_s=since_s)
        payload.send_autopilot_command(Cmd.DO_CHANGE_SPEED, 1.0, PAYLOAD_SPEED_MPS, -1.0)
        yield from stage.wait(1.0)


PAYLOAD_SPEED_MPS = 9.0


@FAULTS.register_procedure(
    6,
    "taken-back-at-once",
    AIRBORNE_PHASES_BEFORE_LANDING,
    (
        check_no_commands_after_takeover,
        check_alert_sent(Alert.CONTROL_RELEASED),
    ),
    ends_after_s=25.0,
)
def take_over_again_right_after_hand_back(stage: FaultContext) -> Iterator[None]:
    """A person hands back control and selects RTL within 0.2 s, or HOLD again within 0.2 s of the
    mission's resumption (A16).

    Before the companion has verified the mission and ordered its mode (up to 1 s), HOLD selected
    again in HOLD shows in no telemetry: only an acknowledgement of the person's command that
    reaches the companion ends the hand-back. The person has to cancel it at the companion, or
    select the mode again.
    """
    craft = stage.craft
    station = Station(craft.link, (GROUND_SYSTEM, GROUND_COMPONENT))
    yield from stage.wait_for_phase_and_record_fault_start()
    hold = MODE_PARAMS[craft.autopilot_kind]["hold"]
    mode_set, handed_back = (1, Cmd.DO_SET_MODE, 0), (COMPANION_COMPONENT, Cmd.DO_PAUSE_CONTINUE, 0)
    replies = station.reply_counts
    stage.expect_effect("both modes are accepted", lambda: replies[mode_set] >= 2)
    stage.expect_change("the hand-back is accepted", lambda: replies[handed_back])
    station.send_autopilot_command(Cmd.DO_SET_MODE, *hold)
    yield from stage.wait(3.0)
    station.send_companion_command(Cmd.DO_PAUSE_CONTINUE, 1.0)
    is_resumed_first = stage.rng.random() < 0.5
    if is_resumed_first:
        yield from stage.wait_until(lambda: craft.autopilot.mode is Mode.AUTO)
    yield from stage.wait(stage.rng.choice([0.1, 0.2]))
    # Before the resumption HOLD would change nothing that a heartbeat shows.
    mode = "hold" if is_resumed_first else "rtl"
    station.send_autopilot_command(Cmd.DO_SET_MODE, *MODE_PARAMS[craft.autopilot_kind][mode])
    yield from stage.wait(CROSSING_S)
    if is_resumed_first or craft.autopilot.mode is not Mode.AUTO:
        stage.record_take_over()


CROSSING_S = 0.15
"""The companion orders the mission's mode within 0.1 s of a heartbeat. A person's mode in between
crosses that order: no heartbeat reports it."""

for duration_s in (2.0, 6.0, 20.0):
    FAULTS.add_case(
        3,
        f"stall-{duration_s:.0f}-s",
        f"The companion stops for {duration_s:.0f} s, and the pilot takes over meanwhile.",
        stall_companion_during_takeover(duration_s),
        AIRBORNE_PHASES,
        (check_no_commands_after_takeover, check_alert_sent(Alert.CONTROL_RELEASED)),
        ends_after_s=duration_s + 15.0,
    )
FAULTS.add_case(
    4,
    "second-same-folder",
    "The companion stops, and a second one started in its run folder is refused.",
    run_second_companion_while_first_stalls(_same_run_dir, second_is_refused=True),
    ("outbound", "return"),
    (
        check_returned_home,
        check_returned_if_p_home_was_high,
        check_procedure_made_note(SECOND_REFUSED_NOTE),
    ),
)
FAULTS.add_case(
    4,
    "second-new-folder",
    "The companion stops, and a second one without records of the flight stays passive.",
    run_second_companion_while_first_stalls(_unused_sibling_run_dir),
    ("outbound", "return"),
    (check_returned_home, check_returned_if_p_home_was_high),
)
FAULTS.add_case(
    4,
    "second-takes-over",
    "The companion stops, a second one continues the flight, and the first releases control.",
    run_second_companion_while_first_stalls(copy_run_dir_to_sibling, second_resumes_flight=True),
    ("outbound", "return"),
    (check_returned_home, check_no_commands_after_takeover, check_alert_sent(Alert.PASSIVE)),
)
