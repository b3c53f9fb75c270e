"""Rate limit for the messages or the cost of one sender, so that it does not affect the others."""

from dataclasses import dataclass, field


@dataclass(slots=True)
class RateLimit:
    """Token bucket: `burst` at once, then `rate_hz`. Time is a passed `t_s`."""

    rate_hz: float
    burst: float
    _tokens: float = field(init=False)
    _refilled_at_s: float | None = None

    def __post_init__(self) -> None:
        self._tokens = self.burst

    def try_consume_tokens(self, t_s: float, count: float = 1.0) -> bool:
        """Return whether this many may pass now, and count them if so."""
        self._refill_tokens(t_s)
        if count > self._tokens:
            return False
        self._tokens -= count
        return True

    def consume_tokens_beyond_limit(self, t_s: float, count: float) -> None:
        """Count what has already passed, even beyond the limit."""
        self._refill_tokens(t_s)
        self._tokens -= count

    def _refill_tokens(self, t_s: float) -> None:
        if self._refilled_at_s is not None:
            self._tokens = min(
                self.burst, self._tokens + self.rate_hz * (t_s - self._refilled_at_s)
            )
        self._refilled_at_s = t_s
