"""Launch windows: until when the forecast lets a plan's sorties fly as they are planned."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from companion.core.base.geo import Ned, ObstacleMap, place_ned
from companion.core.mission.flight_plan import frame_at
from companion.core.routing.leg_energy import RouteEnergy
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.feasibility.reach import Reach, day_energy
from ground_station.core.planning.day_problem import obstacle_map
from ground_station.core.planning.forecast_check import Flown, Priced, in_forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.orders import Order, place_of

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
    found: list[LaunchWindow] = []
    for sortie in plan.sorties:
        flown = _flown(data, plan, sortie, orders[sortie.order], obstacles)
        found.append(_Sortie(data, sortie, flown, energies, forecast).window())
    return found


class _Sortie:
    """One sortie at other times than the plan has it."""

    def __init__(
        self,
        data: DayData,
        sortie: PlannedSortie,
        flown: Flown,
        energies: Mapping[str, RouteEnergy],
        forecast: DayForecast,
    ) -> None:
        drone = data.day.drone(sortie.vehicle)
        assert drone is not None
        airframe, energy = data.airframes[drone.airframe], energies[drone.airframe]
        self._reach = Reach(drone, airframe, data.day.mission, data.day.forecast, energy)
        self._sortie, self._flown, self._forecast = sortie, flown, forecast
        self._takes_s = sortie.land_s - sortie.launch_s

    def window(self) -> LaunchWindow:
        """By the hour from its planned launch, then to the minutes in the hour that it ends in."""
        first_s = self._sortie.launch_s
        end_s = min(self._forecast.left_s - self._takes_s, first_s + MOST_S)
        times = [*np.arange(first_s, end_s, STEP_S).tolist(), end_s]
        may = [self._may(t_s) for t_s in times]
        if all(may):
            return LaunchWindow(self._sortie.order, None, None, end_s)
        shut = may.index(False)
        until_s = self._last(times[max(0, shut - 1)], times[shut])
        later = [at for at in range(shut, len(may)) if may[at]]
        again_s = times[later[0]] if later else None
        return LaunchWindow(self._sortie.order, until_s, again_s, end_s)

    def _may(self, t_s: float) -> bool:
        to_s = t_s + self._takes_s
        priced = in_forecast(self._reach, self._flown, self._forecast, t_s, to_s)
        return isinstance(priced, Priced) and priced.pays

    def _last(self, open_s: float, shut_s: float) -> float:
        """The last step at which it may, between a time at which it may and one at which not."""
        steps = np.arange(FINE_S * np.ceil(open_s / FINE_S), shut_s, FINE_S).tolist()
        last_s = open_s
        for t_s in steps:
            if not self._may(t_s):
                break
            last_s = t_s
        return last_s


def _flown(
    data: DayData, plan: DayPlan, sortie: PlannedSortie, order: Order, obstacles: ObstacleMap
) -> Flown:
    frame = frame_at(data.day.depot.place)
    start = place_ned(frame, plan.stop(sortie.launch).pads[sortie.vehicle])
    end = place_ned(frame, plan.stop(sortie.home).pads[sortie.vehicle])
    customer = place_ned(frame, place_of(order))
    points: list[Ned] = [start, customer, end]
    height_m = sortie.outbound_height_m - start[2]
    ways = ObstacleRoutes(obstacles, np.array(points)[:, :2], data.day.mission.cruise_height_m)
    return Flown(order.mass_kg, start, customer, end, height_m, ways.via(0, 1), ways.via(1, 2))
