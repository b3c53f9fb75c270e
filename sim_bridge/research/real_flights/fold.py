"""One fold: everything fitted on some days' flights, and judged on the flights of others."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from companion.adapters.files.params import read_airframe
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.calibration.airframe_fit import Calibration, calibrate
from companion.core.calibration.drag import DragPriors, WindSeen, see_wind
from companion.core.measured_energy.energy_scatter import EnergyScatter, charges_of
from companion.core.measured_energy.flown_track import STEP_S, flown_legs
from companion.core.measured_energy.forecast import EnergyForecast, KnownFlight, fit_forecast
from companion.core.measured_energy.route_times import FlownRoute, flown_route
from companion.core.measured_energy.to_go import route_points
from companion.core.vehicle.airframe import Airframe
from sim_bridge.research.real_flights.folder import FlightFolder, ReadFlight, read_folder
from sim_bridge.research.real_flights.rivals import Rivals, fit_rivals
from sim_bridge.research.real_flights.wind_replay import (
    AirspeedMean,
    AnemometerScale,
    WindReplay,
    airspeed_mean,
    fit_scale,
    replay_wind,
    stretches,
    windows,
)
from sim_bridge.research.real_flights.wind_rivals import WIND_RIVALS, rival_winds

CALIBRATED_FLIGHTS = 36
"""Drag and power are calibrated on so many of the fitting flights, spread evenly over days and
hours: with all of 119 drag at 10 m/s moves by less than its standard deviation, in seven times the
time."""
SCORED_FLIGHTS = 9
"""So many of the fitting flights tell the anemometer's scale as the rivals find it."""
SCALED_FLIGHTS = 24
"""The anemometer's scale is learned on so many of the fitting flights. With nine alone it
moved between 0.90 and 0.99 from fold to fold, which is 1 m/s at 16 m/s of airspeed."""
_ODD_LOG = 0.10
"""A flight that draws so much more or less than predicted may have another payload: four times the
scatter of flights."""


@dataclass(frozen=True, slots=True)
class Fold:
    """Which folders, and which days of the fitting one are left out ("": none)."""

    judged: Path
    fitted: Path
    day: str
    airframe: str
    climate: bool


@dataclass(frozen=True, slots=True)
class JudgedEnergy:
    """Measured and stated energy at one point of one flight, Wh; `at` "flown" is all of it."""

    at: str
    measured_wh: float
    predicted_wh: float
    upper_wh: float


@dataclass(frozen=True, slots=True)
class JudgedWind:
    """Means of one flight with one estimator, against one reading of the anemometer."""

    legs: tuple[AirspeedMean, ...]
    windows: tuple[AirspeedMean, ...]


@dataclass(frozen=True, slots=True)
class JudgedFlight:
    """Everything about one flight; `winds` by what ours hears and by rival, rivals in Wh."""

    name: str
    date: str
    energies: tuple[JudgedEnergy, ...]
    rivals_wh: dict[str, float]
    winds: dict[str, JudgedWind]
    words: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FoldResult:
    """One fold's flights, and what was fitted for it."""

    day: str
    flights: tuple[JudgedFlight, ...]
    scale: AnemometerScale
    trim_deg: tuple[float, float]
    drag_stds: tuple[float, float, float]
    scatter: dict[str, EnergyScatter]
    slopes: dict[str, float]
    power_flown: tuple[float, float, float]
    identified: tuple[str, ...]
    not_identified: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Fitted:
    calibration: Calibration
    scale: AnemometerScale
    rival_scales: dict[str, AnemometerScale]
    forecast: EnergyForecast
    rivals: Rivals


