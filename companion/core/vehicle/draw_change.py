"""Detection of lasting changes of the power draw: a failing motor, ice, torn foil as a sail.

CUSUM tests (Page, Biometrika 41, 1954; drift at half the change and the likelihood ratio as in
Basseville and Nikiforov, Detection of Abrupt Changes, 1993, 2.2) on the logarithm of measured over
expected power, in log-seconds. One detects a large rise in any air, one a small rise relative to
the measured noise, one the end of an accepted rise.
"""

import math
from collections import deque
from dataclasses import dataclass

_SMALL_RISE_LOG, _LARGE_RISE_LOG = math.log(1.25), math.log(1.7)
_MAX_AGE_S = 1.0
"""Maximum age of a reading: batteries are reported at 2 Hz, so an older one was followed by a lost
one. A single outlier then stays far below every limit."""

_MAX_DEVIATION_LOG = 1.0
"""Limit of a single log ratio: an outlier of any size counts as a factor of 2.7."""

_LARGE_LIMIT = 1.5
"""Log-seconds. The maximum of 20 flights without fault in rough air is 1.1 (the tests' default
flight, seeds 1 to 10, both autopilots). Detects factor 1.7 in 6 s, factor 2 in 4 s."""

_SMALL_LIMIT_NATS = 5.0
"""Log-likelihood. The maximum of the same 20 flights is 3.5. Detects factor 1.4 in 20 s (median
over flights in calm to rough air), factor 1.25 in 40 s or more, in a short flight not at all."""

_DECREASE_LIMIT = 4.0
"""Log-seconds: a descent or braking draws 0.45 (log) less for 10 s without the end of a rise."""

_NOISE_PER_DIFFERENCE_S = 18.0
"""Noise density of the log ratio over its mean square change in 1 s (von Neumann's estimate, which
a step hardly affects). Means of 10 to 60 s of those flights give 4 to 9 s: the rest is margin."""

_LEAST_NOISE_S = 0.03
"""Noise density of a hover in still air: std 0.06, correlated over about 4 s."""

_FIRST_DIFFERENCE2 = 0.01
_DIFFERENCE_CLIP2 = 0.25
_DIFFERENCE_MEMORY_S = 30.0
_LAG_S = 1.0


_LOW_CURRENT_LOG = 0.26
"""Smallest deficit of a current sensor that is searched for: it reads 77 % of the current."""

_LOW_CURRENT_SIGMAS = 5.0
"""Deficit in standard deviations of the power model, where that is uncertain."""

_LOW_CURRENT_LIMIT = 3.0
"""Log-seconds beyond half of that deficit. Reading 65 % is detected after 10 s of level flight,
80 % after 32 s."""


@dataclass(frozen=True, slots=True)
class DetectedChange:
    """Detected change: mean deviation `deviation_log` of the log ratio over the last `duration_s`
    seconds.
    """

    deviation_log: float
    duration_s: float


@dataclass(slots=True)
class _CusumTest:
    """One CUSUM test: `statistic` grows with evidence; sum, duration of residuals since 0."""

    statistic: float = 0.0
    residual_s: float = 0.0
    for_s: float = 0.0

    def update_statistic(self, evidence: float, residual_log: float, dt_s: float) -> None:
        self.statistic = max(0.0, self.statistic + evidence)
        if self.statistic == 0.0:
            self.residual_s = self.for_s = 0.0
            return
        self.residual_s += residual_log * dt_s
        self.for_s += dt_s

    def mean_change_since_zero(self) -> DetectedChange:
        return DetectedChange(self.residual_s / self.for_s, self.for_s)


class LowCurrentDetector:
    """Detector of a current sensor that reads low, from measured over modelled power.

    No vehicle flies level on much less power than the model. `gain` is the estimated reading over
    the true current with its relative standard deviation; None: nothing was detected.
    """

    def __init__(self, expected_log: float, model_std_frac: float) -> None:
        self._expected_log = expected_log
        self._std_frac = model_std_frac
        self._half_log = 0.5 * max(_LOW_CURRENT_LOG, _LOW_CURRENT_SIGMAS * model_std_frac)
        self._test = _CusumTest()
        self.gain: tuple[float, float] | None = None

    def update_and_detect(self, dt_s: float, measured_w: float, modelled_w: float) -> bool:
        """Process the mean power of the last `dt_s` in level flight. Returns True once."""
        if self.gain is not None or not (measured_w > 0.0 and modelled_w > 0.0):
            return False
        low = self._expected_log - math.log(measured_w / modelled_w)
        low = min(max(low, -_MAX_DEVIATION_LOG), _MAX_DEVIATION_LOG)
        self._test.update_statistic((low - self._half_log) * dt_s, low, dt_s)
        if self._test.statistic < _LOW_CURRENT_LIMIT:
            return False
        deviation_log = self._test.mean_change_since_zero().deviation_log
        self.gain = math.exp(-deviation_log), self._std_frac
        return True


class _NoiseEstimator:
    """Estimator of the log ratio's noise density from its changes within one second."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float]] = deque()
        self._difference2 = _FIRST_DIFFERENCE2
        self._t_s = 0.0

    def update_noise_density_s(self, log_ratio: float, dt_s: float) -> float:
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


class DrawChangeDetector:
    """Detector of lasting changes of one vehicle's draw, from measured over expected power."""

    def __init__(self) -> None:
        self._noise = _NoiseEstimator()
        self._reset_all_tests()

    def update_and_detect_change(
        self,
        dt_s: float,
        log_power_ratio: float,
        accepted_log_power_ratio: float,
        age_s: float = 0.0,
    ) -> DetectedChange | None:
        """Process the log ratio of the last `dt_s`. Returns the change once it is detected.

        `age_s`: age of the battery reading.
        """
        if age_s > _MAX_AGE_S:
            return None
        noise_s = self._noise.update_noise_density_s(log_power_ratio, dt_s)
        residual = min(
            max(log_power_ratio - accepted_log_power_ratio, -_MAX_DEVIATION_LOG), _MAX_DEVIATION_LOG
        )
        self._large.update_statistic((residual - 0.5 * _LARGE_RISE_LOG) * dt_s, residual, dt_s)
        log_likelihood_rate = (
            _SMALL_RISE_LOG / noise_s * (min(residual, _LARGE_RISE_LOG) - 0.5 * _SMALL_RISE_LOG)
        )
        self._small.update_statistic(log_likelihood_rate * dt_s, residual, dt_s)
        self._decrease.update_statistic((-residual - 0.5 * _LARGE_RISE_LOG) * dt_s, residual, dt_s)
        return self._detect_change_and_reset(accepted_log_power_ratio)

    def _detect_change_and_reset(self, accepted_log: float) -> DetectedChange | None:
        for test, limit in ((self._large, _LARGE_LIMIT), (self._small, _SMALL_LIMIT_NATS)):
            if test.statistic > limit:
                return self._change_of_test_and_reset_tests(test)
        # The draw falls in each braking or descent, so only an accepted rise can end.
        if accepted_log >= _SMALL_RISE_LOG and self._decrease.statistic > _DECREASE_LIMIT:
            return self._change_of_test_and_reset_tests(self._decrease)
        return None

    def _change_of_test_and_reset_tests(self, test: _CusumTest) -> DetectedChange:
        change = test.mean_change_since_zero()
        self._reset_all_tests()
        return change

    def _reset_all_tests(self) -> None:
        self._large, self._small, self._decrease = _CusumTest(), _CusumTest(), _CusumTest()
