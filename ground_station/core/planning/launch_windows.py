"""Launch windows: until when the forecast lets a plan's sorties fly as they are planned."""

from dataclasses import dataclass

import numpy as np

from companion.core.base.geo import Ned, ObstacleMap, place_ned
from companion.core.base.place import Place
from companion.core.mission.flight_plan import frame_at
from ground_station.core.feasibility.hills import hills_of
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.feasibility.reach import Reach, day_energy
from ground_station.core.feasibility.wind_limit import limit_of
from ground_station.core.planning.day_problem import obstacle_map
from ground_station.core.planning.forecast_check import Flown, Priced, in_forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.orders import Order, place_of
from ground_station.core.weather.forecast_field import OutsideForecast

STEP_S = 3600.0
FINE_S = 300.0
"""Windows end at a whole step of this after the day's beginning: less is not known of a front."""

MOST_S = 24.0 * 3600.0
"""Windows are looked for so far ahead: a later day has a newer forecast."""


@dataclass(frozen=True, slots=True)
class LaunchWindow:
    """When an order may be launched as planned: the last time of the window about its planned
    launch, and the next time after it. `until_s` None: to the end of what was looked at, `end_s`.
    `again_s` None: not before that.
    """

    order: str
    until_s: float | None
    again_s: float | None
    end_s: float


def launch_windows(data: DayData, plan: DayPlan, forecast: DayForecast) -> list[LaunchWindow]:
    """The window of each sortie of a plan, its way and height as planned."""
    orders = {order.id: order for order in data.orders}
    obstacles = obstacle_map(data)
    energies = {name: day_energy(data.day, one) for name, one in data.airframes.items()}
    hills = hills_of(data.day, data.elevation)
    found: list[LaunchWindow] = []
    for sortie in plan.sorties:
        drone = data.day.drone(sortie.vehicle)
        assert drone is not None
        airframe, energy = data.airframes[drone.airframe], energies[drone.airframe]
        reach = Reach(drone, airframe, data.day.mission, data.day.forecast, energy, hills)
        start = plan.stop(sortie.launch).pads[sortie.vehicle]
        end = plan.stop(sortie.home).pads[sortie.vehicle]
        flown = flown_by_plan(data, orders[sortie.order], (start, end), sortie, obstacles)
        takes_s = sortie.land_s - sortie.launch_s
        found.append(
            SortieInForecast(
                sortie.order, reach, flown, forecast, sortie.launch_s, takes_s, limit_of(data)
            ).window()
        )
    return found


def flown_by_plan(
    data: DayData,
    order: Order,
    pads: tuple[Place, Place],
    sortie: PlannedSortie,
    obstacles: ObstacleMap,
) -> Flown:
    """A planned sortie's way, from one pad by its customer to the other."""
    frame = frame_at(data.day.depot.place)
    start, end = (place_ned(frame, pad) for pad in pads)
    customer = place_ned(frame, place_of(order))
    points: list[Ned] = [start, customer, end]
    height_m = sortie.outbound_height_m - start[2]
    ways = ObstacleRoutes(obstacles, np.array(points)[:, :2], data.day.mission.cruise_height_m)
    return Flown(order.mass_kg, start, customer, end, height_m, ways.via(0, 1), ways.via(1, 2))


@dataclass(frozen=True, slots=True)
class SortieInForecast:
    """One sortie at any time that the forecast reaches, its way and height as they are.

    `launch_s`: from when its window is looked for. `takes_s`: from take-off to landing.
    `limit_mps`: of the wind aloft.
    """

    order: str
    reach: Reach
    flown: Flown
    forecast: DayForecast
    launch_s: float
    takes_s: float
    limit_mps: float

    def window(self) -> LaunchWindow:
        """By the hour from its planned launch, then to the minutes in the hour that it ends in."""
        first_s = self.launch_s
        end_s = min(self.forecast.left_s - self.takes_s, first_s + MOST_S)
        times = [*np.arange(first_s, end_s, STEP_S).tolist(), end_s]
        may = [self.may(t_s) for t_s in times]
        if all(may):
            return LaunchWindow(self.order, None, None, end_s)
        shut = may.index(False)
        until_s = self._last(times[max(0, shut - 1)], times[shut])
        later = [at for at in range(shut, len(may)) if may[at]]
        again_s = times[later[0]] if later else None
        return LaunchWindow(self.order, until_s, again_s, end_s)

    def priced(self, t_s: float) -> Priced | OutsideForecast:
        """What it takes, launched at a time of the day."""
        to_s = t_s + self.takes_s
        return in_forecast(self.reach, self.flown, self.forecast, t_s, to_s)

    def may(self, t_s: float) -> bool:
        """Whether a pack pays for it, launched then, and no limit forbids it; never outside the
        forecast.
        """
        return self.forbidden_by(t_s) == ""

    def forbidden_by(self, t_s: float) -> str | None:
        """The wind that forbids a launch at a time, in words; empty: it is promised. None: the
        forecast does not say.
        """
        priced = self.priced(t_s)
        if isinstance(priced, OutsideForecast):
            return None
        height_m = self.flown.height_m
        if priced.strongest_mps >= self.limit_mps:
            wind = f"{priced.strongest_mps:.1f} m/s at {height_m:.0f} m"
            return f"{wind}, the limit is {self.limit_mps:.1f}"
        if priced.pays or priced.wind is None:
            return ""
        return f"{priced.wind.speed_mps:.1f} m/s at {height_m:.0f} m"

    def _last(self, open_s: float, shut_s: float) -> float:
        """The last step at which it may, between a time at which it may and one at which not."""
        steps = np.arange(FINE_S * np.ceil(open_s / FINE_S), shut_s, FINE_S).tolist()
        last_s = open_s
        for t_s in steps:
            if not self.may(t_s):
                break
            last_s = t_s
        return last_s
