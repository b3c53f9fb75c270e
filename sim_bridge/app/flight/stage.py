"""Context of one fault in a flight or small day: time, phase and affected vehicle.

A fault procedure is a generator that acts on this context. Each `yield` waits for one exchange:
0.1 s in a flight, 1 s in a day.

**Evidence.** Each procedure states, before it injects its fault, what the injection changes by
truth or in messages that cross the link. A row of which an expected effect is never observed, or
that expects none, has not been tested and fails. One line is enough:

    stage.expect_effect("the autopilot is in HOLD", lambda: craft.autopilot.mode is Mode.HOLD)
    stage.expect_change("another voltage", lambda: battery.voltage_v, by=3.0)
    stage.expect_messages_changed("BATTERY_STATUS")  # by the tap: altered, dropped, delayed

A condition is evaluated at each step until it holds. It must not hold before the injection.
"""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.core.mission.alerts import Alert, is_text_of_any_alert
from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.app.link.tap import Tap
from sim_bridge.app.world.flight_phase import FlightPhase
from sim_bridge.app.world.safety_rules import MODE_REPORT_DELAY_S
from sim_bridge.autopilot.base.modes import PILOTED

PHASE_DELAY_RANGE_S = (0.5, 4.0)
"""Range of the delay from phase start to fault start, drawn by seed."""


@dataclass(slots=True)
class ExpectedEffect:
    """An effect by which an injection is observed; `is_observed` is evaluated until it holds."""

    description: str
    is_observed: Callable[[], bool]
    held_before_injection: bool
    was_observed: bool = False

    def update(self) -> None:
        """Evaluate the condition."""
        self.was_observed = self.was_observed or self.is_observed()

    @property
    def failure_text(self) -> str:
        """Reason why the injection is not shown, empty if it is."""
        if self.held_before_injection:
            return f"{self.description}: already before the injection"
        return "" if self.was_observed else self.description


@dataclass(slots=True)
class FaultContext:
    """One flight or day under one fault."""

    phase: FlightPhase
    """Phase in which the fault starts."""
    rng: np.random.Generator
    is_in_phase: Callable[[], bool]
    after_phase_s: tuple[float, float] | None = PHASE_DELAY_RANGE_S
    """Bounds of the drawn delay from the phase to the fault. None: no delay."""
    craft_and_lockstep: tuple[Craft, Lockstep] | None = None
    """The vehicle of a flight. None in a day."""
    t_s: float = 0.0
    start_s: float | None = None
    end_s: float | None = None
    """End of the injection, if it ends."""
    notes: list[str] = field(default_factory=list)
    own_tap: Tap | None = None
    expected_effects: list[ExpectedEffect] = field(default_factory=list)
    second: "FaultContext | None" = None
    """Context of the second fault of a pair."""
    resources: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)
    """Resources of the procedure, closed after the flight."""
    remaining_steps: Iterator[None] = field(default_factory=lambda: iter(()))
    """Remaining steps of the procedure."""

    def continue_procedure(self, t_s: float) -> bool:
        """Continue the procedure at `t_s`. Return False after its last step."""
        self.t_s = t_s
        has_more_steps = next(self.remaining_steps, self) is not self
        for effect in self.expected_effects:
            effect.update()
        return has_more_steps

    @classmethod
    def for_flight(
        cls, craft: Craft, lockstep: Lockstep, phase: FlightPhase, rng: np.random.Generator
    ) -> "FaultContext":
        """Return the context of one flight. A fault in READY starts with the authorisation."""

        def is_in_phase() -> bool:
            waits = phase is FlightPhase.READY and not craft.operator.accepted
            return craft.true_flight_phase is phase and not waits

        after_s = None if phase is FlightPhase.READY else PHASE_DELAY_RANGE_S
        return cls(phase, rng, is_in_phase, after_s, (craft, lockstep))

    def wait(self, duration_s: float) -> Iterator[None]:
        """Let simulated time pass."""
        until_s = self.t_s + duration_s
        while self.t_s < until_s - 1e-6:
            yield

    def wait_until(self, is_met: Callable[[], bool]) -> Iterator[None]:
        """Wait for a condition."""
        while not is_met():
            yield

    def wait_for_phase_and_record_fault_start(self) -> Iterator[None]:
        """Wait for the phase and the delay after it, then mark the start of the fault."""
        yield from self.wait_until(self.is_in_phase)
        if self.after_phase_s is not None:
            yield from self.wait(self.rng.uniform(*self.after_phase_s))
        self.record_fault_start()

    def record_fault_start(self) -> None:
        """Record the start time of the fault."""
        self.start_s = self.t_s

    def expect_effect(
        self, description: str, is_observed: Callable[[], bool], *, is_in_world: bool = False
    ) -> None:
        """Require this effect, which does not hold yet unless the fault `is_in_world`, as a part of
        it since power-up. `description`: the expected observation, such as "home is 3 km away".
        """
        held_before = not is_in_world and is_observed()
        self.expected_effects.append(ExpectedEffect(description, is_observed, held_before))

    def expect_change(
        self, description: str, read: Callable[[], Any], by: float | None = None
    ) -> None:
        """Require another value than now; of a number or vector, a change of its norm over `by`."""
        before = read()
        if by is None:
            self.expect_effect(description, lambda: read() != before)
        else:
            self.expect_effect(
                description, lambda: float(np.linalg.norm(np.subtract(read(), before))) > by
            )

    def expect_messages_changed(self, *message_names: str) -> None:
        """Require that the tap alters, drops, repeats or delays each of these messages (none given:
        any message, injected ones included) from now on.
        """
        counts = self.tap.changed_counts
        for name in message_names:
            self.expect_change(f"{name} changed on the link", lambda name=name: counts[name])
        if not message_names:
            self.expect_change("a message changed on the link", counts.total)

    # --- the vehicle of a flight ---------------------------------------------------------------

    @property
    def craft(self) -> Craft:
        """The affected vehicle."""
        assert self.craft_and_lockstep is not None
        return self.craft_and_lockstep[0]

    def record_take_over(self, known_after_s: float = MODE_REPORT_DELAY_S) -> None:
        """Record a take-over, which the companion can know of after `known_after_s`."""
        self.craft.link.record_take_over(self.t_s, known_after_s)

    def take_over_by_pilot(self) -> None:
        """Start a pilot override and record it as a take-over."""
        autopilot = self.craft.autopilot
        self.expect_effect("the pilot's mode is in effect", lambda: autopilot.mode in PILOTED)
        self.craft.start_pilot_override()
        self.record_take_over()

    @property
    def tap(self) -> Tap:
        """The tap of this fault on the companion's link."""
        if self.own_tap is None:
            self.own_tap = Tap()
            self.craft.link.taps.append(self.own_tap)
        return self.own_tap

    @property
    def is_armed(self) -> bool:
        """True if the autopilot is armed."""
        return self.craft.autopilot.is_armed

    def has_operator_received_alert(self, *alerts: Alert) -> bool:
        """Return True if the operator has received one of these alerts."""
        return any(
            is_text_of_any_alert(text, *alerts) for _, text in self.craft.operator.received_texts
        )

    def kill_companion(self) -> None:
        """Kill the companion with SIGKILL."""
        companion = self.craft.companion
        self.expect_effect("the companion is killed", lambda: not companion.is_running)
        companion.kill()
        self._exclude_companion_from_lockstep()

    def stall_companion(self) -> None:
        """Stop the companion with SIGSTOP."""
        companion = self.craft.companion
        self.expect_effect("the companion is stopped", lambda: companion.is_stopped)
        companion.suspend()
        self._exclude_companion_from_lockstep()

    def restart_companion(self) -> None:
        """Restart the companion, unless another fault has; simulated time waits for its reply."""
        craft = self.craft
        self.expect_effect(
            "the restarted companion replies",
            lambda: craft.companion.is_running and not craft.is_companion_returning,
        )
        if not craft.companion.is_running:
            craft.companion.start()
            craft.is_companion_returning = True

    def resume_companion(self) -> None:
        """Resume the companion with SIGCONT; simulated time waits until it has caught up."""
        self.craft.companion.continue_after_suspend()
        self.craft.is_companion_returning = True

    def _exclude_companion_from_lockstep(self) -> None:
        """Continue the lockstep without replies of this companion."""
        assert self.craft_and_lockstep is not None
        self.craft_and_lockstep[1].mark_unresponsive(self.craft.number - 1)


