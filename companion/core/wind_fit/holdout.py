"""A wind process judged on wind that it was not fitted to."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from companion.core.wind.process import WindProcessParams
from companion.core.wind_fit.fit import LEAST_FIT_S, MEAN_S, WindFit, WindMeans, fit_process
from companion.core.wind_fit.score import (
    HORIZONS_S,
    Forecasts,
    Judged,
    Score,
    fitted_tail_dof,
    joined,
    outlook_forecasts,
    running_mean_errors,
    score,
    with_spread,
)

BLOCK_S = 1200.0
JUDGED_BLOCKS = 2  # judged together, so that a forecast of twenty minutes fits in
MOST_FOLDS = 5
SEEN_STD_MPS = 0.5  # error of a vehicle's wind estimate at each decision
FITTED, GAUSSIAN = "fitted process", "fitted process, Gaussian tails"
PERSISTENCE, LONG_MEAN = "mean of the last 30 s", "mean of the last 300 s"
_SEED = 20_230_512  # of the estimate's noise
_RUNNING_S = {PERSISTENCE: 30.0, LONG_MEAN: 300.0}


@dataclass(frozen=True, slots=True)
class Holdout:
    """Scores on judged stretches, and the fit that each fold was judged with."""

    scores: tuple[Score, ...]
    folds: tuple[WindProcessParams, ...]
    judged_s: float


def fit_with_tail(
    recordings: Sequence[WindMeans],
    name: str,
    parts: int,
    on_step: Callable[[], None] = lambda: None,
) -> WindFit:
    """The fit, with the tails that its own forecasts' errors ask for."""
    fit = fit_process(recordings, name, parts, on_step)
    said = joined([_forecasts(fit.process, whole(r), on_step) for r in recordings])
    return WindFit(
        replace(fit.process, tail_dof=fitted_tail_dof(said)),
        fit.log_std,
        fit.log_likelihood,
        fit.means,
    )


def whole(recording: WindMeans) -> Judged:
    """All of a recording as a judged stretch."""
    return Judged(recording, float(recording.t_s[0]), float(recording.t_s[-1]))


def judge_held_out(
    recordings: Sequence[WindMeans],
    parts: int,
    others: Sequence[WindProcessParams] = (),
    on_step: Callable[[], None] = lambda: None,
) -> Holdout | None:
    """Fit on some stretches, judge on the others, until all were judged once.

    `others` are processes given beforehand, judged as they are. None where the recordings are too
    short to be divided.
    """
    folds = _folds(recordings)
    kept: dict[str, list[dict[float, Forecasts]]] = {}
    fits: list[WindProcessParams] = []
    judged_s = 0.0
    for judged, training in folds:
        if sum(r.t_s.size for r in training) * MEAN_S < LEAST_FIT_S:
            continue
        fitted = fit_with_tail(training, "held out", parts, on_step).process
        fits.append(fitted)
        judged_s += sum(j.last_s - j.first_s for j in judged)
        for process in (fitted, *others):
            label = FITTED if process is fitted else process.name
            kept.setdefault(label, []).extend(_forecasts(process, j, on_step) for j in judged)
        for label, last_s in _RUNNING_S.items():
            kept.setdefault(label, []).extend(_running(judged, training, last_s))
    if not fits:
        return None
    return Holdout(tuple(_scores(kept, fits, others)), tuple(fits), judged_s)


def _scores(
    kept: dict[str, list[dict[float, Forecasts]]],
    fits: Sequence[WindProcessParams],
    others: Sequence[WindProcessParams],
) -> list[Score]:
    dofs = [f.tail_dof for f in fits if f.tail_dof is not None]
    # One law for the pooled errors: the middle of what the folds found, each on its own training.
    middle = float(np.median(dofs)) if 2 * len(dofs) > len(fits) else None
    tails: dict[str, float | None] = {FITTED: middle} | {o.name: o.tail_dof for o in others}
    scores: list[Score] = []
    for label, parts in kept.items():
        for horizon_s, found in joined(parts).items():
            scores.append(score(label, horizon_s, found, tails.get(label)))
            if label == FITTED and middle is not None:
                scores.append(score(GAUSSIAN, horizon_s, found))
    return sorted(scores, key=lambda s: s.horizon_s)


