"""Cross-fitting: a block's planner is fitted only on seconds outside that block.

For each block the outlook's wind process is fitted by likelihood, tails included, as `companion
fit-wind` does it. With less than 20 minutes to fit on, the shipped process is used. Two numbers
follow. `spread`: how much larger the forecast errors were than stated, over windows as long as a
way home. `accepted`: the risk that a single decision may take so that all missions together lose
what the operator accepts. It is found from the gate's own P(home) at departures drawn in the same
seconds. Nothing that a judged mission sees or flies through is used: the block, the history before
it and the longest mission after it are held out.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook
from companion.core.wind.process import WindProcessParams
from companion.core.wind_fit.fit import LEAST_FIT_S, MEAN_S, WindMeans, ten_second_means
from companion.core.wind_fit.holdout import fit_with_tail
from sim_bridge.research.promise.blocks import Block
from sim_bridge.research.promise.planner import AVERAGE_S, HISTORY_S, NOISE_MPS
from sim_bridge.research.promise.recording import Stretch

_KEPT_BACK = 0.06

_MOST_FIT_S = 3.0 * 3600.0
_PARTS = 3
_EVERY_S = 20
_MOST_ERRORS = 500
_WINDOW_FRACS = (0.15, 0.3)  # of the endurance: short and long ways home
_INDEPENDENT_S = 200.0  # forecast errors this far apart are taken as independent
_PRIOR_ERRORS = 10.0  # weight of the prior spread 1, in independent errors


@dataclass(frozen=True, slots=True)
class Unjudged:
    """Seconds `first` to `last` of a stretch on which a fold's models may be fitted."""

    stretch: int
    first: int
    last: int


def unjudged_by(judged: tuple[Block, ...], stretches: tuple[Stretch, ...]) -> tuple[Unjudged, ...]:
    """Each stretch without the judged blocks, their history and their missions."""
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


def fitted_process(
    unjudged: tuple[Unjudged, ...], stretches: tuple[Stretch, ...], shipped: WindProcessParams
) -> WindProcessParams:
    """Process fitted to the first hours of unjudged wind; the shipped one if too little is left."""
    means: list[WindMeans] = []
    for part in unjudged:
        wind = stretches[part.stretch].wind_ne_mps[part.first : part.last + 1]
        if sum(m.t_s.size for m in means) * MEAN_S < _MOST_FIT_S:
            means += ten_second_means(np.arange(wind.shape[0], dtype=np.float64), wind)
    if sum(m.t_s.size for m in means) * MEAN_S < LEAST_FIT_S:
        return shipped
    return fit_with_tail(means, "unjudged", _PARTS).process


def fitted_spread(
    unjudged: tuple[Unjudged, ...],
    stretches: tuple[Stretch, ...],
    process: WindProcessParams,
    endurance_s: float,
    rng: np.random.Generator,
) -> float:
    """RMS of the standardised forecast errors, shrunk towards 1 while there are few.

    One standard error, 1 / sqrt(2 n), is added: a broken promise costs more than a delivery not
    made.
    """
    usable = [u for u in unjudged if u.last - u.first > HISTORY_S + endurance_s]
    seconds = sum(u.last - u.first - HISTORY_S for u in usable)
    every_s = max(_EVERY_S, math.ceil(seconds / _MOST_ERRORS))
    squares: list[float] = []
    for part in usable:
        wind = stretches[part.stretch].wind_ne_mps[part.first : part.last + 1]
        squares += _standardised(wind, process, endurance_s, every_s, rng)
    independent = 2.0 * min(len(squares), seconds / _INDEPENDENT_S)  # two axes
    mean = float(np.mean(squares)) if squares else 1.0
    known = independent + _PRIOR_ERRORS
    spread = math.sqrt((independent * mean + _PRIOR_ERRORS) / known)
    return spread * (1.0 + 1.0 / math.sqrt(2.0 * known))


def _standardised(
    wind_ne_mps: Floats,
    process: WindProcessParams,
    endurance_s: float,
    every_s: int,
    rng: np.random.Generator,
) -> Iterator[float]:
    """Yield squared errors of window means over the gate's variance, averaged over both axes.

    The gate prices a leg at its midpoint wind. The windows are as long as short and long ways home.
    """
    seconds = wind_ne_mps.shape[0]
    noisy = wind_ne_mps + NOISE_MPS * rng.standard_normal(wind_ne_mps.shape)
    cov = np.eye(2) * NOISE_MPS**2 / AVERAGE_S
    windows = [math.ceil(frac * endurance_s) for frac in _WINDOW_FRACS]
    middles = 0.5 * np.array(windows, float)
    for now in range(HISTORY_S, seconds - max(windows), every_s):
        outlook = WindOutlook(process)
        belief = WindBelief(float(now), np.zeros(2), cov, ("told",), False)
        for at in range(now - HISTORY_S + AVERAGE_S, now + 1, AVERAGE_S):
            mean = noisy[at - AVERAGE_S : at].mean(axis=0)
            belief = WindBelief(float(at), mean, cov, ("told",), True)
            outlook.observe(belief)
        seen = outlook.forecast(belief, middles)
        variance = np.diag(seen.walk_cov_m2ps2)
        actual = np.array([wind_ne_mps[now : now + w].mean(axis=0) for w in windows])
        errors = (actual - seen.mean_to_ne_mps) ** 2
        yield float((errors.mean(axis=1) / variance).mean())


def aimed_at(max_loss: float) -> float:
    """The mean loss to aim at, so that sampling error does not exceed the accepted loss.

    `L - 0.06 sqrt(L (1 - L))`: two standard deviations over 1,100 independent missions above it is
    L (2 / sqrt(1100) = 0.06). 0.4 % for 1 %, 13 % for 15 %.
    """
    return max(max_loss - _KEPT_BACK * math.sqrt(max_loss * (1.0 - max_loss)), 0.3 * max_loss)


def accepted_for(max_loss: float, levels: tuple[float, ...], said_p_home: Floats) -> float:
    """The highest risk level at which departures, by their own P(home), lose no more than aimed at.

    `said_p_home` (departures, levels) is NaN where the gate would not go. The level is
    interpolated, in its logarithm, between two grid levels. Raises ValueError without departures.
    """
    if said_p_home.shape[0] == 0:
        raise ValueError("no departures to settle the accepted loss on")
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
