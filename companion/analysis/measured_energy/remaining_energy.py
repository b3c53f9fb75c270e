"""Remaining energy from any point of a route with known corners, height and speed.

Time by `RouteTimes`, power by the airframe's model (`multirotor_power_w` with `power_flown`). The
wind is the estimate at the point; without one, still air.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.analysis.measured_energy.flown_track import FlownTrack
from companion.analysis.measured_energy.route_times import FlownRoute, RoutePlan, RouteTimes
from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w


@dataclass(frozen=True, slots=True)
class RoutePoint:
    """A point of a route: `index` on the track's grid; `leg_progress` may be fractional."""

    name: str
    index: int
    leg_progress: float


def takeoff_corner_and_midpoint(track: FlownTrack, route: FlownRoute) -> Iterator[RoutePoint]:
    """Yield take-off, each corner, and the point at half of the total leg length."""
    yield RoutePoint("takeoff", 0, 0.0)
    for number, index in enumerate(route.marks[2:-1], start=1):
        yield RoutePoint(f"corner_{number}", index, float(number))
    yield _half_length_point(track, route)


def _half_length_point(track: FlownTrack, route: FlownRoute) -> RoutePoint:
    lengths = np.array(route.plan.leg_m)
    half_m = 0.5 * float(lengths.sum())
    leg = int(np.searchsorted(np.cumsum(lengths), half_m))
    remaining_m = half_m - float(lengths[:leg].sum())
    first, last = route.marks[leg + 1], route.marks[leg + 2]
    north0, east0 = track.position_ne_m(first)
    span = slice(first, last + 1)
    flown_m = np.hypot(track.north_m[span] - north0, track.east_m[span] - east0)
    index = first + int(np.argmax(flown_m >= min(remaining_m, float(flown_m.max()))))
    return RoutePoint("half", index, leg + remaining_m / float(lengths[leg]))


def predict_remaining_energy_wh(
    airframe: Airframe,
    times: RouteTimes,
    plan: RoutePlan,
    payload_kg: float,
    leg_progress: float,
    wind_speed_mps: float,
    density_kgpm3: float,
) -> float:
    """Return the energy from a point of the route to power off.

    Only the wind speed is used: on a closed route the courses cover all directions, and the
    airspeed is the root mean square.
    """
    mass_kg = airframe.flying_mass_kg(payload_kg)
    cruise_mps = float(np.hypot(plan.speed_mps, wind_speed_mps))
    power = multirotor_power_w(
        airframe,
        mass_kg,
        np.array([0.0, cruise_mps, 0.0]),
        np.array([1.0, 0.0, -1.0]) * _climb_level_descent_rates_mps(times),
        density_kgpm3,
    )
    seconds = [
        times.climb_s(plan.height_m) if leg_progress == 0.0 else 0.0,
        _remaining_cruise_time_s(times, plan, leg_progress),
        times.descent_s(plan.height_m),
    ]
    return float(power @ np.array(seconds)) / 3600.0


def _climb_level_descent_rates_mps(times: RouteTimes) -> Floats:
    """Return rates of climb and descent, at least 1 m/s so that the phase is detected."""
    up, down = (1.0 / max(slope, 1e-3) for slope in (times.climb[1], times.descent[1]))
    return np.clip(np.array([up, 0.0, down]), 1.0, 10.0)


def _remaining_cruise_time_s(times: RouteTimes, plan: RoutePlan, leg_progress: float) -> float:
    """Return the remaining cruise time; a partial leg counts by its remaining share."""
    completed_count = int(leg_progress)
    leg_durations_s = [
        times.leg_s(length_m, plan.speed_mps) for length_m in plan.leg_m[completed_count:]
    ]
    return sum(leg_durations_s) - (leg_progress - completed_count) * (
        leg_durations_s[0] if leg_durations_s else 0.0
    )
