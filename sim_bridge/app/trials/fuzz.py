"""Field-level fuzz test of MAVLink telemetry: whole flights, a real companion, altered messages.

With arbitrary false telemetry the vehicle need not return home. The checks here must always pass.
"""

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.logs.decision_log import read_mcap_rows
from companion.core.base.errors import LeewayError
from companion.core.mission.alerts import Alert, is_text_of_any_alert
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.app.faults.runner import write_changed_flight_file
from sim_bridge.app.faults.verdict import EXIT_INTERNAL_ERROR, EXIT_USAGE_ERROR
from sim_bridge.app.flight.companion_process import suite_fork_server
from sim_bridge.app.flight.fly import FlyOptions, fly_vehicles_and_evaluate
from sim_bridge.app.flight.stage import Script
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.app.link.message_mutation import (
    MUTATIONS,
    STUCK,
    MessageMutator,
    SweepTarget,
    sweep_targets,
)
from sim_bridge.app.link.tap import Tap
from sim_bridge.app.trials.trial import TrialRow, build_row_and_delete_passed_folder
from sim_bridge.app.world.exception_files import count_tracebacks_by_file
from sim_bridge.app.world.safety_rules import (
    TakeOver,
    find_energy_rise_after_takeoff,
    format_sent_command,
)
from sim_bridge.app.world.truth_record import COLUMNS
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd

FLIGHT: dict[str, Any] = {
    "site": {"customer": {"east_m": -150.0, "north_m": -30.0, "up_m": 0.75}, "rally": []},
    "mission": {"cruise_height_m": 20.0, "leg_length_m": 60.0},
}
"""Shortened flight of the fault suite: two minutes, a third of it on the ground."""

NOMINAL_FLIGHT_S = 115.0
"""Duration from power-up without faults; alterations start within it."""

LIMIT_S = 240.0
"""Time limit of a flight: twice the duration without faults."""

TAKEOFF_LIMIT_S = 90.0
"""Limit for take-off (23 s without faults); later the case counts as not launched."""

OBSERVATION_S = 10.0
"""Time from control release to the end: all retries of a command are due within 3 s."""

RESPONSE_LIMIT_S = 60.0
SWEEP_INTERVAL = 3
"""Every third case is a sweep over single fields."""

SWEPT_MESSAGES, STUCK_MESSAGES, SWEEP_LIMIT_S = 2, 20, 3.0
"""A field is altered in so many messages (if stuck, in more), or for this time."""

ALTERED_MESSAGES = ("HEARTBEAT", "CURRENT_MODE", "ATTITUDE", "GLOBAL_POSITION_INT", "GPS_RAW_INT",
              "SYS_STATUS", "BATTERY_STATUS", "VFR_HUD", "MISSION_CURRENT", "MISSION_ITEM_REACHED",
              "EXTENDED_SYS_STATE", "SYSTEM_TIME", "HOME_POSITION", "COMMAND_ACK", "MISSION_ACK",
              "MISSION_COUNT", "MISSION_ITEM_INT", "PARAM_VALUE", "TIMESYNC")  # fmt: skip
"""Messages that the companion receives (docs/reference/mavlink.md)."""

MODE_MESSAGES = ("HEARTBEAT", "CURRENT_MODE")
LANDED, RELEASED, TIME_LIMIT, NO_TAKEOFF = "down", "let go", "time", "never left"
"""How a flight ended: on the ground, or stopped because the checks were complete."""

PROBABILITY_KEYS = ("p_home", "p_home_now", "p_success")
PROBABILITY_MESSAGES = ("LW_PHOME", "LW_PHNOW", "LW_PSUCC")
AIRBORNE_COLUMN = COLUMNS.index("airborne")


class FuzzCase(msgspec.Struct, frozen=True, kw_only=True):
    """All inputs of one flight. `messages` empty: every message can be altered."""

    autopilot: str
    seed: int
    altered_frac: float = msgspec.field(name="share")
    start_s: float = msgspec.field(name="begins_s")
    end_s: float | None = msgspec.field(name="ends_s")
    alteration_kinds: tuple[str, ...] = msgspec.field(name="deeds")
    messages: tuple[str, ...]
    pilot_override_after_s: float | None = msgspec.field(name="takes_over_after_s")
    """Delay from the first alteration to a pilot override in flight; null: no override."""
    is_sweep: bool = False
    """Alter one field of `messages` at a time, all in an order drawn by seed."""

    @property
    def name(self) -> str:
        """Name of the run folder and the case file."""
        return f"fuzz-{self.autopilot}-seed{self.seed}"


