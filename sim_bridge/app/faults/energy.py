"""Energy faults: false battery readings, failed release, increased draw, degraded packs."""

import math
from collections.abc import Iterator

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.fault import (
    AIRBORNE_PHASES_BEFORE_LANDING,
    SAFETY_RULES,
    FaultGroup,
    start_at_once,
)
from sim_bridge.app.faults.verdict import (
    FaultRunResult,
    check_alert_sent,
    check_delivered,
    check_no_false_delivery,
)
from sim_bridge.app.flight.craft_building import read_true_airframe
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.link.tap import message_with_changed_fields, pass_unchanged
from sim_bridge.app.world.flight_phase import FlightPhase
from sim_bridge.autopilot.kinds import BatterySensing
from sim_bridge.autopilot.mavlink.codec import Message

FAULTS = FaultGroup("energy")

DELIVERY_RULES = (*SAFETY_RULES, check_delivered)
BATTERY_MESSAGE = "BATTERY_STATUS"
BATTERY_DELAY_S = 4.0
OUTLIER_MAH = 4_000_000
CELL_V, MIN_CURRENT_A = 3.0, 0.1
DISTANT_CUSTOMER = {
    "site": {"customer": {"name": "customer", "east_m": -900.0, "north_m": -60.0, "up_m": 4.5}},
    "vehicle": {"charge_frac": 0.5},
}
"""At 1.7 times the draw this flight ends below the reserve unless it returns immediately."""

SMALL_CHANGE_ALERT_S = 60.0
"""Alert limit for 1.4 times the draw with a minute of flight remaining: half are reported within
20 s, 90 % within 40 s."""

LEVEL_FLIGHT_ALERT_S, DRAW_ALERT_S = 10.0, 25.0
"""Alert limits for a change of draw by more than half: in level flight, and where a climb or
descent of up to 15 s, whose power is modelled less accurately, hides it."""


def report_lower_second_pack(lower_by_percent_points: int) -> FaultProcedure:
    """Return a procedure: alternately a pack `lower_by_percent_points` lower is reported."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        def report_two_packs(message: Message) -> list[Message] | None:
            if message.msg_name != BATTERY_MESSAGE:
                return None
            charge_percent = round(100.0 * stage.craft.vehicle.battery.charge_frac)
            return [
                message_with_changed_fields(message, battery_remaining=charge_percent),
                message_with_changed_fields(
                    message,
                    id=1,
                    battery_remaining=max(charge_percent - lower_by_percent_points, 0),
                ),
            ]

        stage.expect_messages_changed(BATTERY_MESSAGE)
        stage.tap.to_companion = report_two_packs
        stage.record_fault_start()
        yield

    return procedure


@FAULTS.register_procedure(26, "counter-late", AIRBORNE_PHASES_BEFORE_LANDING, DELIVERY_RULES)
def delay_one_battery_message(stage: FaultContext) -> Iterator[None]:
    """One battery message is delayed by 4 s."""
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_messages_changed(BATTERY_MESSAGE)
    stage.tap.delay_s_by_name[BATTERY_MESSAGE] = BATTERY_DELAY_S
    yield from stage.wait(0.6)
    del stage.tap.delay_s_by_name[BATTERY_MESSAGE]


def alter_one_battery_message(**changed_fields: int) -> FaultProcedure:
    """Return a procedure: one battery message has these field values."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        altered: list[Message] = []

        def alter_first_battery_message(message: Message) -> list[Message] | None:
            if altered or message.msg_name != BATTERY_MESSAGE:
                return None
            altered.append(message)
            return [message_with_changed_fields(message, **changed_fields)]

        stage.expect_messages_changed(BATTERY_MESSAGE)
        stage.tap.to_companion = alter_first_battery_message
        yield from stage.wait_until(lambda: bool(altered))
        stage.tap.to_companion = pass_unchanged

    return procedure


