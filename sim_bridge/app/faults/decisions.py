"""Faults of concurrent decisions: a person selects a mode or item, or replaces the mission."""

import math
from collections.abc import Iterator

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.fault import SAFETY_RULES, FaultGroup
from sim_bridge.app.faults.mission_and_home import (
    MISSION_SHIFT_M,
    RETURN_ON_HOLD_ARGUMENTS,
    expect_other_mission_onboard,
)
from sim_bridge.app.faults.verdict import (
    check_alert_sent,
    check_control_retained,
    check_delivered,
    check_landed_intact_by_pilot_anywhere,
    check_no_commands_after_takeover,
    check_procedure_made_note,
    check_returned_home,
)
from sim_bridge.app.flight.stage import FaultContext
from sim_bridge.app.link.client_messages import (
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    MODE_PARAMS,
    message_to_autopilot,
)
from sim_bridge.app.link.message_mutation import AUTOPILOT_COMPONENT
from sim_bridge.app.link.tap import message_with_changed_fields, pass_unchanged
from sim_bridge.app.world.flight_phase import FlightPhase
from sim_bridge.app.world.station import Station, shift_mission_east
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd

MISSION_REPLACED_ALERTS = (Alert.MISSION_FOREIGN, Alert.MISSION_FOREIGN_RESTORING)

FAULTS = FaultGroup("decisions")

ENDS_AFTER_S = 20.0
LANDING_ITEM_NOTE, HOLD_NOTE, OWN_MISSION_NOTE = (
    "landing item still current",
    "vehicle in HOLD",
    "own mission flown",
)
ABOVE_HOME_M = 10.0
HOLD_BEFORE_UPLOAD_S = (0.3, 0.6)
INTRUDERS = ((30, 8), (2, 8), (26, 8), (1, 12), (2, 0))
"""MAV_TYPE and MAV_AUTOPILOT of other components: camera, gimbal, ones that pose as vehicles."""


def connect_operator_station(stage: FaultContext) -> Station:
    """Return the operator's station, whose commands the companion accepts."""
    return Station(stage.craft.link, (GROUND_SYSTEM, GROUND_COMPONENT))


def send_mode_command(stage: FaultContext, station: Station, mode: str) -> None:
    """Select a flight mode at the autopilot, which has to accept it."""
    replies = station.reply_counts
    stage.expect_change(f"{mode} is accepted", lambda: replies[1, Cmd.DO_SET_MODE, 0])
    station.send_autopilot_command(Cmd.DO_SET_MODE, *MODE_PARAMS[stage.craft.autopilot_kind][mode])


def _wait_for_command_then_drop_messages(
    stage: FaultContext, message_name: str, command: int | None, dropped_names: set[str]
) -> Iterator[None]:
    """Wait for a command of the companion; from then on drop these messages to it."""
    commands: list[Message] = []

    def record_matching_command(message: Message) -> None:
        if message.msg_name == message_name and (command is None or message.command == command):
            commands.append(message)

    stage.expect_messages_changed()
    stage.tap.to_autopilot = record_matching_command
    stage.tap.to_companion = lambda m: [] if commands and m.msg_name in dropped_names else None
    yield from stage.wait_until(lambda: bool(commands))
    stage.tap.to_autopilot = pass_unchanged


