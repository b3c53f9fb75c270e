"""What a drone can bring, by the energy model that it flies with: out, drop, home, landed.

This is the desk's filter, not the promise: a straight line each way in the forecast wind, over the
hills that the day's elevation has, priced by `RouteEnergy` and widened to the accepted loss. Routes
around obstacles and the decisions of the return budget in flight are the companion's: it may still
refuse, and then says why.
"""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import ndtri

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.mission.flight_file import Mission
from companion.core.mission.flight_plan import DROP_S, SETTLE_SLACK_S
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.airframe import Airframe
from ground_station.core.feasibility.hills import Hills
from ground_station.core.schema.day import Day, Drone, Forecast

Waypoints = tuple[tuple[float, float], ...]
"""Points (north, east) of a route around obstacles."""

FITS_M = 1.0
"""A distance that people read, in whole metres."""

PAYLOAD_STEP_KG = 0.1
"""Payloads are rounded up to this step, so that few power tables are made."""


@dataclass(frozen=True, slots=True)
class SortieNeed:
    """Energy and time of a delivery: mean and standard deviation of the energy, and the mean
    time.
    """

    mean_wh: float
    std_wh: float
    time_s: float
    flyable: bool


@dataclass(frozen=True, slots=True)
class Feasible:
    """The drone can bring it, with this much energy to spare at the accepted loss."""

    spare_wh: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Infeasible:
    """The drone cannot bring it: why, and what would make it possible."""

    why: str
    remedy: str


def day_energy(day: Day, airframe: Airframe) -> RouteEnergy:
    """The energy model of one airframe on a day: its limits, its air."""
    return RouteEnergy.for_mission(airframe, day.mission, day.air.density_kgpm3)


