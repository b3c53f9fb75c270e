"""Speed to fly: the airspeed of least energy per metre over ground, and what the autopilot flies.

The operator chooses a `SpeedRule`: least energy per metre; or the cruise airspeed, and faster only
where a headwind makes faster cheaper; or the fastest that the return budget allows. No rule flies
slower than the headwind: such a vehicle would never come home.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import max_airspeed_mps, multirotor_power_w
from companion.core.vehicle.wind_triangle import (
    airspeeds_along_mps,
    airspeeds_needed_mps,
    ground_speeds_mps,
)

Flown = tuple[Floats, Floats]

SpeedRule = Literal["least_energy", "cruise", "fastest"]
"""Which airspeed is flown: of least energy per metre; the cruise airspeed, faster only where a
headwind makes that cheaper; the fastest with which the mission still keeps its promise."""

_SPEED_STEP_MPS = 0.25
_WIND_STEP_MPS = 0.5
_WIND_BEYOND_MPS = 6.0  # the table's reach beyond the fastest airspeed
_TILT_AUTHORITY = 0.97  # share of the tilt-limited airspeed that may be planned with, for gusts
# Of the cruise airspeed. Below, tilt says too little of the wind; no airframe's least lies there.
_SLOWEST_FRAC = 0.5


def slowest_airspeed_mps(rule: SpeedRule, cruise_airspeed_mps: float) -> float:
    """The least airspeed that a rule plans with; the speed to fly is the cheapest from there up."""
    return cruise_airspeed_mps if rule == "cruise" else _SLOWEST_FRAC * cruise_airspeed_mps


def fastest_airspeed_mps(airframe: Airframe, payload_kg: float, density_kgpm3: float) -> float:
    """The fastest airspeed that is planned with: tilt-limited, with some authority for gusts."""
    mass_kg = airframe.mass_kg(payload_kg)
    return _TILT_AUTHORITY * max_airspeed_mps(airframe, mass_kg, density_kgpm3)


class SteadyPower:
    """Power in level flight and in the airframe's climb against airspeed, tabulated, one mass."""

    def __init__(self, airframe: Airframe, payload_kg: float, density_kgpm3: float) -> None:
        mass_kg = airframe.mass_kg(payload_kg)
        self.max_airspeed_mps = max_airspeed_mps(airframe, mass_kg, density_kgpm3)
        self.max_ground_mps = airframe.speeds.max_ground_mps
        self._speeds = np.arange(0.0, self.max_airspeed_mps + 2 * _SPEED_STEP_MPS, _SPEED_STEP_MPS)
        self._level = multirotor_power_w(airframe, mass_kg, self._speeds, 0.0, density_kgpm3)
        climb = airframe.speeds.climb_mps
        self._climb = multirotor_power_w(airframe, mass_kg, self._speeds, climb, density_kgpm3)

    def level_w(self, airspeed_mps: Floats) -> Floats:
        """Electrical power in level flight (the table's last entry beyond its end)."""
        return np.interp(airspeed_mps, self._speeds, self._level)

    def climb_w(self, airspeed_mps: Floats) -> Floats:
        """Electrical power while climbing at the airframe's climb speed."""
        return np.interp(airspeed_mps, self._speeds, self._climb)

    def fly_ground_speed(
        self, ground_mps: Floats | float, along_mps: Floats, across_mps: Floats
    ) -> Flown:
        """(ground speed made, airspeed) when told a ground speed; tilt saturates.

        The autopilot holds the line and gives up speed; where even the cross-wind is too much the
        ground speed made is 0.
        """
        airspeed = airspeeds_needed_mps(ground_mps, along_mps, across_mps)
        most = airspeeds_along_mps(self.max_airspeed_mps, across_mps) + along_mps
        made = np.clip(most, 0.0, ground_mps)
        made = np.where(np.abs(across_mps) > self.max_airspeed_mps, 0.0, made)
        return made, np.minimum(airspeed, self.max_airspeed_mps)

    def fly_airspeed(
        self, airspeed_mps: Floats | float, along_mps: Floats, across_mps: Floats
    ) -> Flown:
        """(ground speed made, airspeed) at one airspeed, by the wind triangle alone."""
        wanted = airspeeds_along_mps(airspeed_mps, across_mps) + along_mps
        command = np.clip(wanted, 0.0, self.max_ground_mps)
        return self.fly_ground_speed(command, along_mps, across_mps)

    def fly_least_energy(
        self, least_airspeed_mps: float, along_mps: Floats, across_mps: Floats
    ) -> Flown:
        """(ground speed, airspeed) at the speed to fly: least Wh/m at `least_airspeed_mps` or over.

        Where no airspeed makes way, the fastest that tilt allows with some authority left.
        """
        top = max(self.max_airspeed_mps * _TILT_AUTHORITY, 1.0)
        least = min(least_airspeed_mps, top)
        candidates = np.append(np.arange(least, top, _SPEED_STEP_MPS), top)
        ground = ground_speeds_mps(candidates, along_mps[..., None], across_mps[..., None])
        metres_per_j = np.nan_to_num(ground, nan=-1.0) / self.level_w(candidates)
        best = candidates[np.argmax(metres_per_j, axis=-1)]
        wanted = np.where(metres_per_j.max(axis=-1) > 0.0, best, top)
        return self.fly_airspeed(wanted, along_mps, across_mps)


class CruiseTable:
    """Ground speed made and power drawn over wind along and across a level path, tabulated.

    `fly(along, across) -> (ground speed, airspeed)` is what is tabulated; a look-up is bilinear
    and takes the same time however the speed is chosen.
    """

    def __init__(self, power: SteadyPower, fly: Callable[[Floats, Floats], Flown]) -> None:
        self._reach_mps = float(np.ceil(power.max_airspeed_mps) + _WIND_BEYOND_MPS)
        steps = round(self._reach_mps / _WIND_STEP_MPS)
        self._rows, self._columns = 2 * steps + 1, steps + 1
        along = (np.arange(self._rows, dtype=np.float64) - steps) * _WIND_STEP_MPS
        across = np.arange(self._columns, dtype=np.float64) * _WIND_STEP_MPS
        winds = np.broadcast_arrays(along[:, None], across[None, :])
        ground, airspeed = fly(*winds)
        self._ground = ground.ravel()
        self._power_w = power.level_w(airspeed).ravel()

    def look_up(self, along_mps: Floats, across_mps: Floats) -> Flown:
        """(ground speed m/s, power W) for winds of any shape; held at the table's ends."""
        x = np.clip((along_mps + self._reach_mps) / _WIND_STEP_MPS, 0.0, self._rows - 1.001)
        y = np.clip(np.abs(across_mps) / _WIND_STEP_MPS, 0.0, self._columns - 1.001)
        i, j = x.astype(np.int64), y.astype(np.int64)
        x -= i
        y -= j
        i *= self._columns
        i += j
        return _bilinear(self._ground, i, self._columns, x, y), _bilinear(
            self._power_w, i, self._columns, x, y
        )


def _bilinear(table: Floats, at: Ints, columns: int, x: Floats, y: Floats) -> Floats:
    low = table.take(at)
    low += (table.take(at + columns) - low) * x
    high = table.take(at + 1)
    high += (table.take(at + columns + 1) - high) * x
    high -= low
    high *= y
    high += low
    return high
