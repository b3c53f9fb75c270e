"""Scores of a wind process on held-out wind."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace
from scipy.special import ndtri, stdtrit

from companion.analysis.wind_fit.fit import (
    MEAN_S,
    MIN_FIT_S,
    AveragedWind,
    WindFit,
    fit_wind_process_to_recordings,
)
from companion.analysis.wind_fit.score import (
    HORIZONS_S,
    Forecasts,
    Score,
    ValidationInterval,
    concatenate_forecasts_by_horizon,
    fit_student_t_dof,
    outlook_forecasts_by_horizon,
    running_mean_errors_by_horizon,
    score_forecasts,
    standardised_errors,
    with_constant_std,
)
from companion.core.certificate.evidence import RETURN_S
from companion.core.certificate.support import COVERAGE
from companion.core.wind.process import WindProcessParams

BLOCK_S = 1200.0
VALIDATION_BLOCKS = 2  # scored together, so that a forecast of twenty minutes fits in
MAX_FOLDS = 5
ESTIMATE_STD_MPS = 0.5  # error of a vehicle's wind estimate
FITTED, GAUSSIAN = "fitted process", "fitted process, Gaussian tails"
PERSISTENCE, LONG_MEAN = "mean of the last 30 s", "mean of the last 300 s"
_SEED = 20_230_512  # of the estimate's noise
_AVERAGING_TIMES_S = {PERSISTENCE: 30.0, LONG_MEAN: 300.0}


@dataclass(frozen=True, slots=True)
class Holdout:
    """Scores on held-out intervals, and the fit of each fold."""

    scores: tuple[Score, ...]
    folds: tuple[WindProcessParams, ...]
    judged_s: float


def fit_wind_process_with_tail(
    recordings: Sequence[AveragedWind],
    name: str,
    process_part_count: int,
    on_evaluation: Callable[[], None] = lambda: None,
) -> WindFit:
    """Return the fit, with tails and differences between sites from its forecast errors."""
    fit = fit_wind_process_to_recordings(recordings, name, process_part_count, on_evaluation)
    forecasts: dict[str, list[dict[float, Forecasts]]] = {}
    for r in recordings:
        interval = recording_as_validation_interval(r)
        found = _process_forecasts_by_horizon(fit.process, interval, on_evaluation)
        forecasts.setdefault(r.site, []).append(found)
    merged = {s: concatenate_forecasts_by_horizon(found) for s, found in forecasts.items()}
    errors = {s: z for s, found in merged.items() if (z := standardised_errors(found)).size}
    factors = {s: float(np.mean(z**2)) for s, z in errors.items()}
    process = replace(
        fit.process,
        tail_dof=fit_student_t_dof(tuple(errors.values())),
        independent_returns=independent_returns(fit.mean_count * MEAN_S, tuple(factors.values())),
    )
    if len(factors) > 1:  # the middle site: hours at one do not outweigh the others
        middle = math.exp(float(np.mean(np.log([*factors.values()]))))
        process = process.with_scaled_variances(middle)
        factors = {s: f / middle for s, f in factors.items()}
    return dataclasses.replace(fit, process=process, site_factors=factors)


def independent_returns(recorded_s: float, site_factors: Sequence[float]) -> float | None:
    """Return the independent observations behind the variance of another site; None for one site.

    The relative variance of a variance from n observations is 2 / n. Of another site it is that of
    Student's prediction from the logarithms of the sites' variances, s^2 (1 + 1 / sites), widened
    by t over the normal quantile. No number of hours at a few sites makes it smaller.
    """
    sites = len(site_factors)
    if sites < 2:
        return None
    widened = float(stdtrit(sites - 1, COVERAGE) / ndtri(COVERAGE)) ** 2 * (1.0 + 1.0 / sites)
    spread = widened * float(np.var(np.log(site_factors), ddof=1))
    return 1.0 / (RETURN_S / recorded_s + 0.5 * spread)


def recording_as_validation_interval(recording: AveragedWind) -> ValidationInterval:
    """Return the whole recording as one scored interval."""
    return ValidationInterval(recording, float(recording.t_s[0]), float(recording.t_s[-1]))


def cross_validate_wind_process(
    recordings: Sequence[AveragedWind],
    process_part_count: int,
    reference_processes: Sequence[WindProcessParams] = (),
    on_evaluation: Callable[[], None] = lambda: None,
) -> Holdout | None:
    """Cross-validate: fit on some intervals, score on the others, each interval once.

    `reference_processes` are further processes, scored unchanged. None if the recordings are too
    short to divide.
    """
    folds = _test_and_training_folds(recordings)
    kept: dict[str, list[dict[float, Forecasts]]] = {}
    fits: list[WindProcessParams] = []
    judged_s = 0.0
    for judged, training in folds:
        if sum(r.t_s.size for r in training) * MEAN_S < MIN_FIT_S:
            continue
        fitted = fit_wind_process_with_tail(
            training, "held out", process_part_count, on_evaluation
        ).process
        fits.append(fitted)
        judged_s += sum(j.last_s - j.first_s for j in judged)
        for process in (fitted, *reference_processes):
            label = FITTED if process is fitted else process.name
            kept.setdefault(label, []).extend(
                _process_forecasts_by_horizon(process, j, on_evaluation) for j in judged
            )
        for label, last_s in _AVERAGING_TIMES_S.items():
            kept.setdefault(label, []).extend(_running_mean_forecasts(judged, training, last_s))
    if not fits:
        return None
    return Holdout(
        tuple(_scores_by_horizon(kept, fits, reference_processes)), tuple(fits), judged_s
    )


def _scores_by_horizon(
    forecasts_by_label: dict[str, list[dict[float, Forecasts]]],
    fold_processes: Sequence[WindProcessParams],
    reference_processes: Sequence[WindProcessParams],
) -> list[Score]:
    dofs = [f.tail_dof for f in fold_processes if f.tail_dof is not None]
    # One distribution for the pooled errors: the median over the folds' fits.
    middle = float(np.median(dofs)) if 2 * len(dofs) > len(fold_processes) else None
    tails: dict[str, float | None] = {FITTED: middle} | {
        o.name: o.tail_dof for o in reference_processes
    }
    scores: list[Score] = []
    for label, parts in forecasts_by_label.items():
        for horizon_s, found in concatenate_forecasts_by_horizon(parts).items():
            scores.append(score_forecasts(label, horizon_s, found, tails.get(label)))
            if label == FITTED and middle is not None:
                scores.append(score_forecasts(GAUSSIAN, horizon_s, found))
    return sorted(scores, key=lambda s: s.horizon_s)


def _running_mean_forecasts(
    test_intervals: Sequence[ValidationInterval],
    training: Sequence[AveragedWind],
    averaging_s: float,
) -> list[dict[float, Forecasts]]:
    """Return a running mean's errors, with their std on the training intervals."""
    known = concatenate_forecasts_by_horizon(
        [
            _running_mean_errors_by_horizon(recording_as_validation_interval(r), averaging_s)
            for r in training
        ]
    )
    spread = {h: float(np.sqrt(np.mean(f[0] ** 2))) for h, f in known.items()}
    return [
        {
            h: with_constant_std(f, spread[h])
            for h, f in _running_mean_errors_by_horizon(j, averaging_s).items()
            if h in spread
        }
        for j in test_intervals
    ]


