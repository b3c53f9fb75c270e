"""One fold: all models fitted on the flights of some days, and evaluated on other days."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.adapters.files.params import read_airframe
from companion.analysis.calibration.airframe_fit import fit_airframe_to_flights
from companion.analysis.calibration.drag import DragPriors, estimate_wind
from companion.analysis.measured_energy.energy_scatter import charge_number_by_flight
from companion.analysis.measured_energy.flight_measurements import replay_wind_estimator
from companion.analysis.measured_energy.flown_track import STEP_S, detect_leg_sequence
from companion.analysis.measured_energy.forecast import (
    EnergyForecast,
    TrainingFlight,
    fit_energy_forecast,
)
from companion.analysis.measured_energy.remaining_energy import takeoff_corner_and_midpoint
from companion.analysis.measured_energy.route_times import FlownRoute, build_flown_route
from companion.analysis.measured_energy.track_power import wind_on_track_grid
from companion.analysis.replay.replayed_wind import FilteredWind
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe
from sim_bridge.research.real_flights.anemometer import (
    AirspeedMean,
    AnemometerScale,
    complete_window_slices,
    fit_anemometer_scale,
    mean_airspeed_over_span,
    slices_without_leg_ends,
)
from sim_bridge.research.real_flights.folder import FlightFolder, ReadFlight, read_usable_flights

CALIBRATED_FLIGHTS = 36
"""Maximum fitting flights for drag and power, spread evenly over days and hours. With all 119
flights, drag at 10 m/s changes by less than its standard deviation, at seven times the run time."""
SCALED_FLIGHTS = 24
"""Maximum fitting flights for the anemometer's scale. With only nine, the scale varies between
0.90 and 0.99 over the folds, which is 1 m/s at 16 m/s of airspeed."""
_PAYLOAD_LOG_RATIO = 0.10
"""Log energy ratio above which a flight may have another payload: four times the scatter of
flights."""

MIN_DAYS = 4
"""Three to fit (scatter between days) and one to evaluate."""


@dataclass(frozen=True, slots=True)
class Fold:
    """Folders, and the day excluded from the fitting folder ("": none)."""

    judged: Path
    fitted: Path
    day: str
    airframe: str


@dataclass(frozen=True, slots=True)
class EvaluatedEnergy:
    """Measured and predicted energy at one point of a flight, Wh; `at` "flown": whole flight."""

    at: str
    measured_wh: float
    predicted_wh: float
    upper_wh: float


@dataclass(frozen=True, slots=True)
class EvaluatedWind:
    """Airspeed means of one flight: one estimator against the anemometer."""

    leg_averages: tuple[AirspeedMean, ...]
    windows: tuple[AirspeedMean, ...]


@dataclass(frozen=True, slots=True)
class EvaluatedFlight:
    """Evaluation of one flight; `winds` by the estimator's inputs."""

    name: str
    date: str
    energies: tuple[EvaluatedEnergy, ...]
    winds: dict[str, EvaluatedWind]
    words: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Fitted:
    airframe: Airframe
    scale: AnemometerScale
    forecast: EnergyForecast


def split_into_day_folds(
    evaluated_flights: FlightFolder, folder: Path, fit_folder: Path | None, airframe: str
) -> list[Fold]:
    """Return one fold per day with routes; with `fit_folder`, one without excluded day."""
    if fit_folder is not None:
        return [Fold(folder, fit_folder, "", airframe)]
    days = sorted({f.ordered.date for f in evaluated_flights.flights if f.ordered.has_route})
    if len(days) < MIN_DAYS:
        raise LeewayError(
            f"{folder}: routes on {len(days)} days, {MIN_DAYS} expected to predict each day from"
            " the others; or give a folder of fitting flights with --fit"
        )
    return [Fold(folder, folder, day, airframe) for day in days]


def fit_and_evaluate_fold(fold: Fold) -> list[EvaluatedFlight]:
    """Fit and evaluate one fold. Raises LeewayError if too few flights are left."""
    fitting = read_usable_flights(fold.fitted, fold.airframe)
    judged = read_usable_flights(fold.judged, fold.airframe)
    fitting_flights = [f for f in _flights_with_route(fitting) if f.ordered.date != fold.day]
    test = [f for f in _flights_with_route(judged) if fold.day in ("", f.ordered.date)]
    fitted = _fit_airframe_scale_and_forecast(fitting_flights, read_airframe(fold.airframe))
    return [_evaluate_flight(flight, fitted) for flight in test]


def _flights_with_route(folder: FlightFolder) -> list[ReadFlight]:
    return [f for f in folder.flights if f.ordered.has_route]


