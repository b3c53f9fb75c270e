"""Launch windows that the forecast permits: now, until when, and from when again.

Each sortie is priced in the wind of its own launch, drop and landing, at its height, with the
fleet's measured deviation from the forecast.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.geo import Ned
from companion.core.base.location import Location
from ground_station.core.deconfliction.depot_layers import DepotLayers
from ground_station.core.feasibility.reach import DayFeasibility, SortieGeometry
from ground_station.core.feasibility.wind_limit import launch_wind_limit_mps
from ground_station.core.planning.airspace import Airspace
from ground_station.core.planning.day_problem import MAX_HEIGHT_AGL_M
from ground_station.core.planning.launch_windows import SortieInForecast
from ground_station.core.schema.day import Drone, Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.orders import Order
from ground_station.core.weather.forecast_field import format_utc

ORDER_HORIZON_S = 4.0 * 3600.0
"""Horizon of the search for closings of an order: later ones are left to a later forecast."""

MAX_FLIGHT_S = 3600.0
"""Upper limit of a flight time; also used for a flight that cannot make headway."""

PLAN_HORIZON_S = 24.0 * 3600.0
"""Horizon of the search for closings of a plan: a later day has a newer forecast."""

COARSE_STEP_S, FINE_STEP_S = 1800.0, 300.0
"""Coarse and fine step of the search: fronts are not known to less than five minutes."""


@dataclass(frozen=True, slots=True)
class LaunchClosing:
    """When a launch is no longer promised: after `until_s` (None: promised to the end of the
    horizon), and again from `reopens_s` (None: beyond the horizon). `wind`: the closing wind.
    """

    order: str
    until_s: float | None
    reopens_s: float | None = None
    wind: str = ""

    def is_closed_at(self, t_s: float) -> bool:
        """Return True if the launch is closed at a time within the horizon."""
        if self.until_s is None or t_s <= self.until_s:
            return False
        return self.reopens_s is None or t_s < self.reopens_s


class ForecastSorties:
    """Prices the sorties of a day in a forecast, as they would be flown."""

    def __init__(self, data: DayData) -> None:
        self._data = data
        self.limit_mps = launch_wind_limit_mps(data)
        self._layers = DepotLayers(data.day.mission, MAX_HEIGHT_AGL_M)
        self._feasibility = DayFeasibility(data.day, data.airframes, data.elevation)
        self._airspace: Airspace | None = None
        self._flown: dict[tuple[str, str, str, str], SortieGeometry] = {}

    def depot_sortie_in_forecast(
        self,
        order: Order,
        customer_ned_m: Ned,
        drone: Drone,
        layer: int,
        day_forecast: DayForecast,
        duration_estimate_wind: Forecast,
    ) -> SortieInForecast:
        """Return a sortie in a layer; `duration_estimate_wind` gives its rough duration."""
        depot = (0.0, 0.0, 0.0)
        height_m = self._layers.mission_in_layer(layer).cruise_height_m
        feasibility = self._feasibility.of_drone(drone, duration_estimate_wind)
        flown = SortieGeometry(order.mass_kg, depot, customer_ned_m, depot, height_m)
        need = feasibility.sortie_need(flown)
        duration_s = min(need.time_s, MAX_FLIGHT_S) if need.flyable else MAX_FLIGHT_S
        return SortieInForecast(
            order.id, feasibility, flown, day_forecast, duration_s, self.limit_mps
        )

    def planned_sortie_in_forecast(
        self,
        order: Order,
        sortie: PlannedSortie,
        launch_and_home_pads: tuple[Location, Location],
        day_forecast: DayForecast,
    ) -> SortieInForecast | None:
        """Return a sortie as planned, between its two pads; None: its drone is not in the day."""
        drone = self._data.day.find_drone(sortie.vehicle)
        if drone is None:
            return None
        key = (sortie.order, sortie.vehicle, sortie.launch, sortie.home)
        if key not in self._flown:
            self._airspace = self._airspace or Airspace(self._data)
            self._flown[key] = self._airspace.sortie_geometry(order, sortie, launch_and_home_pads)
        duration_s = sortie.land_s - sortie.launch_s
        feasibility = self._feasibility.of_drone(drone)
        return SortieInForecast(
            order.id, feasibility, self._flown[key], day_forecast, duration_s, self.limit_mps
        )


def find_launch_closing(
    sortie: SortieInForecast, search_start_s: float, horizon_s: float = ORDER_HORIZON_S
) -> LaunchClosing:
    """Return the closing of the next launch of this order, searched from now on."""
    times = [
        *np.arange(search_start_s, search_start_s + horizon_s, COARSE_STEP_S).tolist(),
        search_start_s + horizon_s,
    ]
    wind_text: str | None = ""
    open_s, closed_s = search_start_s, None
    for t_s in times:
        if wind_text := sortie.launch_restriction_text(t_s):
            closed_s = t_s
            break
        open_s = t_s
    if closed_s is None:
        return LaunchClosing(sortie.order, None)
    until_s = (
        _last_permitted_launch_s(sortie, open_s, closed_s)
        if closed_s > search_start_s
        else search_start_s - 1.0
    )
    later = (t for t in times if t > closed_s and sortie.launch_restriction_text(t) == "")
    return LaunchClosing(sortie.order, until_s, next(later, None), wind_text or "")


def _last_permitted_launch_s(sortie: SortieInForecast, open_s: float, closed_s: float) -> float:
    last_s = open_s
    for t_s in np.arange(open_s + FINE_STEP_S, closed_s, FINE_STEP_S).tolist():
        if sortie.launch_restriction_text(t_s):
            break
        last_s = t_s
    return last_s


def launch_closings_of_plan(
    data: DayData, plan: DayPlan, forecast: DayForecast
) -> list[LaunchClosing]:
    """Return the closing of each sortie of a plan as planned, within the forecast's range."""
    sorties, found = ForecastSorties(data), list[LaunchClosing]()
    orders = {order.id: order for order in data.orders}
    for sortie in plan.sorties:
        pads = tuple(
            plan.get_stop(id_).pads[sortie.vehicle] for id_ in (sortie.launch, sortie.home)
        )
        flown = sorties.planned_sortie_in_forecast(
            orders[sortie.order], sortie, (pads[0], pads[1]), forecast
        )
        assert flown is not None
        horizon_s = forecast.forecast_end_day_s - flown.duration_s - sortie.launch_s
        found.append(
            find_launch_closing(flown, sortie.launch_s, min(max(horizon_s, 0.0), PLAN_HORIZON_S))
        )
    return found


def format_utc_time_of_day(forecast: DayForecast, day_s: float) -> str:
    """Format a time of the day without its date."""
    return format_utc(forecast.day_start_s + day_s).partition(" ")[2]


def format_closing_of_orders(
    forecast: DayForecast,
    until_s: float,
    reopens_s: float | None,
    closings_at_same_time: Sequence[LaunchClosing],
    now_s: float,
) -> str:
    """Format a line for orders that close at one time."""
    names = [one.order for one in closings_at_same_time]
    shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    subject = f"order{'' if len(names) == 1 else 's'} {shown}"
    reopening = format_reopening_suffix(forecast, reopens_s)
    wind = closings_at_same_time[0].wind
    text = f"{subject} may not be launched: the forecast has {wind}{reopening}"
    return text if until_s < now_s else f"after {format_utc_time_of_day(forecast, until_s)} {text}"


def format_reopening_suffix(forecast: DayForecast, reopens_s: float | None) -> str:
    """Format the time from which a launch is permitted again; empty: not within the horizon."""
    return (
        "" if reopens_s is None else f"; again from {format_utc_time_of_day(forecast, reopens_s)}"
    )
