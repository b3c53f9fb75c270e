"""Effect of terrain and buildings on the wind: slower in a wake, faster over and around an
obstacle.

The pattern is stationary while the wind direction is constant, whereas eddies move with the wind.
Its covariance between two positions is `(share U)^2 exp(-d / L)` at all times, with the mean wind U
and the distance d, in which heights are multiplied by `_HEIGHT_WEIGHT`. This is a rough model: a
wake has sharp edges, and most positions are outside of wakes.

The share is learned from the reports minute by minute by the likelihood of each of `SHARES`
(Rasmussen and Williams 2006, eq. 5.8). It is 0 until an effect is more likely than none.
"""

import math

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.process import variance_share_after_averaging
from companion.core.wind_field.linear_algebra import euclidean_distances

LENGTH_M = 200.0
"""Correlation length: between wakes of houses, about 100 m long, and those of ridges."""
_HEIGHT_WEIGHT = 4.0
"""Weight of height differences in distances: a wake is flat."""

SHARES = (0.0, 0.05, 0.1, 0.15, 0.2)
"""Candidate standard deviations on each axis, relative to the mean wind."""
_PRIOR = (0.8, 0.05, 0.05, 0.05, 0.05)
"""Prior probability of each share."""
MAX_LOG_ODDS = 10.0
"""Limit of the log odds against share 0: the wind direction may change within minutes."""
MIN_OTHER_MEMBERS = 2
"""Minimum number of members besides the dominant one for the share to be learned."""
MEMORY_S = 3600.0
"""Time constant of forgetting: the pattern changes when the wind turns."""


def terrain_correlation_coordinates(position_ne_m: Floats, height_m: Floats) -> Floats:
    """Return points (n, 3) whose Euclidean distances are d / L."""
    return np.column_stack([position_ne_m, _HEIGHT_WEIGHT * height_m]) / LENGTH_M


def averaging_std_factor_along_path(path_length_m: Floats) -> Floats:
    """Return the share (n,) of the standard deviation left by averaging over a path of
    `path_length_m`.
    """
    return np.sqrt(variance_share_after_averaging(LENGTH_M / np.maximum(path_length_m, 1.0), 1.0))


def relative_terrain_covariance(
    first_coordinates: Floats,
    first_averaging_factors: Floats,
    second_coordinates: Floats,
    second_averaging_factors: Floats,
) -> Floats:
    """Return the covariance (n, m) between two sets of points, relative to the variance of the
    effect. `first_averaging_factors`, `second_averaging_factors`: shares of the standard deviation
    left by averaging."""
    found = np.exp(-euclidean_distances(first_coordinates, second_coordinates))
    found *= first_averaging_factors[:, None]
    found *= second_averaging_factors
    return found


class TerrainShare:
    """Estimate of the terrain effect: the root mean square of `SHARES`, weighted by their posterior
    probabilities.

    The estimate is limited to the one without the member with the strongest evidence, which may be
    in a wake or faulty.
    """

    def __init__(self) -> None:
        self.learned_s = -math.inf
        self._log_odds = np.zeros((2, len(SHARES)))
        """Log odds against share 0, with all members and without the dominant one."""
        self._by_member: dict[str, Floats] = {}
        """Log odds of each member, given all earlier reports."""
        self.share = 0.0
        """Standard deviation over the mean wind."""

    def add_evidence_and_find_dominant_member(
        self, log_likelihoods: dict[str, Floats], now_s: float
    ) -> str:
        """Add each member's log likelihoods since `learned_s`. Returns the member with the
        strongest evidence for a terrain effect in the whole memory."""
        kept, before = self._forgetting_factor_since_update(now_s), self._by_member
        self._by_member = {
            name: kept * before.get(name, np.zeros(len(SHARES))) + logs - logs[0]
            for name, logs in log_likelihoods.items()
        }
        likeliest = int(np.sum(list(self._by_member.values()), axis=0).argmax())
        return max(log_likelihoods, key=lambda name: float(self._by_member[name][likeliest]))

    def update_share(
        self,
        log_likelihoods_all_members: Floats,
        log_likelihoods_without_dominant: Floats,
        now_s: float,
    ) -> None:
        """Update the share with log likelihoods since `learned_s`: of all members, and without the
        dominant member."""
        log_likelihoods = np.stack([log_likelihoods_all_members, log_likelihoods_without_dominant])
        odds = (
            self._forgetting_factor_since_update(now_s) * self._log_odds
            + log_likelihoods
            - log_likelihoods[:, :1]
        )
        self._log_odds = np.clip(odds, -MAX_LOG_ODDS, MAX_LOG_ODDS)
        self.share = min(_posterior_rms_terrain_share(each) for each in self._log_odds)
        self.learned_s = now_s

    def _forgetting_factor_since_update(self, now_s: float) -> float:
        return math.exp(-(now_s - self.learned_s) / MEMORY_S)


def _posterior_rms_terrain_share(log_odds: Floats) -> float:
    weights = np.array(_PRIOR) * np.exp(log_odds)
    weights /= weights.sum()
    return float(np.sqrt(weights @ np.square(SHARES))) if weights[0] < 0.5 else 0.0
