"""Tells that the vehicle's draw has changed for good: a failing motor, ice, a sail of torn film.

CUSUM tests (Page, Biometrika 41, 1954; drift at half the change and the likelihood ratio as in
Basseville and Nikiforov, Detection of Abrupt Changes, 1993, 2.2) on the logarithm of measured over
expected power, in log-seconds. One looks for a large rise in any air, one for a small rise against
the noise of this air, one for the end of a rise that was taken before.
"""

import math
from collections import deque
from dataclasses import dataclass

_SMALL, _LARGE = math.log(1.25), math.log(1.7)
_HOLD_S = 1.0
"""How long one reading counts: batteries are reported at 2 Hz, so one that is older was followed by
a lost one. A single outlier then stays far below every limit."""

_CLIP = 1.0
"""Of a single log ratio: an outlier of any size counts as 2.7 times."""

_LARGE_LIMIT = 1.5
"""Log-seconds. The most that 20 untroubled flights in rough air reached is 1.1 (the tests' default
flight, seeds 1 to 10, both autopilots); 1.7 times is told in 6 s, twice in 4 s."""

_SMALL_LIMIT_NATS = 5.0
"""Log-likelihood. The most in the same 20 flights is 3.5. 1.4 times is told in 20 s (median over
flights in calm to rough air), 1.25 times in 40 s and more, or not before a short flight is over."""

_FALL_LIMIT = 4.0
"""Log-seconds: a descent or braking draws 0.45 (log) less for 10 s and is no end of a rise."""

_NOISE_PER_DIFFERENCE_S = 18.0
"""Noise density of the log ratio, over its mean square change in 1 s (von Neumann's estimate, which
a step hardly moves). Those flights' means of 10 to 60 s give 4 to 9 s: the rest is margin."""

_LEAST_NOISE_S = 0.03
"""Noise density of a hover in still air: a scatter of 0.06, remembered for some 4 s."""

_FIRST_DIFFERENCE2 = 0.01
_DIFFERENCE_CLIP2 = 0.25
_DIFFERENCE_MEMORY_S = 30.0
_LAG_S = 1.0


@dataclass(frozen=True, slots=True)
class Departure:
    """From `for_s` seconds ago the log ratio was off by `by_log` on average."""

    by_log: float
    for_s: float


@dataclass(slots=True)
class _Sum:
    """One test: `s` rises with evidence; mean and length of the readings since it last was 0."""

    s: float = 0.0
    residual_s: float = 0.0
    for_s: float = 0.0

    def add(self, evidence: float, residual: float, dt_s: float) -> None:
        self.s = max(0.0, self.s + evidence)
        if self.s == 0.0:
            self.residual_s = self.for_s = 0.0
            return
        self.residual_s += residual * dt_s
        self.for_s += dt_s

    def departure(self) -> Departure:
        return Departure(self.residual_s / self.for_s, self.for_s)


class _Noise:
    """Noise density of the log ratio, from its changes in a second."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float]] = deque()
        self._difference2 = _FIRST_DIFFERENCE2
        self._t_s = 0.0

    def density_s(self, log_ratio: float, dt_s: float) -> float:
        self._t_s += dt_s
        self._recent.append((self._t_s, log_ratio))
        while len(self._recent) > 1 and self._recent[1][0] <= self._t_s - _LAG_S:
            self._recent.popleft()
        before_s, before = self._recent[0]
        if before_s <= self._t_s - _LAG_S:
            difference2 = min((log_ratio - before) ** 2, _DIFFERENCE_CLIP2)
            share = -math.expm1(-dt_s / _DIFFERENCE_MEMORY_S)
            self._difference2 += share * (difference2 - self._difference2)
        return max(_NOISE_PER_DIFFERENCE_S * self._difference2, _LEAST_NOISE_S)


class DrawChange:
    """Hears every comparison of measured and expected power; one per vehicle."""

    def __init__(self) -> None:
        self._noise = _Noise()
        self._forget()

    def observe(
        self, dt_s: float, log_ratio: float, believed_log: float, age_s: float = 0.0
    ) -> Departure | None:
        """Take the log ratio of the last `dt_s`; returns what the ratio departed by, once told.

        `age_s`: how long ago the battery said so.
        """
        if age_s > _HOLD_S:
            return None
        noise_s = self._noise.density_s(log_ratio, dt_s)
        residual = min(max(log_ratio - believed_log, -_CLIP), _CLIP)
        self._large.add((residual - 0.5 * _LARGE) * dt_s, residual, dt_s)
        unlikely = _SMALL / noise_s * (min(residual, _LARGE) - 0.5 * _SMALL)
        self._small.add(unlikely * dt_s, residual, dt_s)
        self._fall.add((-residual - 0.5 * _LARGE) * dt_s, residual, dt_s)
        return self._told(believed_log)

    def _told(self, believed_log: float) -> Departure | None:
        for test, limit in ((self._large, _LARGE_LIMIT), (self._small, _SMALL_LIMIT_NATS)):
            if test.s > limit:
                return self._departed(test)
        # The draw falls whenever it brakes or descends: only a rise that was taken can end.
        if believed_log >= _SMALL and self._fall.s > _FALL_LIMIT:
            return self._departed(self._fall)
        return None

    def _departed(self, test: _Sum) -> Departure:
        told = test.departure()
        self._forget()
        return told

    def _forget(self) -> None:
        self._large, self._small, self._fall = _Sum(), _Sum(), _Sum()
