"""Scores of a replay: the wind, against a reference where there is one, and the promise."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.replay.flight_replay import ReplayResult
from companion.core.replay.recorded_flight import WindReference

SETTLED_S = 30.0
"""Scores count from so long into the flight."""


@dataclass(frozen=True, slots=True)
class WindSummary:
    """The wind in flight: its mean (where it moves to), the strongest, the estimate's own error."""

    rows: int
    mean_to_n_mps: float
    mean_to_e_mps: float
    mean_speed_mps: float
    most_mps: float
    mean_std_mps: float

    @property
    def mean_from_deg(self) -> float:
        """Where the mean wind comes from, clockwise from north."""
        return math.degrees(math.atan2(-self.mean_to_e_mps, -self.mean_to_n_mps)) % 360.0


@dataclass(frozen=True, slots=True)
class WindScore:
    """The estimate against a reference: error of the vector (m/s), normalised error squared
    (2 is ideal), and what the best constant wind of the same rows would have missed.
    """

    rows: int
    from_s: float
    to_s: float
    rmse_mps: float
    nees: float
    constant_rmse_mps: float
    constant_to_n_mps: float
    constant_to_e_mps: float


def wind_summary(result: ReplayResult) -> WindSummary | None:
    """Return the wind in flight; `None` where nothing was estimated in the air."""
    wind = result.wind_to_ne_mps[result.in_air]
    if not len(wind):
        return None
    cov = result.wind_cov_m2ps2[result.in_air]
    speed = np.hypot(wind[:, 0], wind[:, 1])
    north, east = wind.mean(axis=0)
    std = np.sqrt(0.5 * (cov[:, 0, 0] + cov[:, 1, 1]))
    return WindSummary(
        len(wind),
        float(north),
        float(east),
        float(speed.mean()),
        float(speed.max()),
        float(std.mean()),
    )


def wind_score(result: ReplayResult, reference: WindReference) -> WindScore | None:
    """Judge the estimate at the reference's own times, in flight, from `SETTLED_S` on."""
    t_s = result.wind_t_s
    at = np.searchsorted(t_s, reference.t_s, side="right") - 1
    near = (at >= 0) & (reference.t_s - t_s[np.maximum(at, 0)] < 1.0) if t_s.size else at < -1
    rows = at[near]
    judged = result.in_air[rows] & (result.flown_s[rows] >= SETTLED_S)
    rows, truth = rows[judged], reference.to_ne_mps[near][judged]
    if rows.size < 2:
        return None
    error = result.wind_to_ne_mps[rows] - truth
    weighed = np.linalg.solve(result.wind_cov_m2ps2[rows], error[:, :, None])[:, :, 0]
    constant = truth.mean(axis=0)
    times = reference.t_s[near][judged]
    return WindScore(
        int(rows.size),
        float(times[0]),
        float(times[-1]),
        _rms(error),
        float((error * weighed).sum(axis=1).mean()),
        _rms(truth - constant),
        float(constant[0]),
        float(constant[1]),
    )


def _rms(vectors: Floats) -> float:
    return math.sqrt(float((vectors**2).sum(axis=1).mean()))
