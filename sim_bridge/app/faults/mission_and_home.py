"""Faults of the onboard mission and home position: edits by another station, a moved home."""

import math
from collections.abc import Iterator

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.fault import (
    AIRBORNE_PHASES,
    AIRBORNE_PHASES_BEFORE_LANDING,
    PHASES,
    SAFETY_RULES,
    FaultGroup,
)
from sim_bridge.app.faults.verdict import check_alert_sent, check_delivered, check_returned_home
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.link.tap import message_with_changed_fields
from sim_bridge.app.world.flight_phase import FlightPhase
from sim_bridge.app.world.station import Station, shift_mission_east, shift_next_waypoint_east
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mission.items import MissionItem

MISSION_ALERTS = (
    *(alert for alert in Alert if alert.name.startswith("MISSION_")),
    Alert.HOLD_UNANSWERED,
)
HOME_ALERTS = tuple(alert for alert in Alert if alert.name.startswith("HOME_"))

FAULTS = FaultGroup("mission and home")

RETURN_ON_HOLD_ARGUMENTS = ("--unanswered-hold=return",)
"""Option set before the flight: PX4 holds at an infeasible mission, with no operator response."""

HEIGHT_RESET_MM = 15_000
MOVED_M = 10.0
WAYPOINT_SHIFT_M = 1500.0
MISSION_SHIFT_M = 3000.0
SLOW_CHECK_S = 30.0
"""Time to detect an edit by reading the list, two items a second (ArduCopter has no mission ID)."""


def _onboard_mission(stage: FaultContext) -> list[MissionItem]:
    return list(stage.craft.autopilot.store.mission)


def expect_other_mission_onboard(stage: FaultContext) -> None:
    """Require that another mission than the present one is onboard from now on."""
    stage.expect_change("another mission is onboard", lambda: _onboard_mission(stage))


def _expect_moved_home(stage: FaultContext) -> None:
    state = stage.craft.autopilot.state
    stage.expect_change("another home position", lambda: state.home_ned_m, by=MOVED_M)


def _wait_for_phase_or_authorisation(stage: FaultContext) -> Iterator[None]:
    """Wait for the phase. In READY begin with the authorisation or, as drawn, up to 4 s before it,
    while the companion is ready.
    """
    if stage.phase is not FlightPhase.READY or stage.rng.random() < 0.5:
        yield from stage.wait_for_phase_and_record_fault_start()
        return
    operator = stage.craft.operator
    operator.authorises_from_s = math.inf
    yield from stage.wait_until(lambda: stage.has_operator_received_alert(Alert.READY))
    operator.authorises_from_s = stage.t_s + stage.rng.uniform(0.3, 4.0)
    stage.record_fault_start()


@FAULTS.register_procedure(
    10,
    "same-length-edit",
    PHASES,
    (*SAFETY_RULES, check_alert_sent(*MISSION_ALERTS, exempt_if_landed_within_s=SLOW_CHECK_S)),
)
def upload_mission_with_moved_waypoint(stage: FaultContext) -> Iterator[None]:
    """Another station moves one waypoint by 1.5 km; the length of the list is unchanged."""
    station = Station(stage.craft.link)
    yield from _wait_for_phase_or_authorisation(stage)
    current = stage.craft.autopilot.executor.index
    expect_other_mission_onboard(stage)
    yield from station.upload_mission(
        shift_next_waypoint_east(_onboard_mission(stage), current, WAYPOINT_SHIFT_M)
    )


@FAULTS.register_procedure(
    11, "foreign-upload", PHASES, (*SAFETY_RULES, check_alert_sent(*MISSION_ALERTS))
)
def upload_distant_mission(stage: FaultContext) -> Iterator[None]:
    """Another station uploads a mission of the same length, 3 km away."""
    station = Station(stage.craft.link)
    yield from _wait_for_phase_or_authorisation(stage)
    expect_other_mission_onboard(stage)
    yield from station.upload_mission(shift_mission_east(_onboard_mission(stage), MISSION_SHIFT_M))


