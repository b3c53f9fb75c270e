"""Evaluates sorties in the forecast wind at their time and height, and rejects infeasible ones."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ground_station.core.feasibility.reach import SortieFeasibility, SortieGeometry, SortieNeed
from ground_station.core.feasibility.wind_limit import launch_wind_limit_mps
from ground_station.core.planning.day_problem import DayProblem, without_orders
from ground_station.core.planning.launch_slots import LaunchSlot, SortieRequest
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import UnplannedOrder
from ground_station.core.weather.forecast_field import OutsideForecast


@dataclass(frozen=True, slots=True)
class PricedSortie:
    """Energy need of a delivery at the accepted loss, in its most demanding forecast wind (`wind`,
    None without a forecast). `strongest_mps`: speed of its strongest wind.
    """

    need: SortieNeed
    required_wh: float
    usable_wh: float
    wind: Forecast | None = None
    strongest_mps: float = 0.0

    @property
    def has_sufficient_energy(self) -> bool:
        """Whether the pack suffices."""
        return self.need.flyable and self.required_wh <= self.usable_wh


def price_in_most_demanding_forecast_wind(
    feasibility: SortieFeasibility,
    geometry: SortieGeometry,
    forecast: DayForecast | None,
    launch_s: float,
    landing_s: float,
) -> PricedSortie | OutsideForecast:
    """Price a delivery in the most demanding of the winds at launch, drop and landing, each at its
    own position and time.

    Without a forecast the wind is that of `feasibility`.
    """
    if forecast is None:
        return _price_sortie(feasibility, geometry)
    found: list[PricedSortie] = []
    height_m = geometry.height_above_depot_m(feasibility.mission)
    positions_ned_m = (geometry.start, geometry.customer, geometry.end)
    for position_ned_m, t_s in zip(
        positions_ned_m, (launch_s, 0.5 * (launch_s + landing_s), landing_s), strict=True
    ):
        wind = forecast.constant_wind_at_day_time(
            t_s, height_m, (position_ned_m[0], position_ned_m[1])
        )
        if isinstance(wind, OutsideForecast):
            return wind
        found.append(_price_sortie(feasibility.copy_for_wind(wind), geometry, wind))
    hardest = max(found, key=lambda one: (not one.need.flyable, one.required_wh))
    strongest_mps = max(one.wind.speed_mps for one in found if one.wind is not None)
    return replace(hardest, strongest_mps=strongest_mps)


def _price_sortie(
    feasibility: SortieFeasibility, geometry: SortieGeometry, wind: Forecast | None = None
) -> PricedSortie:
    need = feasibility.sortie_need(geometry)
    usable_wh, battery_std_wh = feasibility.usable_above_reserve_wh_and_std(geometry.payload_kg)
    required_wh = need.mean_wh + feasibility.sigmas * math.hypot(need.std_wh, battery_std_wh)
    return PricedSortie(need, required_wh, usable_wh, wind)


def price_slot_in_forecast(
    nodes: DayProblem, slot: LaunchSlot, data: DayData, truck_start_day_s: float
) -> PricedSortie | OutsideForecast:
    """Price a launch slot in the forecast; its times are relative to `truck_start_day_s` (day
    time).
    """
    feasibility = nodes.classes[slot.request.kind].feasibility
    geometry = nodes.sortie_geometry(
        slot.request.nodes, slot.from_pad_ned_m, slot.to_pad_ned_m, slot.volume.high_m
    )
    times = (truck_start_day_s + slot.launched_s, truck_start_day_s + slot.landed_s)
    return price_in_most_demanding_forecast_wind(feasibility, geometry, data.forecast, *times)


def reason_by_forbidden_sortie(
    nodes: DayProblem, slots: Iterable[LaunchSlot], data: DayData, truck_start_day_s: float
) -> dict[SortieRequest, str]:
    """Return the sorties that the forecast forbids, each with the reason."""
    if data.forecast is None:
        return {}
    limit_mps = launch_wind_limit_mps(data)
    found: dict[SortieRequest, str] = {}
    for slot in slots:
        priced = price_slot_in_forecast(nodes, slot, data, truck_start_day_s)
        if isinstance(priced, OutsideForecast):
            found[slot.request] = priced.reason
        elif priced.strongest_mps >= limit_mps:
            reason = (
                f"{_forecast_wind_text_at_launch(data.forecast, slot, truck_start_day_s)}; the"
                f" limit is {limit_mps:.1f} m/s"
            )
            found[slot.request] = reason
        elif not priced.has_sufficient_energy:
            found[slot.request] = _forecast_wind_text_at_launch(
                data.forecast, slot, truck_start_day_s
            )
    return found


def _forecast_wind_text_at_launch(
    forecast: DayForecast, slot: LaunchSlot, truck_start_day_s: float
) -> str:
    t_s, height_m = truck_start_day_s + slot.launched_s, slot.volume.high_m
    wind = forecast.wind_at_day_time(t_s, height_m)
    return f"the forecast is {wind} at {height_m:.0f} m, {forecast.format_utc_date_and_time(t_s)}"


def exclude_sorties_from_drone_kinds(
    nodes: DayProblem, reason_by_rejected_sortie: dict[SortieRequest, str]
) -> tuple[DayProblem, list[UnplannedOrder]]:
    """Exclude these orders from their drone kinds. Return the problem, and the orders that no
    vehicle can serve then.
    """
    kinds = [replace(kind, can_serve=kind.can_serve.copy()) for kind in nodes.problem.kinds]
    for request in reason_by_rejected_sortie:
        kinds[request.kind].can_serve[request.customer] = False
    problem = replace(nodes.problem, kinds=tuple(kinds))
    flies = np.any([kind.can_serve for kind in kinds], axis=0)
    left = [
        UnplannedOrder(
            order=nodes.orders[request.customer - 1].id,
            reason=reason[:1000],
            remedy="another launch time, or the truck",
        )
        for request, reason in reason_by_rejected_sortie.items()
        if not (flies[request.customer] or problem.truck_can_serve[request.customer])
    ]
    filtered = replace(nodes, problem=problem)
    return (without_orders(filtered, {line.order for line in left}) if left else filtered), left