def run_fold(fold: Fold) -> FoldResult:
    """Fit and judge; LeewayError where too few flights are left."""
    fitting = read_folder(fold.fitted, fold.airframe, fold.climate)
    judged = read_folder(fold.judged, fold.airframe, fold.climate)
    train = [f for f in _routes(fitting) if f.ordered.date != fold.day]
    test = [f for f in _routes(judged) if fold.day in ("", f.ordered.date)]
    fitted = _fit(train, read_airframe(fold.airframe))
    done = tuple(_judge(flight, fitted) for flight in test)
    quantities, flying = fitted.calibration.quantities, fitted.calibration.airframe
    forecast = fitted.forecast
    flown = forecast.airframe.power_flown
    assert flown is not None
    return FoldResult(
        fold.day,
        done,
        fitted.scale,
        (flying.drag.trim_forward_deg, flying.drag.trim_right_deg),
        drag_stds(flying),
        {"flown": forecast.flown, **{n: p.scatter for n, p in forecast.points.items()}},
        {n: p.slope for n, p in forecast.points.items()},
        (flown.climb_frac, flown.level_frac, flown.descent_frac),
        tuple(q.name for q in quantities if q.identified),
        tuple(f"{q.name}: {q.flight}" for q in quantities if not q.identified),
    )


def _routes(folder: FlightFolder) -> list[ReadFlight]:
    return [f for f in folder.flights if f.ordered.has_route]