def _running(
    judged: Sequence[Judged], training: Sequence[WindMeans], last_s: float
) -> list[dict[float, Forecasts]]:
    """A running mean's errors, with the spread that they had on the training stretches."""
    known = joined([_errors(whole(r), last_s) for r in training])
    spread = {h: float(np.sqrt(np.mean(f[0] ** 2))) for h, f in known.items()}
    return [
        {h: with_spread(f, spread[h]) for h, f in _errors(j, last_s).items() if h in spread}
        for j in judged
    ]


def _errors(judged: Judged, last_s: float) -> dict[float, Forecasts]:
    return running_mean_errors(judged, last_s, SEEN_STD_MPS, np.random.default_rng(_SEED))


def _forecasts(
    process: WindProcessParams, judged: Judged, on_step: Callable[[], None]
) -> dict[float, Forecasts]:
    random = np.random.default_rng(_SEED)
    return outlook_forecasts(process, judged, SEEN_STD_MPS, random, on_step)


def _folds(
    recordings: Sequence[WindMeans],
) -> list[tuple[list[Judged], list[WindMeans]]]:
    """Judged stretches of JUDGED_BLOCKS blocks, dealt to folds in turn, and the rest of each."""
    pieces: list[tuple[int, float, float]] = []
    for number, recording in enumerate(recordings):
        first, last = float(recording.t_s[0]), float(recording.t_s[-1]) + MEAN_S
        count = max(round((last - first) / (JUDGED_BLOCKS * BLOCK_S)), 1)
        edges = np.linspace(first, last, count + 1)
        pieces += [(number, float(a), float(b)) for a, b in itertools.pairwise(edges)]
    count = min(MOST_FOLDS, len(pieces))
    if count < 2:
        return []
    return [
        (
            [Judged(recordings[n], a, b) for n, a, b in pieces[fold::count]],
            _without(recordings, pieces[fold::count]),
        )
        for fold in range(count)
    ]


def _without(
    recordings: Sequence[WindMeans], pieces: Sequence[tuple[int, float, float]]
) -> list[WindMeans]:
    left: list[WindMeans] = []
    for number, recording in enumerate(recordings):
        keep = np.ones(recording.t_s.size, bool)
        for of, a, b in pieces:
            if of == number:
                keep &= ~((recording.t_s >= a) & (recording.t_s < b))
        index = np.flatnonzero(keep)
        for run in np.split(index, np.flatnonzero(np.diff(index) > 1) + 1):
            if run.size > 1:
                left.append(WindMeans(recording.t_s[run], recording.wind_to_ne_mps[run]))
    return left


def changes_mps(recordings: Sequence[WindMeans], probability: float) -> list[tuple[float, float]]:
    """(H, quantile): mean headwind over the next H s less that of the last 30 s, the worst of
    eight directions, where the recordings are long enough.
    """
    random = np.random.default_rng(_SEED)
    found = joined([running_mean_errors(whole(r), 30.0, 0.0, random) for r in recordings])
    return [
        (
            h,
            max(
                float(np.quantile(sign * found[h][0][:, line], probability))
                for sign in (-1.0, 1.0)
                for line in range(found[h][0].shape[1])
            ),
        )
        for h in HORIZONS_S
        if h in found
    ]


def stated_change_std_mps(process: WindProcessParams, horizon_s: float, wind_mps: float) -> float:
    """The process's own standard deviation of that change, at a mean wind."""
    last, ahead = round(30.0 / MEAN_S), round(horizon_s / MEAN_S)
    t_s = np.arange(last + ahead) * MEAN_S
    lag = np.abs(np.subtract.outer(t_s, t_s))
    weight = np.concatenate([np.full(last, -1.0 / last), np.full(ahead, 1.0 / ahead)])
    total = 0.0
    for memory, variance in zip(process.memory_s, process.variance_m2ps2, strict=True):
        total += variance * float(weight @ np.exp(-lag / memory) @ weight)
    return float(np.sqrt(total * process.variance_scale(wind_mps)))