def _fit_airframe_scale_and_forecast(
    fitting_flights: Sequence[ReadFlight], start: Airframe
) -> _Fitted:
    if not fitting_flights:
        raise LeewayError("no flight for fitting: at least three days with routes expected")
    selected = _evenly_spread_indices(len(fitting_flights), CALIBRATED_FLIGHTS)
    done = fit_airframe_to_flights(
        [fitting_flights[i].measured.prepared.blocks for i in selected],
        start,
        measure_holdout_error=False,
        priors=DragPriors.for_symmetric_airframe(),
    )
    airframe, seen = done.airframe, dict(zip(selected, done.drag.winds, strict=True))
    charge_indices = charge_number_by_flight(
        [f.ordered.date for f in fitting_flights],
        [f.measured.resting_voltage_v for f in fitting_flights],
    )
    known: list[TrainingFlight] = []
    for i, (flight, charge_index) in enumerate(zip(fitting_flights, charge_indices, strict=True)):
        wind = seen[i] if i in seen else estimate_wind(flight.measured.prepared.blocks, airframe)
        track, blocks = flight.measured.track, flight.measured.prepared.blocks
        along = wind_on_track_grid(track, blocks, wind)
        route, _ = planned_route_or_reason(flight)
        density, day = blocks.density_kgpm3, flight.ordered.date
        known.append(TrainingFlight(track, route, along, density, day, charge_index))
    scaled = [
        fitting_flights[selected[at]]
        for at in _evenly_spread_indices(len(selected), SCALED_FLIGHTS)
    ]
    legs = [
        leg
        for f in scaled
        for leg in _evaluate_wind(f, replay_wind_estimator(f.measured, airframe), None).leg_averages
    ]
    return _Fitted(airframe, fit_anemometer_scale(legs), fit_energy_forecast(airframe, known))


def _evenly_spread_indices(count: int, max_count: int) -> list[int]:
    """Return at most `max_count` of `count` indices, spread evenly."""
    return sorted({round(i) for i in np.linspace(0, count - 1, max_count)})


def planned_route_or_reason(flight: ReadFlight) -> tuple[FlownRoute | None, str]:
    """Return the ordered route, from the table's height and speed and the corners with stops.

    Returns `None` and the reason if it cannot be determined: changing heights, no legs.
    """
    ordered = flight.ordered
    if len(ordered.heights_m) != 1:
        return None, "climbs en route: remaining energy is not evaluated"
    try:
        return build_flown_route(flight.measured.track, ordered.heights_m[0], ordered.speed_mps), ""
    except LeewayError as error:
        return None, f"{error}: remaining energy is not evaluated"


def _evaluate_flight(flight: ReadFlight, fitted: _Fitted) -> EvaluatedFlight:
    airframe = fitted.airframe
    unaided = replay_wind_estimator(flight.measured, airframe)
    aided = replay_wind_estimator(flight.measured, airframe, with_airspeed=True)
    energies, words = _evaluate_energies(flight, fitted.forecast, unaided.mean_ne_mps)
    return EvaluatedFlight(
        flight.ordered.name,
        flight.ordered.date,
        tuple(energies),
        {
            "tilt": _evaluate_wind(flight, unaided, fitted.scale),
            "tilt_unscaled": _evaluate_wind(flight, unaided, None),
            "anemometer": _evaluate_wind(flight, aided, fitted.scale),
        },
        tuple(words),
    )


def _evaluate_energies(
    flight: ReadFlight, forecast: EnergyForecast, wind_ne_mps: Floats
) -> tuple[list[EvaluatedEnergy], list[str]]:
    track, density = flight.measured.track, flight.measured.density_kgpm3
    if track.ends_in_flight:
        return [], ["log ends in flight: energy is not evaluated"]
    prediction = forecast.predict_track_energy(track, wind_ne_mps, density)
    rows = [EvaluatedEnergy("flown", track.energy_wh, prediction.predicted_wh, prediction.upper_wh)]
    words = _payload_findings(flight, track.energy_wh / prediction.predicted_wh, forecast.airframe)
    route, reason = planned_route_or_reason(flight)
    if route is None:
        return rows, [*words, reason]
    for point in takeoff_corner_and_midpoint(track, route):
        left = forecast.predict_remaining_energy(track, route, point, wind_ne_mps, density)
        if left is not None:
            measured = track.energy_from_index_to_end_wh(point.index)
            rows.append(EvaluatedEnergy(point.name, measured, left.predicted_wh, left.upper_wh))
    return rows, words


def _payload_findings(
    flight: ReadFlight, measured_to_predicted_ratio: float, airframe: Airframe
) -> list[str]:
    """Report an energy ratio that another payload explains: hover power scales with mass^(3/2)."""
    if abs(math.log(measured_to_predicted_ratio)) < _PAYLOAD_LOG_RATIO:
        return []
    table_kg = flight.ordered.payload_kg
    matching_kg = (
        airframe.flying_mass_kg(table_kg) * measured_to_predicted_ratio ** (2.0 / 3.0)
        - airframe.mass.empty_kg
    )
    return [
        f"draws {100.0 * (measured_to_predicted_ratio - 1.0):+.0f} % relative to the prediction"
        " for the table's"
        f" {table_kg:g} kg; a payload of {max(matching_kg, 0.0):.2f} kg matches: wrong payload?"
    ]


def _evaluate_wind(
    flight: ReadFlight, wind: FilteredWind, scale: AnemometerScale | None
) -> EvaluatedWind:
    def airspeed_averages(spans: Sequence[slice]) -> tuple[AirspeedMean, ...]:
        known = (mean_airspeed_over_span(flight, wind, span) for span in spans)
        return tuple(
            m if scale is None else m.as_anemometer_reading(scale) for m in known if m is not None
        )

    track = flight.measured.track
    leg_list = detect_leg_sequence(track, flight.ordered.speed_mps)
    spans = slices_without_leg_ends(track, [(leg.first, leg.last) for leg in leg_list], STEP_S)
    windows = [part for span in spans for part in complete_window_slices(span, STEP_S)]
    return EvaluatedWind(airspeed_averages(spans), airspeed_averages(windows))
