"""Forecast of a flight's total and remaining energy, each with a bound valid on a new day.

Fitted to flights on several days: power by phase, times of the route, and the scatter of measured
about predicted energy. The scatter comes from flights whose day is held out of power and times, so
it contains the effect of a new day. Past consumption predicts part of the remaining: a slope on the
logarithm of measured over predicted energy up to the point.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.analysis.measured_energy.energy_scatter import (
    EnergyScatter,
    fit_energy_ratio_scatter,
)
from companion.analysis.measured_energy.flown_track import STEP_S, FlownTrack
from companion.analysis.measured_energy.remaining_energy import (
    RoutePoint,
    predict_remaining_energy_wh,
    takeoff_corner_and_midpoint,
)
from companion.analysis.measured_energy.route_times import FlownRoute, RouteTimes, fit_route_times
from companion.analysis.measured_energy.track_power import (
    energy_by_phase,
    measured_to_modelled_power_by_phase,
    modelled_track_power_w,
    with_flown_power_ratios,
)
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import measured_over_modelled_power

BOUND_SHARE = 0.95
_MIN_FLIGHTS = 12
_MIN_DAYS = 3
_MIN_CONSUMED_WH = 0.5


@dataclass(frozen=True, slots=True)
class EnergyPrediction:
    """Predicted energy, and its bound for a BOUND_SHARE of flights on new days, Wh."""

    predicted_wh: float
    upper_wh: float


@dataclass(frozen=True, slots=True)
class TrainingFlight:
    """A flight for the fit. `route` is `None` if remaining energy cannot be evaluated; the wind is
    (n, 2) on the track's grid or (2,), north and east (direction to)."""

    track: FlownTrack
    route: FlownRoute | None
    wind_to_ne_mps: Floats
    density_kgpm3: float
    day: str
    charge: int


@dataclass(frozen=True, slots=True)
class PointScatter:
    """Scatter of the remaining energy at one point, after correction with `slope`."""

    slope: float
    scatter: EnergyScatter


@dataclass(frozen=True)
class EnergyForecast:
    """`airframe` includes `power_flown`; `points` by name, those with enough flights."""

    airframe: Airframe
    times: RouteTimes
    flown: EnergyScatter
    points: dict[str, PointScatter]

    def predict_track_energy(
        self, track: FlownTrack, wind_to_ne_mps: Floats, density_kgpm3: float
    ) -> EnergyPrediction:
        """Return the energy over a flown track: power times time."""
        power = modelled_track_power_w(self.airframe, track, wind_to_ne_mps, density_kgpm3)
        return _prediction_with_upper_bound(float(power.sum()) * STEP_S / 3600.0, self.flown)

    def predict_remaining_energy(
        self,
        track: FlownTrack,
        route: FlownRoute,
        point: RoutePoint,
        wind_to_ne_mps: Floats,
        density_kgpm3: float,
    ) -> EnergyPrediction | None:
        """Return the remaining energy for a wind estimate (n, 2); `None` without scatter."""
        known = self.points.get(point.name)
        if known is None:
            return None
        power = modelled_track_power_w(self.airframe, track, wind_to_ne_mps, density_kgpm3)
        wind = np.broadcast_to(wind_to_ne_mps, (len(track.t_s), 2))[point.index]
        base = _predicted_remaining_energy_wh(
            self.airframe, self.times, track, route, point, wind, density_kgpm3
        )
        consumed_log_ratio = _log_consumed_energy_ratio(track, power, point)
        return _prediction_with_upper_bound(
            base * float(np.exp(known.slope * consumed_log_ratio)), known.scatter
        )


def fit_energy_forecast(airframe: Airframe, flights: Sequence[TrainingFlight]) -> EnergyForecast:
    """Fit the forecast to flights on several days. Raises LeewayError for too few."""
    days = sorted({f.day for f in flights})
    if len(days) < _MIN_DAYS:
        raise LeewayError(f"energy forecast: flights on {len(days)} days, {_MIN_DAYS} expected")
    bare = with_flown_power_ratios(airframe, None)
    modelled = [
        modelled_track_power_w(bare, f.track, f.wind_to_ne_mps, f.density_kgpm3) for f in flights
    ]
    logs: dict[str, list[tuple[int, float, float]]] = {}
    for day in days:
        training_indices = [i for i, f in enumerate(flights) if f.day != day]
        fitted = _fit_phase_power_and_route_times(bare, flights, modelled, training_indices)
        for i in (i for i, f in enumerate(flights) if f.day == day):
            for name, consumed_log_ratio, log in _log_energy_ratios_by_point(
                *fitted, flights[i], modelled[i]
            ):
                logs.setdefault(name, []).append((i, consumed_log_ratio, log))
    final, times = _fit_phase_power_and_route_times(bare, flights, modelled, range(len(flights)))
    flown = _fit_point_scatter(logs.pop("flown", []), flights).scatter
    points = {
        n: _fit_point_scatter(rows, flights)
        for n, rows in logs.items()
        if len(rows) >= _MIN_FLIGHTS and len({flights[i].day for i, *_ in rows}) >= _MIN_DAYS
    }
    return EnergyForecast(final, times, flown, points)


