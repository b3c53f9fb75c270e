"""Feasibility of a delivery by the vehicle's own energy model: flight out, drop, return, landing.

This is the desk's filter, not the promise: straight lines in the forecast wind, over the terrain of
the day's elevation, priced by `RouteEnergy` with a margin for the accepted loss. The companion
plans routes around obstacles and decides by its return budget in flight: it may still reject the
delivery, with a reason.
"""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import ndtri

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.mission.flight_file import Mission
from companion.core.mission.flight_plan import DROP_TOTAL_S, SETTLE_MARGIN_S
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.airframe import Airframe
from ground_station.core.feasibility.hills import Hills, hills_of
from ground_station.core.schema.day import Day, Drone, Forecast
from ground_station.core.schema.elevation import SiteElevation

Waypoints = tuple[tuple[float, float], ...]
"""Points (north, east) of a route around obstacles."""

DISTANCE_TOLERANCE_M = 1.0
"""Tolerance of distances in messages, which show whole metres."""

OUTBOUND_LEGS = 4
"""Climb, settling, cruise and descent, before the release; a route corner adds a cruise leg."""

PAYLOAD_STEP_KG = 0.1
"""Payloads are rounded up to this step, to limit the number of power tables."""


@dataclass(frozen=True, slots=True)
class SortieGeometry:
    """A delivery: ground points NED about the depot (`start` and `end`: the depot, or stops of the
    truck), route corners (north, east), and flight height above the depot (None: the mission's
    cruise height), which is higher over hills.
    """

    payload_kg: float
    start: Ned
    customer: Ned
    end: Ned
    height_m: float | None = None
    outbound_waypoints: Waypoints = ()
    return_waypoints: Waypoints = ()

    def height_above_depot_m(self, mission: Mission) -> float:
        """Return `height_m`, by default the mission's cruise height."""
        return mission.cruise_height_m if self.height_m is None else self.height_m

    @property
    def ground_ne_m(self) -> Waypoints:
        """Ground points and route corners, (north, east)."""
        points = (self.start[:2], self.customer[:2], self.end[:2])
        return points + self.outbound_waypoints + self.return_waypoints

    @property
    def columns_ne_m(self) -> Waypoints:
        """Points above which the vehicle climbs and descends, (north, east)."""
        return tuple(p[:2] for p in dict.fromkeys((self.start, self.customer, self.end)))


@dataclass(frozen=True, slots=True)
class SortieNeed:
    """Mean and standard deviation of a delivery's energy, its mean time, and that to the drop."""

    mean_wh: float
    std_wh: float
    time_s: float
    flyable: bool
    drop_s: float


@dataclass(frozen=True, slots=True)
class Feasible:
    """The drone can deliver, with this energy margin at the accepted loss."""

    spare_wh: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Infeasible:
    """The drone cannot deliver: the reason, and the condition that would make it possible."""

    reason: str
    remedy: str
    is_energy_short: bool = False
    """A launch and landing closer to the customer may resolve it."""


def route_energy_model_for_day(day: Day, airframe: Airframe) -> RouteEnergy:
    """Return the energy model of an airframe with the day's limits and air density."""
    return RouteEnergy.for_mission(airframe, day.mission, day.standard_air_at_depot.density_kgpm3)