class Reach:
    """What one drone can bring under a forecast."""

    def __init__(
        self,
        drone: Drone,
        airframe: Airframe,
        mission: Mission,
        forecast: Forecast,
        route_energy: RouteEnergy,
        hills: Hills | None = None,
    ) -> None:
        """`hills`: what the flights climb over; None: level ground, or none that is known."""
        self.drone = drone
        self.hills = hills
        self.airframe = airframe
        self.mission = mission
        self.wind_to_ne_mps = np.array(forecast.to_ne_mps)
        self.wind_cov_ne_m2ps2 = forecast.std_mps**2 * np.eye(2)
        self.energy = route_energy
        self.sigmas = float(ndtri(1.0 - mission.max_loss))

    def in_wind(self, forecast: Forecast) -> "Reach":
        """The same drone in another wind."""
        other = copy.copy(self)
        other.wind_to_ne_mps = np.array(forecast.to_ne_mps)
        other.wind_cov_ne_m2ps2 = forecast.std_mps**2 * np.eye(2)
        return other

    def budget_wh(self, payload_kg: float, charge_frac: float | None = None) -> tuple[float, float]:
        """Usable energy above the reserve, and its standard deviation."""
        full_wh = self.full_wh(payload_kg)
        left_wh = full_wh * (self.drone.charge_frac if charge_frac is None else charge_frac)
        std_wh = self.airframe.battery.usable_std_frac * left_wh
        return left_wh - self.mission.reserve_frac * full_wh, std_wh

    def full_wh(self, payload_kg: float) -> float:
        """Usable energy of its full pack."""
        draw_w = self.energy.hover_power_w(rounded_up(payload_kg))
        return self.airframe.battery.usable_wh(
            draw_w, self.drone.temperature_c, self.drone.battery_health_frac
        )

    def need(
        self,
        payload_kg: float,
        start: Ned,
        customer: Ned,
        end: Ned,
        height_m: float | None = None,
        out_via: Waypoints = (),
        back_via: Waypoints = (),
    ) -> SortieNeed:
        """Energy and time of a delivery. `customer` is the ground point there, NED about the
        depot.

        `start` and `end` are ground points too: the depot, or stops of the truck. The flight is
        `height_m` above the depot (None: the mission's cruise height), or higher over hills, by the
        points (north, east) given.
        """
        level_m = self.mission.cruise_height_m if height_m is None else height_m
        up_m = (
            self._over_hills_m(level_m, (start, *out_via, customer)),
            self._over_hills_m(level_m, (customer, *back_via, end)),
        )
        legs = self._legs(rounded_up(payload_kg), (start, customer, end), up_m, out_via, back_via)
        costs = self.energy.costs(legs, self.wind_to_ne_mps[None, :])
        mean_wh = float(costs.energy_wh.sum())
        wind_wh = self.energy.route_std_wh(legs, self.wind_to_ne_mps, self.wind_cov_ne_m2ps2)
        model_wh = self.airframe.power_rotor.model_std_frac * mean_wh
        std_wh = math.hypot(wind_wh, model_wh)
        return SortieNeed(mean_wh, std_wh, float(costs.time_s.sum()), bool(costs.feasible.all()))

    def can_bring(
        self,
        payload_kg: float,
        customer: Ned,
        start: Ned = (0.0, 0.0, 0.0),
        end: Ned = (0.0, 0.0, 0.0),
        charge_frac: float | None = None,
        need: SortieNeed | None = None,
    ) -> Feasible | Infeasible:
        """Whether payload, wind and energy allow this delivery at the accepted loss.

        `need`: what it takes, where that is known already.
        """
        most_kg = self.airframe.mass.max_payload_kg
        if payload_kg > most_kg:
            return Infeasible(
                f"{payload_kg:g} kg, {self.drone.airframe} carries {most_kg:g} kg",
                f"a parcel of at most {most_kg:g} kg, or the truck",
            )
        if trouble := self.energy.lift_trouble(payload_kg):
            return Infeasible(trouble, "a lighter parcel, cooler air, or the truck")
        need = need or self.need(payload_kg, start, customer, end)
        spare_wh = self._spare_wh(need, payload_kg, charge_frac)
        if need.flyable and spare_wh >= 0.0:
            return Feasible(spare_wh, need.time_s)
        return self._cannot(need, spare_wh, payload_kg, customer, charge_frac)

    def lifts(self, payload_kg: float) -> bool:
        """Whether it may carry this parcel, and can in this air."""
        too_heavy = payload_kg > self.airframe.mass.max_payload_kg
        return not (too_heavy or self.energy.lift_trouble(payload_kg))

    def pays(self, need: SortieNeed, payload_kg: float, charge_frac: float | None) -> bool:
        """Whether a pack with this charge pays for a delivery at the accepted loss."""
        return need.flyable and self._spare_wh(need, payload_kg, charge_frac) >= 0.0

    def affordable(
        self,
        payload_kg: float,
        start: Ned,
        customer: Ned,
        end: Ned,
        height_m: float,
        out_via: Waypoints = (),
        back_via: Waypoints = (),
    ) -> SortieNeed | None:
        """What a delivery takes, where the energy is there at the accepted loss."""
        need = self.need(payload_kg, start, customer, end, height_m, out_via, back_via)
        return need if need.flyable and self._spare_wh(need, payload_kg, None) >= 0.0 else None

    def _spare_wh(self, need: SortieNeed, payload_kg: float, charge_frac: float | None) -> float:
        budget_wh, budget_std_wh = self.budget_wh(payload_kg, charge_frac)
        return budget_wh - need.mean_wh - self.sigmas * math.hypot(need.std_wh, budget_std_wh)

    @property
    def upwind_ne(self) -> tuple[float, float]:
        """Unit vector against the wind; north in a calm."""
        speed_mps = float(np.hypot(*self.wind_to_ne_mps))
        if speed_mps < 0.1:
            return 1.0, 0.0
        return -float(self.wind_to_ne_mps[0]) / speed_mps, -float(
            self.wind_to_ne_mps[1]
        ) / speed_mps

    def _cannot(
        self,
        need: SortieNeed,
        spare_wh: float,
        payload_kg: float,
        customer: Ned,
        charge: float | None,
    ) -> Infeasible:
        if not need.flyable:
            return Infeasible("the wind is too strong to make way", "less wind, or the truck")
        why = f"{-spare_wh:.0f} Wh short at the accepted loss of {self.mission.max_loss:g}"
        full = self._spare_wh(need, payload_kg, 1.0)
        at = self.drone.charge_frac if charge is None else charge
        if at < 1.0 and full >= 0.0:
            return Infeasible(why, "a full battery")
        stop_m = self.radius_m(payload_kg, customer)
        if stop_m <= 0.0:
            return Infeasible(why, "less wind, or the truck")
        return Infeasible(why, f"a launch and landing within {stop_m:.0f} m of it, or the truck")

    def radius_m(self, payload_kg: float, customer: Ned, charge_frac: float = 1.0) -> float:
        """How far from this customer, towards the depot, it may start and land."""
        far_m = math.hypot(customer[0], customer[1])

        def spare_wh(middle_m: float) -> float:
            share = 1.0 - middle_m / far_m
            stop = (share * customer[0], share * customer[1], customer[2])
            need = self.need(payload_kg, stop, customer, stop)
            return self._spare_wh(need, payload_kg, charge_frac) if need.flyable else -math.inf

        return last_that_fits(spare_wh, far_m) if far_m > 0.0 else 0.0

    def _legs(
        self,
        payload_kg: float,
        grounds: tuple[Ned, Ned, Ned],
        up_m: tuple[float, float],
        out_via: Waypoints,
        back_via: Waypoints,
    ) -> tuple[Leg, ...]:
        """`up_m`: heights of the way out and of the way back above the depot."""
        start, customer, end = grounds
        out, back = (-height_m for height_m in up_m)
        drop = customer[2] - self.mission.drop_height_m
        over_start, over = (start[0], start[1], out), (customer[0], customer[1], out)
        over_again, over_end = (customer[0], customer[1], back), (end[0], end[1], back)
        low = (customer[0], customer[1], drop)
        return (
            Leg(LegKind.CLIMB, start, over_start, payload_kg),
            Leg(LegKind.HOVER, over_start, over_start, payload_kg, duration_s=self.settle_s),
            *_cruise(over_start, out_via, over, payload_kg),
            Leg(LegKind.DESCEND, over, low, payload_kg),
            Leg(LegKind.HOVER, low, low, payload_kg, duration_s=DROP_S),
            Leg(LegKind.CLIMB, low, over_again, 0.0),
            *_cruise(over_again, back_via, over_end, 0.0),
            Leg(LegKind.LAND, over_end, end, 0.0),
        )

    def _over_hills_m(self, level_m: float, way: Sequence[Sequence[float]]) -> float:
        """The height of a way by these points, above the depot, over the hills below it."""
        if self.hills is None:
            return level_m
        points = np.array([point[:2] for point in way])
        least_m = float(self.hills.least_height_m(points[:-1], points[1:]).max())
        return float(over_hills_m(self.mission, level_m, least_m))

    @property
    def settle_s(self) -> float:
        """How long it loiters over its pad before it leaves."""
        return self.mission.wind_settle_s + SETTLE_SLACK_S


