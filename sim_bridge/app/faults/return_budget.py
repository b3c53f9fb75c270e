"""Faults of the return budget: held too long, a failsafe to the wrong site, a hopeless mission."""

import math
from collections.abc import Iterator
from dataclasses import replace

from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.decisions import connect_operator_station, send_mode_command
from sim_bridge.app.faults.fault import SAFETY_RULES, FaultGroup
from sim_bridge.app.faults.verdict import (
    FaultRunResult,
    check_alert_sent,
    check_no_commands_after_takeover,
    check_procedure_made_note,
    check_returned_home,
)
from sim_bridge.app.flight.stage import FaultContext
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.mavlink.enums import Cmd

FAULTS = FaultGroup("energy")

ALARM_NOTE = "alarm before the autopilot's own, away from home"
HOLD_LIMIT_S, MODE_DELAY_S = 900.0, 3.0
AWAY_M = 60.0
LOW_BATTERY_TEXTS = ("battery level", "Battery 1 is")


def _is_away(stage: FaultContext) -> bool:
    return math.hypot(*stage.craft.vehicle.pos_ned_m[:2]) > AWAY_M


def _has_autopilot_reported_low_battery(stage: FaultContext) -> bool:
    texts = [text for _, text in stage.craft.operator.received_texts]
    return any(known in text for text in texts for known in LOW_BATTERY_TEXTS)


@FAULTS.register_procedure(
    72,
    "held-until-low",
    ("outbound", "return"),
    (
        check_returned_home,
        check_no_commands_after_takeover,
        check_procedure_made_note(ALARM_NOTE),
        check_alert_sent(Alert.RETURN_DUE),
    ),
    ends_after_s=HOLD_LIMIT_S,
    flight={"vehicle": {"charge_frac": 0.5}},
)
def hold_until_alarm_then_return_by_rtl(stage: FaultContext) -> Iterator[None]:
    """A person holds, or a foreign mission loiters, until the return alarm; then RTL (A10)."""
    station, craft = connect_operator_station(stage), stage.craft
    yield from stage.wait_for_phase_and_record_fault_start()
    member = stage.rng.choice(["hold", "position", "foreign mission"])
    autopilot, is_copter = craft.autopilot, craft.autopilot_kind == "ardupilot"
    is_held = {
        "hold": lambda: autopilot.mode is (Mode.LOITER if is_copter else Mode.HOLD),
        "position": lambda: autopilot.mode is Mode.LOITER,
        "foreign mission": lambda: all(
            item.command == Cmd.NAV_LOITER_TIME for item in autopilot.store.mission[1:]
        ),
    }
    stage.expect_effect(f"held by {member}", is_held[member])
    yield from stage.wait_until(lambda: _is_away(stage))
    if member == "foreign mission":
        stage.kill_companion()
        items = craft.autopilot.store.mission
        loiter = next(i for i in items if i.command == Cmd.NAV_LOITER_TIME)
        points = (i for i in items if i.command == Cmd.NAV_WAYPOINT)
        away = max(points, key=lambda i: math.hypot(i.x - loiter.x, i.y - loiter.y))
        foreign = replace(loiter, param1=HOLD_LIMIT_S, x=away.x, y=away.y)
        yield from station.upload_mission([foreign] * len(items))
        yield from stage.wait(2.0)
        stage.restart_companion()
    elif member == "position" and not is_copter:  # PX4 refuses position control without sticks
        craft.start_pilot_override()
    else:
        send_mode_command(stage, station, member)
    stage.record_take_over()
    yield from stage.wait_until(
        lambda: (
            stage.has_operator_received_alert(Alert.RETURN_DUE)
            or _has_autopilot_reported_low_battery(stage)
        )
    )
    if not _has_autopilot_reported_low_battery(stage) and _is_away(stage):
        stage.notes.append(ALARM_NOTE)
    yield from stage.wait(MODE_DELAY_S)
    send_mode_command(stage, station, "rtl")