@FAULTS.register_procedure(
    11,
    "foreign-upload-again",
    ("climb", "outbound"),
    (*SAFETY_RULES, check_alert_sent(Alert.MISSION_CHANGED, Alert.MISSION_CHANGED_LANDING)),
)
def upload_distant_mission_twice(stage: FaultContext) -> Iterator[None]:
    """A foreign mission is uploaded, and again after the companion has restored its own."""
    station = Station(stage.craft.link)
    yield from _wait_for_phase_or_authorisation(stage)
    items = shift_mission_east(_onboard_mission(stage), MISSION_SHIFT_M)
    expect_other_mission_onboard(stage)
    yield from station.upload_mission(items)
    yield from stage.wait_until(lambda: stage.has_operator_received_alert(Alert.MISSION_RESTORED))
    expect_other_mission_onboard(stage)
    yield from station.upload_mission(items)


@FAULTS.register_procedure(11, "same-upload", PHASES, (*SAFETY_RULES, check_delivered))
def upload_own_mission_again(stage: FaultContext) -> Iterator[None]:
    """Another station uploads the companion's own mission again."""
    station = Station(stage.craft.link)
    yield from _wait_for_phase_or_authorisation(stage)
    stage.expect_change("the upload is accepted", lambda: station.reply_counts[1, None, 0])
    yield from station.upload_mission(_onboard_mission(stage))