@FAULTS.register_procedure(
    63,
    "held-again",
    ("outbound", "return"),
    (
        check_no_commands_after_takeover,
        check_procedure_made_note(HOLD_NOTE),
        check_alert_sent(Alert.CONTROL_RELEASED),
    ),
    ends_after_s=ENDS_AFTER_S,
)
def select_hold_again_after_hand_back(stage: FaultContext) -> Iterator[None]:
    """A person selects HOLD again 0.3 s after the hand-back; acks and modes are lost (A1)."""
    station = connect_operator_station(stage)
    yield from stage.wait_for_phase_and_record_fault_start()
    send_mode_command(stage, station, "hold")
    yield from stage.wait(3.0)
    station.send_companion_command(Cmd.DO_PAUSE_CONTINUE, 1.0)
    yield from _wait_for_command_then_drop_messages(
        stage, "COMMAND_LONG", Cmd.DO_SET_MODE, {"COMMAND_ACK", "HEARTBEAT", "CURRENT_MODE"}
    )
    yield from stage.wait_until(lambda: stage.craft.autopilot.mode is Mode.AUTO)
    yield from stage.wait(0.3)
    send_mode_command(stage, station, "hold")
    stage.record_take_over(0.0)
    yield from stage.wait(0.4)
    stage.tap.to_companion = pass_unchanged
    yield from stage.wait(10.0)
    if stage.craft.autopilot.mode is not Mode.AUTO:
        stage.notes.append(HOLD_NOTE)


@FAULTS.register_procedure(
    64,
    "item-selected",
    ("outbound",),
    (
        check_no_commands_after_takeover,
        check_procedure_made_note(LANDING_ITEM_NOTE),
        check_alert_sent(Alert.CONTROL_RELEASED),
    ),
    ends_after_s=ENDS_AFTER_S,
)
def select_landing_item_during_jump(stage: FaultContext) -> Iterator[None]:
    """A person selects the landing while a jump is unconfirmed for 1.3 s (A2)."""
    station, craft = connect_operator_station(stage), stage.craft
    yield from stage.wait_for_phase_and_record_fault_start()
    by_command = craft.autopilot_kind == "ardupilot"
    name = "COMMAND_LONG" if by_command else "MISSION_SET_CURRENT"
    dropped_names = {"COMMAND_ACK", "MISSION_CURRENT"}
    yield from _wait_for_command_then_drop_messages(
        stage, name, Cmd.DO_SET_MISSION_CURRENT if by_command else None, dropped_names
    )
    yield from stage.wait(0.5)
    items = craft.autopilot.store.mission
    landing = max(k for k, item in enumerate(items) if item.command == Cmd.NAV_LAND)
    stage.expect_effect(
        "the landing is the current item", lambda: craft.autopilot.executor.index == landing
    )
    if by_command:
        station.send_autopilot_command(Cmd.DO_SET_MISSION_CURRENT, float(landing))
    else:
        station.send_to_autopilot(
            message_to_autopilot("MISSION_SET_CURRENT", craft.number, seq=landing)
        )
    stage.record_take_over(0.0)
    yield from stage.wait(0.8)
    stage.tap.to_companion = pass_unchanged
    yield from stage.wait(8.0)
    if craft.autopilot.executor.index == landing:
        stage.notes.append(LANDING_ITEM_NOTE)


def _upload_shifted_mission(
    stage: FaultContext, station: Station, item_count: int | None = None
) -> Iterator[None]:
    expect_other_mission_onboard(stage)
    items = list(stage.craft.autopilot.store.mission)[:item_count]
    yield from station.upload_mission(shift_mission_east(items, MISSION_SHIFT_M))


def _onboard_mission_items_without_home(stage: FaultContext) -> list[tuple[int, int, int, float]]:
    """Return the onboard mission without item 0, which is ArduCopter's home."""
    return [(i.command, i.x, i.y, i.z) for i in stage.craft.autopilot.store.mission[1:]]


def _wait_for_auto_and_note_own_mission(
    stage: FaultContext, own_items: list[tuple[int, int, int, float]]
) -> Iterator[None]:
    """Note if the companion's mission is onboard when the armed vehicle next flies a mission."""
    yield from stage.wait_until(lambda: stage.is_armed and stage.craft.autopilot.mode is Mode.AUTO)
    if _onboard_mission_items_without_home(stage) == own_items:
        stage.notes.append(OWN_MISSION_NOTE)


