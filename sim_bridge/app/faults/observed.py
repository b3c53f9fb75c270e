"""Faults of reports about the vehicle: paused or ended mission, landing detector, barometer."""

from collections.abc import Iterator

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.fault import (
    AIRBORNE_PHASES,
    SAFETY_RULES,
    FaultGroup,
)
from sim_bridge.app.faults.verdict import (
    FaultRunResult,
    check_alert_sent,
    check_no_commands_after_takeover,
    check_no_false_delivery,
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
from sim_bridge.app.link.tap import message_with_changed_fields
from sim_bridge.app.world.station import Station
from sim_bridge.app.world.vehicle_host import EXCHANGE_S
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd, MissionState

FAULTS = FaultGroup("air and sensors")
AUTHORITY = {"group": "authority"}

INJECTED_NOTE, AIR_DISARM_NOTE = "injection took effect", "disarm ordered in the air"
SETTLE_S, HOVER_SPEED_MPS, HOVER_S = 16.0, 1.5, 10.0
"""PX4 brakes for 11 s from 17 m/s; then a vehicle that is slower for so long stands still."""

PAUSE_LIMIT_S = 60.0
ENDS_AFTER_S = 40.0
DRIFT_RANGE_MPS = (0.08, 0.20)
MAX_DRIFT_M = 20.0
MIN_HEIGHT_ERROR_M = 4.0
LANDED_STATES = {"on ground": 1, "in air": 2, "undefined": 0}
FALL_REPORT_S = 1.5


def _pause_mission(stage: FaultContext, station: Station) -> Iterator[None]:
    """Pause as a ground station does; ArduCopter refuses it except on the way to a waypoint."""
    craft = stage.craft
    if craft.autopilot_kind == "px4":
        stage.expect_effect("the autopilot is in HOLD", lambda: craft.autopilot.mode is Mode.HOLD)
        station.send_autopilot_command(Cmd.DO_SET_MODE, *MODE_PARAMS["px4"]["hold"])
        return
    stage.expect_effect("the mission is paused", lambda: craft.autopilot.executor.is_paused)
    until_s = stage.t_s + PAUSE_LIMIT_S
    while not craft.autopilot.executor.is_paused and stage.t_s < until_s:
        station.send_autopilot_command(Cmd.DO_PAUSE_CONTINUE, 0.0)
        yield


def _note_if_hovering(stage: FaultContext) -> Iterator[None]:
    """Note, by truth, whether the vehicle stands still in the air for `HOVER_S`."""
    yield from stage.wait(SETTLE_S)
    speeds: list[float] = []
    until_s = stage.t_s + HOVER_S
    while stage.t_s < until_s:
        speeds += stage.craft.vehicle.truth.vel_ned_mps[:2]
        yield
    if max(map(abs, speeds)) < HOVER_SPEED_MPS and stage.craft.record.landed_s is None:
        stage.notes.append(INJECTED_NOTE)


@FAULTS.register_procedure(
    69,
    "mission-paused",
    ("outbound", "return"),
    (
        check_no_commands_after_takeover,
        check_alert_sent(Alert.CONTROL_RELEASED),
        check_procedure_made_note(INJECTED_NOTE),
    ),
    ends_after_s=ENDS_AFTER_S,
    **AUTHORITY,
)
def pause_mission_by_station(stage: FaultContext) -> Iterator[None]:
    """A ground station pauses the mission; ArduCopter stays in AUTO (A7)."""
    station = Station(stage.craft.link)
    yield from stage.wait_for_phase_and_record_fault_start()
    yield from _pause_mission(stage, station)
    stage.record_take_over(1.2)
    yield from _note_if_hovering(stage)


@FAULTS.register_procedure(
    69,
    "mission-pause-ended",
    ("outbound", "return"),
    (
        *SAFETY_RULES,
        check_alert_sent(Alert.CONTROL_RELEASED),
        check_procedure_made_note(INJECTED_NOTE),
    ),
    **AUTHORITY,
)
def pause_mission_then_hand_back(stage: FaultContext) -> Iterator[None]:
    """A ground station pauses the mission, and the operator hands control back (A7)."""
    station = Station(stage.craft.link, (GROUND_SYSTEM, GROUND_COMPONENT))
    yield from stage.wait_for_phase_and_record_fault_start()
    yield from _pause_mission(stage, station)
    yield from _note_if_hovering(stage)
    yield from stage.wait(stage.rng.uniform(0.0, 10.0))
    station.send_companion_command(Cmd.DO_PAUSE_CONTINUE, 1.0)


@FAULTS.register_procedure(
    69,
    "mission-pause-unreported",
    ("return",),
    (
        check_procedure_made_note(INJECTED_NOTE),
        check_alert_sent(Alert.STANDSTILL),
    ),
    autopilots=("ardupilot",),
    ends_after_s=ENDS_AFTER_S,
    **AUTHORITY,
)
def pause_mission_of_old_autopilot(stage: FaultContext) -> Iterator[None]:
    """The mission is paused, and the autopilot does not report the mission's state (A7)."""
    station = Station(stage.craft.link)
    stage.expect_messages_changed("MISSION_CURRENT")
    stage.tap.to_companion = lambda message: (
        [message_with_changed_fields(message, mission_state=0)]
        if message.msg_name == "MISSION_CURRENT"
        else None
    )
    yield from stage.wait_for_phase_and_record_fault_start()
    yield from _pause_mission(stage, station)
    yield from stage.wait(45.0)  # the companion may jump again once; low energy ends the pause
    yield from _note_if_hovering(stage)


@FAULTS.register_procedure(
    70,
    "mission-complete-away",
    ("outbound", "drop", "return"),
    (
        check_no_commands_after_takeover,
        check_alert_sent(Alert.CONTROL_RELEASED),
        check_procedure_made_note(INJECTED_NOTE),
    ),
    ends_after_s=ENDS_AFTER_S,
    **AUTHORITY,
)
def select_last_item_by_person(stage: FaultContext) -> Iterator[None]:
    """A person selects the last item: the mission is complete away from home (A8)."""
    station, craft = Station(stage.craft.link), stage.craft
    yield from stage.wait_for_phase_and_record_fault_start()
    last = len(craft.autopilot.store.mission) - 1
    executor = craft.autopilot.executor
    stage.expect_effect(
        "the mission is complete in the air",
        lambda: executor.state == MissionState.COMPLETE and craft.vehicle.is_airborne,
    )
    if craft.autopilot_kind == "ardupilot":
        station.send_autopilot_command(Cmd.DO_SET_MISSION_CURRENT, float(last))
    else:
        station.send_to_autopilot(
            message_to_autopilot("MISSION_SET_CURRENT", craft.number, seq=last)
        )
    stage.record_take_over(1.2)
    yield from stage.wait(10.0)
    if craft.autopilot.executor.state == MissionState.COMPLETE:
        stage.notes.append(INJECTED_NOTE)


def _check_no_disarm_in_air(flown: FaultRunResult) -> str | None:
    """Check that no disarm was ordered while the vehicle was in the air by truth."""
    return AIR_DISARM_NOTE if AIR_DISARM_NOTE in flown.stage.notes else None


@FAULTS.register_procedure(
    84,
    "landed-state-stuck",
    AIRBORNE_PHASES,
    (*SAFETY_RULES, check_procedure_made_note(INJECTED_NOTE), _check_no_disarm_in_air),
)
def freeze_landed_state(stage: FaultContext) -> Iterator[None]:
    """EXTENDED_SYS_STATE is stuck: on the ground, in the air or undefined, drawn (C2)."""
    state = LANDED_STATES[stage.rng.choice(list(LANDED_STATES))]
    yield from stage.wait_for_phase_and_record_fault_start()

    def replace_landed_state(message: Message) -> list[Message] | None:
        if message.msg_name != "EXTENDED_SYS_STATE":
            return None
        if message.landed_state != state and INJECTED_NOTE not in stage.notes:
            stage.notes.append(INJECTED_NOTE)
        return [message_with_changed_fields(message, landed_state=state)]

    def note_disarm_in_air(message: Message) -> list[Message] | None:
        is_disarm = (
            message.msg_name == "COMMAND_LONG"
            and message.command == Cmd.COMPONENT_ARM_DISARM
            and message.param1 == 0.0
        )
        if is_disarm and stage.craft.record.airborne_since_s is not None:
            stage.notes.append(AIR_DISARM_NOTE)
        return None

    stage.expect_messages_changed("EXTENDED_SYS_STATE")
    stage.tap.to_companion, stage.tap.to_autopilot = replace_landed_state, note_disarm_in_air


def _check_crash_is_reported(flown: FaultRunResult) -> str | None:
    """Check that the vehicle crashed by truth, and that the companion's verdict is a loss."""
    if not flown.stage.craft.vehicle.is_crashed:
        return "it did not crash"
    finished = [d["reason"] for d in flown.row["decisions"] if d["kind"] == "finished"]
    verdict = finished[-1].partition(":")[0] if finished else "none"
    return None if verdict in ("DEL", "FAIL") else f"verdict of the companion: {verdict}"


@FAULTS.register_procedure(
    85,
    "motors-stop-at-20-m",
    ("land",),
    (
        check_alert_sent(Alert.FALLING, Alert.DISARMED_IN_AIR, within_s=FALL_REPORT_S),
        _check_crash_is_reported,
    ),
)
def stop_motors_by_false_landing(stage: FaultContext) -> Iterator[None]:
    """The autopilot detects a landing at up to 20 m, and its motors stop (C3)."""
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_effect(
        "the motors are stopped in the air",
        lambda: not stage.is_armed and stage.craft.vehicle.is_airborne,
    )
    stage.craft.autopilot.landing_detector.is_in_error = True
    yield from stage.wait_until(lambda: stage.craft.vehicle.is_crashed)


@FAULTS.register_procedure(
    86,
    "barometer-drifts",
    ("climb", "outbound"),
    (
        check_returned_home,
        check_no_false_delivery,
        check_alert_sent(Alert.HEIGHT_DOUBT),
        check_procedure_made_note(INJECTED_NOTE),
    ),
)
def drift_barometer(stage: FaultContext) -> Iterator[None]:
    """The barometer drifts by 8 to 20 m in 100 s, up or down (C4)."""
    rate_mps = stage.rng.choice([-1.0, 1.0]) * stage.rng.uniform(*DRIFT_RANGE_MPS)
    yield from stage.wait_for_phase_and_record_fault_start()
    sensors, craft = stage.craft.vehicle.sensors, stage.craft

    def height_error_m() -> float:
        return float(craft.autopilot.state.pos_ned_m[2] - craft.vehicle.pos_ned_m[2])

    start_error_m = height_error_m()  # a climbing vehicle's estimate lags by metres

    def is_height_wrong() -> bool:
        return abs(height_error_m() - start_error_m) > MIN_HEIGHT_ERROR_M

    stage.expect_effect(f"a height error of {MIN_HEIGHT_ERROR_M:g} m", is_height_wrong)
    while True:
        if abs(sensors.baro_offset_m) < MAX_DRIFT_M:
            sensors.baro_offset_m += rate_mps * EXCHANGE_S
        if is_height_wrong() and INJECTED_NOTE not in stage.notes:
            stage.notes.append(INJECTED_NOTE)
        yield
