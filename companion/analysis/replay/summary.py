"""Scores of a replay: wind in flight, and wind against a reference if available."""

import math
from dataclasses import dataclass

import numpy as np

from companion.analysis.replay.flight_replay import ReplayResult
from companion.analysis.replay.recorded_flight import WindReference
from companion.core.base.arrays import Floats

MIN_FLIGHT_TIME_S = 30.0
"""Flight time from which scores count."""


@dataclass(frozen=True, slots=True)
class WindSummary:
    """Wind in flight: mean (direction to), maximum speed, and mean estimated std."""

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
    """Estimate against a reference: error of the vector (m/s), normalised error squared (2 is
    ideal), and the error of the best constant wind over the same rows.
    """

    rows: int
    from_s: float
    to_s: float
    rmse_mps: float
    nees: float
    constant_rmse_mps: float
    constant_to_n_mps: float
    constant_to_e_mps: float


def summarise_wind_in_flight(result: ReplayResult) -> WindSummary | None:
    """Return the wind in flight; `None` without an estimate in flight."""
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


def score_wind_against_reference(
    result: ReplayResult, reference: WindReference
) -> WindScore | None:
    """Score the estimate at the reference's times, in flight, from `MIN_FLIGHT_TIME_S` on."""
    t_s = result.wind_t_s
    at = np.searchsorted(t_s, reference.t_s, side="right") - 1
    near = (at >= 0) & (reference.t_s - t_s[np.maximum(at, 0)] < 1.0) if t_s.size else at < -1
    rows = at[near]
    judged = result.in_air[rows] & (result.flown_s[rows] >= MIN_FLIGHT_TIME_S)
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
        _rms_vector_length(error),
        float((error * weighed).sum(axis=1).mean()),
        _rms_vector_length(truth - constant),
        float(constant[0]),
        float(constant[1]),
    )


def _rms_vector_length(vectors: Floats) -> float:
    return math.sqrt(float((vectors**2).sum(axis=1).mean()))
