"""Scores all estimators on real flights, by days; the airframe is fitted to a folder's other days.

- A window is 10 s in the air, from 30 s after take-off on, one after another.
- The error is the mean estimated airspeed |v - w|, converted to an anemometer reading, minus the
  actual reading. Every anemometer provides this, including two-axis ones.
- A speed-only anemometer is in the rotors' flow: its scale and bias are fitted for each estimator
  on the folder's other days. A vector reference is used without conversion, as are all readings in
  a folder of fewer than four days.
- The score is the root mean square over days of each day's RMS error, with equal weight per day.
  Its interval is a bootstrap over days.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np

from companion.analysis.calibration.airframe_fit import fit_airframe_to_flights
from companion.analysis.calibration.drag import DragPriors
from companion.analysis.replay.replayed_wind import FilteredWind
from companion.app.api import read_airframe
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.plugin import WIND_ESTIMATORS, load_plugin
from companion.core.vehicle.airframe import Airframe
from sim_bridge.research.real_flights.anemometer import airspeed_std_mps
from sim_bridge.research.study.run import Experiment, ExperimentRun, Report
from sim_bridge.research.study.sheet import Column, Sheet, format_optional, low_to_high
from sim_bridge.research.windbench.estimators import estimators_by_name
from sim_bridge.research.windbench.flights import (
    BenchFlight,
    BenchFolder,
    Window,
    read_bench_folder,
    starts_in_the_air,
)

CALIBRATED_FLIGHTS = 12
"""Maximum flights, spread evenly over the other days: drag to 3 %, in two seconds."""

MIN_DAYS = 4
BOOTSTRAP_DRAWS, SEED = 2000, 1


@dataclass(frozen=True, slots=True)
class BenchDay:
    """Work item: evaluate all estimators, `own` included, on one day of a folder.

    `symmetric`: the airframe has equal front and side drag areas. `starts_s`: the filters start
    anew in the air at this interval, instead of on the ground.
    """

    folder: Path
    day: str
    airframe: str
    own: tuple[str, ...]
    symmetric: bool = False
    starts_s: float | None = None


class WindowScore(msgspec.Struct, frozen=True):
    """One window by one estimator; `std_mps` and `vector_mps` (wind vector error) are `None` if
    unknown."""

    folder: str
    day: str
    flight: str
    read_mps: float
    estimated_mps: float = msgspec.field(name="believed_mps")
    std_mps: float | None
    vector_mps: float | None


WindowScores = dict[str, list[WindowScore]]
"""Evaluated windows by estimator."""


class EstimatorScore(msgspec.Struct, frozen=True):
    """Score of an estimator. `low_mps`, `high_mps`: 95 % by days; `nees` in one dimension, 1 is
    ideal; `vector_mps` RMS if a vector reference exists; `worst_mps` of one flight or start, of the
    vector if it exists."""

    estimator: str
    score_mps: float
    low_mps: float
    high_mps: float
    nees: float | None
    vector_mps: float | None
    worst_mps: float
    folders: dict[str, float]


def score_estimators_on_flights(
    airframe_by_folder: Sequence[tuple[Path, str]],
    own: tuple[str, ...],
    run: ExperimentRun,
    *,
    symmetric: bool,
    starts_s: float | None = None,
) -> Report:
    """Score the estimators, `own` included, on all folders; return tables and JSON."""
    scores = compute_scores(airframe_by_folder, own, run, symmetric=symmetric, starts_s=starts_s)
    rows, standings = scores.rows, scores.standings
    board = leader_board(standings, len(next(iter(rows.values()))), scores.day_count)
    document: dict[str, object] = {
        "format": "windbench/1", "standings": standings, "windows": rows,
    }  # fmt: skip
    if own:
        document["plugins"] = {name: load_plugin(WIND_ESTIMATORS, name).version for name in own}
    return Report({"windbench": board}, document)


@dataclass(frozen=True, slots=True)
class Scores:
    """Evaluated windows by estimator, and the estimators' scores."""

    rows: WindowScores
    standings: list[EstimatorScore]
    day_count: int