@FAULTS.register_procedure(
    65,
    "replaced-while-held",
    ("outbound", "return"),
    (
        *SAFETY_RULES,
        check_procedure_made_note(OWN_MISSION_NOTE),
        check_alert_sent(*MISSION_REPLACED_ALERTS),
    ),
    ends_after_s=ENDS_AFTER_S,
)
def replace_mission_during_hold(stage: FaultContext) -> Iterator[None]:
    """A person selects HOLD, the mission is replaced, the operator hands back control (A3)."""
    station = connect_operator_station(stage)
    yield from stage.wait_for_phase_and_record_fault_start()
    own_items = _onboard_mission_items_without_home(stage)
    send_mode_command(stage, station, "hold")
    yield from stage.wait(2.0)
    yield from _upload_shifted_mission(stage, station)
    station.send_companion_command(Cmd.DO_PAUSE_CONTINUE, 1.0)
    yield from _wait_for_auto_and_note_own_mission(stage, own_items)


@FAULTS.register_procedure(
    66,
    "replaced-while-dead",
    ("outbound", "return"),
    (*SAFETY_RULES, check_alert_sent(*MISSION_REPLACED_ALERTS)),
    ends_after_s=ENDS_AFTER_S,
)
def replace_mission_during_companion_outage(stage: FaultContext) -> Iterator[None]:
    """The mission is replaced during a companion outage; then return or resume is ordered (A4)."""
    station = connect_operator_station(stage)
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.kill_companion()
    yield from _upload_shifted_mission(stage, station)
    yield from stage.wait(8.0)
    stage.restart_companion()
    yield from stage.wait_until(lambda: stage.has_operator_received_alert(*MISSION_REPLACED_ALERTS))
    if stage.rng.random() < 0.5:
        station.send_companion_command(Cmd.NAV_RETURN_TO_LAUNCH)
    else:
        station.send_companion_command(Cmd.DO_PAUSE_CONTINUE, 1.0)


@FAULTS.register_procedure(
    67,
    "replaced-when-ready",
    ("ready",),
    (check_returned_home, check_delivered, check_procedure_made_note(OWN_MISSION_NOTE)),
    ends_after_s=ENDS_AFTER_S,
)
def replace_mission_before_launch(stage: FaultContext) -> Iterator[None]:
    """The mission is replaced in phase ready, 3 s before the launch is authorised (A5)."""
    station, operator = connect_operator_station(stage), stage.craft.operator
    operator.authorises = False
    yield from stage.wait_until(lambda: stage.has_operator_received_alert(Alert.READY))
    stage.record_fault_start()
    own_items = _onboard_mission_items_without_home(stage)
    yield from _upload_shifted_mission(stage, station)
    yield from stage.wait(3.0)
    operator.authorises = True
    yield from _wait_for_auto_and_note_own_mission(stage, own_items)


@FAULTS.register_procedure(
    68,
    "last-resort-refused",
    ("outbound",),
    (*SAFETY_RULES, check_alert_sent(Alert.MODE_NOT_IN_EFFECT)),
    ends_after_s=ENDS_AFTER_S,
)
def replace_mission_twice_and_refuse_rtl(stage: FaultContext) -> Iterator[None]:
    """The mission is replaced twice, and RTL is refused for 12 s (A6)."""
    station, craft = connect_operator_station(stage), stage.craft
    yield from stage.wait_for_phase_and_record_fault_start()
    yield from _upload_shifted_mission(stage, station)
    yield from stage.wait_until(lambda: stage.has_operator_received_alert(Alert.MISSION_RESTORED))
    stage.expect_change("RTL is refused", lambda: craft.link.refused_count)
    craft.link.refused = frozenset({("COMMAND_LONG", Cmd.DO_SET_MODE)})
    yield from _upload_shifted_mission(stage, station)
    yield from stage.wait_until(lambda: stage.has_operator_received_alert(Alert.RETURN_REFUSED_RTL))
    yield from stage.wait(12.0)
    craft.link.refused = frozenset()