def draw_case(seed: int, case_number: int) -> FuzzCase:
    """Draw case `case_number` of the trial with this seed."""
    rng = np.random.default_rng([seed, case_number])
    if case_number % SWEEP_INTERVAL == SWEEP_INTERVAL - 1:
        return _draw_sweep_case(rng, 1000 * seed + case_number)
    alteration_kinds = rng.choice(MUTATIONS, rng.integers(1, len(MUTATIONS) + 1), replace=False)
    start_s = float(rng.choice([0.0, rng.uniform(0.0, NOMINAL_FLIGHT_S)], p=[0.2, 0.8]))
    duration_s = float(rng.choice([2.0, 10.0, 40.0, math.inf]))
    return FuzzCase(
        autopilot=str(rng.choice(["px4", "ardupilot"])),
        seed=1000 * seed + case_number,
        altered_frac=round(float(10.0 ** rng.uniform(-2.0, 0.0)), 4),
        start_s=round(start_s, 1),
        end_s=round(start_s + duration_s, 1) if math.isfinite(duration_s) else None,
        alteration_kinds=tuple(sorted(map(str, alteration_kinds))),
        messages=_draw_altered_message_names(rng),
        pilot_override_after_s=round(rng.uniform(0.0, 30.0), 1) if rng.random() < 0.4 else None,
    )


def _draw_sweep_case(rng: np.random.Generator, seed: int) -> FuzzCase:
    """Draw a sweep. One in four is of mode messages from a drawn time on: they end the flight."""
    others = tuple(name for name in ALTERED_MESSAGES if name not in MODE_MESSAGES)
    is_of_modes = rng.random() < 0.25
    return FuzzCase(
        autopilot=str(rng.choice(["px4", "ardupilot"])),
        seed=seed,
        altered_frac=0.0,
        start_s=round(rng.uniform(0.0, NOMINAL_FLIGHT_S), 1) if is_of_modes else 0.0,
        end_s=None,
        alteration_kinds=(),
        messages=MODE_MESSAGES if is_of_modes else others,
        pilot_override_after_s=None,
        is_sweep=True,
    )


def _draw_altered_message_names(rng: np.random.Generator) -> tuple[str, ...]:
    """Draw one, three, all except mode messages, or all messages. A false mode makes the companion
    release control, which ends the test early."""
    match rng.integers(4):
        case 0:
            return (str(rng.choice(ALTERED_MESSAGES)),)
        case 1:
            return tuple(sorted(map(str, rng.choice(ALTERED_MESSAGES, 3, replace=False))))
        case 2:
            return tuple(name for name in ALTERED_MESSAGES if name not in MODE_MESSAGES)
        case _:
            return ()


