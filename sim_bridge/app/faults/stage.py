"""What a fault's play has to do with: one vehicle, the time, draws, and who took over when."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from sim_bridge.adapters.lockstep import Lockstep
from sim_bridge.app.flight.vehicle_process import Craft
from sim_bridge.app.link.tap import Tap

STEP_S = 0.1
AFTER_PHASE_S = (0.5, 4.0)
"""A fault begins so long after its phase did, drawn by seed."""

TRUE_PHASE = {"ready": "start", "land": "landing"}
"""Names of phases as the truth calls them, where they differ."""


@dataclass(slots=True)
class Stage:
    """One flight under one fault. `took_over_s`: from then on the companion commands nothing."""

    craft: Craft
    rng: np.random.Generator
    lockstep: Lockstep
    phase: str
    """Where in the flight the fault begins."""
    t_s: float = 0.0
    began_s: float | None = None
    took_over_s: float | None = None
    notes: list[str] = field(default_factory=list)
    ends: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)
    """What a play opened, to be closed after the flight."""

    def wait(self, duration_s: float) -> Iterator[None]:
        """Let simulated time pass."""
        until_s = self.t_s + duration_s
        while self.t_s < until_s - 1e-6:
            yield

    def until(self, true: Callable[[], bool]) -> Iterator[None]:
        """Wait for something to be so."""
        while not true():
            yield

    def reached(self) -> Iterator[None]:
        """Wait for the phase and a moment more, drawn by seed; the fault begins then."""
        true_name = TRUE_PHASE.get(self.phase, self.phase)
        yield from self.until(lambda: self.craft.phase == true_name)
        if self.phase == "ready":
            yield from self.until(lambda: self.craft.operator.accepted)
        else:
            yield from self.wait(self.rng.uniform(*AFTER_PHASE_S))
        self.begin()

    def begin(self) -> None:
        """Note when the fault began."""
        self.began_s = self.t_s

    def taken_over(self, told_within_s: float) -> None:
        """A person has taken over; the companion can know of it after `told_within_s`."""
        self.took_over_s = self.t_s + told_within_s

    @property
    def tap(self) -> Tap:
        """The tap on the companion's link."""
        if self.craft.tap is None:
            self.craft.tap = Tap()
        return self.craft.tap

    def was_said(self, words: str) -> bool:
        """The companion has told the operator so."""
        return any(words in text for _, text in self.craft.operator.said)

    @property
    def armed(self) -> bool:
        """By truth."""
        return self.craft.autopilot.is_armed


@dataclass(slots=True)
class Performance:
    """Plays one fault on the first vehicle of a run (a `Script` of `fly`)."""

    play: Callable[[Stage], Iterator[None]]
    phase: str
    rng: np.random.Generator
    stage: Stage | None = None
    _steps: Iterator[None] | None = None

    def apply(self, crafts: list[Craft], t_s: float, lockstep: Lockstep) -> None:
        """One step of 0.1 s."""
        if self.stage is None:
            self.stage = Stage(crafts[0], self.rng, lockstep, self.phase)
            self._steps = self.play(self.stage)
        self.stage.t_s = t_s
        if self._steps is not None and next(self._steps, self) is self:
            self._steps = None  # the play is over

    def end(self) -> None:
        """The flight is over: what the play began is ended, what it took away is put back."""
        if self.stage is not None:
            self.stage.ends.close()