def _fit(train: Sequence[ReadFlight], start: Airframe) -> _Fitted:
    if not train:
        raise LeewayError("no flight to fit to: at least three days with routes expected")
    chosen = _spread(len(train), CALIBRATED_FLIGHTS)
    done = calibrate(
        [train[i].blocks for i in chosen], start, leave_out=False, priors=DragPriors.symmetric()
    )
    seen = dict(zip(chosen, done.drag.winds, strict=True))
    winds = [
        seen[i] if i in seen else see_wind(f.blocks, done.airframe) for i, f in enumerate(train)
    ]
    charges = charges_of([f.ordered.date for f in train], [f.start_v for f in train])
    known = [_known(*row) for row in zip(train, winds, charges, strict=True)]
    scored = chosen[:: max(len(chosen) // SCORED_FLIGHTS, 1)]
    flying = done.airframe
    scaled = [chosen[at] for at in _spread(len(chosen), SCALED_FLIGHTS)]
    scale = _scale_of([(train[i], replay_wind(train[i], flying)) for i in scaled])
    rivals = [(train[i], rival_winds(train[i], flying)) for i in scored]
    rival_scales = {n: _scale_of([(f, winds[n]) for f, winds in rivals]) for n in WIND_RIVALS}
    forecast = fit_forecast(done.airframe, known)
    return _Fitted(done, scale, rival_scales, forecast, fit_rivals(train))


def _spread(count: int, most: int) -> list[int]:
    """At most so many of `count` indices, spread evenly."""
    return sorted({round(i) for i in np.linspace(0, count - 1, most)})


def _scale_of(replays: Sequence[tuple[ReadFlight, WindReplay]]) -> AnemometerScale:
    """The anemometer as the estimator of these replays finds it."""
    return fit_scale([leg for f, wind in replays for leg in _wind(f, wind, None).legs])


def as_reported(airframe: Airframe) -> Airframe:
    """The airframe without its mean trims: the attitude is taken as the autopilot reports it."""
    changed = msgspec.structs.replace
    return changed(airframe, drag=changed(airframe.drag, trim_forward_deg=0.0, trim_right_deg=0.0))


def drag_stds(airframe: Airframe) -> tuple[float, float, float]:
    """What the estimator expects of trim (degrees), drag model and drag gain (fractions)."""
    drag = airframe.drag
    return drag.trim_std_deg, drag.model_std_frac, drag.gain_std_frac


def _known(flight: ReadFlight, wind: WindSeen, charge: int) -> KnownFlight:
    mean = np.array([wind.to_north_mps.mean(), wind.to_east_mps.mean()])
    route = planned_route(flight)[0]
    day = flight.ordered.date
    return KnownFlight(flight.track, route, mean, flight.density_kgpm3, day, charge)


def planned_route(flight: ReadFlight) -> tuple[FlownRoute | None, str]:
    """The route as ordered, from the table's height and speed and the corners where it stopped.

    `None`, and why, where that does not tell it: heights that change on the way, no legs.
    """
    ordered = flight.ordered
    if len(ordered.heights_m) != 1:
        return None, "climbs on its way: energy to go is not judged"
    try:
        return flown_route(flight.track, ordered.heights_m[0], ordered.speed_mps), ""
    except LeewayError as error:
        return None, f"{error}: energy to go is not judged"


def _judge(flight: ReadFlight, fitted: _Fitted) -> JudgedFlight:
    airframe = fitted.calibration.airframe
    alone = replay_wind(flight, airframe)
    aided = replay_wind(flight, airframe, with_airspeed=True)
    leaning = replay_wind(flight, as_reported(airframe))
    energies, words = _energies(flight, fitted.forecast, alone.mean_ne_mps)
    return JudgedFlight(
        flight.ordered.name,
        flight.ordered.date,
        tuple(energies),
        fitted.rivals.predicted_wh(flight),
        {
            "tilt": _wind(flight, alone, fitted.scale),
            "tilt_as_reported": _wind(flight, leaning, fitted.scale),
            "tilt_unscaled": _wind(flight, alone, None),
            "anemometer": _wind(flight, aided, fitted.scale),
            "anemometer_unscaled": _wind(flight, aided, None),
            **{
                name: _wind(flight, wind, fitted.rival_scales[name])
                for name, wind in rival_winds(flight, airframe).items()
            },
        },
        tuple(words),
    )


def _energies(
    flight: ReadFlight, forecast: EnergyForecast, wind_ne_mps: Floats
) -> tuple[list[JudgedEnergy], list[str]]:
    track, density = flight.track, flight.density_kgpm3
    if track.cut_short:
        return [], ["cut off in the air: energy is not judged"]
    stated = forecast.of_track(track, wind_ne_mps, density)
    rows = [JudgedEnergy("flown", track.energy_wh, stated.predicted_wh, stated.upper_wh)]
    words = _odd_payload(flight, track.energy_wh / stated.predicted_wh, forecast.airframe)
    route, why = planned_route(flight)
    if route is None:
        return rows, [*words, why]
    for point in route_points(track, route):
        left = forecast.to_go(track, route, point, wind_ne_mps, density)
        if left is not None:
            measured = track.energy_after_wh(point.index)
            rows.append(JudgedEnergy(point.name, measured, left.predicted_wh, left.upper_wh))
    return rows, words


def _odd_payload(flight: ReadFlight, ratio: float, airframe: Airframe) -> list[str]:
    """Say a draw that another payload would explain: hover power goes with mass to the 3/2."""
    if abs(math.log(ratio)) < _ODD_LOG:
        return []
    stated_kg = flight.ordered.payload_kg
    told_kg = airframe.mass_kg(stated_kg) * ratio ** (2.0 / 3.0) - airframe.mass.empty_kg
    return [
        f"draws {100.0 * (ratio - 1.0):+.0f} % against what is predicted with the table's"
        f" {stated_kg:g} kg; {max(told_kg, 0.0):.2f} kg would explain it: wrong payload?"
    ]


def _wind(flight: ReadFlight, wind: WindReplay, scale: AnemometerScale | None) -> JudgedWind:
    legs = flown_legs(flight.track, flight.ordered.speed_mps)
    spans = stretches(flight.track, [(leg.first, leg.last) for leg in legs], STEP_S)
    parts = [part for span in spans for part in windows(span, STEP_S)]
    return JudgedWind(
        _means(flight, wind, scale, spans),
        _means(flight, wind, scale, parts),
    )


def _means(
    flight: ReadFlight, wind: WindReplay, scale: AnemometerScale | None, spans: Sequence[slice]
) -> tuple[AirspeedMean, ...]:
    known = (airspeed_mean(flight, wind, span) for span in spans)
    return tuple(m if scale is None else m.as_read(scale) for m in known if m is not None)