@FAULTS.register_procedure(26, "counter-reset", AIRBORNE_PHASES_BEFORE_LANDING)
def restart_battery_counters_at_zero(stage: FaultContext) -> Iterator[None]:
    """The counters of consumed charge and energy restart at zero."""
    yield from stage.wait_for_phase_and_record_fault_start()
    first_messages: list[Message] = []

    def subtract_first_counters(message: Message) -> list[Message] | None:
        if message.msg_name != BATTERY_MESSAGE:
            return None
        first_messages.append(message)
        counters = ("current_consumed", "energy_consumed")
        return [
            message_with_changed_fields(
                message,
                **{
                    n: max(getattr(message, n) - getattr(first_messages[0], n), 0) for n in counters
                },
            )
        ]

    stage.expect_messages_changed(BATTERY_MESSAGE)
    stage.tap.to_companion = subtract_first_counters


@FAULTS.register_procedure(30, "parcel-sticks", ("drop",), (*SAFETY_RULES, check_no_false_delivery))
def make_parcel_release_fail(stage: FaultContext) -> Iterator[None]:
    """The parcel stays attached while the gripper reports success."""
    craft = stage.craft
    stage.expect_effect(
        "the gripper is open with the parcel attached",
        lambda: craft.autopilot.behaviour.is_gripper_open and craft.vehicle.parcel_aboard,
    )
    craft.vehicle.release_fails = True
    stage.record_fault_start()
    yield


def check_delivery_reported_as_by_truth(flown: FaultRunResult) -> str | None:
    """Check that a delivery is reported if, and only if, the parcel was released."""
    is_reported = any(alert is Alert.DELIVERED for _, alert, _ in flown.alerts)
    has_released = not flown.stage.craft.vehicle.parcel_aboard
    return None if is_reported is has_released else f"released {has_released}, not so reported"


def release_parcel_in_drawn_wind(stage: FaultContext) -> Iterator[None]:
    """Release or keep the parcel while drawn wind is added over the customer."""
    vehicle, rng = stage.craft.vehicle, stage.rng
    vehicle.release_fails = bool(rng.random() < 0.5)
    yield from stage.wait_until(stage.is_in_phase)
    stage.record_fault_start()
    before_n, before_e, _ = vehicle.truth.wind_to_ned_mps
    stage.expect_effect(
        "the wind has changed by 1 m/s",
        lambda: math.dist(vehicle.truth.wind_to_ned_mps[:2], (before_n, before_e)) > 1.0,
    )
    size_mps, course_rad = rng.uniform(2.0, 5.0), rng.uniform(0.0, math.tau)
    vehicle.wind_field.front_to_ne_mps = (
        size_mps * math.cos(course_rad),
        size_mps * math.sin(course_rad),
    )


for suffix, payload_kg in (("", 0.5), ("-light", 0.25)):
    FAULTS.add_case(
        90,
        f"release-in-wind{suffix}",
        f"A parcel of {payload_kg:g} kg is released, or sticks, in 2 to 5 m/s of added wind (S3).",
        release_parcel_in_drawn_wind,
        ("drop",),
        (*SAFETY_RULES, check_delivery_reported_as_by_truth),
        flight={"vehicle": {"payload_kg": payload_kg}},
    )


