"""E-processes: evidence against a promise that may be looked at after every flight.

An e-process is 1 or less on average at any moment at which one may stop, while the promise holds.
By Ville's inequality it then ever reaches 1 / a with a probability of a at most (Ramdas, Gruenwald,
Vovk, Shafer, "Game-theoretic statistics and safe anytime-valid inference", Statistical Science 38,
2023, sections 2 and 3). Two bets are here, and both are made by the day: what the flights of a day
share (air, temperature, the parcel's kind) is one draw, however many flights there are.

- `ShiftTest` bets on a mean that has risen, in normal noise with a part that a day shares.
- `ShareTest` bets on the share of checks that failed in a day, of any distribution.

A change may come at any time. The bets of every starting day are mixed with weights that sum to 1
(a mixture of e-processes is one; Shin, Ramdas, Rinaldo, "E-detectors", New England Journal of
Statistics in Data Science 2, 2024, sum them without weights, which bounds how often a false alarm
comes and not whether one ever does).

All arrays may have leading axes, one entry for each service that is followed.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from companion.core.base.arrays import Floats

SEASON_DAYS = 50.0
"""Starting days are about equally likely over so many days (a service of 500 flights, ten a day);
later ones get less, as 1 / day^2."""
SURE_SIGMAS = 2.0
"""How far under a mean one is sure of it, for an estimate after an alarm."""


def start_weight(day: int) -> float:
    """Prior weight of a change before the flights of this day, counted from 1."""
    return SEASON_DAYS / ((SEASON_DAYS + day - 1.0) * (SEASON_DAYS + day))


def weight_left(day: int) -> float:
    """Sum of the weights of all later days: the series telescopes, and all weights sum to 1."""
    return SEASON_DAYS / (SEASON_DAYS + day)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence of one test. `day` counts the days begun, 0 before the first flight.

    `log_closed` (..., bets) is the log of what the bets hold that began on a day before this one,
    each with its weight. `information` (...) and `score` (...) are the sums over today's flights.
    """

    day: int
    log_closed: Floats
    information: Floats
    score: Floats

    @classmethod
    def none(cls, bets: int, shape: tuple[int, ...] = ()) -> "Evidence":
        """Before the first flight, of as many services as `shape` says."""
        return cls(0, np.full((*shape, bets), -np.inf), np.zeros(shape), np.zeros(shape))

    def next_day(self, log_today: Floats) -> "Evidence":
        """The evening: `log_today` (..., bets) is what each bet has won on this day."""
        zeros = np.zeros_like(self.score)
        if self.day == 0:
            return replace(self, day=1)
        return Evidence(self.day + 1, self._running() + log_today, zeros, zeros)

    def log_e(self, log_today: Floats) -> Floats:
        """Log of the e-process now (...): the mean over the bets, with what did not begin yet."""
        if self.day == 0:
            return np.zeros_like(self.score)
        running = self._running() + log_today
        held = np.logaddexp(running, math.log(weight_left(self.day)))
        return np.asarray(logsumexp(held, axis=-1)) - math.log(held.shape[-1])

    def _running(self) -> Floats:
        return np.logaddexp(self.log_closed, math.log(start_weight(self.day)))


