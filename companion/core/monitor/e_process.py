"""E-processes: evidence against a promise that may be evaluated after every flight.

While the promise holds, an e-process has an expectation of at most 1 at every stopping time. By
Ville's inequality it ever reaches 1 / a with a probability of at most a (Ramdas, Gruenwald, Vovk,
Shafer, "Game-theoretic statistics and safe anytime-valid inference", Statistical Science 38, 2023,
sections 2 and 3). Both tests bet by day, because the common conditions of a day's flights (air,
temperature, type of parcel) are a single random draw.

- `ShiftTest` bets on an increased mean in normal noise with a component common to a day.
- `ShareTest` bets on the share of a day's failed checks, of any distribution.

A change may occur at any time. The bets of all starting days are mixed with weights that sum to 1:
a mixture of e-processes is an e-process. (Shin, Ramdas, Rinaldo, "E-detectors", New England Journal
of Statistics in Data Science 2, 2024, sum them without weights, which bounds the rate of false
alarms and not the probability of any false alarm.)

All arrays may have leading axes, one entry for each service.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.probability import log_sum_exp

START_DAY_SCALE = 50.0
"""Days over which starting days are about equally likely (500 flights, ten a day); the weight of
later ones falls as 1 / day^2."""
LOWER_BOUND_SIGMAS = 2.0
"""Standard deviations of the lower confidence bound that selects the change day after an alarm."""


def prior_weight_of_change_day(day: int) -> float:
    """Return the prior weight of a change before the flights of this day, counted from 1."""
    return START_DAY_SCALE / ((START_DAY_SCALE + day - 1.0) * (START_DAY_SCALE + day))


def prior_weight_after_day(day: int) -> float:
    """Return the sum of the weights of all later days. All weights sum to 1 (telescoping)."""
    return START_DAY_SCALE / (START_DAY_SCALE + day)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence of one test. `day` is the number of the current day, 0 before the first flight.

    `log_closed` (..., bets) is the log of the weighted value of all bets from earlier starting
    days. `information` (...) and `score` (...) are the sums over the current day's flights.
    """

    day: int
    log_closed: Floats
    information: Floats
    score: Floats

    @classmethod
    def initial(cls, bet_count: int, array_shape: tuple[int, ...] = ()) -> "Evidence":
        """Return the evidence before the first flight, for services of this array shape."""
        return cls(
            0,
            np.full((*array_shape, bet_count), -np.inf),
            np.zeros(array_shape),
            np.zeros(array_shape),
        )

    def start_next_day(self, log_gain_today: Floats) -> "Evidence":
        """Close the day; `log_gain_today` (..., bets) is the log gain of each bet on this day."""
        zeros = np.zeros_like(self.score)
        if self.day == 0:
            return replace(self, day=1)
        return Evidence(self.day + 1, self._log_running_bets() + log_gain_today, zeros, zeros)

    def log_e_value(self, log_gain_today: Floats) -> Floats:
        """Return the log of the e-process (...): mean over bets, later starting days included."""
        if self.day == 0:
            return np.zeros_like(self.score)
        running = self._log_running_bets() + log_gain_today
        log_value = np.logaddexp(running, math.log(prior_weight_after_day(self.day)))
        return log_sum_exp(log_value) - math.log(log_value.shape[-1])

    def _log_running_bets(self) -> Floats:
        return np.logaddexp(self.log_closed, math.log(prior_weight_of_change_day(self.day)))


