"""Conditions that trigger failsafes; the reaction is each autopilot's own."""

from dataclasses import dataclass, field


@dataclass(slots=True)
class Latch:
    """A condition that has to last for a time before it triggers, and then triggers once."""

    since_s: float | None = None
    is_on: bool = False

    def update_and_report_trigger(
        self, condition: bool, now_s: float, required_duration_s: float
    ) -> bool:
        """True once, when the condition has lasted for `required_duration_s`."""
        if not condition:
            self.since_s = None
            self.is_on = False
            return False
        if self.since_s is None:
            self.since_s = now_s
        if self.is_on or now_s - self.since_s < required_duration_s - 1e-6:
            return False
        self.is_on = True
        return True


@dataclass(slots=True)
class Latches:
    """One latch for each failure."""

    rc: Latch = field(default_factory=Latch)
    gcs: Latch = field(default_factory=Latch)
    position: Latch = field(default_factory=Latch)
    battery_low: Latch = field(default_factory=Latch)
    battery_critical: Latch = field(default_factory=Latch)
    battery_emergency: Latch = field(default_factory=Latch)
    fence: Latch = field(default_factory=Latch)
    last_gcs_heartbeat_s: float | None = None

    def time_since_gcs_heartbeat_s(self, now_s: float) -> float:
        """Seconds without a ground station; 0 if there never was one."""
        return 0.0 if self.last_gcs_heartbeat_s is None else now_s - self.last_gcs_heartbeat_s