def compute_scores(
    airframe_by_folder: Sequence[tuple[Path, str]],
    own: tuple[str, ...],
    run: ExperimentRun,
    *,
    symmetric: bool,
    starts_s: float | None = None,
) -> Scores:
    """Score the estimators, `own` included, on all folders."""
    names = list(estimators_by_name(own))
    if len({path.name for path, _ in airframe_by_folder}) < len(airframe_by_folder):
        raise LeewayError("DIR: two folders of one name; expected names of their own")
    work: list[BenchDay] = []
    for path, airframe in airframe_by_folder:
        folder = read_bench_folder(path, airframe)
        for words in folder.rejected:
            run.print_message(f"{folder.name}: {words}")
        work += [
            BenchDay(path.resolve(), day, airframe, own, symmetric, starts_s) for day in folder.days
        ]
    days = run.run_cases_and_return_results(
        Experiment("days", work, score_estimators_on_day, WindowScores)
    )
    rows = {name: [row for day in days for row in day.get(name, [])] for name in names}
    if not all(rows.values()):
        raise LeewayError(
            f"--starts {starts_s:g}: no flight is long enough; expected fewer seconds"
        )
    standings = [score_estimator(name, rows[name]) for name in names]
    return Scores(rows, standings, len(days))


_read = lru_cache(maxsize=4)(read_bench_folder)


def score_estimators_on_day(day_work: BenchDay) -> WindowScores:
    """Evaluate one day, which is excluded from all fits."""
    folder = _read(day_work.folder, day_work.airframe)
    priors = DragPriors.for_symmetric_airframe() if day_work.symmetric else None
    airframe = _calibrate_on_other_days(
        folder, day_work.day, read_airframe(day_work.airframe), priors
    )
    # Attitude is levelled by the mean trims, for filters without trim parameters.
    changed, drag = msgspec.structs.replace, airframe.drag
    trims = math.radians(drag.trim_forward_deg), math.radians(drag.trim_right_deg)
    plain = changed(airframe, drag=changed(drag, trim_forward_deg=0.0, trim_right_deg=0.0))
    found: WindowScores = {}
    for flight in (f for f in folder.flights if f.day == day_work.day):
        levelled = tuple(s.with_attitude_corrected_by_trims(*trims) for s in flight.observations)
        level = replace(flight, observations=levelled)
        starts = (
            [level] if (every := day_work.starts_s) is None else starts_in_the_air(level, every)
        )
        for start in starts:
            for name, estimate in estimators_by_name(day_work.own).items():
                wind = estimate(start, plain)
                rows = [_evaluate_window(folder.name, start, w, wind) for w in start.windows]
                found.setdefault(name, []).extend(rows)
    return found


def _calibrate_on_other_days(
    folder: BenchFolder, excluded_day: str, start: Airframe, priors: DragPriors | None
) -> Airframe:
    """Fit the start airframe to the folder's other days; unchanged if these are too few."""
    others = [(f.day, f.blocks) for f in folder.flights if f.day != excluded_day and f.blocks]
    if len({day for day, _ in others}) < MIN_DAYS - 1:
        return start
    selected = sorted({round(i) for i in np.linspace(0, len(others) - 1, CALIBRATED_FLIGHTS)})
    blocks = [others[i][1] for i in selected]
    return fit_airframe_to_flights(
        blocks, start, measure_holdout_error=False, priors=priors
    ).airframe


def _evaluate_window(
    folder: str, flight: BenchFlight, window: Window, wind: FilteredWind
) -> WindowScore:
    air = flight.velocity_ne_mps[window.rows] - wind.mean_ne_mps[window.rows]
    std, vector = None, None
    if wind.cov_ne_m2ps2 is not None:
        std = airspeed_std_mps(air, wind.cov_ne_m2ps2[window.rows])
    if window.wind_to_ne_mps is not None:
        error = wind.mean_ne_mps[window.rows].mean(axis=0) - window.wind_to_ne_mps
        vector = float(np.hypot(*error))
    speed = float(np.nanmean(np.hypot(air[:, 0], air[:, 1])))
    return WindowScore(folder, flight.day, flight.name, window.read_mps, speed, std, vector)


