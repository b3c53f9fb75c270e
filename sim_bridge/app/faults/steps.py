"""Steps of reported quantities and of the clock: estimator resets, corrupted reports, wraps."""

import math
from collections.abc import Callable, Iterator

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
POSITION_FIELDS_PER_M = 1e7 / 111_200.0
"""Units of GLOBAL_POSITION_INT's latitude per metre."""

WIND, LOST = Alert.HEADING_UNUSABLE, Alert.POSITION_LOST
WRAP_S = 2.0**32 / 1000.0
FieldOffsets = dict[str, float]


def _draw_heading_offsets(rng: np.random.Generator) -> tuple[str, FieldOffsets]:
    return "ATTITUDE", {"yaw": math.radians(rng.choice([-1.0, 1.0]) * rng.uniform(45.0, 180.0))}


def _draw_position_offsets(rng: np.random.Generator) -> tuple[str, FieldOffsets]:
    size, course = rng.uniform(30.0, 300.0) * POSITION_FIELDS_PER_M, rng.uniform(0.0, math.tau)
    return "GLOBAL_POSITION_INT", {"lat": size * math.cos(course), "lon": size * math.sin(course)}


def _draw_altitude_offsets(rng: np.random.Generator) -> tuple[str, FieldOffsets]:
    size_mm = 1000.0 * rng.choice([-1.0, 1.0]) * rng.uniform(15.0, 60.0)
    return "GLOBAL_POSITION_INT", {"alt": size_mm, "relative_alt": size_mm}


def _draw_velocity_offsets(rng: np.random.Generator) -> tuple[str, FieldOffsets]:
    size, course = 100.0 * rng.uniform(5.0, 10.0), rng.uniform(0.0, math.tau)
    return "GLOBAL_POSITION_INT", {"vx": size * math.cos(course), "vy": size * math.sin(course)}


def offset_reports(
    draw_offsets: Callable[[np.random.Generator], tuple[str, FieldOffsets]],
) -> FaultProcedure:
    """Return a procedure: reports are offset by drawn amounts for 3 to 20 s, then right again."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        name, offsets = draw_offsets(stage.rng)

        def add_offsets(message: Message) -> list[Message] | None:
            if message.msg_name != name:
                return None
            values = {key: getattr(message, key) + by for key, by in offsets.items()}
            if name == "ATTITUDE":
                values = {key: math.remainder(one, math.tau) for key, one in values.items()}
            else:
                values = {key: round(one) for key, one in values.items()}
            return [message_with_changed_fields(message, **values)]

        yield from stage.wait_for_phase_and_record_fault_start()
        stage.expect_messages_changed(name)
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


for number, name, description, draw_offsets, alert in (
    (
        83,
        "heading-step",
        "heading is wrong by 45 to 180 degrees",
        _draw_heading_offsets,
        WIND,
    ),
    (96, "position-step", "position is wrong by 30 to 300 m", _draw_position_offsets, LOST),
    (97, "altitude-step", "altitude is wrong by 15 to 60 m", _draw_altitude_offsets, LOST),
    (98, "velocity-step", "velocity is wrong by 5 to 10 m/s", _draw_velocity_offsets, WIND),
):
    alert_rule = check_alert_sent(alert, within_s=3.0)
    FAULTS.add_case(
        number,
        name,
        f"The reported {description} for 3 to 20 s (C1).",
        offset_reports(draw_offsets),
        STEP_PHASES,
        (*SAFETY_RULES, alert_rule, check_wind_right_after_step, check_no_leg_decision),
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
