"""What the ground does to the wind: slower behind a ridge or houses, faster over and beside them.

It stands where it is for as long as the wind blows from there, while an eddy is carried past. Its
covariance between two places is `(share U)^2 exp(-d / L)`, whatever the times, with the mean wind U
and the distance d, where heights apart count more than places. A Gaussian of one length: a wake
has sharp sides, and most places are in none.

How much of it there is follows from what was told: by the likelihood of each of `SHARES` (Rasmussen
and Williams 2006, eq. 5.8), minute by minute. Over open ground drones that move tell within minutes
that there is none.
"""

import math

import numpy as np
from scipy.spatial.distance import cdist

from companion.core.base.arrays import Floats
from companion.core.wind.process import averaged_share

LENGTH_M = 200.0
"""Wakes of houses are some 100 m long, a ridge is as long as it is."""
_UP = 4.0
"""A wake is a few times as long as what makes it is high."""

SHARES = (0.0, 0.05, 0.1, 0.15, 0.2)
"""Standard deviation over the mean wind, on each axis."""
_PRIOR = (0.8, 0.05, 0.05, 0.05, 0.05)
MEMORY_S = 3600.0
"""What was told so long ago counts 1/e: the wind turns, and stands elsewhere."""
LITTLE = 0.02
"""Less is as good as none."""


def coordinates(place_ne_m: Floats, height_m: Floats) -> Floats:
    """Points (n, 3) whose Euclidean distances are d / L."""
    return np.column_stack([place_ne_m, _UP * height_m]) / LENGTH_M


def left_by_averaging(span_m: Floats) -> Floats:
    """Share (n,) of the standard deviation that a mean over a way of so many metres leaves."""
    return np.sqrt(averaged_share(LENGTH_M / np.maximum(span_m, 1.0), 1.0))


def within(at: Floats, left: Floats) -> Floats:
    """Correlations (n, n) among points, each a mean that leaves the share `left` of it."""
    found = between(at, left, at, left)
    found[np.diag_indices(left.size)] = left**2
    return found


def between(one: Floats, left: Floats, other: Floats, right: Floats) -> Floats:
    """Correlations (n, m) between points and other points, likewise."""
    found = np.exp(-cdist(one, other))
    found *= left[:, None]
    found *= right
    return found


class StandingShare:
    """How much of it there is: the root of the mean square of `SHARES`, each weighed by how likely
    it makes what was told.

    It is no more than all but the one member say who differs most from the others: that one may be
    in a lee, or wrong.
    """

    def __init__(self) -> None:
        self.learned_s = -math.inf
        self._evidence = np.tile(np.log(_PRIOR), (2, 1))
        self._shares = _shares(self._evidence)

    @property
    def share(self) -> float:
        """Standard deviation over the mean wind; 0 where it is as good as nothing."""
        share = float(self._shares.min())
        return share if share >= LITTLE else 0.0

    @property
    def seen(self) -> float:
        """The same once it is more likely than not that anything stands, until then 0: ground that
        nobody has seen anything of excuses nobody.
        """
        logs = self._evidence[int(np.argmin(self._shares))]
        weights = np.exp(logs - logs.max())
        return self.share if weights[0] < 0.5 * weights.sum() else 0.0

    def learn(self, everybody: Floats, others: Floats | None, now_s: float) -> None:
        """Take the log likelihoods of what was told since `learned_s`: of all, and without the one
        who differs most. None: they say the same.
        """
        forgotten = math.exp(-max(now_s - self.learned_s, 0.0) / MEMORY_S)
        self._evidence = np.log(_PRIOR) + forgotten * (self._evidence - np.log(_PRIOR))
        self._evidence += np.stack([everybody, everybody if others is None else others])
        self._shares = _shares(self._evidence)
        self.learned_s = now_s


def _shares(log_weights: Floats) -> Floats:
    weights = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))
    return np.sqrt(weights @ np.square(SHARES) / weights.sum(axis=1))


PRIOR_SHARE = float(_shares(np.log([_PRIOR]))[0])
