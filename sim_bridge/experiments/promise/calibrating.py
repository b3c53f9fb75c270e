"""Cross-fitting: what the planner of a judged block learns from the seconds that are not judged.

Two numbers for each block. `spread`: how much wider than the outlook's the errors of its forecasts
were, over windows as long as a way home. `accepted`: what a single decision may risk so that all
missions together lose what the operator accepts; found on departures drawn in the same seconds, by
what the gate itself says there. Nothing that a judged mission sees or flies through enters: the
block, the history before it and the longest mission behind it are left out.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.wind_estimator import WindBelief
from companion.core.wind_outlook import WindOutlook
from sim_bridge.experiments.promise.blocks import Block
from sim_bridge.experiments.promise.planner import AVERAGE_S, HISTORY_S, NOISE_MPS
from sim_bridge.experiments.promise.recording import Stretch

Floats = NDArray[np.float64]

_KEPT_BACK = 0.04

_EVERY_S = 20
_WINDOW_FRACS = (0.15, 0.3)  # of the endurance: short and long ways home
_INDEPENDENT_S = 200.0  # forecast errors this far apart are taken as independent
_PRIOR_ERRORS = 10.0  # independent errors that the outlook's own spread counts for


@dataclass(frozen=True, slots=True)
class Unjudged:
    """Seconds `first` to `last` of a stretch that a fold's models may be fitted on."""

    stretch: int
    first: int
    last: int


def unjudged_by(judged: tuple[Block, ...], stretches: tuple[Stretch, ...]) -> tuple[Unjudged, ...]:
    """What is left of every stretch without the judged blocks, their history and their missions."""
    left: list[Unjudged] = []
    for index, stretch in enumerate(stretches):
        taken = sorted((b.first - HISTORY_S, b.until) for b in judged if b.stretch == index)
        begin = 0
        for first, until in taken:
            if first - 1 > begin:
                left.append(Unjudged(index, begin, first - 1))
            begin = max(begin, until + 1)
        if stretch.seconds > begin:
            left.append(Unjudged(index, begin, stretch.seconds))
    return tuple(left)


def fitted_spread(
    unjudged: tuple[Unjudged, ...],
    stretches: tuple[Stretch, ...],
    endurance_s: float,
    rng: np.random.Generator,
) -> float:
    """Root mean square of the standardised forecast errors, drawn towards 1 while they are few."""
    squares: list[float] = []
    seconds = 0
    for part in unjudged:
        wind = stretches[part.stretch].wind_ne_mps[part.first : part.last + 1]
        found: list[float] = []
        for frac in _WINDOW_FRACS:
            found = list(_standardised(wind, frac * endurance_s, rng))
            squares += found
        seconds += len(found) * _EVERY_S
    independent = 2.0 * seconds / _INDEPENDENT_S  # two axes
    mean = float(np.mean(squares)) if squares else 1.0
    return math.sqrt((independent * mean + _PRIOR_ERRORS) / (independent + _PRIOR_ERRORS))


def _standardised(
    wind_ne_mps: Floats, window_s: float, rng: np.random.Generator
) -> Iterator[float]:
    """Squared errors, mean over both axes, of window means over their variance as the gate has it.

    The gate prices a leg at the wind in its middle.
    """
    seconds = wind_ne_mps.shape[0]
    noisy = wind_ne_mps + NOISE_MPS * rng.standard_normal(wind_ne_mps.shape)
    cov = np.eye(2) * NOISE_MPS**2 / AVERAGE_S
    middle = np.array([0.5 * window_s])
    for begin in range(0, seconds - HISTORY_S - math.ceil(window_s), _EVERY_S):
        now = begin + HISTORY_S
        outlook = WindOutlook()
        belief = WindBelief(0.0, np.zeros(2), cov, ("told",), True)
        for at in range(begin + AVERAGE_S, now + 1, AVERAGE_S):
            mean = noisy[at - AVERAGE_S : at].mean(axis=0)
            belief = WindBelief(float(at), mean, cov, ("told",), True)
            outlook.observe(belief)
        seen = outlook.forecast(belief, middle)
        actual = wind_ne_mps[now : now + math.ceil(window_s)].mean(axis=0)
        error = actual - seen.mean_to_ne_mps[0]
        yield float((error**2).mean()) / float(seen.walk_cov_m2ps2[0, 0])


def aimed_at(max_loss: float) -> float:
    """The mean loss to aim at so that chance does not carry it over what is accepted.

    `L - 0.04 sqrt(L (1 - L))`: its upper 95 % limit over 1,700 independent missions is L
    (1.645 / sqrt(1700) = 0.04). 0.6 % for 1 %, 14 % for 15 %.
    """
    return max(max_loss - _KEPT_BACK * math.sqrt(max_loss * (1.0 - max_loss)), 0.3 * max_loss)


def accepted_for(max_loss: float, levels: tuple[float, ...], said_p_home: Floats) -> float:
    """The boldest level with which departures, by what is said there, lose what is aimed at.

    `said_p_home` (departures, levels): NaN where the gate would not go. The level is interpolated
    between two of the grid's.
    """
    goes = np.isfinite(said_p_home)
    loss = np.where(goes, 1.0 - said_p_home, 0.0).sum(axis=0) / np.maximum(goes.sum(axis=0), 1)
    loss = np.maximum.accumulate(loss)
    aim = aimed_at(max_loss)
    if loss[0] >= aim:
        return levels[0]
    if loss[-1] <= aim:
        return levels[-1]
    above = int(np.argmax(loss > aim))
    share = (aim - loss[above - 1]) / (loss[above] - loss[above - 1])
    low, high = math.log(levels[above - 1]), math.log(levels[above])
    return math.exp(low + share * (high - low))