def _fit_phase_power_and_route_times(
    model_airframe: Airframe,
    flights: Sequence[TrainingFlight],
    modelled_power_w_by_flight: Sequence[Floats],
    training_indices: Sequence[int],
) -> tuple[Airframe, RouteTimes]:
    table = measured_to_modelled_power_by_phase(
        energy_by_phase(flights[i].track, modelled_power_w_by_flight[i]) for i in training_indices
    )
    times = fit_route_times(
        [route for i in training_indices if (route := flights[i].route) is not None]
    )
    return with_flown_power_ratios(model_airframe, table), times


def _log_energy_ratios_by_point(
    airframe: Airframe, times: RouteTimes, flight: TrainingFlight, modelled_w: Floats
) -> list[tuple[str, float, float]]:
    """Return (point, log so far, log measured over predicted); "flown" is the whole flight."""
    track = flight.track
    power = modelled_w * measured_over_modelled_power(airframe, track.climb_mps)
    whole = float(power.sum()) * STEP_S / 3600.0
    rows = [("flown", 0.0, float(np.log(track.energy_wh / whole)))]
    if flight.route is None:
        return rows
    for point in takeoff_corner_and_midpoint(track, flight.route):
        mean = np.atleast_2d(flight.wind_to_ne_mps).mean(axis=0)
        wind = mean if point.leg_progress else np.zeros(2)
        args = (airframe, times, track, flight.route, point, wind, flight.density_kgpm3)
        log = float(
            np.log(
                track.energy_from_index_to_end_wh(point.index)
                / _predicted_remaining_energy_wh(*args)
            )
        )
        rows.append((point.name, _log_consumed_energy_ratio(track, power, point), log))
    return rows


def _predicted_remaining_energy_wh(
    airframe: Airframe,
    times: RouteTimes,
    track: FlownTrack,
    route: FlownRoute,
    point: RoutePoint,
    wind_to_ne_mps: Floats,
    density_kgpm3: float,
) -> float:
    wind_mps = float(np.hypot(*wind_to_ne_mps))
    leg_progress = point.leg_progress
    return predict_remaining_energy_wh(
        airframe, times, route.plan, track.payload_kg, leg_progress, wind_mps, density_kgpm3
    )


def _log_consumed_energy_ratio(track: FlownTrack, power_w: Floats, point: RoutePoint) -> float:
    """Return the log of measured over modelled energy up to a point; 0 for little energy."""
    seen = slice(0, point.index)
    modelled = float(power_w[seen].sum()) * STEP_S / 3600.0
    measured = float(track.power_w[seen].sum()) * STEP_S / 3600.0
    return float(np.log(measured / modelled)) if modelled > _MIN_CONSUMED_WH else 0.0


def _fit_point_scatter(
    rows: list[tuple[int, float, float]], flights: Sequence[TrainingFlight]
) -> PointScatter:
    consumed_log_ratio, logs = np.array([row[1:] for row in rows]).reshape(-1, 2).T
    slope = 0.0
    if float(np.var(consumed_log_ratio)) > 0.0:
        slope = float(
            np.clip(
                np.cov(consumed_log_ratio, logs)[0, 1] / np.var(consumed_log_ratio, ddof=1),
                0.0,
                1.0,
            )
        )
    selected_flights = [flights[i] for i, *_ in rows]
    scatter = fit_energy_ratio_scatter(
        logs - slope * consumed_log_ratio,
        [f.day for f in selected_flights],
        [f.charge for f in selected_flights],
    )
    return PointScatter(slope, scatter)


def _prediction_with_upper_bound(base_wh: float, scatter: EnergyScatter) -> EnergyPrediction:
    return EnergyPrediction(
        base_wh * scatter.median_factor, base_wh * scatter.upper_bound_factor(BOUND_SHARE)
    )
