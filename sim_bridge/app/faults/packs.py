"""Faults of packs and their monitors: cold, empty monitors, sensor gain, cell counts, freezes."""

from collections.abc import Iterator

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.air import FRONT_DURATION_S, ramp_up_return_headwind
from sim_bridge.app.faults.fault import SAFETY_RULES, FaultGroup
from sim_bridge.app.faults.telemetry import Ranges, freeze_fields
from sim_bridge.app.faults.verdict import (
    check_alert_sent,
    check_delivered,
    check_no_takeoff,
    check_procedure_made_note,
)
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.link.tap import message_with_changed_fields
from sim_bridge.autopilot.mavlink.codec import Message

FAULTS = FaultGroup("energy")

BATTERY_MESSAGE, SYSTEM_MESSAGE = "BATTERY_STATUS", "SYS_STATUS"
INJECTED_NOTE = "fault took effect"
INJECTED = check_procedure_made_note(INJECTED_NOTE)
PACK_RULES = (*SAFETY_RULES, INJECTED)

COLD_PACK = {"vehicle": {"temperature_c": -10.0}}
COLD_RISE_RANGE_MPS = (6.0, 8.0)


@FAULTS.register_procedure(
    78, "cold-pack-and-front", ("outbound", "return"), SAFETY_RULES, untold=COLD_PACK
)
def raise_headwind_on_cold_pack(stage: FaultContext) -> Iterator[None]:
    """A pack at -10 degrees C, and a front of 6 to 8 m/s against the way home (B2)."""
    battery = stage.craft.vehicle.battery
    stage.expect_effect(
        "pack at -10 degrees C", lambda: battery.temperature_c <= -10.0, is_in_world=True
    )
    stage.record_fault_start()
    yield from stage.wait_until(stage.is_in_phase)
    rise_mps = stage.rng.uniform(*COLD_RISE_RANGE_MPS)
    yield from ramp_up_return_headwind(stage, rise_mps, FRONT_DURATION_S)


TIGHT_PACK = {"vehicle": {"charge_frac": 0.44}}
"""An honest sensor shows that the delivery just keeps the reserve, or does not."""


def scale_measured_current(least_gain: float, greatest_gain: float) -> FaultProcedure:
    """Return a procedure: from power-up the current sensor reads a drawn share of the current."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        sensors, gain = stage.craft.vehicle.sensors, stage.rng.uniform(least_gain, greatest_gain)

        def is_share_counted() -> bool:
            counted_j = stage.craft.autopilot.battery.consumed_j
            expected_j = gain * stage.craft.vehicle.battery.delivered_j
            return stage.craft.vehicle.is_airborne and abs(counted_j / expected_j - 1.0) < 0.1

        stage.expect_effect(f"{gain:.2f} times the energy is counted", is_share_counted)
        sensors.current_gain *= gain
        stage.record_fault_start()
        yield from stage.wait_until(lambda: stage.craft.vehicle.is_airborne)
        yield from stage.wait(5.0)
        if is_share_counted():
            stage.notes.append(INJECTED_NOTE)

    return procedure


for suffix, gains, rules in (
    ("low", (0.6, 0.8), (*PACK_RULES, check_alert_sent(Alert.CURRENT_SENSOR_LOW))),
    ("high", (1.2, 1.3), PACK_RULES),
):
    FAULTS.add_case(
        79,
        f"current-sensor-{suffix}",
        f"The current sensor reads {gains[0]:g} to {gains[1]:g} times the current from power-up,"
        " on a flight without spare energy (B3).",
        scale_measured_current(*gains),
        ("ready",),
        rules,
        flight=TIGHT_PACK,
    )


UNKNOWN_U16 = 65535
EMPTY_MONITOR_FIELDS = {
    BATTERY_MESSAGE: {
        "voltages": (UNKNOWN_U16,) * 10,
        "current_battery": -1,
        "current_consumed": -1,
        "energy_consumed": -1,
    },
    SYSTEM_MESSAGE: {"voltage_battery": UNKNOWN_U16, "current_battery": -1},
}
"""Unknown values, by MAVLink's common.xml."""