def describe_missing_effects(context: FaultContext) -> str:
    """Return the expected effects of an injection that were not observed, empty if all were."""
    for effect in context.expected_effects:
        effect.update()
    texts = [effect.failure_text for effect in context.expected_effects]
    return "; ".join(filter(None, texts)) if texts else "none is expected"


FaultProcedure = Callable[[FaultContext], Iterator[None]]


class Script:
    """Scripted events or an observer of a run. Each hook does nothing unless it is overridden."""

    def apply_step(self, crafts: list[Craft], t_s: float, lockstep: Lockstep) -> None:
        """Apply one step of 0.1 s; called after physics and before the companions reply."""

    def on_step_completed(self, crafts: list[Craft], t_s: float, reply_wall_s: float) -> None:
        """Observe the vehicles after the companions have replied, within `reply_wall_s`."""

    def should_continue(self, t_s: float) -> bool:
        """Return False to end the run; called after each step."""
        return True

    def undo_at_run_end(self) -> None:
        """Undo lasting changes at the end of the run."""


@dataclass(slots=True)
class FaultScript(Script):
    """Applies one fault to one vehicle of a run."""

    procedure: FaultProcedure
    phase: FlightPhase
    rng: np.random.Generator
    vehicle: int = 1
    end_delay_s: float | None = None
    """Time from a take-over to the end of the run; None: the run continues."""
    context: FaultContext | None = None

    def apply_step(self, crafts: list[Craft], t_s: float, lockstep: Lockstep) -> None:
        """Apply one step of 0.1 s."""
        if self.context is None:
            craft = crafts[self.vehicle - 1]
            self.context = FaultContext.for_flight(craft, lockstep, self.phase, self.rng)
            self.context.remaining_steps = self.procedure(self.context)
        self.context.continue_procedure(t_s)

    def should_continue(self, t_s: float) -> bool:
        """Return False when the delay after a take-over has passed."""
        takeover = None if self.context is None else self.context.craft.link.takeover
        return (
            self.end_delay_s is None
            or takeover is None
            or t_s < takeover.known_s + self.end_delay_s
        )

    def undo_at_run_end(self) -> None:
        """Undo the changes of the procedure and end what it started."""
        if self.context is not None:
            self.context.resources.close()