class SortieFeasibility:
    """Delivery feasibility of one drone under a forecast."""

    def __init__(
        self,
        drone: Drone,
        airframe: Airframe,
        mission: Mission,
        forecast: Forecast,
        route_energy: RouteEnergy,
        hills: Hills | None = None,
    ) -> None:
        """`hills`: the terrain below the flights; None if level or unknown."""
        self.drone = drone
        self.hills = hills
        self.airframe = airframe
        self.mission = mission
        self.wind_to_ne_mps = np.array(forecast.to_ne_mps)
        self.wind_cov_ne_m2ps2 = forecast.std_mps**2 * np.eye(2)
        self.energy = route_energy
        self.sigmas = float(ndtri(1.0 - mission.max_loss))

    def copy_for_wind(self, forecast: Forecast) -> "SortieFeasibility":
        """Return a copy for another wind."""
        other = copy.copy(self)
        other.wind_to_ne_mps = np.array(forecast.to_ne_mps)
        other.wind_cov_ne_m2ps2 = forecast.std_mps**2 * np.eye(2)
        return other

    def usable_above_reserve_wh_and_std(
        self, payload_kg: float, charge_frac: float | None = None
    ) -> tuple[float, float]:
        """Return the usable energy above the reserve, and its standard deviation."""
        full_wh = self.full_pack_usable_wh(payload_kg)
        left_wh = full_wh * (self.drone.charge_frac if charge_frac is None else charge_frac)
        std_wh = self.airframe.battery.usable_std_frac * left_wh
        return left_wh - self.mission.reserve_frac * full_wh, std_wh

    def full_pack_usable_wh(self, payload_kg: float) -> float:
        """Return the usable energy of the full pack."""
        draw_w = self.energy.hover_power_w(round_up_payload_kg(payload_kg))
        return self.airframe.battery.usable_energy_of_full_pack_wh(
            draw_w, self.drone.temperature_c, self.drone.battery_health_frac
        )

    def sortie_need(self, geometry: SortieGeometry) -> SortieNeed:
        """Compute energy and time of a delivery."""
        out, back = geometry.outbound_waypoints, geometry.return_waypoints
        level_m = geometry.height_above_depot_m(self.mission)
        up_m = (
            self._flight_height_over_hills_m(level_m, (geometry.start, *out, geometry.customer)),
            self._flight_height_over_hills_m(level_m, (geometry.customer, *back, geometry.end)),
        )
        leg_list = self._delivery_legs(geometry, up_m)
        costs = self.energy.leg_costs_wind_major(leg_list, self.wind_to_ne_mps[None, :])
        mean_wh = float(costs.energy_wh.sum())
        wind_wh = self.energy.route_energy_std_wh(
            leg_list, self.wind_to_ne_mps, self.wind_cov_ne_m2ps2
        )
        model_wh = self.airframe.power_rotor.model_std_frac * mean_wh
        std_wh = math.hypot(wind_wh, model_wh)
        time_s = costs.time_s.ravel()
        drop_s = float(time_s[: len(out) + OUTBOUND_LEGS].sum())
        return SortieNeed(
            mean_wh, std_wh, float(costs.time_s.sum()), bool(costs.feasible.all()), drop_s
        )

    def check_delivery(
        self,
        payload_kg: float,
        customer: Ned,
        start: Ned = (0.0, 0.0, 0.0),
        end: Ned = (0.0, 0.0, 0.0),
        charge_frac: float | None = None,
        need: SortieNeed | None = None,
    ) -> Feasible | Infeasible:
        """Check whether payload, wind and energy allow this delivery at the accepted loss.

        `need`: its energy and time if already computed.
        """
        most_kg = self.airframe.mass.max_payload_kg
        if payload_kg > most_kg:
            return Infeasible(
                f"{payload_kg:g} kg, {self.drone.airframe} carries {most_kg:g} kg",
                f"a parcel of at most {most_kg:g} kg, or the truck",
            )
        if lift_error := self.energy.overload_reason_or_empty(payload_kg):
            return Infeasible(lift_error, "a lighter parcel, cooler air, or the truck")
        need = need or self.sortie_need(SortieGeometry(payload_kg, start, customer, end))
        spare_wh = self._energy_margin_wh(need, payload_kg, charge_frac)
        if need.flyable and spare_wh >= 0.0:
            return Feasible(spare_wh, need.time_s)
        return self._infeasible_result(need, spare_wh, payload_kg, customer, charge_frac)

    def can_lift(self, payload_kg: float) -> bool:
        """Return whether the payload limit and the air density allow this parcel."""
        too_heavy = payload_kg > self.airframe.mass.max_payload_kg
        return not (too_heavy or self.energy.overload_reason_or_empty(payload_kg))

    def is_within_energy_budget(
        self, need: SortieNeed, payload_kg: float, charge_frac: float | None
    ) -> bool:
        """Return whether a pack with this charge suffices at the accepted loss."""
        return need.flyable and self._energy_margin_wh(need, payload_kg, charge_frac) >= 0.0

    def sortie_need_if_feasible(self, geometry: SortieGeometry) -> SortieNeed | None:
        """Return energy and time of a delivery; None if infeasible at the accepted loss."""
        need = self.sortie_need(geometry)
        return need if self.is_within_energy_budget(need, geometry.payload_kg, None) else None

    def _energy_margin_wh(
        self, need: SortieNeed, payload_kg: float, charge_frac: float | None
    ) -> float:
        budget_wh, budget_std_wh = self.usable_above_reserve_wh_and_std(payload_kg, charge_frac)
        return budget_wh - need.mean_wh - self.sigmas * math.hypot(need.std_wh, budget_std_wh)

    @property
    def upwind_unit_vector_ne(self) -> tuple[float, float]:
        """Unit vector against the wind; north in a calm."""
        speed_mps = float(np.hypot(*self.wind_to_ne_mps))
        if speed_mps < 0.1:
            return 1.0, 0.0
        return -float(self.wind_to_ne_mps[0]) / speed_mps, -float(
            self.wind_to_ne_mps[1]
        ) / speed_mps

    def _infeasible_result(
        self,
        need: SortieNeed,
        spare_wh: float,
        payload_kg: float,
        customer: Ned,
        charge_frac: float | None,
    ) -> Infeasible:
        if not need.flyable:
            return Infeasible("the wind is too strong to fly against", "less wind, or the truck")
        reason = f"{-spare_wh:.0f} Wh short at the accepted loss of {self.mission.max_loss:g}"
        full = self._energy_margin_wh(need, payload_kg, 1.0)
        at = self.drone.charge_frac if charge_frac is None else charge_frac
        if at < 1.0 and full >= 0.0:
            return Infeasible(reason, "a full battery", is_energy_short=True)
        stop_m = self.max_stop_distance_from_customer_m(payload_kg, customer)
        remedy = (
            "less wind" if stop_m <= 0.0 else f"a launch and landing within {stop_m:.0f} m of it"
        )
        return Infeasible(reason, f"{remedy}, or the truck", is_energy_short=True)

    def max_stop_distance_from_customer_m(
        self, payload_kg: float, customer: Ned, charge_frac: float = 1.0
    ) -> float:
        """Return the greatest distance from the customer, towards the depot, to start and land."""
        far_m = math.hypot(customer[0], customer[1])

        def energy_margin_at_wh(stop_distance_m: float) -> float:
            share = 1.0 - stop_distance_m / far_m
            stop = (share * customer[0], share * customer[1], customer[2])
            need = self.sortie_need(SortieGeometry(payload_kg, stop, customer, stop))
            return (
                self._energy_margin_wh(need, payload_kg, charge_frac) if need.flyable else -math.inf
            )

        return find_max_feasible_distance_m(energy_margin_at_wh, far_m) if far_m > 0.0 else 0.0

    def _delivery_legs(
        self, geometry: SortieGeometry, outbound_and_return_height_m: tuple[float, float]
    ) -> tuple[Leg, ...]:
        """`outbound_and_return_height_m`: outbound and return heights above the depot."""
        start, customer, end = geometry.start, geometry.customer, geometry.end
        payload_kg = round_up_payload_kg(geometry.payload_kg)
        out, back = (-height_m for height_m in outbound_and_return_height_m)
        drop = customer[2] - self.mission.drop_height_m
        over_start, over = (start[0], start[1], out), (customer[0], customer[1], out)
        over_again, over_end = (customer[0], customer[1], back), (end[0], end[1], back)
        low = (customer[0], customer[1], drop)
        return (
            Leg(LegKind.CLIMB, start, over_start, payload_kg),
            Leg(
                LegKind.HOVER,
                over_start,
                over_start,
                payload_kg,
                duration_s=self.loiter_before_departure_s,
            ),
            *_cruise_legs(over_start, geometry.outbound_waypoints, over, payload_kg),
            Leg(LegKind.DESCEND, over, low, payload_kg),
            Leg(LegKind.HOVER, low, low, payload_kg, duration_s=DROP_TOTAL_S),
            Leg(LegKind.CLIMB, low, over_again, 0.0),
            *_cruise_legs(over_again, geometry.return_waypoints, over_end, 0.0),
            Leg(LegKind.LAND, over_end, end, 0.0),
        )

    def _flight_height_over_hills_m(
        self, layer_height_m: float, route: Sequence[Sequence[float]]
    ) -> float:
        """Return the height above the depot of a route over the hills below it."""
        if self.hills is None:
            return layer_height_m
        points = np.array([point[:2] for point in route])
        least_m = float(self.hills.min_flight_height_above_depot_m(points[:-1], points[1:]).max())
        return float(flight_height_over_hills_m(self.mission, layer_height_m, least_m))

    @property
    def loiter_before_departure_s(self) -> float:
        """Loiter time over the pad before departure."""
        return self.mission.wind_settle_s + SETTLE_MARGIN_S


