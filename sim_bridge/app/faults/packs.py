"""Faults of packs and their monitors: cold, empty monitors, sensor gain, cell counts, freezes."""

from collections.abc import Iterator

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.air import FRONT_DURATION_S, ramp_up_return_headwind
from sim_bridge.app.faults.fault import SAFETY_RULES, FaultGroup
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
    78, "cold-pack-and-front", ("outbound", "return"), PACK_RULES, untold=COLD_PACK
)
def raise_headwind_on_cold_pack(stage: FaultContext) -> Iterator[None]:
    """A pack at -10 degrees C, and a front of 6 to 8 m/s against the way home (B2)."""
    stage.record_fault_start()
    if stage.craft.vehicle.battery.temperature_c <= -10.0:
        stage.notes.append(INJECTED_NOTE)
    yield from stage.wait_until(stage.is_in_phase)
    rise_mps = stage.rng.uniform(*COLD_RISE_RANGE_MPS)
    yield from ramp_up_return_headwind(stage, rise_mps, FRONT_DURATION_S)


TIGHT_PACK = {"vehicle": {"charge_frac": 0.44}}
"""An honest sensor shows that the delivery just keeps the reserve, or does not."""


def scale_measured_current(least_gain: float, greatest_gain: float) -> FaultProcedure:
    """Return a procedure: from power-up the current sensor reads a drawn share of the current."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        sensors, gain = stage.craft.vehicle.sensors, stage.rng.uniform(least_gain, greatest_gain)
        sensors.current_gain *= gain
        stage.record_fault_start()
        yield from stage.wait_until(lambda: stage.craft.vehicle.is_airborne)
        yield from stage.wait(5.0)
        counted_j = stage.craft.autopilot.battery.consumed_j
        if abs(counted_j / stage.craft.vehicle.battery.delivered_j / gain - 1.0) < 0.1:
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
