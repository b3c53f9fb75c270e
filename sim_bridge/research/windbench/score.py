"""The scoring rule: airspeed over 10 s, day by day.

- A window is 10 s in the air, from 30 s after take-off on, one after another.
- The error is the mean airspeed |v - w| by the estimator, as the anemometer would read it, less
  what it read. Any anemometer tells that, one with two axes too.
- An anemometer of speed alone sits in the rotors' flow: its scale and bias are fitted for each
  estimator on the folder's other days. A reference that tells the vector is taken as it is, and so
  is everything in a folder of fewer than four days.
- The score is the root mean square over days of each day's RMS error: days count alike. Its
  interval is a bootstrap over days.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from sim_bridge.research.real_flights.comparison import compared

LEAST_DAYS = 4
DRAWS, SEED = 2000, 1


class Scored(msgspec.Struct, frozen=True):
    """One window by one estimator; `std_mps` and `vector_mps` (error of the wind's vector) where
    they are told."""

    folder: str
    day: str
    flight: str
    read_mps: float
    believed_mps: float
    std_mps: float | None
    vector_mps: float | None


class Standing(msgspec.Struct, frozen=True):
    """An estimator's place. `low_mps`, `high_mps`: 95 % by days; `nees` in one dimension, 1 is
    ideal; `vector_mps` RMS where a reference tells the vector."""

    estimator: str
    score_mps: float
    low_mps: float
    high_mps: float
    nees: float | None
    vector_mps: float | None
    folders: dict[str, float]


@dataclass(frozen=True, slots=True)
class _Errors:
    """One estimator's errors of one day, and the errors over the stated std."""

    folder: str
    error_mps: Floats
    normalised: Floats


def standing(name: str, rows: Sequence[Scored]) -> Standing:
    """Judge all windows of one estimator."""
    days = [_of_day(rows, key) for key in sorted({(r.folder, r.day) for r in rows})]
    squares = np.array([float(np.mean(day.error_mps**2)) for day in days])
    rng = np.random.default_rng(SEED)
    drawn = np.sqrt(squares[rng.integers(0, len(days), (DRAWS, len(days)))].mean(axis=1))
    normalised = np.concatenate([day.normalised for day in days])
    vectors = [r.vector_mps for r in rows if r.vector_mps is not None]
    return Standing(
        name,
        math.sqrt(float(squares.mean())),
        float(np.percentile(drawn, 2.5)),
        float(np.percentile(drawn, 97.5)),
        float(np.mean(normalised**2)) if len(normalised) else None,
        math.sqrt(float(np.mean(np.square(vectors)))) if vectors else None,
        {
            folder: math.sqrt(
                float(
                    np.mean([s for s, d in zip(squares, days, strict=True) if d.folder == folder])
                )
            )
            for folder in sorted({day.folder for day in days})
        },
    )


@dataclass(frozen=True, slots=True)
class ScoreDifference:
    """Score of one estimator less another's, m/s, and its 95 % interval over so many days."""

    days: int
    mean_mps: float
    low_mps: float
    high_mps: float


def difference(rows: Sequence[Scored], than: Sequence[Scored]) -> ScoreDifference:
    """Of the same windows by two estimators; days drawn together."""
    keys = {(r.folder, r.day) for r in rows}
    found = compared(
        "", [("/".join(key), _square(rows, key), _square(than, key)) for key in keys], np.sqrt
    )
    assert found is not None, "rows"
    return ScoreDifference(len(keys), found.ours - found.theirs, found.low, found.high)


def _square(rows: Sequence[Scored], key: tuple[str, str]) -> float:
    return float(np.mean(_of_day(rows, key).error_mps ** 2))


def flight_errors_mps(rows: Sequence[Scored]) -> dict[tuple[str, str, str], float]:
    """RMS error of each flight, by folder, day and name."""
    found: dict[tuple[str, str, str], float] = {}
    for key in sorted({(r.folder, r.day) for r in rows}):
        own = [r for r in rows if (r.folder, r.day) == key]
        squares = _of_day(rows, key).error_mps ** 2
        for name in sorted({r.flight for r in own}):
            at = [i for i, r in enumerate(own) if r.flight == name]
            found[*key, name] = math.sqrt(float(squares[at].mean()))
    return found


def _of_day(rows: Sequence[Scored], key: tuple[str, str]) -> _Errors:
    folder, day = key
    own = [r for r in rows if (r.folder, r.day) == key]
    scale, bias = _reading([r for r in rows if r.folder == folder], day)
    errors = np.array([scale * r.believed_mps + bias - r.read_mps for r in own])
    told = [
        error / (scale * r.std_mps)
        for error, r in zip(errors, own, strict=True)
        if r.std_mps is not None
    ]
    return _Errors(folder, errors, np.array(told))


def _reading(rows: Sequence[Scored], day: str) -> tuple[float, float]:
    """What the anemometer makes of an airspeed, by the other days; as it is where they are few."""
    others = [r for r in rows if r.day != day]
    if len({r.day for r in others}) < LEAST_DAYS - 1 or rows[0].vector_mps is not None:
        return 1.0, 0.0
    scale, bias = np.polyfit([r.believed_mps for r in others], [r.read_mps for r in others], 1)
    return float(scale), float(bias)