@dataclass(slots=True)
class FuzzMonitor(Script):
    """Alters telemetry as its case requires and observes the companion."""

    case: FuzzCase
    liar: MessageMutator
    craft: Craft | None = None
    control_released_s: float | None = None
    """Time when the companion reported the release of control."""
    takeover: TakeOver = field(default_factory=TakeOver)
    """The pilot override, or the release of control without one."""
    response_timed_out: bool = False
    invalid_probability: str | None = None
    ending: str = LANDED
    swept: list[tuple[float, SweepTarget, int]] = field(default_factory=list)
    """Start, target and number of altered messages of each ended step of a sweep."""
    _targets: Iterator[SweepTarget] = field(default_factory=lambda: iter(()))
    _target_since_s: float = 0.0

    @classmethod
    def for_case(cls, case: FuzzCase) -> "FuzzMonitor":
        """Return a monitor with the random generator of the case."""
        rng = np.random.default_rng(case.seed)
        mutator = MessageMutator(rng, case.altered_frac, case.alteration_kinds, case.messages)
        targets = sweep_targets(case.messages) if case.is_sweep else []
        order = rng.permutation(len(targets))
        return cls(case, mutator, _targets=cycle([targets[k] for k in order]))

    def apply_step(self, crafts: list[Craft], t_s: float, lockstep: Lockstep) -> None:
        """Apply one step of 0.1 s."""
        if self.craft is None:
            self.craft = crafts[0]
            self.craft.link.takeover = self.takeover
            self.craft.link.taps = [
                Tap(
                    to_companion=self.liar.mutate_random_share_of_messages,
                    to_autopilot=self._record_release_and_bad_probability,
                )
            ]
        end_s = math.inf if self.case.end_s is None else self.case.end_s
        self.liar.active = self.case.start_s <= t_s < end_s
        self._advance_sweep(t_s)
        self.response_timed_out |= self.craft.companion.is_running and not lockstep.live_clients
        self._start_pilot_override_when_due(self.craft, t_s)

    def _advance_sweep(self, t_s: float) -> None:
        """Begin with the next field after enough altered messages, or after the time limit."""
        liar, target = self.liar, self.liar.target
        if not liar.active:
            return
        enough = STUCK_MESSAGES if target and target.value == STUCK else SWEPT_MESSAGES
        if target and liar.target_count < enough and t_s < self._target_since_s + SWEEP_LIMIT_S:
            return
        if target is not None:
            self.swept.append((self._target_since_s, target, liar.target_count))
        liar.target, liar.target_count, self._target_since_s = next(self._targets, None), 0, t_s

    def _start_pilot_override_when_due(self, craft: Craft, t_s: float) -> None:
        """Start the pilot override in flight; record when a true heartbeat has reported it."""
        if self.takeover.start_s is None:
            after_s, record = self.case.pilot_override_after_s, craft.record
            flies = record.takeoff_s is not None and record.landed_s is None
            if after_s is not None and flies and t_s >= self.case.start_s + after_s:
                craft.start_pilot_override()
                self.takeover.start_s = t_s
                self.liar.passed_mode = None
        elif self.liar.passed_mode is not None:
            kind, mode = craft.autopilot_kind, self.liar.passed_mode
            self.takeover.record_reported_mode(t_s, kind, mode)

    def _record_release_and_bad_probability(self, message: Message) -> list[Message] | None:
        is_probability = (
            message.msg_name == "NAMED_VALUE_FLOAT" and message.name in PROBABILITY_MESSAGES
        )
        if is_probability and not 0.0 <= message.value <= 1.0:  # NaN too
            self.invalid_probability = f"published {message.name} = {message.value}"
        is_release = message.msg_name == "STATUSTEXT" and is_text_of_any_alert(
            message.text, Alert.CONTROL_RELEASED
        )
        if is_release and self.control_released_s is None and self.craft is not None:
            self.control_released_s = self.craft.t_s
            self.takeover.record_known(self.craft.t_s, 0.0)
        return None

    def should_continue(self, t_s: float) -> bool:
        """Return False when all checks can be evaluated."""
        if self.control_released_s is not None and t_s > self.control_released_s + OBSERVATION_S:
            self.ending = RELEASED
        elif t_s >= TAKEOFF_LIMIT_S and self.craft is not None:
            left = self.craft.record.takeoff_s is not None
            self.ending = TIME_LIMIT if left and t_s >= LIMIT_S else LANDED if left else NO_TAKEOFF
        return self.ending == LANDED


@dataclass(frozen=True, slots=True)
class FuzzResult:
    """An ended flight with altered telemetry: truth, messages and the companion's record."""

    monitor: FuzzMonitor
    craft: Craft
    rows: list[tuple[str, dict[str, Any]]]
    """Rows of the decision log, in order: (topic, row)."""


Check = Callable[[FuzzResult], str | None]


def find_exception_or_crash(result: FuzzResult) -> str | None:
    """Check for a traceback in output and logs, and for the exit code of a crash."""
    code = result.craft.companion.exit_code
    if files := count_tracebacks_by_file(result.craft.run_dir):
        return f"an exception: {', '.join(files)}"
    crashed = code is not None and (code < 0 or code in (EXIT_INTERNAL_ERROR, EXIT_USAGE_ERROR))
    return f"exit code {code}" if crashed else None