def multiply_power_draw(factor: float) -> FaultProcedure:
    """Return a procedure: the power is multiplied by `factor` (ice, worn motor, added drag)."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        yield from stage.wait_for_phase_and_record_fault_start()
        vehicle = stage.craft.vehicle
        stage.expect_change("another draw", lambda: vehicle.draw_factor)
        vehicle.draw_factor = factor

    return procedure


def check_draw_change_alert_in_time(flown: FaultRunResult) -> str | None:
    """Check that the operator received the alert of the changed draw in time."""
    limit_s = LEVEL_FLIGHT_ALERT_S if flown.stage.phase is FlightPhase.OUTBOUND else DRAW_ALERT_S
    return check_alert_sent(Alert.DRAW_CHANGED, within_s=limit_s)(flown)


@FAULTS.register_procedure(24, "cell-lost", AIRBORNE_PHASES_BEFORE_LANDING)
def short_circuit_battery_cell(stage: FaultContext) -> Iterator[None]:
    """One cell of the pack is short-circuited."""
    yield from stage.wait_for_phase_and_record_fault_start()
    battery = stage.craft.vehicle.battery
    stage.expect_change("another voltage", lambda: battery.voltage_v, by=CELL_V)
    battery.short_one_cell()


IN_TIME_RULES = (*SAFETY_RULES, check_draw_change_alert_in_time)
SMALL_CHANGE_RULES = (
    *SAFETY_RULES,
    check_alert_sent(Alert.DRAW_CHANGED, within_s=SMALL_CHANGE_ALERT_S),
)
for number, factor, suffix, circumstance, phases, rules, flight in (
    (21, 1.25, "", "", AIRBORNE_PHASES_BEFORE_LANDING, SAFETY_RULES, {}),
    (21, 1.4, "", ": an alert within a minute", ("outbound",), SMALL_CHANGE_RULES, {}),
    (22, 1.7, "", "", AIRBORNE_PHASES_BEFORE_LANDING, IN_TIME_RULES, {}),
    (
        22,
        1.7,
        "-far",
        " on a flight without spare energy",
        ("outbound",),
        IN_TIME_RULES,
        DISTANT_CUSTOMER,
    ),
    (23, 2.0, "", "", AIRBORNE_PHASES_BEFORE_LANDING, IN_TIME_RULES, {}),
):
    FAULTS.add_case(
        number,
        f"draw-{factor:g}{suffix}",
        f"The draw rises to {factor:g} times{circumstance}.",
        multiply_power_draw(factor),
        phases,
        rules,
        flight=flight,
    )
FAULTS.add_case(
    26,
    "current-unmeasured",
    "The autopilot measures no current; voltage and percentage follow a timer, then are constant.",
    start_at_once(
        "no current in the messages",
        lambda stage: (
            stage.craft.autopilot.battery.reported_current_a is None
            and stage.craft.vehicle.battery.current_a > MIN_CURRENT_A
        ),
    ),
    ("ready",),
    autopilots=("px4",),
    battery_sensing=BatterySensing.SIH_TIMER,
    settings={"BAT1_N_CELLS": 6.0},
)
for difference, rules in ((5, DELIVERY_RULES), (20, SAFETY_RULES)):
    FAULTS.add_case(
        25,
        f"packs-{difference}-apart",
        f"Two packs whose percentages differ by {difference} points.",
        report_lower_second_pack(difference),
        ("ready",),
        rules,
    )
OUTLIER_COUNTERS = {"current_consumed": OUTLIER_MAH, "energy_consumed": OUTLIER_MAH}
for number, name, description, changed_fields in (
    (26, "counter-wild", "One message with implausible counters.", OUTLIER_COUNTERS),
    (27, "percentage-0-once", "One message reports an empty battery.", {"battery_remaining": 0}),
    (27, "percentage-100-once", "One message reports a full battery.", {"battery_remaining": 100}),
):
    procedure = alter_one_battery_message(**changed_fields)
    phases = AIRBORNE_PHASES_BEFORE_LANDING
    FAULTS.add_case(number, name, description, procedure, phases, DELIVERY_RULES)
for number, name, description, pack, effect, is_observed in (
    (
        28,
        "cold",
        "A pack at -10 degrees C; the flight file does not state the temperature.",
        {"temperature_c": -10.0},
        "a pack at -10 degrees C",
        lambda stage: stage.craft.vehicle.battery.temperature_c == -10.0,
    ),
    (
        29,
        "aged",
        "A pack with 80 % of its capacity; the flight file does not state the loss.",
        {"battery_health_frac": 0.8},
        "a pack of 80 % of its capacity",
        lambda stage: (
            stage.craft.vehicle.battery.capacity_ah
            < 0.81 * read_true_airframe(stage.craft.flight).battery.capacity_ah
        ),
    ),
):
    FAULTS.add_case(
        number,
        f"pack-{name}",
        description,
        start_at_once(effect, is_observed),
        ("ready",),
        untold={"vehicle": pack},
    )