FAILSAFE_NOTE = "RTL of the failsafe landed at the rally point"
MAX_SITE_DISTANCE_M = 30.0
QUAY_EAST_M, QUAY_NORTH_M = -720.0, 60.0
LOW_BATTERY_SETTINGS = {
    "px4": {"BAT_CRIT_THR": 0.99},
    "ardupilot": {"BATT_FS_LOW_ACT": 2.0, "BATT_LOW_VOLT": 99.0},
}
"""Settings with which each autopilot commands RTL for a low battery at once."""


@FAULTS.register_procedure(
    89,
    "failsafe-during-diversion",
    ("return",),
    (
        *SAFETY_RULES,
        check_no_commands_after_takeover,
        check_procedure_made_note(FAILSAFE_NOTE),
        check_alert_sent(Alert.DIVERTING),
    ),
    flight={
        "site": {
            "customer": {"name": "customer", "east_m": -900.0, "north_m": -60.0, "up_m": 4.5},
            "rally": [
                {"name": "quay", "east_m": QUAY_EAST_M, "north_m": QUAY_NORTH_M, "up_m": 3.6}
            ],
        },
        "vehicle": {"charge_frac": 0.55},
    },
)
def trigger_battery_failsafe_during_diversion(stage: FaultContext) -> Iterator[None]:
    """The draw rises to 1.7 to 2 times; in the diversion the autopilot commands RTL (S2)."""
    station, craft = connect_operator_station(stage), stage.craft
    yield from stage.wait_for_phase_and_record_fault_start()
    stage.expect_change("another draw", lambda: craft.vehicle.draw_factor)
    craft.vehicle.draw_factor = stage.rng.uniform(1.7, 2.0)
    yield from stage.wait_until(lambda: stage.has_operator_received_alert(Alert.DIVERTING))
    yield from stage.wait(stage.rng.uniform(4.0, 8.0))
    stage.expect_effect("the autopilot is in RTL", lambda: craft.autopilot.mode is Mode.RTL)
    for name, value in LOW_BATTERY_SETTINGS[craft.autopilot_kind].items():
        station.send_parameter_to_autopilot(name, value)
    yield from stage.wait_until(lambda: craft.autopilot.mode is Mode.RTL)
    stage.record_take_over()
    yield from stage.wait_until(lambda: craft.record.landed_s is not None)
    north_m, east_m, _ = craft.vehicle.pos_ned_m
    if math.hypot(north_m - QUAY_NORTH_M, east_m - QUAY_EAST_M) < MAX_SITE_DISTANCE_M:
        stage.notes.append(FAILSAFE_NOTE)


def check_no_hopeless_go_decision(flown: FaultRunResult) -> str:
    """Check that no decision to fly on had a P(success) below the gate's threshold."""
    return "; ".join(
        f"{one['kind']} at P(success) {one['p_success']:.3f}"
        for one in flown.row["decisions"]
        if one["kind"] in GO_KINDS and (one["p_success"] or 0.0) < MIN_SUCCESS
    )


HEADWIND_MPS, HEADWIND_AT_M = 13.0, 30.0
MIN_SUCCESS, GO_KINDS = 0.05, ("go", "onward", "descend")


@FAULTS.register_procedure(
    91,
    "hopeless-mission",
    ("outbound",),
    (
        *SAFETY_RULES,
        check_no_hopeless_go_decision,
        check_alert_sent(Alert.GATE_CLOSED),
    ),
    flight={
        "vehicle": {"charge_frac": 0.43},
        "wind": {
            "kind": "steady",
            "speed_mps": HEADWIND_MPS,
            "from_deg": 270.0,
            "turbulence": "dryden",
        },
    },
)
def increase_headwind_to_customer(stage: FaultContext) -> Iterator[None]:
    """The headwind measured after take-off makes the delivery hopeless, the return safe (S5)."""
    wind_field = stage.craft.vehicle.wind_field
    stage.expect_effect(
        "a headwind",
        lambda: wind_field.mean_wind_to_ne_mps(stage.t_s, HEADWIND_AT_M)[1] > 0.9 * HEADWIND_MPS,
        is_in_world=True,
    )
    wind_field.front_to_ne_mps = (0.0, stage.rng.uniform(0.0, 1.0))
    stage.record_fault_start()
    yield