@dataclass(frozen=True, slots=True)
class ShiftTest:
    """Test for a mean that has risen by one of `shifts` above `tolerance`.

    Null: value = m + a + e with m <= `tolerance`, a normal with `day_std` and equal for all flights
    of a day, e normal with the std of each value. The bet on a shift d is the likelihood ratio of a
    day's flights, the common part integrated out: with P the sum of 1 / std^2 and S the sum of
    (value - tolerance) / std^2 it is exp((d S - d^2 P / 2) / (1 + P day_std^2)). A mean below the
    tolerance only lowers it. Values are clipped to +-`max_value`: one outlier raises no alarm and
    removes no evidence. Clipping above only lowers the bet; clipping below at five sigma has no
    effect under the null.
    """

    tolerance: float
    day_std: float
    shifts: tuple[float, ...]
    max_value: float

    def initial_evidence(self, shape: tuple[int, ...] = ()) -> Evidence:
        """Return the evidence before the first flight."""
        return Evidence.initial(len(self.shifts), shape)

    def start_next_day(self, evidence: Evidence) -> Evidence:
        """Start the next day, before its first flight."""
        return evidence.start_next_day(self._log_gain_today(evidence))

    def with_added_flight(
        self, evidence: Evidence, value: Floats | float, std: Floats | float
    ) -> Evidence:
        """Add a flight's value with its standard deviation."""
        precision = 1.0 / np.square(std)
        excess = np.clip(value, -self.max_value, self.max_value) - self.tolerance
        return replace(
            evidence,
            information=evidence.information + precision,
            score=evidence.score + precision * excess,
        )

    def log_e_value(self, evidence: Evidence) -> Floats:
        """Return the log of the e-process after the last flight."""
        return evidence.log_e_value(self._log_gain_today(evidence))

    def _log_gain_today(self, evidence: Evidence) -> Floats:
        shift = np.asarray(self.shifts)
        information, score = evidence.information[..., None], evidence.score[..., None]
        ratio = shift * score - 0.5 * np.square(shift) * information
        return ratio / (1.0 + information * self.day_std**2)

    def mean_and_std_since_change(
        self, information_by_day: Floats, score_by_day: Floats
    ) -> tuple[Floats, Floats]:
        """Return (mean, std) of the value on the next day, from the days since it changed.

        `information_by_day` and `score_by_day` are (days, ...), the sums of each day, latest last.
        The mean is the minimum-variance mean of the days from a starting day on. The starting day
        has the highest lower bound of the mean (two standard deviations). So a step is estimated
        from its day on, and a slow drift from its last days. The std includes the mean's error and
        the common part of a new day.
        """
        spread = 1.0 + information_by_day * self.day_std**2
        weight = np.cumsum((information_by_day / spread)[::-1], axis=0)
        total = np.cumsum((score_by_day / spread)[::-1], axis=0)
        safe = np.maximum(weight, 1e-12)
        start = np.argmax(total / safe - LOWER_BOUND_SIGMAS / np.sqrt(safe), axis=0)[None]
        selected_weight = np.take_along_axis(safe, start, 0)[0]
        mean = np.take_along_axis(total, start, 0)[0] / selected_weight
        return self.tolerance + mean, np.sqrt(1.0 / selected_weight + self.day_std**2)


@dataclass(frozen=True, slots=True)
class ShareTest:
    """Test for a share of failed checks per day above `allowed`.

    Null: given all earlier days, the mean of a day's share X of failed checks is at most `allowed`,
    with any distribution and any dependence between the checks of a day. The bet of a day is
    1 + stake (X - allowed), fixed before the day, so that its mean is at most 1 (Waudby-Smith and
    Ramdas, "Estimating means of bounded random variables by betting", JRSS B 86, 2024, eq. 11). It
    is evaluated at the end of the day. `information` counts checks, `score` failed ones.
    """

    allowed: float
    stakes: tuple[float, ...]

    def __post_init__(self) -> None:
        if not all(0.0 < stake * self.allowed < 1.0 for stake in self.stakes):
            raise ValueError(f"stakes {self.stakes}: expected 0 to {1.0 / self.allowed}")

    def initial_evidence(self, shape: tuple[int, ...] = ()) -> Evidence:
        """Return the evidence before the first flight."""
        return Evidence.initial(len(self.stakes), shape)

    def start_next_day(self, evidence: Evidence) -> Evidence:
        """Start the next day, before its first flight, and evaluate the bet of the last one."""
        checks = evidence.information
        share = np.where(checks > 0.0, evidence.score / np.maximum(checks, 1.0), self.allowed)
        gain = np.asarray(self.stakes) * (share - self.allowed)[..., None]
        return evidence.start_next_day(np.log1p(gain))

    def with_added_flight(
        self, evidence: Evidence, failed_check_count: Floats | float, check_count: Floats | float
    ) -> Evidence:
        """Add a flight's number of checks and of failed checks."""
        return replace(
            evidence,
            information=evidence.information + check_count,
            score=evidence.score + failed_check_count,
        )

    def log_e_value(self, evidence: Evidence) -> Floats:
        """Return the log of the e-process up to the end of the previous day."""
        return evidence.log_e_value(np.zeros_like(evidence.log_closed))
