"""Common clock of a simulated day for desk, companions, truck and verdict."""

from dataclasses import dataclass

EPOCH_US = 1_780_000_000_000_000
"""Wall-clock start of every simulated day (June 2026)."""


@dataclass(slots=True)
class DayClock:
    """Simulated time (`ground_station.core.fleet.fleet_link.Clock`)."""

    t_s: float = 0.0

    def monotonic_s(self) -> float:
        """Return the seconds since the start of the day."""
        return self.t_s

    def epoch_us(self) -> int:
        """Return microseconds since 1970-01-01, UTC."""
        return EPOCH_US + round(self.t_s * 1e6)