class DayFeasibility:
    """Creates `SortieFeasibility` for a day's drones; energy models and terrain are cached."""

    def __init__(
        self, day: Day, airframes: Mapping[str, Airframe], elevation: SiteElevation | None = None
    ) -> None:
        self._day, self._airframes, self._hills = day, airframes, hills_of(day, elevation)
        self._energies: dict[str, RouteEnergy] = {}

    def of_drone(self, drone: Drone, wind: Forecast | None = None) -> SortieFeasibility:
        """Return the feasibility for a drone in this wind; None: the day's forecast."""
        day, airframe = self._day, self._airframes[drone.airframe]
        if drone.airframe not in self._energies:
            self._energies[drone.airframe] = route_energy_model_for_day(day, airframe)
        energy = self._energies[drone.airframe]
        wind = wind or day.forecast
        return SortieFeasibility(drone, airframe, day.mission, wind, energy, self._hills)


def flight_height_over_hills_m(
    mission: Mission, layer_height_m: Floats | float, min_height_over_terrain_m: Floats | float
) -> Floats:
    """Return the flight height in the layer at `layer_height_m` where the terrain requires
    `min_height_over_terrain_m`. The height of a layer above the cruise height is added over terrain
    as over the depot.
    """
    return np.asarray(
        np.maximum(
            layer_height_m,
            np.add(min_height_over_terrain_m, layer_height_m) - mission.cruise_height_m,
        )
    )