def report_monitor_without_pack(
    charge_percents: tuple[int, ...], *, has_pack: bool = True
) -> FaultProcedure:
    """Return a procedure: monitor 0 has no pack and reports one of these charges; the pack, if
    there is one, is monitor 1.
    """

    def procedure(stage: FaultContext) -> Iterator[None]:
        charge_percent = int(stage.rng.choice(charge_percents))

        def report_both(message: Message) -> list[Message] | None:
            empty = EMPTY_MONITOR_FIELDS.get(message.msg_name)
            if empty is None:
                return None
            stage.notes.append(INJECTED_NOTE)
            fields = {**empty, "battery_remaining": charge_percent}
            reported = [message_with_changed_fields(message, **fields)]
            if message.msg_name == BATTERY_MESSAGE and has_pack:
                reported.append(message_with_changed_fields(message, id=1))
            return reported

        if has_pack:
            stage.craft.autopilot.params.add_second_battery_monitor()
        stage.expect_messages_changed(*EMPTY_MONITOR_FIELDS)
        stage.tap.to_companion = report_both
        stage.record_fault_start()
        yield

    return procedure


for charge_frac, suffix, stated, rules in (
    (0.9, "full", (0, 55, 100), (*PACK_RULES, check_delivered)),
    (0.09, "empty", (100,), (INJECTED, check_no_takeoff)),
):
    FAULTS.add_case(
        77,
        f"monitor-without-pack-{suffix}",
        f"Monitor 0 has no pack and reports a charge; the pack, monitor 1, is at {charge_frac:.0%}"
        " (B1).",
        report_monitor_without_pack(stated),
        ("ready",),
        rules,
        flight={"vehicle": {"charge_frac": charge_frac}},
    )


def split_voltage_over_cells(message: Message, cell_count: int) -> Message:
    """Return BATTERY_STATUS with the pack's voltage split over cells, 11 to 14 in the extension."""
    total_mv = sum(mv for mv in message.voltages if mv < UNKNOWN_U16)
    cells_mv = [round(total_mv / cell_count)] * cell_count + [0] * (14 - cell_count)
    return message_with_changed_fields(
        message, voltages=tuple(cells_mv[:10]), voltages_ext=tuple(cells_mv[10:])
    )


@FAULTS.register_procedure(80, "many-cells", ("ready",), (*PACK_RULES, check_delivered))
def report_pack_over_many_cells(stage: FaultContext) -> Iterator[None]:
    """A monitor reports 12 or 14 cells, those beyond the tenth in the extension field (B4)."""
    cell_count = int(stage.rng.choice((12, 14)))

    def report_cells(message: Message) -> list[Message] | None:
        if message.msg_name != BATTERY_MESSAGE:
            return None
        stage.notes.append(INJECTED_NOTE)
        return [split_voltage_over_cells(message, cell_count)]

    stage.expect_messages_changed(BATTERY_MESSAGE)
    stage.tap.to_companion = report_cells
    stage.record_fault_start()
    yield


FROZEN_FIELDS: dict[str, Ranges] = {
    name: dict.fromkeys((*fields, "battery_remaining"), (0.0, 0.0))
    for name, fields in EMPTY_MONITOR_FIELDS.items()
}
FREEZE_ALERT_S = 20.0


@FAULTS.register_procedure(
    82,
    "monitor-freezes",
    ("outbound", "return"),
    (*PACK_RULES, check_alert_sent(Alert.MONITOR_FROZEN, within_s=FREEZE_ALERT_S)),
)
def freeze_battery_monitor(stage: FaultContext) -> Iterator[None]:
    """The battery monitor freezes in flight: constant values with current time stamps (B6)."""
    yield from stage.wait_for_phase_and_record_fault_start()
    freeze = freeze_fields(stage, FROZEN_FIELDS)

    def freeze_and_note(message: Message) -> list[Message] | None:
        frozen = freeze(message)
        if frozen and frozen[0].current_battery != message.current_battery:
            stage.notes.append(INJECTED_NOTE)
        return frozen

    stage.expect_messages_changed(*FROZEN_FIELDS)
    stage.tap.to_companion = freeze_and_note
