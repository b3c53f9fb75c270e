"""What each state and hypothesis of the wind estimator is worth over the simulated envelope."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from companion.core.vehicle.airframe import Airframe
from companion.core.wind.estimator import WindEstimator
from sim_bridge.research.results.sheet import Sheet
from sim_bridge.research.wind.ablation import ABLATIONS, without
from sim_bridge.research.wind.envelope_flight import Condition, drag_deviates, fly_envelope
from sim_bridge.research.wind.envelope_score import judged
from sim_bridge.truth.params import AirframeTruth

WHOLE = "all of it"
CONDITIONS = (
    *(Condition(None, wind) for wind in (0.0, 2.5, 8.0)),
    *(Condition(10.0, wind) for wind in (0.0, 2.5, 8.0)),
    *(Condition(18.0, wind) for wind in (0.0, 2.5, 12.0)),
    Condition(10.0, 4.0, wind_step=True),
)


@dataclass(frozen=True)
class StatesJob:
    """One condition, flown so often; every variant hears the same flights."""

    index: int
    condition: Condition
    flights: int
    seed: int
    truth: AirframeTruth
    airframe: Airframe


class StatesRow(msgspec.Struct, frozen=True):
    """By variant: mean square error of each flight, (m/s)^2, and its mean NEES."""

    condition: str
    squares_m2ps2: dict[str, list[float]]
    nees: dict[str, list[float]]


def states_jobs(
    flights: int, seed: int, truth: AirframeTruth, airframe: Airframe, pitot: bool
) -> list[StatesJob]:
    """All conditions."""
    return [
        StatesJob(i, replace(c, pitot=pitot), flights, seed, truth, airframe)
        for i, c in enumerate(CONDITIONS)
    ]


def fly_states(job: StatesJob) -> StatesRow:
    """Fly one condition and judge the whole estimator and each of ABLATIONS."""
    makers = {WHOLE: WindEstimator} | {name: without(name) for name in ABLATIONS}
    squares: dict[str, list[float]] = {name: [] for name in makers}
    nees: dict[str, list[float]] = {name: [] for name in makers}
    drags = drag_deviates(job.flights, np.random.default_rng([job.seed, job.index]))
    for i, drag in enumerate(drags):
        rng = np.random.default_rng([job.seed, job.index, i])
        flown = fly_envelope(job.truth, job.condition, rng, drag)
        for name, make in makers.items():
            errors = judged(flown, job.airframe, make)
            squares[name].append(float(np.mean(np.sum(errors.error_ne_mps**2, axis=1))))
            nees[name].append(float(errors.nees.mean()))
    return StatesRow(job.condition.name, squares, nees)


def states_sheet(rows: Sequence[StatesRow], seed: int) -> Sheet:
    """RMSE of the whole estimator, and what each variant's is over it, in %."""
    head = ["condition", "RMSE m/s", "NEES"]
    head += [f"{name}, %" for name in ABLATIONS]
    cells = [
        [
            row.condition,
            f"{math.sqrt(float(np.mean(row.squares_m2ps2[WHOLE]))):.2f}",
            f"{np.mean(row.nees[WHOLE]):.2f}",
            *(_more(row, name) for name in ABLATIONS),
        ]
        for row in rows
    ]
    flights = len(rows[0].squares_m2ps2[WHOLE])
    note = (
        f"Seed {seed}, {flights} flights a condition, the same for all. RMSE without a state over"
        " that with all, less 1; the 95 % interval is paired by flights. Above nought it earns its"
        " place there. The truth has errors of compass, trim and drag, gusts, and the drag law of"
        " the estimator's own."
    )
    return Sheet("What each state is worth in simulated flights", head, cells, note)


def _more(row: StatesRow, name: str) -> str:
    """Relative RMSE more, by the delta method on paired mean squares."""
    whole = np.array(row.squares_m2ps2[WHOLE])
    ratio = np.array(row.squares_m2ps2[name]).sum() / whole.sum()
    left = (np.array(row.squares_m2ps2[name]) - ratio * whole) / whole.mean()
    std = float(left.std(ddof=1)) / math.sqrt(len(whole))
    more, half = math.sqrt(ratio) - 1.0, 1.96 * 0.5 * std / math.sqrt(ratio)
    return f"{100.0 * more:+.0f} ± {100.0 * half:.0f}"