def over_hills_m(mission: Mission, level_m: Floats | float, least_m: Floats | float) -> Floats:
    """The height of a flight in the layer at `level_m`, where the ground asks for `least_m`: a
    higher layer keeps as much more over the ground as over the depot.
    """
    return np.asarray(np.maximum(level_m, np.add(least_m, level_m) - mission.cruise_height_m))


def last_that_fits(spare: Callable[[float], float], far: float) -> float:
    """Where `spare`, which falls over 0 to `far`, reaches zero: `FITS_M` below that at most.

    Energy is almost linear in the distance, so the chord finds the place and a step beyond it
    proves it; where that does not halve what is left, the middle does.
    """
    low, high = (0.0, spare(0.0)), (far, spare(far))
    if low[1] < 0.0 or high[1] >= 0.0:
        return 0.0 if low[1] < 0.0 else far
    halves = False
    while (width := high[0] - low[0]) > FITS_M:
        middle = 0.5 * (low[0] + high[0]) if halves else _beside_chord(low, high)
        at = (middle, spare(middle))
        low, high = (at, high) if at[1] >= 0.0 else (low, at)
        halves = high[0] - low[0] > 0.5 * width
    return low[0]


def _beside_chord(low: tuple[float, float], high: tuple[float, float]) -> float:
    """Half of `FITS_M` beside the chord's zero, on the side of the end that is farther from it."""
    width = high[0] - low[0]
    if not math.isfinite(high[1]):
        return low[0] + 0.5 * width
    chord = low[0] + width * low[1] / (low[1] - high[1])
    beside = 0.5 * FITS_M if chord - low[0] < high[0] - chord else -0.5 * FITS_M
    return min(max(chord + beside, low[0] + 0.25 * FITS_M), high[0] - 0.25 * FITS_M)


def _cruise(start: Ned, via: Waypoints, end: Ned, payload_kg: float) -> list[Leg]:
    points = [start, *((north, east, start[2]) for north, east in via), end]
    return [Leg(LegKind.CRUISE, a, b, payload_kg) for a, b in pairwise(points)]


def rounded_up(payload_kg: float) -> float:
    """The payload that a parcel is priced as."""
    return math.ceil(payload_kg / PAYLOAD_STEP_KG - 1e-9) * PAYLOAD_STEP_KG
