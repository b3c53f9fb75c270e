"""The flight that identifies an airframe, as mission items: what `companion calibrate` asks for.

A minute at rest in the air, a square whose sides are flown at three speeds in turn, a climb: the
speeds tell linear from quadratic drag and induced from parasite power, the corners tell drag from
wind and from trim (course and speed change faster than those do), hover and climb tell thrust.
"""

import math
from dataclasses import dataclass

from companion.core.airframe import Airframe

TAKEOFF, WAYPOINT, LOITER_TIME, LAND, CHANGE_SPEED = 22, 16, 19, 21, 178
GROUND_SPEED = 1.0  # DO_CHANGE_SPEED's type
_SLOW_FRAC, _MIDDLE_FRAC, _FAST_FRAC = 0.35, 0.6, 0.9


@dataclass(frozen=True, slots=True)
class PlanItem:
    """A MAVLink mission item about home: metres north, east and up, or None without a place."""

    command: int
    place_neu_m: tuple[float, float, float] | None = None
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """`duration_s` is aimed at with whole legs; `mirrored` flies them the other way round."""

    height_m: float = 40.0
    side_m: float = 150.0
    duration_s: float = 600.0
    mirrored: bool = False


def square_speeds_mps(airframe: Airframe) -> tuple[float, float, float]:
    """Ground speeds of the squares: well apart, the fastest leaving tilt for a headwind."""
    cruise = min(airframe.speeds.cruise_airspeed_mps, airframe.speeds.max_ground_mps)
    return (
        round(_SLOW_FRAC * cruise, 1),
        round(_MIDDLE_FRAC * cruise, 1),
        round(_FAST_FRAC * cruise, 1),
    )


def calibration_items(airframe: Airframe, options: PlanOptions) -> list[PlanItem]:
    """The mission: take off, hover, legs, a climb and a hover above, more legs, land."""
    _, middle, _ = square_speeds_mps(airframe)
    low, high = options.height_m, options.height_m + 30.0
    items = [
        PlanItem(TAKEOFF, (0.0, 0.0, low)),
        PlanItem(LOITER_TIME, (0.0, 0.0, low), (40.0, 0.0, 0.0, math.nan)),
    ]
    legs = _legs(airframe, options, options.duration_s - _overhead_s(airframe, options))
    half = len(legs) // 2
    items += _fly_legs(legs[:half], options, low, first=0)
    items += [
        PlanItem(WAYPOINT, (*_corner(half, options), high)),
        PlanItem(LOITER_TIME, (*_corner(half, options), high), (20.0, 0.0, 0.0, math.nan)),
        PlanItem(WAYPOINT, (*_corner(half, options), low)),
    ]
    items += _fly_legs(legs[half:], options, low, first=half)
    items += [
        PlanItem(CHANGE_SPEED, None, (GROUND_SPEED, middle, -1.0, 0.0)),
        PlanItem(WAYPOINT, (0.0, 0.0, low)),
        PlanItem(LAND, (0.0, 0.0, 0.0)),
    ]
    return items


def _overhead_s(airframe: Airframe, options: PlanOptions) -> float:
    """Climbs, descents and hovers of the plan, roughly."""
    speeds = airframe.speeds
    slow_s = min(speeds.land_slow_height_m, options.height_m) / speeds.landing_mps
    climbs_m, descents_m = options.height_m + 30.0, options.height_m + 20.0
    return 60.0 + climbs_m / speeds.climb_mps + descents_m / speeds.descent_mps + slow_s


def _legs(airframe: Airframe, options: PlanOptions, left_s: float) -> list[float]:
    """The legs' speeds: three in turn about four sides, so that each side sees each of them."""
    slow, middle, fast = square_speeds_mps(airframe)
    order = [fast, slow, middle]
    legs: list[float] = []
    while True:
        speed = order[len(legs) % len(order)]
        left_s -= options.side_m / speed + speed / airframe.speeds.accel_mps2 + 2.0
        if left_s < 0.0 and len(legs) >= 8:
            return legs
        legs.append(speed)


def _corner(legs_flown: int, options: PlanOptions) -> tuple[float, float]:
    """North and east of the corner where so many legs end."""
    side = options.side_m * (-1.0 if options.mirrored else 1.0)
    return [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)][legs_flown % 4]


def _fly_legs(
    speeds_mps: list[float], options: PlanOptions, height_m: float, first: int
) -> list[PlanItem]:
    items: list[PlanItem] = []
    for number, speed in enumerate(speeds_mps, first + 1):
        items += [
            PlanItem(CHANGE_SPEED, None, (GROUND_SPEED, speed, -1.0, 0.0)),
            PlanItem(WAYPOINT, (*_corner(number, options), height_m)),
        ]
    return items
