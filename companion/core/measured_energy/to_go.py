"""Energy still to come on a route whose corners, height and speed are known, from any point of it.

Time by `RouteTimes`, power by the airframe's own model (`multirotor_power_w` with `power_flown`).
The wind is what is believed there; with none, still air.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.measured_energy.flown_track import FlownTrack
from companion.core.measured_energy.route_times import FlownRoute, RoutePlan, RouteTimes
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w


@dataclass(frozen=True, slots=True)
class RoutePoint:
    """A point of a route: `index` on the track's grid; `legs_flown` whole and part of them."""

    name: str
    index: int
    legs_flown: float


def route_points(track: FlownTrack, route: FlownRoute) -> Iterator[RoutePoint]:
    """Take-off, each corner, and half of the legs' length."""
    yield RoutePoint("takeoff", 0, 0.0)
    for number, index in enumerate(route.corners, start=1):
        yield RoutePoint(f"corner_{number}", index, float(number))
    yield _half_way(track, route)


def _half_way(track: FlownTrack, route: FlownRoute) -> RoutePoint:
    lengths = np.array(route.plan.leg_m)
    half_m = 0.5 * float(lengths.sum())
    leg = int(np.searchsorted(np.cumsum(lengths), half_m))
    left_m = half_m - float(lengths[:leg].sum())
    first, last = route.marks[leg + 1], route.marks[leg + 2]
    north0, east0 = track.place(first)
    span = slice(first, last + 1)
    flown_m = np.hypot(track.north_m[span] - north0, track.east_m[span] - east0)
    index = first + int(np.argmax(flown_m >= min(left_m, float(flown_m.max()))))
    return RoutePoint("half", index, leg + left_m / float(lengths[leg]))


def energy_to_go_wh(
    airframe: Airframe,
    times: RouteTimes,
    plan: RoutePlan,
    payload_kg: float,
    legs_flown: float,
    wind_speed_mps: float,
    density_kgpm3: float,
) -> float:
    """Energy from a point of the route to power off.

    Of the wind its speed alone: over a route that closes, courses meet it from all sides, and the
    airspeed is the root of the mean square.
    """
    mass_kg = airframe.mass_kg(payload_kg)
    cruise_mps = float(np.hypot(plan.speed_mps, wind_speed_mps))
    power = multirotor_power_w(
        airframe,
        mass_kg,
        np.array([0.0, cruise_mps, 0.0]),
        np.array([1.0, 0.0, -1.0]) * _rates_mps(times),
        density_kgpm3,
    )
    seconds = [
        times.climb_s(plan.height_m) if legs_flown == 0.0 else 0.0,
        _cruise_s(times, plan, legs_flown),
        times.descent_s(plan.height_m),
    ]
    return float(power @ np.array(seconds)) / 3600.0


def _rates_mps(times: RouteTimes) -> Floats:
    """Rates of climb and descent by the times; at least 1 m/s, at which a phase is whole."""
    up, down = (1.0 / max(slope, 1e-3) for slope in (times.climb[1], times.descent[1]))
    return np.clip(np.array([up, 0.0, down]), 1.0, 10.0)


def _cruise_s(times: RouteTimes, plan: RoutePlan, legs_flown: float) -> float:
    """Of a part of a leg, as much of its starting and stopping is left as of its length."""
    whole = int(legs_flown)
    legs = [times.leg_s(length_m, plan.speed_mps) for length_m in plan.leg_m[whole:]]
    return sum(legs) - (legs_flown - whole) * (legs[0] if legs else 0.0)
