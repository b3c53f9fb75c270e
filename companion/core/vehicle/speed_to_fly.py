"""Speed to fly: airspeed of least energy per metre over ground, and the resulting ground speed.

The operator selects a `SpeedRule`: least energy per metre; the cruise airspeed, faster only where
a headwind makes that cheaper; or the fastest that the return budget allows. No rule flies slower
than the headwind, at which the vehicle could not return.
"""

import math
from collections.abc import Callable
from typing import Literal

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import level_airspeed_at_max_tilt_mps, multirotor_power_w
from companion.core.vehicle.wind_triangle import (
    airspeeds_along_path_mps,
    airspeeds_for_ground_speed_mps,
    ground_speeds_mps,
)

FloatsPair = tuple[Floats, Floats]

SpeedRule = Literal["least_energy", "cruise", "fastest"]
"""Rule for the airspeed: least energy per metre; the cruise airspeed, faster only where a headwind
makes that cheaper; the fastest with which the mission keeps the return promise."""

_SPEED_STEP_MPS = 0.25
_WIND_STEP_MPS = 0.5
_WIND_MARGIN_MPS = 6.0  # range of the table beyond the fastest airspeed
_TILT_AUTHORITY = 0.97  # share of the tilt-limited airspeed used for planning, for gusts
# Of the cruise airspeed. Below it tilt is a poor measure of wind; no airframe's optimum is there.
_SLOWEST_FRAC = 0.5


def slowest_airspeed_of_rule_mps(rule: SpeedRule, cruise_airspeed_mps: float) -> float:
    """Return the least airspeed of a rule. The speed to fly is the cheapest at or above it."""
    return cruise_airspeed_mps if rule == "cruise" else _SLOWEST_FRAC * cruise_airspeed_mps


def fastest_planning_airspeed_mps(
    airframe: Airframe, payload_kg: float, density_kgpm3: float
) -> float:
    """Return the fastest airspeed for planning: the tilt limit minus a margin for gusts."""
    mass_kg = airframe.flying_mass_kg(payload_kg)
    return _TILT_AUTHORITY * level_airspeed_at_max_tilt_mps(airframe, mass_kg, density_kgpm3)


class SteadyPower:
    """Power tables over airspeed for one mass: level flight and climb at the airframe's rate.

    `limit_w`: maximum power for a chosen airspeed, at least that of the most economical one.
    """

    def __init__(
        self,
        airframe: Airframe,
        payload_kg: float,
        density_kgpm3: float,
        limit_w: float = math.inf,
    ) -> None:
        mass_kg = airframe.flying_mass_kg(payload_kg)
        self.max_airspeed_mps = level_airspeed_at_max_tilt_mps(airframe, mass_kg, density_kgpm3)
        self.max_ground_mps = airframe.speeds.max_ground_mps
        self._speeds = np.arange(0.0, self.max_airspeed_mps + 2 * _SPEED_STEP_MPS, _SPEED_STEP_MPS)
        self._level = multirotor_power_w(airframe, mass_kg, self._speeds, 0.0, density_kgpm3)
        climb = airframe.speeds.climb_mps
        self._climb = multirotor_power_w(airframe, mass_kg, self._speeds, climb, density_kgpm3)
        within = np.flatnonzero(self._level <= max(limit_w, float(self._level.min())))
        self._limit_mps = float(self._speeds[within[-1]])

    def level_flight_power_w(self, airspeed_mps: Floats) -> Floats:
        """Return electrical power in level flight (the table's last entry beyond its end)."""
        return np.interp(airspeed_mps, self._speeds, self._level)

    def climb_power_w(self, airspeed_mps: Floats) -> Floats:
        """Return electrical power in a climb at the airframe's climb rate."""
        return np.interp(airspeed_mps, self._speeds, self._climb)

    def achieved_speeds_for_ground_speed_mps(
        self, ground_mps: Floats | float, tailwind_mps: Floats, crosswind_mps: Floats
    ) -> FloatsPair:
        """Return (achieved ground speed, airspeed) for a commanded ground speed; tilt saturates.

        The autopilot holds the line and reduces speed. Where the cross-wind exceeds the maximum
        airspeed the achieved ground speed is 0.
        """
        airspeed = airspeeds_for_ground_speed_mps(ground_mps, tailwind_mps, crosswind_mps)
        limit = airspeeds_along_path_mps(self.max_airspeed_mps, crosswind_mps) + tailwind_mps
        achieved = np.clip(limit, 0.0, ground_mps)
        achieved = np.where(np.abs(crosswind_mps) > self.max_airspeed_mps, 0.0, achieved)
        return achieved, np.minimum(airspeed, self.max_airspeed_mps)

    def achieved_speeds_for_airspeed_mps(
        self, airspeed_mps: Floats | float, tailwind_mps: Floats, crosswind_mps: Floats
    ) -> FloatsPair:
        """Return (achieved ground speed, airspeed) for one airspeed, by the wind triangle."""
        target = airspeeds_along_path_mps(airspeed_mps, crosswind_mps) + tailwind_mps
        command = np.clip(target, 0.0, self.max_ground_mps)
        return self.achieved_speeds_for_ground_speed_mps(command, tailwind_mps, crosswind_mps)

    def achieved_speeds_of_least_energy_mps(
        self, least_airspeed_mps: float, tailwind_mps: Floats, crosswind_mps: Floats
    ) -> FloatsPair:
        """Return (ground speed, airspeed) of least Wh/m at `least_airspeed_mps` or above.

        Without a positive ground speed at any airspeed: the fastest airspeed for planning.
        """
        top = max(min(self.max_airspeed_mps * _TILT_AUTHORITY, self._limit_mps), 1.0)
        least = min(least_airspeed_mps, top)
        candidates = np.append(np.arange(least, top, _SPEED_STEP_MPS), top)
        ground = ground_speeds_mps(candidates, tailwind_mps[..., None], crosswind_mps[..., None])
        metres_per_j = np.nan_to_num(ground, nan=-1.0) / self.level_flight_power_w(candidates)
        best = candidates[np.argmax(metres_per_j, axis=-1)]
        target = np.where(metres_per_j.max(axis=-1) > 0.0, best, top)
        return self.achieved_speeds_for_airspeed_mps(target, tailwind_mps, crosswind_mps)


