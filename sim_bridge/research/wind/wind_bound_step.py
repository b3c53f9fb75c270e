"""What a step of the wind adds to the bound, announced and unannounced.

A ramp of the mean wind, 10 s long, from a time that is one of every second of the flight, by a
vector of the step's size and of any direction. What it does to the filter that knows of none is
linear in that vector r (Willsky and Jones, IEEE Trans. Automatic Control 21(1), 1976): innovations
are the white ones and G r, errors the old ones and D r, with G and D from the filter's own
recursion. So for each beginning j the data tell r by least squares; that beginning's likelihood is
a Gaussian's; and the least error of an estimator that is told j is the filter's and D cov(r) D'.

Nobody announces a step. The best estimate of one who is not told is the mean of all beginnings'
estimates, and of none, weighed by how likely each is given the data, and its error is that of one
who is told and E|difference of both estimates|^2, as the told one's error is orthogonal to all that
the data tell. That expectation is over the data: DRAWS of them. Before the flight there is a step
with STEP_CHANCE, at any time alike.
"""

import numpy as np
from scipy.special import softmax

from companion.core.base.arrays import Floats
from sim_bridge.research.wind.envelope_flight import (
    END_S,
    SAMPLE_S,
    WIND_STEP_AT_S,
    WIND_STEP_LASTS_S,
    WIND_STEP_MPS,
)

EVERY_S = 1.0
STEP_CHANCE = 0.5
DRAWS = 100
RATE_STD_MPS2 = WIND_STEP_MPS / WIND_STEP_LASTS_S / np.sqrt(2.0)  # an axis
_LATER_SAMPLES = 50  # of the window to come


class Steps:
    """All beginnings of a step in one flight, beside the filter that knows of none."""

    def __init__(self, first_s: float, states: int, rng: np.random.Generator) -> None:
        begins = np.arange(first_s, END_S, EVERY_S)
        # the flight's own is among them, exactly
        self._begin_s = np.append(begins[np.abs(begins - WIND_STEP_AT_S) > 1e-6], WIND_STEP_AT_S)
        count = self._begin_s.size
        self._error = np.zeros((states, count, 2))  # D
        self._told = np.tile(np.eye(2) / RATE_STD_MPS2**2, (count, 1, 1))  # information on r
        self._rng = rng
        self._rate = RATE_STD_MPS2 * rng.standard_normal((2, DRAWS))
        # Information times estimate of r: from the white innovations, and what the true ramp adds
        # where the last beginning is the true one.
        self._white = np.zeros((count, 2, DRAWS))
        self._ramped = np.zeros((count, 2, 2))

    def seen(self, t_s: float, move: Floats, rows: Floats, gain: Floats, s: Floats) -> None:
        """One sample: the filter moved, and was corrected by `gain`; `s` are its innovations'
        covariance."""
        states = self._error.shape[0]
        measured = rows.shape[1]
        moved = (move @ self._error.reshape(states, -1)).reshape(self._error.shape)
        moved += move[:, None, :2] * self._ramping(t_s)[:, None]
        response = np.tensordot(rows, moved[:measured], 1)  # (seen, count, 2)
        self._error = moved - np.tensordot(gain, response, 1)
        weighed = np.linalg.solve(s, response.reshape(len(rows), -1)).reshape(response.shape)
        self._told += np.einsum("sja,sjb->jab", response, weighed)
        white = np.linalg.cholesky(s) @ self._rng.standard_normal((len(rows), DRAWS))
        self._white += np.einsum("sja,sd->jad", weighed, white)
        self._ramped += np.einsum("sja,sb->jab", weighed, response[:, -1])

    def _ramping(self, t_s: float) -> Floats:
        """Metres a second by which a rate of 1 m/s2 moves the wind over the sample ending now."""
        since = t_s - self._begin_s
        return np.where((since > 1e-6) & (since <= WIND_STEP_LASTS_S + 1e-6), SAMPLE_S, 0.0)

    def shifted(self, shift: Floats) -> None:
        """The sums of the past moved on."""
        self._error = np.tensordot(shift, self._error, 1)

    def added(self, t_s: float, window: Floats, steps: bool) -> tuple[float, float]:
        """What is added to the filter's least mean square error of the window's mean: for one who
        is told whether and when the wind steps, and for one who is not."""
        by_rate = np.tensordot(window, self._error, 1)  # (2, count, 2)
        by_rate += self._to_come(t_s)[None, :, None] * np.eye(2)[:, None, :]
        cov = np.linalg.inv(self._told)
        known = self._white + (self._ramped @ self._rate if steps else 0.0)
        rates = cov @ known  # (count, 2, DRAWS)
        estimates = np.einsum("wja,jad->wjd", by_rate, rates)
        prior = -np.log(RATE_STD_MPS2**4 * np.linalg.det(self._told))
        fit = 0.5 * (np.einsum("jad,jad->jd", known, rates) + prior[:, None])
        weights = softmax(np.vstack([fit + np.log(STEP_CHANCE / len(fit)), self._none()]), axis=0)
        best = np.einsum("jd,wjd->wd", weights[:-1], estimates)
        if not steps:
            return 0.0, float(np.mean(np.sum(best**2, axis=0)))
        told = float(np.trace(by_rate[:, -1] @ cov[-1] @ by_rate[:, -1].T))
        off = best - estimates[:, -1]
        return told, told + float(np.mean(np.sum(off**2, axis=0)))

    def _none(self) -> Floats:
        return np.full((1, DRAWS), np.log(1.0 - STEP_CHANCE))

    def _to_come(self, t_s: float) -> Floats:
        """Of the window's mean, by a rate of 1 m/s2: what ramps after now."""
        total = np.zeros(self._begin_s.size)
        for sample in range(1, _LATER_SAMPLES + 1):
            left = _LATER_SAMPLES + 1 - sample
            total += left * self._ramping(t_s + sample * SAMPLE_S)
        return total / (2 * _LATER_SAMPLES)
