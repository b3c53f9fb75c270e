"""A row of the fault suite: the fault injected into a flight or small day, and its rules."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from sim_bridge.app.faults.verdict import (
    FaultRunResult,
    Rule,
    check_day_rules,
    check_energy_never_rises,
    check_fault_took_effect,
    check_no_error_exit_code,
    check_no_exceptions,
    check_no_false_delivery,
    check_returned_home,
    check_returned_if_p_home_was_high,
    check_single_flight_per_power_up,
)
from sim_bridge.app.flight.stage import FaultContext, FaultProcedure
from sim_bridge.app.world.flight_phase import FlightPhase
from sim_bridge.autopilot.kinds import AUTOPILOTS, BatterySensing

PHASES = tuple(FlightPhase)[1:-1]
"""Phases in which a fault can begin: from `READY` to `LAND`."""

AIRBORNE_PHASES, AIRBORNE_PHASES_BEFORE_LANDING = PHASES[1:], PHASES[1:-1]

SAFETY_RULES: tuple[Rule, ...] = (check_returned_home, check_returned_if_p_home_was_high)
"""Rules that apply to nearly every row."""

FLEET_GROUP = "fleet"
DAY_LIMIT_S = 900.0
"""Limit of a day: about 200 s without a fault, as much again for a new plan and second flight."""


def start_at_once(
    expected_effect: str, is_observed: Callable[[FaultContext], bool]
) -> FaultProcedure:
    """Return a procedure that begins at once: the fault is part of the world (air or pack)."""

    def procedure(stage: FaultContext) -> Iterator[None]:
        stage.expect_effect(expected_effect, lambda: is_observed(stage), is_in_world=True)
        stage.record_fault_start()
        yield

    return procedure


STARTUP_EFFECT_CODE = """\
import pathlib, sys
def record_fault_effect():
    (pathlib.Path(sys.argv[-1]) / "fault_effect").touch()
"""
"""Python code before each row's `before_companion`, which calls `record_fault_effect()` where its
fault takes effect in the companion's process."""


def expect_startup_effect(stage: FaultContext, *, since_start: bool = False) -> None:
    """Require that the row's `before_companion` code records its effect, now or from its start."""
    path = stage.craft.run_dir / "fault_effect"
    stage.expect_effect("fault in the companion's process", path.exists, is_in_world=since_start)


def start_with_companion(stage: FaultContext) -> Iterator[None]:
    """Begin at once: the fault is in the companion's process, by `before_companion`."""
    expect_startup_effect(stage, since_start=True)
    stage.record_fault_start()
    yield


@dataclass(frozen=True, slots=True)
class FaultCase:
    """One row: a fault of one vehicle's flight, or (group FLEET) of a small day of a fleet.

    `procedure`: fault procedure on a stage (in a day also on its `SmallDay`). `flight` changes
    tables of the flight file; `untold` changes only the simulator's copy. `arguments`: additional
    companion options. `before_companion`: Python code that runs first in the companion's process,
    after `STARTUP_EFFECT_CODE`.
    `ends_after_s`: time from a takeover to the end of the flight. `signed`: autopilot and companion
    share a signing key. `settings`: autopilot parameters. `day_s`: time limit of a day; a longer
    day has failed.
    """

    number: int
    name: str
    group: str
    description: str
    procedure: Callable[..., Iterator[None]]
    rules: tuple[Rule, ...] = (check_returned_home,)
    phases: tuple[FlightPhase, ...] = (FlightPhase.OUTBOUND,)
    autopilots: tuple[str, ...] = AUTOPILOTS
    flight: dict[str, Any] = field(default_factory=dict)
    untold: dict[str, Any] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    before_companion: str = ""
    ends_after_s: float | None = None
    signed: bool = False
    day_s: float = DAY_LIMIT_S
    battery_sensing: BatterySensing = BatterySensing.POWER_MODULE
    settings: dict[str, float] = field(default_factory=dict)
    effect_rules: tuple[Rule, ...] = (check_fault_took_effect,)

    def find_broken_rules(
        self, flown: FaultRunResult, *, has_tight_energy: bool = False
    ) -> list[str]:
        """Return the broken rules. Always: the fault took effect, no exception, a normal
        end, no rise of the energy estimate.

        A `has_tight_energy` flight may be refused before the fault starts, may turn back, and may
        be lost as often as P(home) predicts, which is evaluated over many flights.
        """
        delivery_rules = tuple(rule for rule in self.rules if rule is check_no_false_delivery)
        specific_rules = delivery_rules if has_tight_energy else self.rules
        if flown.stage.start_s is not None or not has_tight_energy:
            specific_rules = (*self.effect_rules, *specific_rules)
        mandatory_rules = (
            (check_day_rules, check_single_flight_per_power_up)
            if self.group == FLEET_GROUP
            else (check_no_error_exit_code, check_energy_never_rises)
        )
        violations = [
            rule(flown) for rule in (*specific_rules, check_no_exceptions, *mandatory_rules)
        ]
        return [violation for violation in violations if violation]


