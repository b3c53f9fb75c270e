"""Steps of reported quantities and of the clock: estimator resets, corrupted reports, wraps."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from companion.adapters.logs.decision_log import read_mcap_rows
from companion.core.mission.alerts import Alert
from sim_bridge.app.faults.fault import SAFETY_RULES, FaultGroup
from sim_bridge.app.faults.verdict import FaultRunResult, check_alert_sent
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.link.tap import message_with_changed_fields, pass_unchanged
from sim_bridge.autopilot.mavlink.codec import Message

FAULTS = FaultGroup("steps")

STEP_PHASES = ("climb", "outbound", "return")
SETTLING_S, MAX_WIND_ERROR_SIGMAS = 5.0, 3.0
WRAP_S = 2.0**32 / 1000.0
POSITION = "GLOBAL_POSITION_INT"
LATITUDE_PER_M = 1e7 / 111_200.0
WIND, LOST = Alert.HEADING_UNUSABLE, Alert.POSITION_LOST


def offset_reports(
    message_name: str, fields: Sequence[str], least: float, most: float
) -> FaultProcedure:
    """Return a procedure: for 3 to 20 s fields are offset by an amount that is drawn from `least`
    to `most`: two fields (north, east) in a drawn direction, others equally with a drawn sign.
    """

    def procedure(stage: FaultContext) -> Iterator[None]:
        size, course = stage.rng.uniform(least, most), stage.rng.uniform(0.0, math.tau)
        parts = [math.copysign(1.0, math.sin(course))] * len(fields)
        if fields[0] in ("lat", "vx"):
            parts = [math.cos(course), math.sin(course)]

        def add_offsets(message: Message) -> list[Message] | None:
            if message.msg_name != message_name:
                return None
            given = zip(fields, parts, strict=True)
            values = {name: getattr(message, name) + size * part for name, part in given}
            for name, value in values.items():
                values[name] = math.remainder(value, math.tau) if name == "yaw" else round(value)
            return [message_with_changed_fields(message, **values)]

        yield from stage.wait_for_phase_and_record_fault_start()
        stage.expect_messages_changed(message_name)
        stage.tap.to_companion = add_offsets
        yield from stage.wait(stage.rng.uniform(3.0, 20.0))
        stage.tap.to_companion = pass_unchanged
        stage.end_s = stage.t_s

    return procedure


def check_wind_right_after_step(flown: FaultRunResult) -> str | None:
    """Check that each stated wind is right from 5 s after the step: within 3 sigma of each axis of
    the true 10 s mean (the norm of both axes).
    """
    stage = flown.stage
    if stage.end_s is None:
        return "the step did not end in flight"
    record = stage.craft.record.samples_by_column()
    truth = np.stack([record[name] for name in ("t_s", "wind_to_n_mps", "wind_to_e_mps")], axis=1)
    worst = 0.0
    for topic, row in read_mcap_rows(stage.craft.run_dir / "decisions.mcap").rows:
        if topic != "wind" or not stage.end_s + SETTLING_S <= row["t_s"] <= truth[-1, 0] - 6.0:
            continue
        near = np.abs(truth[:, 0] - row["t_s"]) <= 5.0
        error = np.array([row["to_n_mps"], row["to_e_mps"]]) - truth[near, 1:].mean(axis=0)
        cov = [[row["nn_m2ps2"], row["ne_m2ps2"]], [row["ne_m2ps2"], row["ee_m2ps2"]]]
        worst = max(worst, math.sqrt(error @ np.linalg.solve(cov, error)))
    limit = MAX_WIND_ERROR_SIGMAS * math.sqrt(2.0)
    return f"wind wrong by {worst:.1f} sigma after the step" if worst > limit else None


def check_no_leg_decision(flown: FaultRunResult) -> str | None:
    """Check that no leg was decided to be missed or left."""
    kinds = {d["kind"] for d in flown.row["decisions"]} & {"waypoint_missed", "way_home_refused"}
    return f"decided {', '.join(sorted(kinds))}" if kinds else None


HEADING_RANGE_RAD = math.radians(45.0), math.pi
for number, name, description, alert, offset in (
    (83, "heading-step", "heading is wrong by 45 to 180 degrees", WIND,
     ("ATTITUDE", ["yaw"], *HEADING_RANGE_RAD)),
    (96, "position-step", "position is wrong by 30 to 300 m", LOST,
     (POSITION, ["lat", "lon"], 30.0 * LATITUDE_PER_M, 300.0 * LATITUDE_PER_M)),
    (97, "altitude-step", "altitude is wrong by 15 to 60 m", LOST,
     (POSITION, ["alt", "relative_alt"], 15e3, 60e3)),
    (98, "velocity-step", "velocity is wrong by 5 to 10 m/s", WIND,
     (POSITION, ["vx", "vy"], 500.0, 1000.0)),
):  # fmt: skip
    rules = (*SAFETY_RULES, check_alert_sent(alert, within_s=3.0), check_wind_right_after_step)
    description = f"The reported {description} for 3 to 20 s (C1)."
    FAULTS.add_case(
        number,
        name,
        description,
        offset_reports(*offset),
        STEP_PHASES,
        (*rules, check_no_leg_decision),
    )


@FAULTS.register_procedure(81, "clock-leaps", STEP_PHASES)
def step_or_wrap_autopilot_clock(stage: FaultContext) -> Iterator[None]:
    """The autopilot's clock jumps by 49.7 days, 6 h or -10 s, or wraps at 2^32 ms (B5)."""
    autopilot = stage.craft.autopilot
    by_s = stage.rng.choice([49.7 * 86400.0, 6.0 * 3600.0, -10.0, 0.0])
    if by_s == 0.0:  # switched on 49.7 days ago
        autopilot.shift_message_clock(WRAP_S - stage.rng.uniform(70.0, 120.0))
        yield from stage.wait_until(lambda: autopilot.time_boot_ms > 1e9)
        yield from stage.wait_until(lambda: autopilot.time_boot_ms < 1e9)
        stage.expect_effect("the clock wrapped in flight", lambda: stage.is_armed, is_in_world=True)
        stage.record_fault_start()
        return
    yield from stage.wait_for_phase_and_record_fault_start()
    before_ms = autopilot.time_boot_ms
    stage.expect_effect("the clock stepped", lambda: abs(autopilot.time_boot_ms - before_ms) > 8000)
    autopilot.shift_message_clock(by_s)
    yield
