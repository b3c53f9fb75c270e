"""Energy of a flight and of the rest of it, each with a bound that holds on a new day.

Fitted to flights on several days: power by phase, times of the route, and the scatter of measured
about predicted energy. The scatter is taken from flights whose day was left out of power and times,
so that it holds what a new day adds. What a flight drew so far tells a part of what it will draw: a
slope on the logarithm of measured over predicted energy up to there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.measured_energy.energy_scatter import EnergyScatter, fit_scatter
from companion.core.measured_energy.flown_track import STEP_S, FlownTrack
from companion.core.measured_energy.route_times import FlownRoute, RouteTimes, fit_times
from companion.core.measured_energy.to_go import RoutePoint, energy_to_go_wh, route_points
from companion.core.measured_energy.track_power import (
    fit_phases,
    phase_energy,
    track_power_w,
    with_flown,
)
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import flown_frac

BOUND_SHARE = 0.95
_LEAST_FLIGHTS = 12
_LEAST_DAYS = 3
_LEAST_SO_FAR_WH = 0.5


@dataclass(frozen=True, slots=True)
class StatedEnergy:
    """Predicted energy and the bound that BOUND_SHARE of flights on new days stay under, Wh."""

    predicted_wh: float
    upper_wh: float


@dataclass(frozen=True, slots=True)
class KnownFlight:
    """A flight to fit to. `route` is `None` where it cannot be judged to go; the wind is the
    flight's mean, north and east, where the air moves to."""

    track: FlownTrack
    route: FlownRoute | None
    wind_to_ne_mps: Floats
    density_kgpm3: float
    day: str
    charge: int


@dataclass(frozen=True, slots=True)
class PointScatter:
    """Scatter of the energy to go at one point, once `slope` of the logarithm so far is taken."""

    slope: float
    scatter: EnergyScatter


@dataclass(frozen=True)
class EnergyForecast:
    """`airframe` has its `power_flown`; `points` by name, those that enough flights had."""

    airframe: Airframe
    times: RouteTimes
    flown: EnergyScatter
    points: dict[str, PointScatter]

    def of_track(self, track: FlownTrack, wind_to_ne_mps: Floats, density: float) -> StatedEnergy:
        """Energy over a flown track: power times time."""
        power = track_power_w(self.airframe, track, wind_to_ne_mps, density)
        return _stated(float(power.sum()) * STEP_S / 3600.0, self.flown)

    def to_go(
        self,
        track: FlownTrack,
        route: FlownRoute,
        point: RoutePoint,
        wind_to_ne_mps: Floats,
        density: float,
    ) -> StatedEnergy | None:
        """Energy from a point on, by the wind (n, 2) believed there; `None`: no scatter known."""
        known = self.points.get(point.name)
        if known is None:
            return None
        power = track_power_w(self.airframe, track, wind_to_ne_mps, density)
        wind = np.broadcast_to(wind_to_ne_mps, (len(track.t_s), 2))[point.index]
        base = _to_go_wh(self.airframe, self.times, track, route, point, wind, density)
        so_far = _log_so_far(track, power, point)
        return _stated(base * float(np.exp(known.slope * so_far)), known.scatter)


def fit_forecast(airframe: Airframe, flights: Sequence[KnownFlight]) -> EnergyForecast:
    """Everything from flights on several days; LeewayError where they are too few."""
    days = sorted({f.day for f in flights})
    if len(days) < _LEAST_DAYS:
        raise LeewayError(f"energy forecast: flights on {len(days)} days, {_LEAST_DAYS} expected")
    bare = with_flown(airframe, None)
    modelled = [track_power_w(bare, f.track, f.wind_to_ne_mps, f.density_kgpm3) for f in flights]
    logs: dict[str, list[tuple[int, float, float]]] = {}
    for day in days:
        kept = [i for i, f in enumerate(flights) if f.day != day]
        fitted = _fit(bare, flights, modelled, kept)
        for i in (i for i, f in enumerate(flights) if f.day == day):
            for name, so_far, log in _left(*fitted, flights[i], modelled[i]):
                logs.setdefault(name, []).append((i, so_far, log))
    final, times = _fit(bare, flights, modelled, range(len(flights)))
    flown = _point(logs.pop("flown", []), flights).scatter
    points = {n: _point(rows, flights) for n, rows in logs.items() if _enough(rows, flights)}
    return EnergyForecast(final, times, flown, points)


def _fit(
    bare: Airframe,
    flights: Sequence[KnownFlight],
    modelled: Sequence[Floats],
    kept: Sequence[int],
) -> tuple[Airframe, RouteTimes]:
    table = fit_phases(phase_energy(flights[i].track, modelled[i]) for i in kept)
    times = fit_times([route for i in kept if (route := flights[i].route) is not None])
    return with_flown(bare, table), times


def _left(
    airframe: Airframe, times: RouteTimes, flight: KnownFlight, modelled_w: Floats
) -> list[tuple[str, float, float]]:
    """(point, log so far, log measured over predicted) of one flight; "flown" is all of it."""
    track = flight.track
    power = modelled_w * flown_frac(airframe, track.climb_mps)
    whole = float(power.sum()) * STEP_S / 3600.0
    rows = [("flown", 0.0, float(np.log(track.energy_wh / whole)))]
    if flight.route is None:
        return rows
    for point in route_points(track, flight.route):
        wind = flight.wind_to_ne_mps if point.legs_flown else np.zeros(2)
        args = (airframe, times, track, flight.route, point, wind, flight.density_kgpm3)
        log = float(np.log(track.energy_after_wh(point.index) / _to_go_wh(*args)))
        rows.append((point.name, _log_so_far(track, power, point), log))
    return rows


def _to_go_wh(
    airframe: Airframe,
    times: RouteTimes,
    track: FlownTrack,
    route: FlownRoute,
    point: RoutePoint,
    wind_to_ne_mps: Floats,
    density: float,
) -> float:
    wind_mps = float(np.hypot(*wind_to_ne_mps))
    legs = point.legs_flown
    return energy_to_go_wh(airframe, times, route.plan, track.payload_kg, legs, wind_mps, density)


def _log_so_far(track: FlownTrack, power_w: Floats, point: RoutePoint) -> float:
    """Logarithm of measured over modelled energy up to a point; 0 where that is too little."""
    seen = slice(0, point.index)
    modelled = float(power_w[seen].sum()) * STEP_S / 3600.0
    measured = float(track.power_w[seen].sum()) * STEP_S / 3600.0
    return float(np.log(measured / modelled)) if modelled > _LEAST_SO_FAR_WH else 0.0


def _enough(rows: list[tuple[int, float, float]], flights: Sequence[KnownFlight]) -> bool:
    return len(rows) >= _LEAST_FLIGHTS and len({flights[i].day for i, *_ in rows}) >= _LEAST_DAYS


def _point(rows: list[tuple[int, float, float]], flights: Sequence[KnownFlight]) -> PointScatter:
    so_far, logs = np.array([row[1:] for row in rows]).reshape(-1, 2).T
    slope = 0.0
    if float(np.var(so_far)) > 0.0:
        slope = float(np.clip(np.cov(so_far, logs)[0, 1] / np.var(so_far, ddof=1), 0.0, 1.0))
    chosen = [flights[i] for i, *_ in rows]
    scatter = fit_scatter(
        logs - slope * so_far, [f.day for f in chosen], [f.charge for f in chosen]
    )
    return PointScatter(slope, scatter)


def _stated(base_wh: float, scatter: EnergyScatter) -> StatedEnergy:
    return StatedEnergy(base_wh * scatter.factor, base_wh * scatter.bound(BOUND_SHARE))
