"""The flight that identifies an airframe, as mission items: what `companion calibrate` asks for.

A minute at rest in the air, a square whose sides are flown at three speeds in turn, a climb: the
speeds tell linear from quadratic drag and induced from parasite power, the corners tell drag from
wind and from trim (course and speed change faster than those do), hover and climb tell thrust.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.core.exports.qgc_plan import PlanItem
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import multirotor_power_w

TAKEOFF, WAYPOINT, LOITER_TIME, LAND, CHANGE_SPEED = 22, 16, 19, 21, 178
GROUND_SPEED = 1.0  # DO_CHANGE_SPEED's type
_SLOW_FRAC, _MIDDLE_FRAC, _FAST_FRAC = 0.35, 0.6, 0.9
_AT_SPEED_S = 8.0  # four blocks of records
DISCHARGE_CHARGE_FRAC = 0.10
"""What a discharge is flown down to: the steep end begins there, a landing takes 1 to 2 %."""
DISCHARGE_HEIGHT_M = 3.0
_LONGEST_FRAC = 1.3  # of the believed hovering time: the plan lands then, whatever the voltage


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """`duration_s` is aimed at with whole legs; `mirrored` flies them the other way round.

    `fast`: sides as fast as the airframe may be told, and slow ones between.
    """

    height_m: float = 40.0
    side_m: float = 150.0
    duration_s: float = 600.0
    mirrored: bool = False
    fast: bool = False


def square_speeds_mps(airframe: Airframe) -> tuple[float, float, float]:
    """Ground speeds of the squares: well apart, the fastest leaving tilt for a headwind."""
    cruise = min(airframe.speeds.cruise_airspeed_mps, airframe.speeds.max_ground_mps)
    return (
        round(_SLOW_FRAC * cruise, 1),
        round(_MIDDLE_FRAC * cruise, 1),
        round(_FAST_FRAC * cruise, 1),
    )


def with_room(airframe: Airframe, options: PlanOptions) -> PlanOptions:
    """The options, fast sides so long that their speed is held for _AT_SPEED_S on each."""
    if not options.fast:
        return options
    fastest = airframe.speeds.max_ground_mps
    side_m = fastest**2 / airframe.speeds.accel_mps2 + _AT_SPEED_S * fastest
    return replace(options, side_m=max(options.side_m, 10.0 * math.ceil(side_m / 10.0)))


def calibration_items(airframe: Airframe, options: PlanOptions) -> list[PlanItem]:
    """The mission: take off, hover, legs, a climb and a hover above, more legs, land."""
    options = with_room(airframe, options)
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
    fastest = airframe.speeds.max_ground_mps
    order = [fastest, middle, fastest] if options.fast else [fast, slow, middle]
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


def discharge_stop_v(airframe: Airframe, payload_kg: float) -> float:
    """Loaded voltage of the pack in hover at which DISCHARGE_CHARGE_FRAC is left, as believed."""
    pack = airframe.battery
    resting = pack.cells * float(
        np.interp(DISCHARGE_CHARGE_FRAC, pack.ocv_charge_frac, pack.ocv_cell_v)
    )
    draw_w = float(multirotor_power_w(airframe, airframe.mass_kg(payload_kg), 0.0))
    inside = max(resting**2 - 4.0 * pack.resistance_ohm * draw_w, 0.0)
    return max(0.5 * (resting + math.sqrt(inside)), pack.low_v)


def discharge_items(airframe: Airframe, payload_kg: float) -> list[PlanItem]:
    """A hover low over the take-off place until the autopilot's own voltage failsafe lands it."""
    pack = airframe.battery
    draw_w = float(multirotor_power_w(airframe, airframe.mass_kg(payload_kg), 0.0))
    believed_s = pack.nominal_wh * pack.usable_frac / draw_w * 3600.0
    place = (0.0, 0.0, DISCHARGE_HEIGHT_M)
    wait = (round(_LONGEST_FRAC * believed_s), 0.0, 0.0, math.nan)
    return [
        PlanItem(TAKEOFF, place),
        PlanItem(LOITER_TIME, place, wait),
        PlanItem(LAND, (0.0, 0.0, 0.0)),
    ]
