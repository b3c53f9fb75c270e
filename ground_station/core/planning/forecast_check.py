"""Sorties in the forecast wind of their own time and height, and those that it forbids."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.geo import Ned
from ground_station.core.feasibility.reach import Reach, SortieNeed, Waypoints
from ground_station.core.feasibility.wind_limit import limit_of
from ground_station.core.planning.day_problem import DayProblem, without
from ground_station.core.planning.launch_slots import LaunchSlot, SortieRequest
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import Unplanned
from ground_station.core.weather.forecast_field import OutsideForecast


@dataclass(frozen=True, slots=True)
class Flown:
    """A delivery as it is flown: ground points and height about the depot, corners on its way."""

    payload_kg: float
    start: Ned
    customer: Ned
    end: Ned
    height_m: float
    out_via: Waypoints = ()
    back_via: Waypoints = ()


@dataclass(frozen=True, slots=True)
class Priced:
    """What a delivery takes at the accepted loss, in the hardest of its winds; `wind`: that one, as
    it is forecast (None: without a forecast), and `strongest_mps` the speed of the strongest.
    """

    need: SortieNeed
    sure_wh: float
    usable_wh: float
    wind: Forecast | None = None
    strongest_mps: float = 0.0

    @property
    def pays(self) -> bool:
        """Whether a pack pays for it."""
        return self.need.flyable and self.sure_wh <= self.usable_wh


def in_forecast(
    reach: Reach, flown: Flown, forecast: DayForecast | None, from_s: float, to_s: float
) -> Priced | OutsideForecast:
    """A delivery in the wind of its launch, of its drop or of its landing, each at its own place
    and time, whichever asks for most.

    Without a forecast in the wind that the drone's `reach` has.
    """
    if forecast is None:
        return _priced(reach, flown)
    found: list[Priced] = []
    places = (flown.start, flown.customer, flown.end)
    for place, t_s in zip(places, (from_s, 0.5 * (from_s + to_s), to_s), strict=True):
        wind = forecast.constant(t_s, flown.height_m, (place[0], place[1]))
        if isinstance(wind, OutsideForecast):
            return wind
        found.append(_priced(reach.in_wind(wind), flown, wind))
    hardest = max(found, key=lambda one: (not one.need.flyable, one.sure_wh))
    strongest_mps = max(one.wind.speed_mps for one in found if one.wind is not None)
    return replace(hardest, strongest_mps=strongest_mps)


def _priced(reach: Reach, flown: Flown, wind: Forecast | None = None) -> Priced:
    need = reach.need(
        flown.payload_kg,
        flown.start,
        flown.customer,
        flown.end,
        flown.height_m,
        flown.out_via,
        flown.back_via,
    )
    usable_wh, battery_std_wh = reach.budget_wh(flown.payload_kg)
    sure_wh = need.mean_wh + reach.sigmas * math.hypot(need.std_wh, battery_std_wh)
    return Priced(need, sure_wh, usable_wh, wind)


def flown_in(nodes: DayProblem, slot: LaunchSlot) -> Flown:
    """The delivery of a launch slot."""
    wish = slot.wish
    return Flown(
        payload_kg=nodes.orders[wish.customer - 1].mass_kg,
        start=slot.from_pad_ned_m,
        customer=nodes.ned(wish.customer),
        end=slot.to_pad_ned_m,
        height_m=slot.volume.high_m,
        out_via=nodes.ways.via(wish.launch, wish.customer),
        back_via=nodes.ways.via(wish.customer, wish.meet),
    )


def slot_priced(
    nodes: DayProblem, slot: LaunchSlot, data: DayData, t0_s: float
) -> Priced | OutsideForecast:
    """A launch slot in the forecast; its times count from `t0_s`, in the day's time."""
    reach = nodes.classes[slot.wish.kind].reach
    times = (t0_s + slot.launched_s, t0_s + slot.landed_s)
    return in_forecast(reach, flown_in(nodes, slot), data.forecast, *times)


def forbidden(
    nodes: DayProblem, slots: Iterable[LaunchSlot], data: DayData, t0_s: float
) -> dict[SortieRequest, str]:
    """Sorties that the forecast does not let fly, each with the reason."""
    if data.forecast is None:
        return {}
    limit_mps = limit_of(data)
    found: dict[SortieRequest, str] = {}
    for slot in slots:
        priced = slot_priced(nodes, slot, data, t0_s)
        if isinstance(priced, OutsideForecast):
            found[slot.wish] = priced.why
        elif priced.strongest_mps >= limit_mps:
            why = f"{_why(data.forecast, slot, t0_s)}; the limit is {limit_mps:.1f} m/s"
            found[slot.wish] = why
        elif not priced.pays:
            found[slot.wish] = _why(data.forecast, slot, t0_s)
    return found


def _why(forecast: DayForecast, slot: LaunchSlot, t0_s: float) -> str:
    t_s, height_m = t0_s + slot.launched_s, slot.volume.high_m
    wind = forecast.wind(t_s, height_m)
    return f"the forecast is {wind} at {height_m:.0f} m, {forecast.clock(t_s)}"


def grounded(
    nodes: DayProblem, held: dict[SortieRequest, str]
) -> tuple[DayProblem, list[Unplanned]]:
    """The problem in which these orders do not fly with drones of that kind, and those that nobody
    brings then.
    """
    kinds = [replace(kind, can_serve=kind.can_serve.copy()) for kind in nodes.problem.kinds]
    for wish in held:
        kinds[wish.kind].can_serve[wish.customer] = False
    problem = replace(nodes.problem, kinds=tuple(kinds))
    flies = np.any([kind.can_serve for kind in kinds], axis=0)
    left = [
        Unplanned(
            order=nodes.orders[wish.customer - 1].id,
            why=why[:1000],
            remedy="another hour, or the truck",
        )
        for wish, why in held.items()
        if not (flies[wish.customer] or problem.truck_can_serve[wish.customer])
    ]
    smaller = replace(nodes, problem=problem)
    return (without(smaller, {line.order for line in left}) if left else smaller), left