@FAULTS.register_procedure(
    71,
    "pilot-lands-after-rtl",
    ("outbound", "return"),
    (
        check_no_commands_after_takeover,
        check_alert_sent(Alert.CONTROL_RELEASED),
        check_landed_intact_by_pilot_anywhere,
    ),
)
def land_by_station_during_own_rtl(stage: FaultContext) -> Iterator[None]:
    """A person selects LAND during the companion's own RTL, far from home or above it (A9)."""
    station, craft = connect_operator_station(stage), stage.craft
    yield from stage.wait_for_phase_and_record_fault_start()
    yield from _upload_shifted_mission(stage, station)
    yield from stage.wait_until(lambda: stage.has_operator_received_alert(Alert.MISSION_RESTORED))
    yield from _upload_shifted_mission(stage, station)
    yield from stage.wait_until(lambda: craft.autopilot.mode is Mode.RTL)
    yield from stage.wait(stage.rng.uniform(1.5, 4.0))
    if stage.rng.random() < 0.5:
        yield from stage.wait_until(lambda: math.hypot(*craft.vehicle.pos_ned_m[:2]) < ABOVE_HOME_M)
    is_in_rtl = craft.autopilot.mode is Mode.RTL
    stage.expect_effect("LAND in RTL", lambda: is_in_rtl and craft.autopilot.mode is Mode.LAND)
    send_mode_command(stage, station, "land")
    stage.record_take_over()


@FAULTS.register_procedure(
    74,
    "hold-then-upload",
    ("outbound", "return"),
    (
        check_no_commands_after_takeover,
        check_procedure_made_note(HOLD_NOTE),
        check_alert_sent(Alert.CONTROL_RELEASED),
    ),
    arguments=RETURN_ON_HOLD_ARGUMENTS,
    ends_after_s=45.0,
)
def select_hold_then_upload_mission(stage: FaultContext) -> Iterator[None]:
    """A person selects HOLD and uploads three items 0.3 to 0.6 s later; no RTL follows (A13)."""
    station, craft = connect_operator_station(stage), stage.craft
    yield from stage.wait_for_phase_and_record_fault_start()
    own_items = _onboard_mission_items_without_home(stage)
    stage.expect_effect(
        "mission replaced", lambda: _onboard_mission_items_without_home(stage) != own_items
    )
    send_mode_command(stage, station, "hold")
    stage.record_take_over()
    yield from stage.wait(stage.rng.uniform(*HOLD_BEFORE_UPLOAD_S))
    yield from _upload_shifted_mission(stage, station, 3)
    yield from stage.wait(40.0)
    if craft.autopilot.mode is not Mode.AUTO:
        stage.notes.append(HOLD_NOTE)


@FAULTS.register_procedure(
    75,
    "intruding-heartbeat",
    ("ready", "climb", "outbound", "return"),
    (
        *SAFETY_RULES,
        check_delivered,
        check_control_retained,
        check_alert_sent(Alert.HEARTBEAT_INTRUDER),
    ),
)
def add_heartbeats_with_autopilot_ids(stage: FaultContext) -> Iterator[None]:
    """Another component sends heartbeats with the autopilot's system and component ID (A14).

    In phase ready it starts before the autopilot is identified.
    """
    number, alternates = stage.rng.integers(len(INTRUDERS)), stage.rng.random() < 0.3
    mav_type, mav_autopilot = INTRUDERS[number]
    count = 0

    def add_intruding_heartbeat(message: Message) -> list[Message] | None:
        nonlocal count
        if message.msg_name != "HEARTBEAT" or message.src_component != AUTOPILOT_COMPONENT:
            return None  # a forwarded one of a station has other IDs
        count += 1
        intruder = {"type": mav_type, "autopilot": mav_autopilot, "base_mode": 0, "custom_mode": 0}
        intruding = message_with_changed_fields(message, **intruder)
        return [message] if alternates and count % 2 else [message, intruding]

    if stage.phase is FlightPhase.READY:
        stage.record_fault_start()
    else:
        yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_messages_changed("HEARTBEAT")
    stage.tap.to_companion = add_intruding_heartbeat
    yield
