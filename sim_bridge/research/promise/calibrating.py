"""Cross-fitting: a block's planner is fitted only on seconds outside that block.

For each block, the wind process of the forecast is fitted by maximum likelihood, including tails,
as in `companion fit-wind`. With less than 20 minutes of data, the shipped process is used. Two
parameters are then calibrated. `spread`: ratio of actual to stated forecast errors, over windows as
long as a return flight. `accepted`: risk per decision for which the loss over all missions equals
the operator's accepted loss, computed from the gate's P(home) at departures drawn in the same
seconds. Wind that an evaluated mission observes or flies through is held out: the block, the
history before it and the longest mission after it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.analysis.wind_fit.fit import MEAN_S, MIN_FIT_S, AveragedWind, average_wind_over_10_s
from companion.analysis.wind_fit.holdout import fit_wind_process_with_tail
from companion.core.base.arrays import Floats
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook
from companion.core.wind.process import WindProcessParams
from sim_bridge.research.promise.planner import AVERAGE_S, HISTORY_S, NOISE_MPS
from sim_bridge.research.promise.recording import Stretch
from sim_bridge.research.promise.world import Block

_SAMPLING_MARGIN = 0.06

_MAX_FIT_S = 3.0 * 3600.0
_PARTS = 3
_ERROR_INTERVAL_S = 20
_MAX_ERRORS = 500
_WINDOW_FRACS = (0.15, 0.3)  # of the endurance: short and long return flights
_INDEPENDENT_S = 200.0  # forecast errors at this separation are treated as independent
_PRIOR_ERRORS = 10.0  # weight of the prior spread 1, in independent errors


@dataclass(frozen=True, slots=True)
class TrainingSpan:
    """Seconds `first` to `last` of a stretch on which a fold's models may be fitted."""

    stretch: int
    first: int
    last: int


def spans_outside_evaluation_blocks(
    evaluation_blocks: tuple[Block, ...], stretches: tuple[Stretch, ...]
) -> tuple[TrainingSpan, ...]:
    """Return stretches without the evaluation blocks, their history and missions."""
    left: list[TrainingSpan] = []
    for index, stretch in enumerate(stretches):
        excluded = sorted(
            (b.first - HISTORY_S, b.last_flight_second)
            for b in evaluation_blocks
            if b.stretch == index
        )
        begin = 0
        for first, until in excluded:
            if first - 1 > begin:
                left.append(TrainingSpan(index, begin, first - 1))
            begin = max(begin, until + 1)
        if stretch.seconds > begin:
            left.append(TrainingSpan(index, begin, stretch.seconds))
    return tuple(left)


def fit_training_process(
    training: tuple[TrainingSpan, ...],
    stretches: tuple[Stretch, ...],
    default_process: WindProcessParams,
) -> WindProcessParams:
    """Return the process fitted to the first training hours; if too short, the shipped one."""
    wind_averages: list[AveragedWind] = []
    for part in training:
        wind = stretches[part.stretch].wind_ne_mps[part.first : part.last + 1]
        if sum(m.t_s.size for m in wind_averages) * MEAN_S < _MAX_FIT_S:
            wind_averages += average_wind_over_10_s(
                np.arange(wind.shape[0], dtype=np.float64), wind
            )
    if sum(m.t_s.size for m in wind_averages) * MEAN_S < MIN_FIT_S:
        return default_process
    return fit_wind_process_with_tail(wind_averages, "unjudged", _PARTS).process


def fit_spread(
    training: tuple[TrainingSpan, ...],
    stretches: tuple[Stretch, ...],
    process: WindProcessParams,
    endurance_s: float,
    rng: np.random.Generator,
) -> float:
    """RMS of the standardised forecast errors, shrunk towards 1 while there are few.

    One standard error, 1 / sqrt(2 n), is added: a lost vehicle costs more than a cancelled
    delivery.
    """
    usable = [u for u in training if u.last - u.first > HISTORY_S + endurance_s]
    seconds = sum(u.last - u.first - HISTORY_S for u in usable)
    interval_s = max(_ERROR_INTERVAL_S, math.ceil(seconds / _MAX_ERRORS))
    squares: list[float] = []
    for part in usable:
        wind = stretches[part.stretch].wind_ne_mps[part.first : part.last + 1]
        squares += _standardised_squared_errors(wind, process, endurance_s, interval_s, rng)
    independent = 2.0 * min(len(squares), seconds / _INDEPENDENT_S)  # two axes
    mean = float(np.mean(squares)) if squares else 1.0
    known = independent + _PRIOR_ERRORS
    spread = math.sqrt((independent * mean + _PRIOR_ERRORS) / known)
    return spread * (1.0 + 1.0 / math.sqrt(2.0 * known))


