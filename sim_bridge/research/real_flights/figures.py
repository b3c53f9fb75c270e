"""The figures of all judged flights: errors, coverage, margins, by point, by day and pooled."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from sim_bridge.research.real_flights.comparison import Comparison, compared
from sim_bridge.research.real_flights.fold import FoldResult, JudgedEnergy, JudgedFlight
from sim_bridge.research.real_flights.leg_errors import LegErrors, leg_errors
from sim_bridge.research.real_flights.wind_replay import AirspeedMean
from sim_bridge.research.real_flights.wind_rivals import WIND_RIVALS

MANY_FLIGHTS = 10
"""A day with fewer says nothing of its own coverage."""

SENSORS = {
    "tilt": "velocity and levelled attitude",
    "tilt_as_reported": "velocity and attitude as reported",
    "tilt_unscaled": "velocity and levelled attitude, anemometer taken as it reads",
    "anemometer": "with the anemometer as an airspeed",
    "anemometer_unscaled": "with the anemometer as an airspeed, taken as it reads",
}


class ToGo(msgspec.Struct, frozen=True):
    """Energy still to come at one point; `mape` in per cent, `margin95` of the bound over it."""

    at: str
    flights: int
    mape: float
    coverage95: float
    worst_day_coverage: float | None
    margin95: float


class EnergyFigures(msgspec.Struct, frozen=True):
    """Of the flown track, and to go."""

    flights: int
    mape: float
    coverage95: float
    worst_day_coverage: float | None
    margin95: float
    to_go: list[ToGo]


class WindFigures(msgspec.Struct, frozen=True):
    """Airspeed by the estimator against the anemometer; `nees` in one dimension, ideal 1."""

    legs: int
    rmse_leg_mps: float
    rmse_10s_mps: float
    nees: float
    rmse_ground_speed_as_airspeed_mps: float


class DayFigures(msgspec.Struct, frozen=True):
    """One day; `error_mean` says how much more was drawn than predicted, in per cent."""

    date: str
    flights: int
    mape: float
    coverage95: float
    error_mean: float
    rmse_leg_mps: float
    nees: float


class RealFlights(msgspec.Struct, frozen=True):
    """Everything that the benchmark says; see docs/reference/benchmarks.md."""

    energy: EnergyFigures
    wind: WindFigures
    days: list[DayFigures]
    winds: dict[str, WindFigures]
    rivals: dict[str, float]
    energy_rivals: list[Comparison]
    wind_rivals: list[Comparison]
    leg_errors: list[LegErrors]
    fitted: list[dict[str, Any]]
    flights: list[dict[str, Any]]
    words: list[str]


def figures(folds: Sequence[FoldResult], words: Sequence[str]) -> RealFlights:
    """All figures of all folds."""
    flights = [flight for fold in folds for flight in fold.flights]
    winds = {name: wind_figures(flights, name) for name in (*SENSORS, *WIND_RIVALS)}
    said = [f"flight {f.name}: {one}" for f in flights for one in f.words]
    return RealFlights(
        energy=energy_figures(flights),
        wind=winds["tilt"],
        days=[_day(date, flights) for date in sorted({f.date for f in flights})],
        winds=winds,
        rivals=rival_errors(flights),
        energy_rivals=energy_comparisons(flights),
        wind_rivals=wind_comparisons(flights),
        leg_errors=leg_errors(flights),
        fitted=[_fitted(fold) for fold in folds],
        flights=[_row(flight) for flight in flights],
        words=[*words, *said],
    )


def energy_figures(flights: Sequence[JudgedFlight]) -> EnergyFigures:
    """Pooled over all flights, and the worst day."""
    points = sorted({e.at for f in flights for e in f.energies} - {"flown"}, key=_order)
    flown = _to_go("flown", flights)
    return EnergyFigures(
        flown.flights,
        flown.mape,
        flown.coverage95,
        flown.worst_day_coverage,
        flown.margin95,
        [_to_go(at, flights) for at in points],
    )


def _order(at: str) -> tuple[int, str]:
    return (["takeoff", "corner_1", "half"].index(at) if at in ("takeoff", "half") else 1, at)


def _to_go(at: str, flights: Sequence[JudgedFlight]) -> ToGo:
    rows = _energies(at, flights)
    by_day = [
        _coverage(day)
        for date in sorted({f.date for f in flights})
        if len(day := _energies(at, [f for f in flights if f.date == date])) >= MANY_FLIGHTS
    ]
    margin = _mean(e.upper_wh / e.predicted_wh - 1.0 for e in rows)
    worst = min(by_day) if by_day else None
    return ToGo(at, len(rows), _mape(rows), _coverage(rows), worst, 100.0 * margin)


def _energies(at: str, flights: Iterable[JudgedFlight]) -> list[JudgedEnergy]:
    return [e for f in flights for e in f.energies if e.at == at]


def _mape(rows: Sequence[JudgedEnergy]) -> float:
    return 100.0 * _mean(abs(e.predicted_wh / e.measured_wh - 1.0) for e in rows)


def _coverage(rows: Sequence[JudgedEnergy]) -> float:
    return _mean(float(e.measured_wh <= e.upper_wh) for e in rows)


def _mean(values: Iterable[float]) -> float:
    found = list(values)
    return float(np.mean(found)) if found else math.nan


def wind_figures(flights: Iterable[JudgedFlight], sensors: str) -> WindFigures:
    """Root mean squares over all legs and all 10 s windows; NEES over the windows."""
    judged = [f.winds[sensors] for f in flights]
    legs = [m for wind in judged for m in wind.legs]
    parts = [m for wind in judged for m in wind.windows]
    return WindFigures(
        len(legs),
        _rms(_errors(legs)),
        _rms(_errors(parts)),
        _mean((m.believed_mps - m.read_mps) ** 2 / m.std_mps**2 for m in parts),
        _rms(np.array([m.ground_mps - m.read_mps for m in legs])),
    )


def _errors(means: Iterable[AirspeedMean]) -> Floats:
    return np.array([m.believed_mps - m.read_mps for m in means])


def _rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else math.nan


def rival_errors(flights: Sequence[JudgedFlight]) -> dict[str, float]:
    """MAPE of the flown energy by each plainer model, in per cent."""
    sums: dict[str, list[float]] = {}
    for flight in flights:
        measured = [e.measured_wh for e in flight.energies if e.at == "flown"]
        for name, predicted in flight.rivals_wh.items() if measured else ():
            sums.setdefault(name, []).append(abs(predicted / measured[0] - 1.0))
    return {name: 100.0 * _mean(errors) for name, errors in sums.items()}


def energy_comparisons(flights: Sequence[JudgedFlight]) -> list[Comparison]:
    """Ours against each plainer model: MAPE of the flown energy, per cent."""
    names = dict.fromkeys(name for f in flights for name in f.rivals_wh)
    rows = [
        (f, e.measured_wh, 100.0 * abs(e.predicted_wh / e.measured_wh - 1.0))
        for f in flights
        for e in f.energies
        if e.at == "flown"
    ]
    found = [
        compared(
            name,
            (
                (f.date, ours, 100.0 * abs(f.rivals_wh[name] / measured - 1.0))
                for f, measured, ours in rows
            ),
        )
        for name in names
    ]
    return [one for one in found if one is not None]


def wind_comparisons(flights: Sequence[JudgedFlight]) -> list[Comparison]:
    """Ours from tilt against each rival: RMS of the airspeed on legs, m/s."""
    found = [compared(name, _leg_squares(flights, name), np.sqrt) for name in WIND_RIVALS]
    return [one for one in found if one is not None]


def _leg_squares(flights: Iterable[JudgedFlight], rival: str) -> Iterator[tuple[str, float, float]]:
    for flight in flights:
        legs = zip(flight.winds["tilt"].legs, flight.winds[rival].legs, strict=True)
        for ours, theirs in legs:
            squares = [(m.believed_mps - m.read_mps) ** 2 for m in (ours, theirs)]
            yield flight.date, squares[0], squares[1]


def _day(date: str, flights: Sequence[JudgedFlight]) -> DayFigures:
    own = [f for f in flights if f.date == date]
    rows, wind = _energies("flown", own), wind_figures(own, "tilt")
    drawn = 100.0 * _mean(e.measured_wh / e.predicted_wh - 1.0 for e in rows)
    return DayFigures(
        date, len(rows), _mape(rows), _coverage(rows), drawn, wind.rmse_leg_mps, wind.nees
    )


def _fitted(fold: FoldResult) -> dict[str, Any]:
    """What was fitted for one fold: the scatter by day is here, for whoever states a bound."""
    return {
        "without": fold.day,
        "anemometer": msgspec.to_builtins(fold.scale),
        "trim_forward_deg": fold.trim_deg[0],
        "trim_right_deg": fold.trim_deg[1],
        "trim_std_deg": fold.drag_stds[0],
        "drag_model_std_frac": fold.drag_stds[1],
        "drag_gain_std_frac": fold.drag_stds[2],
        "power_flown": dict(
            zip(("climb_frac", "level_frac", "descent_frac"), fold.power_flown, strict=True)
        ),
        "slope_so_far": fold.slopes,
        "scatter": {at: msgspec.to_builtins(one) for at, one in fold.scatter.items()},
        "identified": list(fold.identified),
        "not_identified": list(fold.not_identified),
    }


def _row(flight: JudgedFlight) -> dict[str, Any]:
    return {
        "flight": flight.name,
        "date": flight.date,
        "energies": [msgspec.to_builtins(e) for e in flight.energies],
        "legs": [msgspec.to_builtins(m) for m in flight.winds["tilt"].legs],
    }