@dataclass(frozen=True, slots=True)
class ShiftTest:
    """Bets that the mean of a flight's value has risen by one of `shifts` above `tolerance`.

    Null: value = m + a + e with m <= `tolerance`, a normal with `day_std` and the same for all
    flights of a day, e normal with the std that comes with each value. The bet on a shift d is the
    likelihood ratio of a day's flights, the shared part integrated out: with P the sum of 1 / std^2
    and S the sum of (value - tolerance) / std^2 it is exp((d S - d^2 P / 2) / (1 + P day_std^2)).
    A mean below the tolerance only lowers it. A value counts as `most` at the most, which can only
    lower it too: one wild figure is no alarm. It counts as -`most` at the least, so that one wild
    figure wipes out no evidence; with `most` five sigma away the null gains nothing by that.
    """

    tolerance: float
    day_std: float
    shifts: tuple[float, ...]
    most: float

    def none(self, shape: tuple[int, ...] = ()) -> Evidence:
        """No evidence."""
        return Evidence.none(len(self.shifts), shape)

    def next_day(self, evidence: Evidence) -> Evidence:
        """Before the first flight of a day."""
        return evidence.next_day(self._today(evidence))

    def take(self, evidence: Evidence, value: Floats | float, std: Floats | float) -> Evidence:
        """A flight's value with its own standard deviation."""
        precision = 1.0 / np.square(std)
        excess = np.clip(value, -self.most, self.most) - self.tolerance
        return replace(
            evidence,
            information=evidence.information + precision,
            score=evidence.score + precision * excess,
        )

    def log_e(self, evidence: Evidence) -> Floats:
        """Log of the e-process after the last flight."""
        return evidence.log_e(self._today(evidence))

    def _today(self, evidence: Evidence) -> Floats:
        shift = np.asarray(self.shifts)
        information, score = evidence.information[..., None], evidence.score[..., None]
        ratio = shift * score - 0.5 * np.square(shift) * information
        return ratio / (1.0 + information * self.day_std**2)

    def since_change(self, information: Floats, score: Floats) -> tuple[Floats, Floats]:
        """(mean, std) of the value on a next day, by the days since it changed.

        `information` and `score` are (days, ...), the sums of each day, the newest last. The mean
        is the one of least variance of the days from a starting day on; that starting day is taken
        from which the mean is surest to be high, two standard deviations under it. So a step is
        taken from where it was, and a slow drift, which has no such place, by its last days. The
        std is that of the mean and of a new day's shared part.
        """
        spread = 1.0 + information * self.day_std**2
        weight = np.cumsum((information / spread)[::-1], axis=0)
        total = np.cumsum((score / spread)[::-1], axis=0)
        safe = np.maximum(weight, 1e-12)
        start = np.argmax(total / safe - SURE_SIGMAS / np.sqrt(safe), axis=0)[None]
        taken = np.take_along_axis(safe, start, 0)[0]
        mean = np.take_along_axis(total, start, 0)[0] / taken
        return self.tolerance + mean, np.sqrt(1.0 / taken + self.day_std**2)


@dataclass(frozen=True, slots=True)
class ShareTest:
    """Bets that more of a day's checks fail than the share `allowed`.

    Null: given all days before, the mean of a day's share X of failed checks is `allowed` at most;
    its distribution is free, and so is what the checks of a day have to do with one another. The
    bet of a day is 1 + stake (X - allowed), fixed before the day, so that its mean is 1 at most
    (Waudby-Smith and Ramdas, "Estimating means of bounded random variables by betting", JRSS B 86,
    2024, eq. 11). It is settled in the evening. `information` counts checks, `score` failed ones.
    """

    allowed: float
    stakes: tuple[float, ...]

    def __post_init__(self) -> None:
        if not all(0.0 < stake * self.allowed < 1.0 for stake in self.stakes):
            raise ValueError(f"stakes {self.stakes}: expected 0 to {1.0 / self.allowed}")

    def none(self, shape: tuple[int, ...] = ()) -> Evidence:
        """No evidence."""
        return Evidence.none(len(self.stakes), shape)

    def next_day(self, evidence: Evidence) -> Evidence:
        """Before the first flight of a day: yesterday's bet is settled."""
        checks = evidence.information
        share = np.where(checks > 0.0, evidence.score / np.maximum(checks, 1.0), self.allowed)
        won = np.asarray(self.stakes) * (share - self.allowed)[..., None]
        return evidence.next_day(np.log1p(won))

    def take(self, evidence: Evidence, failed: Floats | float, checks: Floats | float) -> Evidence:
        """A flight's checks, and how many of them failed."""
        return replace(
            evidence,
            information=evidence.information + checks,
            score=evidence.score + failed,
        )

    def log_e(self, evidence: Evidence) -> Floats:
        """Log of the e-process, up to yesterday evening."""
        return evidence.log_e(np.zeros_like(evidence.log_closed))