@FAULTS.register_procedure(
    12,
    "shorter-upload",
    PHASES,
    (*SAFETY_RULES, check_alert_sent(*MISSION_ALERTS)),
    arguments=RETURN_ON_HOLD_ARGUMENTS,
)
def upload_first_half_of_mission(stage: FaultContext) -> Iterator[None]:
    """Another station uploads the first half of the list."""
    station = Station(stage.craft.link)
    yield from _wait_for_phase_or_authorisation(stage)
    items = _onboard_mission(stage)
    expect_other_mission_onboard(stage)
    yield from station.upload_mission(items[: len(items) // 2])


@FAULTS.register_procedure(
    12, "longer-upload", PHASES, (*SAFETY_RULES, check_alert_sent(*MISSION_ALERTS))
)
def upload_mission_with_appended_copy(stage: FaultContext) -> Iterator[None]:
    """Another station uploads the list with a second list appended."""
    station = Station(stage.craft.link)
    yield from _wait_for_phase_or_authorisation(stage)
    items = _onboard_mission(stage)
    expect_other_mission_onboard(stage)
    yield from station.upload_mission([*items, *shift_mission_east(items[1:], MISSION_SHIFT_M)])


def clear_mission_by_station(stage: FaultContext) -> Iterator[None]:
    """Another station clears the mission."""
    station = Station(stage.craft.link)
    yield from _wait_for_phase_or_authorisation(stage)
    if stage.is_armed and stage.craft.autopilot_kind == "ardupilot":
        stage.expect_effect("the clear is refused", lambda: _is_mission_transfer_refused(station))
    else:
        expect_other_mission_onboard(stage)
    station.send_mission_clear_all()


def _is_mission_transfer_refused(station: Station) -> bool:
    return any(command is None and result for _, command, result in station.reply_counts)


@FAULTS.register_procedure(14, "upload-cut", PHASES)
def abort_mission_upload_halfway(stage: FaultContext) -> Iterator[None]:
    """Another station starts an upload and stops halfway."""
    station = Station(stage.craft.link)
    yield from _wait_for_phase_or_authorisation(stage)
    items = _onboard_mission(stage)
    half = len(items) // 2
    stage.expect_effect(
        "half of the items are requested", lambda: station.uploaded_item_count >= half
    )
    yield from station.upload_mission(
        shift_mission_east(items, MISSION_SHIFT_M), stop_after_items=half
    )


def move_home_by_station(*, north_m: float = 0.0, up_m: float = 0.0) -> FaultProcedure:
    """Return a procedure: another station moves the home position."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        station = Station(stage.craft.link)
        yield from stage.wait_for_phase_and_record_fault_start()
        _expect_moved_home(stage)
        station.send_set_home_at_offset(stage.craft.depot, north_m=north_m, up_m=up_m)

    return procedure


@FAULTS.register_procedure(
    16,
    "home-kept-low",
    ("climb", "outbound"),
    (*SAFETY_RULES, check_alert_sent(Alert.HOME_NOT_RESTORED)),
)
def set_home_low_twice(stage: FaultContext) -> Iterator[None]:
    """Home is set 20 m lower, and again after the companion has restored it."""
    station = Station(stage.craft.link)
    yield from stage.wait_for_phase_and_record_fault_start()
    _expect_moved_home(stage)
    station.send_set_home_at_offset(stage.craft.depot, up_m=-20.0)
    yield from stage.wait(4.0)
    _expect_moved_home(stage)
    station.send_set_home_at_offset(stage.craft.depot, up_m=-20.0)


@FAULTS.register_procedure(
    18,
    "height-reset",
    AIRBORNE_PHASES_BEFORE_LANDING,
    (*SAFETY_RULES, check_alert_sent(Alert.HOME_MOVED)),
)
def offset_reported_height_above_home(stage: FaultContext) -> Iterator[None]:
    """Reported heights above home are 15 m too high; heights above sea level are correct."""
    yield from stage.wait_for_phase_and_record_fault_start()

    def offset_relative_altitude(message: Message) -> list[Message] | None:
        if message.msg_name != "GLOBAL_POSITION_INT":
            return None
        return [
            message_with_changed_fields(
                message, relative_alt=message.relative_alt + HEIGHT_RESET_MM
            )
        ]

    stage.expect_messages_changed("GLOBAL_POSITION_INT")
    stage.tap.to_companion = offset_relative_altitude


@FAULTS.register_procedure(
    20, "progress-late", ("climb", "outbound"), (check_returned_home, check_delivered)
)
def delay_mission_progress_messages(stage: FaultContext) -> Iterator[None]:
    """Mission progress is delayed by 2 s."""
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_messages_changed("MISSION_CURRENT")
    stage.tap.delay_s_by_name["MISSION_CURRENT"] = 2.0


def set_autopilot_parameter_by_station(
    **name_and_value_by_autopilot: tuple[str, float],
) -> FaultProcedure:
    """Return a procedure: another station sets a parameter (name and value by autopilot)."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        station = Station(stage.craft.link)
        name, value = name_and_value_by_autopilot[stage.craft.autopilot_kind]
        yield from stage.wait_for_phase_and_record_fault_start()
        params = stage.craft.autopilot.params
        stage.expect_change(f"another {name}", lambda: params[name])
        station.send_parameter_to_autopilot(name, value)

    return procedure


FAULTS.add_case(
    13,
    "mission-cleared",
    "Another station clears the mission.",
    clear_mission_by_station,
    PHASES,
    (*SAFETY_RULES, check_alert_sent(*MISSION_ALERTS)),
    autopilots=("px4",),
    arguments=RETURN_ON_HOLD_ARGUMENTS,
)
FAULTS.add_case(
    13,
    "clear-refused",
    "Another station clears the mission; ArduCopter refuses this in the air.",
    clear_mission_by_station,
    PHASES,
    (*SAFETY_RULES, check_delivered),
    autopilots=("ardupilot",),
)
for number, name, description, procedure in (
    (15, "home-up-25", "Home is set 25 m higher.", move_home_by_station(up_m=25.0)),
    (16, "home-down-20", "Home is set 20 m lower.", move_home_by_station(up_m=-20.0)),
    (17, "home-3-km-away", "Home is set 3 km away.", move_home_by_station(north_m=3000.0)),
):
    rules = (*SAFETY_RULES, check_alert_sent(*HOME_ALERTS))
    FAULTS.add_case(number, name, description, procedure, AIRBORNE_PHASES, rules)
for name, change, px4, ardupilot, arguments in (
    (
        "speed",
        "lowers the mission speed to 5 m/s",
        ("MPC_XY_VEL_MAX", 5.0),
        ("WPNAV_SPEED", 500.0),
        (),
    ),
    (
        "rtl-height",
        "sets the height of RTL to 5 m",
        ("RTL_RETURN_ALT", 5.0),
        ("RTL_ALT", 500.0),
        (),
    ),
    (
        "fence",
        "reduces the fence radius to 200 m: the customer is outside it",
        ("GF_MAX_HOR_DIST", 200.0),
        ("FENCE_RADIUS", 200.0),
        RETURN_ON_HOLD_ARGUMENTS,
    ),
):
    FAULTS.add_case(
        19,
        f"{name}-changed",
        f"Another station {change}.",
        set_autopilot_parameter_by_station(px4=px4, ardupilot=ardupilot),
        arguments=arguments,
    )