def find_max_feasible_distance_m(
    energy_margin_at: Callable[[float], float], max_distance_m: float
) -> float:
    """Find the zero of falling `energy_margin_at`, up to `max_distance_m`, `DISTANCE_TOLERANCE_M`
    below it.

    Energy is almost linear in the distance, so the chord's zero and a step past it bracket the
    result; where that does not halve the bracket, bisection does.
    """
    low, high = (0.0, energy_margin_at(0.0)), (max_distance_m, energy_margin_at(max_distance_m))
    if low[1] < 0.0 or high[1] >= 0.0:
        return 0.0 if low[1] < 0.0 else max_distance_m
    halves = False
    while (width := high[0] - low[0]) > DISTANCE_TOLERANCE_M:
        middle = 0.5 * (low[0] + high[0]) if halves else _near_chord_zero(low, high)
        at = (middle, energy_margin_at(middle))
        low, high = (at, high) if at[1] >= 0.0 else (low, at)
        halves = high[0] - low[0] > 0.5 * width
    return low[0]


def _near_chord_zero(
    low_distance_and_margin: tuple[float, float], high_distance_and_margin: tuple[float, float]
) -> float:
    """Return the chord's zero, shifted by half of `DISTANCE_TOLERANCE_M` towards the more distant
    end.
    """
    width = high_distance_and_margin[0] - low_distance_and_margin[0]
    if not math.isfinite(high_distance_and_margin[1]):
        return low_distance_and_margin[0] + 0.5 * width
    chord = low_distance_and_margin[0] + width * low_distance_and_margin[1] / (
        low_distance_and_margin[1] - high_distance_and_margin[1]
    )
    offset_m = (
        0.5 * DISTANCE_TOLERANCE_M
        if chord - low_distance_and_margin[0] < high_distance_and_margin[0] - chord
        else -0.5 * DISTANCE_TOLERANCE_M
    )
    return min(
        max(chord + offset_m, low_distance_and_margin[0] + 0.25 * DISTANCE_TOLERANCE_M),
        high_distance_and_margin[0] - 0.25 * DISTANCE_TOLERANCE_M,
    )


def _cruise_legs(start: Ned, waypoints: Waypoints, end: Ned, payload_kg: float) -> list[Leg]:
    points = [start, *((north, east, start[2]) for north, east in waypoints), end]
    return [Leg(LegKind.CRUISE, a, b, payload_kg) for a, b in pairwise(points)]


def round_up_payload_kg(payload_kg: float) -> float:
    """Round a payload up to `PAYLOAD_STEP_KG`."""
    return math.ceil(payload_kg / PAYLOAD_STEP_KG - 1e-9) * PAYLOAD_STEP_KG
