"""How much one speaker may say, or cost: what is above that costs nobody else anything."""

from dataclasses import dataclass, field


@dataclass(slots=True)
class RateLimit:
    """`burst` at once, and `rate_hz` from then on. Time is a passed `t_s`."""

    rate_hz: float
    burst: float
    _left: float = field(init=False)
    _at_s: float | None = None

    def __post_init__(self) -> None:
        self._left = self.burst

    def take(self, t_s: float, count: float = 1.0) -> bool:
        """Whether so many may pass now; they are counted if so."""
        self._refill(t_s)
        if count > self._left:
            return False
        self._left -= count
        return True

    def spend(self, t_s: float, count: float) -> None:
        """Count what has passed already, into debt where it was too much."""
        self._refill(t_s)
        self._left -= count

    def _refill(self, t_s: float) -> None:
        if self._at_s is not None:
            self._left = min(self.burst, self._left + self.rate_hz * (t_s - self._at_s))
        self._at_s = t_s
