"""What the ground does to the wind: slower behind a ridge or houses, faster over and beside them.

It stands where it is for as long as the wind blows from there, while an eddy is carried past. Its
covariance between two places is `(share U)^2 exp(-d / L)`, whatever the times, with the mean wind U
and the distance d, in which heights count `_UP` times. That is a rough model: a wake has sharp
sides, and most places are in none.

How much of it there is follows from what was told, minute by minute: by the likelihood of each of
`SHARES` (Rasmussen and Williams 2006, eq. 5.8). Until it is more likely than not that anything
stands nothing does.
"""

import math

import numpy as np
from scipy.spatial.distance import cdist

from companion.core.base.arrays import Floats
from companion.core.wind.process import averaged_share

LENGTH_M = 200.0
"""Between wakes of houses, some 100 m long, and those of ridges."""
_UP = 4.0
"""Metres of height count so many times: a wake is flat."""

SHARES = (0.0, 0.05, 0.1, 0.15, 0.2)
"""Standard deviation over the mean wind, on each axis."""
_PRIOR = (0.8, 0.05, 0.05, 0.05, 0.05)
"""How likely each is before anybody has told anything."""
MOST_LOG_ODDS = 10.0
"""Of a share against none: the air may come from elsewhere within minutes."""
LEAST_OTHERS = 2
"""Fewer members than that, besides the one who says most of it, teach nothing."""
MEMORY_S = 3600.0
"""What was told so long ago counts 1/e: the wind turns, and stands elsewhere."""


def coordinates(place_ne_m: Floats, height_m: Floats) -> Floats:
    """Points (n, 3) whose Euclidean distances are d / L."""
    return np.column_stack([place_ne_m, _UP * height_m]) / LENGTH_M


def left_by_averaging(span_m: Floats) -> Floats:
    """Share (n,) of the standard deviation that a mean over a way of so many metres leaves."""
    return np.sqrt(averaged_share(LENGTH_M / np.maximum(span_m, 1.0), 1.0))


def between(one: Floats, left: Floats, other: Floats, right: Floats) -> Floats:
    """Covariance (n, m) between points and other points, over the variance of what stands; each is
    a mean that leaves the share `left` or `right` of its standard deviation.
    """
    found = np.exp(-cdist(one, other))
    found *= left[:, None]
    found *= right
    return found


class StandingShare:
    """How much of it there is: the root of the mean square of `SHARES`, each weighed by how likely
    it makes what was told.

    It is no more than all members say but the one who says most of it: that one may be in a lee, or
    wrong.
    """

    def __init__(self) -> None:
        self.learned_s = -math.inf
        self._log_odds = np.zeros((2, len(SHARES)))
        """Against none, of everybody and of the others."""
        self._by_member: dict[str, Floats] = {}
        """The same of what each member told, given what was told before it."""
        self.share = 0.0
        """Standard deviation over the mean wind."""

    def says_most(self, told: dict[str, Floats], now_s: float) -> str:
        """Take each member's log likelihoods of what was told since `learned_s`; returns who speaks
        most for that anything stands, in all that is remembered.
        """
        kept, before = self._remembered(now_s), self._by_member
        self._by_member = {
            name: kept * before.get(name, np.zeros(len(SHARES))) + logs - logs[0]
            for name, logs in told.items()
        }
        likeliest = int(np.sum(list(self._by_member.values()), axis=0).argmax())
        return max(told, key=lambda name: float(self._by_member[name][likeliest]))

    def learn(self, everybody: Floats, others: Floats, now_s: float) -> None:
        """Take the log likelihoods of what was told since `learned_s`: of all, and without the one
        who says most of it.
        """
        told = np.stack([everybody, others])
        odds = self._remembered(now_s) * self._log_odds + told - told[:, :1]
        self._log_odds = np.clip(odds, -MOST_LOG_ODDS, MOST_LOG_ODDS)
        self.share = min(_share(each) for each in self._log_odds)
        self.learned_s = now_s

    def _remembered(self, now_s: float) -> float:
        return math.exp(-(now_s - self.learned_s) / MEMORY_S)


def _share(log_odds: Floats) -> float:
    weights = np.array(_PRIOR) * np.exp(log_odds)
    weights /= weights.sum()
    return float(np.sqrt(weights @ np.square(SHARES))) if weights[0] < 0.5 else 0.0