def _standardised_squared_errors(
    wind_ne_mps: Floats,
    process: WindProcessParams,
    endurance_s: float,
    interval_s: int,
    rng: np.random.Generator,
) -> Iterator[float]:
    """Yield squared errors of window means over the gate's variance, averaged over both axes.

    The gate evaluates a leg at its midpoint wind. Windows last as long as short and long returns.
    """
    seconds = wind_ne_mps.shape[0]
    noisy = wind_ne_mps + NOISE_MPS * rng.standard_normal(wind_ne_mps.shape)
    cov = np.eye(2) * NOISE_MPS**2 / AVERAGE_S
    windows = [math.ceil(frac * endurance_s) for frac in _WINDOW_FRACS]
    middles = 0.5 * np.array(windows, float)
    for now in range(HISTORY_S, seconds - max(windows), interval_s):
        outlook = WindOutlook(process)
        belief = WindBelief(float(now), np.zeros(2), cov, ("told",), False)
        for at in range(now - HISTORY_S + AVERAGE_S, now + 1, AVERAGE_S):
            mean = noisy[at - AVERAGE_S : at].mean(axis=0)
            belief = WindBelief(float(at), mean, cov, ("told",), True)
            outlook.update_from_estimate(belief)
        seen = outlook.forecast(belief, middles)
        variance = np.diag(seen.change_cov_m2ps2)
        actual = np.array([wind_ne_mps[now : now + w].mean(axis=0) for w in windows])
        errors = (actual - seen.mean_to_ne_mps) ** 2
        yield float((errors.mean(axis=1) / variance).mean())


def loss_target_below_accepted(accepted_loss: float) -> float:
    """Return the target mean loss that keeps sampling error below the accepted loss.

    `L - 0.06 sqrt(L (1 - L))`: two standard deviations over 1,100 independent missions above it is
    L (2 / sqrt(1100) = 0.06). 0.4 % for 1 %, 13 % for 15 %.
    """
    return max(
        accepted_loss - _SAMPLING_MARGIN * math.sqrt(accepted_loss * (1.0 - accepted_loss)),
        0.3 * accepted_loss,
    )


def fit_risk_level(max_loss: float, levels: tuple[float, ...], p_home: Floats) -> float:
    """Return the highest risk level whose predicted loss does not exceed the target loss.

    `p_home` (departures, levels) is NaN where the gate refuses departure. The level is
    interpolated logarithmically between two grid levels. Raises ValueError without departures.
    """
    if p_home.shape[0] == 0:
        raise ValueError("said_p_home: expected at least one departure, got none")
    departs = np.isfinite(p_home)
    loss = np.where(departs, 1.0 - p_home, 0.0).sum(axis=0) / np.maximum(departs.sum(axis=0), 1)
    at, share = level_and_share_at_loss(loss, loss_target_below_accepted(max_loss))
    if share == 0.0:
        return levels[at]
    low, high = math.log(levels[at]), math.log(levels[at + 1])
    return math.exp(low + share * (high - low))


def level_and_share_at_loss(loss_by_level: Floats, aim: float) -> tuple[int, float]:
    """Return the level below the one that loses `aim`, and the share of the step to the next."""
    loss = np.maximum.accumulate(loss_by_level)
    if loss[0] >= aim:
        return 0, 0.0
    if loss[-1] <= aim:
        return loss.size - 1, 0.0
    above = int(np.argmax(loss > aim))
    return above - 1, float((aim - loss[above - 1]) / (loss[above] - loss[above - 1]))
