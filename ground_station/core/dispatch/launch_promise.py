"""Which launches the forecast promises: now, until when, and again from when.

Each is priced in the wind of its own launch, drop and landing, at its height, with what the fleet
felt against the forecast.
"""

from dataclasses import dataclass

import numpy as np

from companion.core.base.geo import Ned, ObstacleMap
from companion.core.base.place import Place
from ground_station.core.deconfliction.depot_layers import DepotLayers
from ground_station.core.feasibility.hills import hills_of
from ground_station.core.feasibility.reach import Reach, day_energy
from ground_station.core.feasibility.wind_limit import limit_of
from ground_station.core.planning.day_problem import TOP_M, obstacle_map
from ground_station.core.planning.forecast_check import Flown
from ground_station.core.planning.launch_windows import SortieInForecast, flown_by_plan
from ground_station.core.schema.day import Drone, Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.orders import Order
from ground_station.core.weather.forecast_field import utc_words

AHEAD_S = 4.0 * 3600.0
"""Closings are looked for so far ahead: a later one is another forecast's."""

LONGEST_S = 3600.0
"""No flight takes longer; one against more wind than it can fly has no time of its own."""

STEP_S, FINE_S = 1800.0, 300.0
"""Looked at by the half hour, then to five minutes: less is not known of a front."""


@dataclass(frozen=True, slots=True)
class Closing:
    """When a launch is no longer promised: after `until_s` (None: it is promised to the end of the
    look), and again from `again_s` (None: not in what was looked at). `wind`: what closes it.
    """

    order: str
    until_s: float | None
    again_s: float | None = None
    wind: str = ""

    def is_shut(self, t_s: float) -> bool:
        """Whether it is not promised at a time that was looked at."""
        if self.until_s is None or t_s <= self.until_s:
            return False
        return self.again_s is None or t_s < self.again_s


class PromisedSorties:
    """The sorties of a day as they would be flown, for a forecast to price."""

    def __init__(self, data: DayData) -> None:
        self._data = data
        self.limit_mps = limit_of(data)
        self._layers = DepotLayers(data.day.mission, TOP_M)
        self._energies = {name: day_energy(data.day, one) for name, one in data.airframes.items()}
        self._hills = hills_of(data.day, data.elevation)
        self._obstacles: ObstacleMap | None = None
        self._flown: dict[tuple[str, str, str, str], Flown] = {}

    def from_depot(
        self, order: Order, ground: Ned, drone: Drone, layer: int, in_: DayForecast, wind: Forecast
    ) -> SortieInForecast:
        """From the depot and back, in a layer. `wind` says about how long it takes."""
        depot = (0.0, 0.0, 0.0)
        height_m = self._layers.mission_in(layer).cruise_height_m
        reach = self._reach(drone, wind)
        flown = Flown(order.mass_kg, depot, ground, depot, height_m)
        need = reach.need(order.mass_kg, depot, ground, depot, height_m)
        takes_s = min(need.time_s, LONGEST_S) if need.flyable else LONGEST_S
        return SortieInForecast(order.id, reach, flown, in_, 0.0, takes_s, self.limit_mps)

    def by_plan(
        self, order: Order, sortie: PlannedSortie, pads: tuple[Place, Place], in_: DayForecast
    ) -> SortieInForecast | None:
        """As it is planned, from one pad to the other; None: its drone is not in the day."""
        drone = self._data.day.drone(sortie.vehicle)
        if drone is None:
            return None
        key = (sortie.order, sortie.vehicle, sortie.launch, sortie.home)
        if key not in self._flown:
            self._obstacles = self._obstacles or obstacle_map(self._data)
            flown = flown_by_plan(self._data, order, pads, sortie, self._obstacles)
            self._flown[key] = flown
        takes_s = sortie.land_s - sortie.launch_s
        reach = self._reach(drone, self._data.day.forecast)
        return SortieInForecast(
            order.id, reach, self._flown[key], in_, 0.0, takes_s, self.limit_mps
        )

    def _reach(self, drone: Drone, wind: Forecast) -> Reach:
        airframe = self._data.airframes[drone.airframe]
        energy = self._energies[drone.airframe]
        return Reach(drone, airframe, self._data.day.mission, wind, energy, self._hills)


def closing_of(sortie: SortieInForecast, now_s: float) -> Closing:
    """When the next launch of this order is closed, looked at from now on."""
    times = np.arange(now_s, now_s + AHEAD_S + 1.0, STEP_S).tolist()
    words: str | None = ""
    open_s, shut_s = now_s, None
    for t_s in times:
        if words := sortie.forbidden_by(t_s):
            shut_s = t_s
            break
        open_s = t_s
    if shut_s is None:
        return Closing(sortie.order, None)
    until_s = _last_open(sortie, open_s, shut_s) if shut_s > now_s else now_s - 1.0
    later = (t for t in times if t > shut_s and sortie.forbidden_by(t) == "")
    return Closing(sortie.order, until_s, next(later, None), words or "")


def _last_open(sortie: SortieInForecast, open_s: float, shut_s: float) -> float:
    last_s = open_s
    for t_s in np.arange(open_s + FINE_S, shut_s, FINE_S).tolist():
        if sortie.forbidden_by(t_s):
            break
        last_s = t_s
    return last_s


def hour_words(forecast: DayForecast, t_s: float) -> str:
    """A time of the day for people, without its date."""
    return utc_words(forecast.at_s + t_s).partition(" ")[2]
