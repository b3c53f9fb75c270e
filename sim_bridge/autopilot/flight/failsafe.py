"""Conditions that failsafes watch; what follows from them is each autopilot's own."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot


@dataclass(slots=True)
class Latch:
    """A condition that has to last before it counts, and then counts once."""

    since_s: float | None = None
    is_on: bool = False

    def update(self, condition: bool, now_s: float, wait_s: float) -> bool:
        """True at the moment at which the condition has lasted for `wait_s`."""
        if not condition:
            self.since_s = None
            self.is_on = False
            return False
        if self.since_s is None:
            self.since_s = now_s
        if self.is_on or now_s - self.since_s < wait_s - 1e-6:
            return False
        self.is_on = True
        return True


@dataclass(slots=True)
class Failsafes:
    """One latch for each thing that can fail."""

    rc: Latch = field(default_factory=Latch)
    gcs: Latch = field(default_factory=Latch)
    position: Latch = field(default_factory=Latch)
    battery_low: Latch = field(default_factory=Latch)
    battery_critical: Latch = field(default_factory=Latch)
    battery_emergency: Latch = field(default_factory=Latch)
    fence: Latch = field(default_factory=Latch)
    gcs_heard_s: float | None = None

    def gcs_heard(self, ap: "Autopilot", system: int) -> None:
        """A ground station's HEARTBEAT, if it is one that this autopilot listens to."""
        if ap.behaviour.minds_gcs(ap.params, system):
            self.gcs_heard_s = ap.t_s

    def gcs_silent_s(self, now_s: float) -> float:
        """Seconds without a ground station; 0 if there never was one."""
        return 0.0 if self.gcs_heard_s is None else now_s - self.gcs_heard_s

    def step(self, ap: "Autopilot") -> None:
        """Let the flavour look at everything."""
        if ap.is_armed:
            ap.behaviour.watch(ap, self)
