"""Two faults in one flight: a row of the suite that combines two others.

The second fault begins with the first, up to 10 s after it, or in a later phase of its own. Both
rows keep their procedure and draws. Rules of a pair, by truth and by the messages sent:

- no exception, no error exit code, no rise of the energy estimate, no command after a newer
  decision of a person, no false delivery: always;
- home, and no P(home) of 0.99 or more without a return: if both rows require home (rows in which a
  person keeps control, or in which the motors are stopped, do not), unless another mission is
  uploaded while the companion is away or restarts (the person decides, as in row 66) or another
  computer has control;
- disarmed at the end: if one of the rows requires it;
- deliveries, alerts and notes of the single rows: not required, as the other fault may prevent
  them.

A flight in which one injection took no effect, because the first fault ended the flight or
prevented the second, is no two-fault flight: `FaultRow.had_two_faults` is false.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from companion.core.base.errors import LeewayError
from sim_bridge.app.faults.fault import FLEET_GROUP, FaultCase, FaultTask
from sim_bridge.app.faults.verdict import (
    FaultRunResult,
    check_disarmed_at_end,
    check_no_false_delivery,
    check_no_takeoff,
    check_returned_home,
    check_returned_if_p_home_was_high,
)
from sim_bridge.app.flight.stage import (
    FaultContext,
    FaultProcedure,
    describe_missing_effects,
)
from sim_bridge.app.world.flight_phase import FlightPhase
from sim_bridge.autopilot.kinds import BatterySensing

PAIR_GROUP, SEPARATOR = "pairs", "+"
MISSION_CHANGING_CASES = (
    *("same-length-edit", "foreign-upload", "foreign-upload-again", "shorter-upload"),
    *("longer-upload", "mission-cleared", "replaced-while-held", "replaced-while-dead"),
    *("replaced-when-ready", "hold-then-upload", "last-resort-refused"),
)
ABSENT_COMPANION_CASES = (
    *("silence-10-s", "silence-60-s", "silence-for-good", "killed-for-good", "killed-and-back"),
    *("back-without-a-thread", "back-an-hour-ahead", "back-an-hour-behind"),
    *("torn-checkpoint", "torn-decision-log"),
    *("second-takes-over", "payload-computer-flies"),
)
MAX_DRAWS = 10_000
MAX_DELAY_S = 10.0
"""Longest delay of a second fault in the phase of the first: shorter than the time from a take-over
to the end of the flight."""


def check_no_late_commands(flown: FaultRunResult) -> str | None:
    """Check that no command was sent after a take-over, if there was one."""
    return flown.stage.craft.link.late_commands_text


def had_two_faults(stage: FaultContext) -> bool:
    """Return whether both faults of a pair began and took effect."""
    return all(
        one is not None and one.start_s is not None and not describe_missing_effects(one)
        for one in (stage, stage.second)
    )


def combine_cases(first: FaultCase, second: FaultCase) -> FaultCase:
    """Return the row of both faults."""
    rules = [check_no_late_commands, check_no_false_delivery]
    is_mission_undone = not any(
        one.name in MISSION_CHANGING_CASES and other.name in ABSENT_COMPANION_CASES
        for one, other in ((first, second), (second, first))
    )
    if is_mission_undone and all(check_returned_home in case.rules for case in (first, second)):
        rules += [check_returned_home, check_returned_if_p_home_was_high]
    if any(check_disarmed_at_end in case.rules for case in (first, second)):
        rules.append(check_disarmed_at_end)
    ends = [case.ends_after_s for case in (first, second) if case.ends_after_s is not None]
    return FaultCase(
        number=1000 * first.number + second.number,
        name=f"{first.name}{SEPARATOR}{second.name}",
        group=PAIR_GROUP,
        description=f"{first.description} {second.description}",
        procedure=run_both_procedures(first, second),
        rules=tuple(rules),
        effect_rules=(),
        phases=tuple(phase for phase in first.phases if _second_phases(first, second, phase)),
        autopilots=tuple(kind for kind in first.autopilots if kind in second.autopilots),
        flight=first.flight or second.flight,
        untold=first.untold or second.untold,
        arguments=tuple(dict.fromkeys(first.arguments + second.arguments)),
        before_companion=first.before_companion or second.before_companion,
        ends_after_s=max(ends, default=None),
        settings=first.settings | second.settings,
        battery_sensing=max(
            first.battery_sensing, second.battery_sensing, key=list(BatterySensing).index
        ),
    )


def _second_phases(
    first: FaultCase, second: FaultCase, phase: FlightPhase
) -> tuple[FlightPhase, ...]:
    """Return the phases of the second fault; without a return home there is no later phase."""
    if check_returned_home not in first.rules:
        return (phase,) if phase in second.phases else ()
    return tuple(other for other in second.phases if phase.is_same_or_before(other))


def run_both_procedures(first: FaultCase, second: FaultCase) -> FaultProcedure:
    """Return the procedure of both rows; `FaultContext.second` is that of the second."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        phases = _second_phases(first, second, stage.phase)
        same = stage.phase in phases and stage.rng.random() < 0.5
        phase = stage.phase if same else phases[stage.rng.integers(len(phases))]
        assert stage.craft_and_lockstep is not None
        other = FaultContext.for_flight(*stage.craft_and_lockstep, phase, stage.rng)
        if phase is stage.phase:
            may_begin_on_ground = phase is FlightPhase.READY
            other.is_in_phase = lambda: (
                stage.start_s is not None
                and (may_begin_on_ground or stage.craft.vehicle.is_airborne)
            )
            other.after_phase_s = (0.0, MAX_DELAY_S) if stage.rng.random() < 0.5 else None
        other.resources = stage.resources
        other.remaining_steps, steps = second.procedure(other), first.procedure(stage)
        stage.second = other
        while True:
            next(steps, None)
            other.continue_procedure(stage.t_s)
            yield

    return procedure


def can_combine(first: FaultCase, second: FaultCase) -> bool:
    """Return whether both faults fit into one flight.

    Signed links are excluded, as altered frames lose their signature, and rows without a take-off.
    At most one fault may change the flight file or the companion's process.
    """
    cases = (first, second)
    changed = [case for case in cases if case.flight or case.untold or case.before_companion]
    return (
        first.name != second.name
        and not any(case.signed or case.group == FLEET_GROUP for case in cases)
        and not any(check_no_takeoff in case.rules for case in cases)
        and len(changed) < 2
    )


def draw_pair_task(
    cases: Sequence[FaultCase],
    autopilots: Sequence[str],
    phases: Sequence[str],
    seed: int,
    run_root: Path,
) -> FaultTask:
    """Draw a pair of these rows, an autopilot and a phase. Raises: LeewayError if none fit."""
    rng = np.random.default_rng([seed, len(SEPARATOR)])
    for _ in range(MAX_DRAWS):
        first, second = (cases[k] for k in rng.integers(len(cases), size=2))
        pair = combine_cases(first, second)
        kinds = [kind for kind in pair.autopilots if kind in autopilots]
        fitting = [phase for phase in pair.phases if phase in phases]
        if kinds and fitting and can_combine(first, second):
            kind, phase = kinds[rng.integers(len(kinds))], fitting[rng.integers(len(fitting))]
            return FaultTask(pair.name, kind, phase, seed, run_root)
    raise LeewayError("--pairs: no two of these rows fit together")