P = TypeVar("P", bound=Callable[..., Iterator[None]])


@dataclass(slots=True)
class FaultGroup:
    """Rows of a group. `register_procedure` is a decorator; `add_case` takes a parametrised one."""

    group: str
    cases: list[FaultCase] = field(default_factory=list)

    def register_procedure(
        self,
        row_number: int,
        case_name: str,
        phases: Sequence[str] = ("outbound",),
        rules: Sequence[Rule] = SAFETY_RULES,
        **case_options: Any,
    ) -> Callable[[P], P]:
        """Decorate a row's procedure. The first paragraph of its docstring describes the fault."""

        def decorate(procedure: P) -> P:
            description = " ".join((procedure.__doc__ or "").partition("\n\n")[0].split())
            self.add_case(
                row_number, case_name, description, procedure, phases, rules, **case_options
            )
            return procedure

        return decorate

    def add_case(
        self,
        row_number: int,
        case_name: str,
        description: str,
        procedure: Callable[..., Iterator[None]],
        phases: Sequence[str] = ("outbound",),
        rules: Sequence[Rule] = SAFETY_RULES,
        **case_options: Any,
    ) -> None:
        """Add a row."""
        case = FaultCase(
            row_number,
            case_name,
            case_options.pop("group", self.group),
            description,
            procedure,
            tuple(rules),
            tuple(map(FlightPhase, phases)),
            **case_options,
        )
        self.cases.append(case)


@dataclass(frozen=True, slots=True)
class FaultTask:
    """One flight of the suite, not yet flown."""

    fault: str
    autopilot: str
    phase: FlightPhase
    seed: int
    run_root: Path
    tight: bool = False
    """Draw the pack's charge from insufficient to ample, and evaluate P(home) over many flights
    instead of the return of each flight."""

    @property
    def title(self) -> str:
        """Name of the flight in messages."""
        return f"{self.fault} {self.autopilot} {self.phase} seed {self.seed}"

    @property
    def run_folder(self) -> Path:
        """Run folder of the flight."""
        return self.run_root / f"{self.fault}-{self.autopilot}-{self.phase}-seed{self.seed}"


class FaultRow(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one flight under one fault, as written by `--json`."""

    fault: str
    group: str
    autopilot: str
    phase: str
    seed: int
    outcome: str
    home: bool
    delivered: bool
    margin_wh: float
    p_home_last_go: float | None
    commands_after_takeover: int
    exceptions: int
    messages: list[str] = msgspec.field(name="said")
    passed: bool = msgspec.field(name="held")
    failure_text: str = msgspec.field(name="why")
    cpu_s: float | None = None
    """CPU time of simulator and companions together. None: not measured."""
    charge_frac: float | None = None
    """Drawn charge of the pack at power-up. None: the charge of the flight file."""
    had_two_faults: bool | msgspec.UnsetType = msgspec.UNSET
    """Whether both injections of a pair took effect. Omitted for a single fault."""
