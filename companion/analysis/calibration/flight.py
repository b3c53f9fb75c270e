"""Mission items of the calibration flight, the input of `companion calibrate`.

A hover of one minute, a square whose sides alternate between three speeds, a climb. The speeds
separate linear from quadratic drag and induced from parasite power, the corners separate drag from
wind and trim (course and speed change faster than those do), hover and climb identify thrust.
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
_MIN_TIME_AT_SPEED_S = 8.0  # four blocks of records
DISCHARGE_CHARGE_FRAC = 0.10
"""Charge at the end of a discharge: the curve is steep below; a landing takes 1 to 2 %."""
DISCHARGE_HEIGHT_M = 3.0
_MAX_HOVER_FRAC = 1.3  # of the estimated hover time: the plan lands then at any voltage


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """`duration_s` is approximated by whole legs; `mirrored` reverses the direction of the square.

    `fast`: sides at the maximum ground speed, and slow sides between them.
    """

    height_m: float = 40.0
    side_m: float = 150.0
    duration_s: float = 600.0
    mirrored: bool = False
    fast: bool = False


def square_speeds_mps(airframe: Airframe) -> tuple[float, float, float]:
    """Return three distinct ground speeds; the fastest leaves tilt margin for a headwind."""
    cruise = min(airframe.speeds.cruise_airspeed_mps, airframe.speeds.max_ground_mps)
    return (
        round(_SLOW_FRAC * cruise, 1),
        round(_MIDDLE_FRAC * cruise, 1),
        round(_FAST_FRAC * cruise, 1),
    )


def with_side_long_enough_for_fast_legs(airframe: Airframe, options: PlanOptions) -> PlanOptions:
    """Return the options with fast sides long enough to hold the speed for _AT_SPEED_S."""
    if not options.fast:
        return options
    fastest = airframe.speeds.max_ground_mps
    side_m = fastest**2 / airframe.speeds.accel_mps2 + _MIN_TIME_AT_SPEED_S * fastest
    return replace(options, side_m=max(options.side_m, 10.0 * math.ceil(side_m / 10.0)))


def calibration_mission_items(airframe: Airframe, options: PlanOptions) -> list[PlanItem]:
    """Return the mission: take-off, hover, legs, climb, hover, more legs, landing."""
    options = with_side_long_enough_for_fast_legs(airframe, options)
    _, middle, _ = square_speeds_mps(airframe)
    low, high = options.height_m, options.height_m + 30.0
    items = [
        PlanItem(TAKEOFF, (0.0, 0.0, low)),
        PlanItem(LOITER_TIME, (0.0, 0.0, low), (40.0, 0.0, 0.0, math.nan)),
    ]
    leg_speeds_mps = _leg_speeds_mps(
        airframe, options, options.duration_s - _climb_descent_hover_time_s(airframe, options)
    )
    half = len(leg_speeds_mps) // 2
    items += _leg_items(leg_speeds_mps[:half], options, low, first_leg_index=0)
    items += [
        PlanItem(WAYPOINT, (*_corner_north_east_m(half, options), high)),
        PlanItem(
            LOITER_TIME, (*_corner_north_east_m(half, options), high), (20.0, 0.0, 0.0, math.nan)
        ),
        PlanItem(WAYPOINT, (*_corner_north_east_m(half, options), low)),
    ]
    items += _leg_items(leg_speeds_mps[half:], options, low, first_leg_index=half)
    items += [
        PlanItem(CHANGE_SPEED, None, (GROUND_SPEED, middle, -1.0, 0.0)),
        PlanItem(WAYPOINT, (0.0, 0.0, low)),
        PlanItem(LAND, (0.0, 0.0, 0.0)),
    ]
    return items


def _climb_descent_hover_time_s(airframe: Airframe, options: PlanOptions) -> float:
    """Return the approximate time of climbs, descents and hovers."""
    speeds = airframe.speeds
    slow_s = min(speeds.land_slow_height_m, options.height_m) / speeds.landing_mps
    climbs_m, descents_m = options.height_m + 30.0, options.height_m + 20.0
    return 60.0 + climbs_m / speeds.climb_mps + descents_m / speeds.descent_mps + slow_s


def _leg_speeds_mps(
    airframe: Airframe, options: PlanOptions, leg_time_budget_s: float
) -> list[float]:
    """Return the legs' speeds: three alternate over four sides, so each side gets each speed."""
    slow, middle, fast = square_speeds_mps(airframe)
    fastest = airframe.speeds.max_ground_mps
    order = [fastest, middle, fastest] if options.fast else [fast, slow, middle]
    leg_speeds_mps: list[float] = []
    while True:
        speed = order[len(leg_speeds_mps) % len(order)]
        leg_time_budget_s -= options.side_m / speed + speed / airframe.speeds.accel_mps2 + 2.0
        if leg_time_budget_s < 0.0 and len(leg_speeds_mps) >= 8:
            return leg_speeds_mps
        leg_speeds_mps.append(speed)


def _corner_north_east_m(leg_count: int, options: PlanOptions) -> tuple[float, float]:
    """Return north and east of the corner after this number of legs."""
    side = options.side_m * (-1.0 if options.mirrored else 1.0)
    return [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)][leg_count % 4]


def _leg_items(
    speeds_mps: list[float], options: PlanOptions, height_m: float, first_leg_index: int
) -> list[PlanItem]:
    items: list[PlanItem] = []
    for number, speed in enumerate(speeds_mps, first_leg_index + 1):
        items += [
            PlanItem(CHANGE_SPEED, None, (GROUND_SPEED, speed, -1.0, 0.0)),
            PlanItem(WAYPOINT, (*_corner_north_east_m(number, options), height_m)),
        ]
    return items


def discharge_stop_voltage_v(airframe: Airframe, payload_kg: float) -> float:
    """Return the estimated pack voltage in hover at DISCHARGE_CHARGE_FRAC of charge."""
    pack = airframe.battery
    resting = pack.cells * float(
        np.interp(DISCHARGE_CHARGE_FRAC, pack.ocv_charge_frac, pack.ocv_cell_v)
    )
    draw_w = float(multirotor_power_w(airframe, airframe.flying_mass_kg(payload_kg), 0.0))
    inside = max(resting**2 - 4.0 * pack.resistance_ohm * draw_w, 0.0)
    return max(0.5 * (resting + math.sqrt(inside)), pack.low_battery_action_voltage_v)


def discharge_mission_items(airframe: Airframe, payload_kg: float) -> list[PlanItem]:
    """Return a low hover above the take-off point that the voltage failsafe ends."""
    pack = airframe.battery
    draw_w = float(multirotor_power_w(airframe, airframe.flying_mass_kg(payload_kg), 0.0))
    estimated_hover_s = pack.nominal_wh * pack.usable_frac / draw_w * 3600.0
    hover_point = (0.0, 0.0, DISCHARGE_HEIGHT_M)
    wait = (round(_MAX_HOVER_FRAC * estimated_hover_s), 0.0, 0.0, math.nan)
    return [
        PlanItem(TAKEOFF, hover_point),
        PlanItem(LOITER_TIME, hover_point, wait),
        PlanItem(LAND, (0.0, 0.0, 0.0)),
    ]