class CruiseTable:
    """Table of ground speed and power over the wind along and across a level path.

    Tabulates `ground_speed_and_airspeed_in_wind(tailwind, crosswind) -> (ground speed, airspeed)`.
    The bilinear look-up takes the same time for every speed rule.
    """

    def __init__(
        self,
        power: SteadyPower,
        ground_speed_and_airspeed_in_wind: Callable[[Floats, Floats], FloatsPair],
    ) -> None:
        self._range_mps = float(np.ceil(power.max_airspeed_mps) + _WIND_MARGIN_MPS)
        steps = round(self._range_mps / _WIND_STEP_MPS)
        self._rows, self._columns = 2 * steps + 1, steps + 1
        tailwind = (np.arange(self._rows, dtype=np.float64) - steps) * _WIND_STEP_MPS
        crosswind = np.arange(self._columns, dtype=np.float64) * _WIND_STEP_MPS
        winds = np.broadcast_arrays(tailwind[:, None], crosswind[None, :])
        ground, airspeed = ground_speed_and_airspeed_in_wind(*winds)
        self._ground = ground.ravel()
        self._power_w = power.level_flight_power_w(airspeed).ravel()

    def interpolate_ground_speed_and_power(
        self, tailwind_mps: Floats, crosswind_mps: Floats
    ) -> FloatsPair:
        """Return (ground speed m/s, power W) for winds of any shape; constant beyond the ends."""
        x = np.clip((tailwind_mps + self._range_mps) / _WIND_STEP_MPS, 0.0, self._rows - 1.001)
        y = np.clip(np.abs(crosswind_mps) / _WIND_STEP_MPS, 0.0, self._columns - 1.001)
        i, j = x.astype(np.int64), y.astype(np.int64)
        x -= i
        y -= j
        i *= self._columns
        i += j
        return _interpolate_bilinearly(
            self._ground, i, self._columns, x, y
        ), _interpolate_bilinearly(self._power_w, i, self._columns, x, y)


def _interpolate_bilinearly(
    table: Floats,
    flat_indices: Ints,
    column_count: int,
    row_fractions: Floats,
    column_fractions: Floats,
) -> Floats:
    low = table.take(flat_indices)
    low += (table.take(flat_indices + column_count) - low) * row_fractions
    high = table.take(flat_indices + 1)
    high += (table.take(flat_indices + column_count + 1) - high) * row_fractions
    high -= low
    high *= column_fractions
    high += low
    return high