def find_lost_record(result: FuzzResult) -> str | None:
    """Check that no record was lost: the disk works, and every number can be written."""
    given_up = [
        line
        for path in result.craft.run_dir.glob("companion.*")  # output and log
        for line in path.read_text(errors="replace").splitlines()
        if is_text_of_any_alert(line.strip(), Alert.RECORD_LOST)
    ]
    return given_up[0].strip()[:160] if given_up else None


def find_energy_increase(result: FuzzResult) -> str | None:
    """Check that the estimated energy never rises after take-off."""
    return find_energy_rise_after_takeoff(
        (row for topic, row in result.rows if topic == "decision"),
        (row for topic, row in result.rows if topic == "energy"),
    )


def find_arming_or_parameter_command_in_air(result: FuzzResult) -> str | None:
    """Check that no arming, disarming or parameter command was sent in true flight."""
    times = np.array([row[0] for row in result.craft.record.rows])
    airborne = np.array([row[AIRBORNE_COLUMN] for row in result.craft.record.rows]) > 0.0
    for command in result.craft.link.commands:
        if command[1] == "PARAM_SET" or command[2] == Cmd.COMPONENT_ARM_DISARM:
            near = np.abs(times - command[0]) <= 0.5
            if near.any() and airborne[near].all():
                return f"in the air: {format_sent_command(command)}"
    return None


def find_invalid_probability(result: FuzzResult) -> str | None:
    """Check that each published or recorded P is in [0, 1]; NaN is recorded as null."""
    if result.monitor.invalid_probability is not None:
        return result.monitor.invalid_probability
    for topic, row in result.rows:
        for key in PROBABILITY_KEYS:
            value, needed = row.get(key), topic == "assessment"
            if (value is None and needed) or (value is not None and not 0.0 <= value <= 1.0):
                return f"{topic}: {key} = {value}"
    return None


CHECKS: tuple[Check, ...] = (
    find_exception_or_crash,
    find_lost_record,
    lambda result: "no reply within a minute" if result.monitor.response_timed_out else None,
    find_energy_increase,
    lambda result: result.craft.link.late_commands_text,
    find_arming_or_parameter_command_in_air,
    find_invalid_probability,
)


def run_case(case: FuzzCase, folder: Path) -> TrialRow:
    """Fly one case and evaluate it."""
    folder.mkdir(parents=True, exist_ok=True)
    monitor = FuzzMonitor.for_case(case)
    options = FlyOptions(
        flight_file=write_changed_flight_file(folder / "flight.toml", FLIGHT),
        autopilot=case.autopilot,
        seed=case.seed,
        run_root=folder,
        picture=False,
        lockstep_limit_s=RESPONSE_LIMIT_S,
        fork_server=suite_fork_server(),
    )
    (row,) = fly_vehicles_and_evaluate(options, monitor)["flights"]
    craft = monitor.craft
    assert craft is not None
    rows: list[tuple[str, dict[str, Any]]] = []
    for path in sorted(craft.run_dir.glob("decisions*.mcap")):
        with contextlib.suppress(LeewayError):  # the companion ended before its first row
            rows += read_mcap_rows(path).rows
    result = FuzzResult(monitor, craft, rows)
    if case.is_sweep:
        lines = (f"{at_s:.1f} {'.'.join(target)} {count}" for at_s, target, count in monitor.swept)
        (folder / "sweep.txt").write_text("\n".join(lines))
    violations = [violation for check in CHECKS if (violation := check(result))]
    ended = NO_TAKEOFF if craft.record.takeoff_s is None else monitor.ending
    outcome = {
        "ended": ended,
        "home": row["home"] if ended == LANDED else None,
        "hands_off_s": monitor.control_released_s,
        "took_over_s": monitor.takeover.start_s,
        "lies": monitor.liar.changed_count,
        "swept_fields": sum(count > 0 for *_, count in monitor.swept),
        "commands": len(craft.link.commands),
        "flown_s": round(craft.t_s, 1),
    }
    return build_row_and_delete_passed_folder(case, folder, violations, outcome)