def score_estimator(name: str, rows: Sequence[WindowScore]) -> EstimatorScore:
    """Score all windows of one estimator."""
    keys = sorted({(r.folder, r.day) for r in rows})
    errors, normalised = zip(
        *(_day_errors_and_standardised_errors(rows, *key) for key in keys), strict=True
    )
    errors_of_flight: dict[tuple[str, str], list[float]] = {}
    for key, of_day in zip(keys, errors, strict=True):
        own = [r for r in rows if (r.folder, r.day) == key]
        for row, error in zip(own, of_day.tolist(), strict=True):
            shown = error if row.vector_mps is None else row.vector_mps
            errors_of_flight.setdefault((row.folder, row.flight), []).append(shown)
    squares = np.array([float(np.mean(each**2)) for each in errors])
    rng = np.random.default_rng(SEED)
    drawn = np.sqrt(squares[rng.integers(0, len(keys), (BOOTSTRAP_DRAWS, len(keys)))].mean(axis=1))
    standardised = np.concatenate(normalised)
    vectors = [r.vector_mps for r in rows if r.vector_mps is not None]
    of_folder = {f: [s for s, k in zip(squares, keys, strict=True) if k[0] == f] for f, _ in keys}
    return EstimatorScore(
        name,
        math.sqrt(float(squares.mean())),
        float(np.percentile(drawn, 2.5)),
        float(np.percentile(drawn, 97.5)),
        float(np.mean(standardised**2)) if len(standardised) else None,
        math.sqrt(float(np.mean(np.square(vectors)))) if vectors else None,
        max(math.sqrt(float(np.mean(np.square(e)))) for e in errors_of_flight.values()),
        {folder: math.sqrt(float(np.mean(own))) for folder, own in of_folder.items()},
    )


def _day_errors_and_standardised_errors(
    rows: Sequence[WindowScore], folder: str, day: str
) -> tuple[Floats, Floats]:
    """Return the errors of one day, and those with a stated std divided by it."""
    own = [r for r in rows if (r.folder, r.day) == (folder, day)]
    scale, bias = _fit_anemometer_on_other_days([r for r in rows if r.folder == folder], day)
    errors = np.array([scale * r.estimated_mps + bias - r.read_mps for r in own])
    standardised = [
        error / (scale * r.std_mps)
        for error, r in zip(errors, own, strict=True)
        if r.std_mps is not None
    ]
    return errors, np.array(standardised)


def _fit_anemometer_on_other_days(
    rows: Sequence[WindowScore], excluded_day: str
) -> tuple[float, float]:
    """Fit the anemometer's scale and bias on the other days; (1, 0) if these are too few."""
    others = [r for r in rows if r.day != excluded_day]
    if len({r.day for r in others}) < MIN_DAYS - 1 or rows[0].vector_mps is not None:
        return 1.0, 0.0
    scale, bias = np.polyfit([r.estimated_mps for r in others], [r.read_mps for r in others], 1)
    return float(scale), float(bias)


def leader_board(standings: list[EstimatorScore], window_count: int, day_count: int) -> Sheet:
    """Return the ranking, best first, with a column per folder."""
    folders = sorted({name for one in standings for name in one.folders})
    ranked = sorted(standings, key=lambda one: one.score_mps)
    columns: dict[str, Column] = {
        "rank": lambda one: str(1 + ranked.index(one)),
        "estimator": "{0.estimator}",
        "score, m/s": "{0.score_mps:.2f}",
        "95 % by days": lambda one: low_to_high((one.low_mps, one.high_mps), ".2f"),
        "NEES (1-D, ideal 1)": lambda one: format_optional(one.nees, ".1f"),
        **{
            f"{name}, m/s": lambda one, name=name: format_optional(one.folders.get(name), ".2f")
            for name in folders
        },
        "wind's vector, m/s": lambda one: format_optional(one.vector_mps, ".2f"),
        "worst flight or start, m/s": "{0.worst_mps:.2f}",
    }
    note = (
        f"{window_count} windows of 10 s on {day_count} days. RMS error of the airspeed over a"
        " window, equal weight per day. The wind vector is evaluated if a reference provides it."
    )
    return Sheet.from_objects("Wind estimators on real flights", ranked, columns, note)