def _running_mean_errors_by_horizon(
    test_interval: ValidationInterval, averaging_s: float
) -> dict[float, Forecasts]:
    return running_mean_errors_by_horizon(
        test_interval, averaging_s, ESTIMATE_STD_MPS, np.random.default_rng(_SEED)
    )


def _process_forecasts_by_horizon(
    process: WindProcessParams, test_interval: ValidationInterval, on_step: Callable[[], None]
) -> dict[float, Forecasts]:
    random = np.random.default_rng(_SEED)
    return outlook_forecasts_by_horizon(process, test_interval, ESTIMATE_STD_MPS, random, on_step)


def _test_and_training_folds(
    recordings: Sequence[AveragedWind],
) -> list[tuple[list[ValidationInterval], list[AveragedWind]]]:
    """Assign the sites, or intervals of VALIDATION_BLOCKS blocks of a single site, to folds in
    turn; return them with the rest.
    """
    groups: dict[object, list[tuple[int, float, float]]] = {}
    whole_sites = len({r.site for r in recordings}) > 1
    for number, recording in enumerate(recordings):
        first, last = float(recording.t_s[0]), float(recording.t_s[-1]) + MEAN_S
        count = max(round((last - first) / (VALIDATION_BLOCKS * BLOCK_S)), 1)
        edges = np.linspace(first, last, 2 if whole_sites else count + 1)
        for a, b in itertools.pairwise(edges):
            group = recording.site if whole_sites else (number, a)
            groups.setdefault(group, []).append((number, float(a), float(b)))
    count = min(MAX_FOLDS, len(groups))
    if count < 2:
        return []
    folds = [list(itertools.chain(*[*groups.values()][f::count])) for f in range(count)]
    return [
        (
            [ValidationInterval(recordings[n], a, b) for n, a, b in intervals],
            _recordings_without_intervals(recordings, intervals),
        )
        for intervals in folds
    ]


def _recordings_without_intervals(
    recordings: Sequence[AveragedWind], test_intervals: Sequence[tuple[int, float, float]]
) -> list[AveragedWind]:
    left: list[AveragedWind] = []
    for number, recording in enumerate(recordings):
        keep = np.ones(recording.t_s.size, bool)
        for of, a, b in test_intervals:
            if of == number:
                keep &= ~((recording.t_s >= a) & (recording.t_s < b))
        index = np.flatnonzero(keep)
        for run in np.split(index, np.flatnonzero(np.diff(index) > 1) + 1):
            if run.size > 1:
                left.append(
                    dataclasses.replace(
                        recording,
                        t_s=recording.t_s[run],
                        wind_to_ne_mps=recording.wind_to_ne_mps[run],
                    )
                )
    return left


def headwind_change_quantile_by_horizon(
    recordings: Sequence[AveragedWind], probability: float
) -> list[tuple[float, float]]:
    """Return (H, quantile) of the mean headwind over the next H s minus that of the last 30 s,
    for the worst of eight directions, if the recordings are long enough.
    """
    random = np.random.default_rng(_SEED)
    found = concatenate_forecasts_by_horizon(
        [
            running_mean_errors_by_horizon(recording_as_validation_interval(r), 30.0, 0.0, random)
            for r in recordings
        ]
    )
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


def process_headwind_change_std_mps(
    process: WindProcessParams, horizon_s: float, wind_mps: float
) -> float:
    """Return the process's standard deviation of that change, at a mean wind."""
    last, future_count = round(30.0 / MEAN_S), round(horizon_s / MEAN_S)
    t_s = np.arange(last + future_count) * MEAN_S
    lag = np.abs(np.subtract.outer(t_s, t_s))
    weight = np.concatenate([np.full(last, -1.0 / last), np.full(future_count, 1.0 / future_count)])
    total = 0.0
    for memory, variance in zip(process.memory_s, process.variance_m2ps2, strict=True):
        total += variance * float(weight @ np.exp(-lag / memory) @ weight)
    return float(np.sqrt(total * process.variance_scale(wind_mps)))
