"""Cost tables for thousands of sorties: the energy model of `SortieFeasibility`, leg by leg.

`SortieFeasibility` checks `budget - mean - z hypot(wind, model, battery)` of a whole sortie, with z
for the accepted loss. That is not a sum of an outbound and a return table, but its upper bound is:
the deviation of a sum is at most the sum of the legs' deviations (Minkowski), and
`hypot(s, c) <= c + k s` for every s within the budget, where k is the slope of the chord. A sortie
that is feasible here is therefore feasible by `SortieFeasibility` and keeps the accepted loss.
Energy is expressed as seconds of hover without a parcel in that wind.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.mission.flight_plan import DROP_TOTAL_S
from companion.core.routing.leg_energy import Leg, LegKind
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes, Price
from ground_station.core.feasibility.reach import (
    PAYLOAD_STEP_KG,
    SortieFeasibility,
    flight_height_over_hills_m,
)
from ground_station.core.truck_drones.problem import LegTables

COURSES = 360
COURSE_MARGIN = 1.0 + 1e-4
"""A leg is priced as the more expensive of the two adjacent courses. Half a degree from both, a
price that varies with the cosine exceeds them by at most (pi / 360)^2 / 2 = 4e-5."""
SHORT_M, LONG_M = 100.0, 1100.0
LOW_M, HIGH_M = 30.0, 90.0


@dataclass(frozen=True, slots=True)
class _LinearPrice:
    """A price linear in length: intercept and slope per metre. Scalars, or by course."""

    base: Price
    per_m: Price

    def price_at(self, length_m: Floats) -> Price:
        """Return the price of this length."""
        at_length = (b + length_m * m for b, m in zip(self.base, self.per_m, strict=True))
        return Price(*at_length)

    def max_energy_std_to_mean_ratio(self) -> float:
        """Return the largest ratio of standard deviation to mean energy."""
        found = 0.0
        for price in (self.base, self.per_m):
            some = np.isfinite(price.energy_wh) & (price.energy_wh > 1e-12)
            ratio = np.divide(
                price.std_wh, price.energy_wh, where=some, out=np.zeros_like(price.energy_wh)
            )
            found = max(found, float(ratio.max(initial=0.0)))
        return found


@dataclass(frozen=True, slots=True)
class _PhaseRates:
    """Prices of one payload: cruise by course, climb, descent to the drop, landing, hover."""

    cruise: _LinearPrice
    climb: _LinearPrice
    descend: _LinearPrice
    land: _LinearPrice
    settle: Price
    drop: Price

    def max_energy_std_to_mean_ratio(self) -> float:
        """Return the largest ratio of standard deviation to mean energy of all phases."""
        lines = (self.cruise, self.climb, self.descend, self.land)
        return max(line.max_energy_std_to_mean_ratio() for line in lines)


class WindSortieModel:
    """Sortie model over ground positions (NED about the depot), one `SortieFeasibility` per drone
    kind.
    """

    def __init__(
        self,
        ned_m: Floats,
        payload_kg: Floats,
        height_m: Floats,
        feasibilities: Sequence[SortieFeasibility],
        routes: ObstacleRoutes,
        pad_offset_m: float = 0.0,
    ) -> None:
        """`height_m`: flight height above the depot to each position, more over the hills of
        `feasibilities`. `pad_offset_m`: greatest distance of a pad from its stop, added to each
        cruise length.
        """
        self._ned_m, self._feasibilities = ned_m, feasibilities
        self._height_m = _flight_height_matrix_m(ned_m, height_m, feasibilities)
        self._steps = np.ceil(payload_kg / PAYLOAD_STEP_KG - 1e-9).astype(np.int64)
        self._routes, self._pad_offset_m = routes, pad_offset_m

    def leg_tables(self, drone_kind: int) -> LegTables:
        """Return times and energies of this kind of drone between all positions."""
        feasibility = self._feasibilities[drone_kind]
        steps = np.unique(self._steps).tolist()
        rates = {step: _phase_rates(feasibility, step * PAYLOAD_STEP_KG) for step in {0, *steps}}
        budgets = {
            step: feasibility.usable_above_reserve_wh_and_std(step * PAYLOAD_STEP_KG)
            for step in rates
        }
        slope = _energy_std_chord_slope(feasibility, list(rates.values()), list(budgets.values()))
        weight = feasibility.sigmas * slope
        count = len(self._ned_m)
        out_s, out_wh = np.empty((count, count)), np.empty((count, count))
        guaranteed_wh = {step: wh - feasibility.sigmas * std for step, (wh, std) in budgets.items()}
        for step in steps:
            to = self._steps == step
            out = self._outbound_price_matrix(rates[step])
            out_s[:, to] = out.time_s[:, to]
            less_wh = max(0.0, guaranteed_wh[0] - guaranteed_wh[step])
            out_wh[:, to] = (out.energy_wh + weight * out.std_wh)[:, to] + less_wh
        back = self._return_price_matrix(rates[0])
        hover = rates[0].settle
        hover_wh_per_s = float((hover.energy_wh + weight * hover.std_wh) / hover.time_s)
        return LegTables(
            out_s=out_s,
            back_s=back.time_s,
            out_hover_s=out_wh / hover_wh_per_s,
            back_hover_s=(back.energy_wh + weight * back.std_wh) / hover_wh_per_s,
            endurance_hover_s=max(0.0, guaranteed_wh[0] / hover_wh_per_s),
        )

    def extra_climb_time_and_hover_s(
        self, drone_kind: int, extra_height_m: float
    ) -> tuple[float, float]:
        """Return the additional time (s) and energy (seconds of hover) of a sortie that flies this
        much higher, with the heaviest parcel.
        """
        feasibility = self._feasibilities[drone_kind]
        loaded, empty = (
            _phase_rates(feasibility, step * PAYLOAD_STEP_KG)
            for step in (int(self._steps.max()), 0)
        )
        both = (loaded.climb, loaded.descend, empty.climb, empty.land)
        added = [Price(*(extra_height_m * part for part in line.per_m)) for line in both]
        weight = feasibility.sigmas
        hover_wh_per_s = float(empty.settle.energy_wh / empty.settle.time_s)
        wh = sum(float(one.energy_wh + weight * one.std_wh) for one in added)
        return sum(float(one.time_s) for one in added), wh / hover_wh_per_s

    def _outbound_price_matrix(self, rates: _PhaseRates) -> Price:
        """Price from each position (row), with the parcel, to each position's drop (column)."""
        up_m = -self._ned_m[:, 2]
        rise_m = np.maximum(self._height_m - up_m[:, None], 0.0)
        mission = self._feasibilities[0].mission
        sink_m = np.maximum(self._height_m - up_m[None, :] - mission.drop_height_m, 0.0)
        verticals = rates.climb.price_at(rise_m).sum_with_added_std(rates.descend.price_at(sink_m))
        waits = rates.settle.sum_with_added_std(rates.drop)
        return (
            self._routes.price_routes(self._cruise_price_function(rates))
            .sum_with_added_std(verticals)
            .sum_with_added_std(waits)
        )

    def _return_price_matrix(self, rates: _PhaseRates) -> Price:
        """Price from each position's drop (row) to the ground at each position (column)."""
        up_m = -self._ned_m[:, 2]
        mission = self._feasibilities[0].mission
        height_m = self._height_m.T
        rise_m = np.maximum(height_m - up_m[:, None] - mission.drop_height_m, 0.0)
        sink_m = np.maximum(height_m - up_m[None, :], 0.0)
        verticals = rates.climb.price_at(rise_m).sum_with_added_std(rates.land.price_at(sink_m))
        return self._routes.price_routes(self._cruise_price_function(rates)).sum_with_added_std(
            verticals
        )

    def _cruise_price_function(self, rates: _PhaseRates):
        def cruise_price_matrix(starts_ne_m: Floats, ends_ne_m: Floats) -> Price:
            away = ends_ne_m[None, :, :] - starts_ne_m[:, None, :2]
            # Not 0: an infinite price times zero length would be NaN.
            length_m = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-6) + self._pad_offset_m
            turn = np.arctan2(away[..., 1], away[..., 0]) / (2.0 * np.pi) * COURSES
            below = np.floor(turn).astype(np.int64) % COURSES
            adjacent = [
                _cruise_price_by_course(rates.cruise, side % COURSES, length_m)
                for side in (below, below + 1)
            ]
            return Price(
                *(np.maximum(a, b) * COURSE_MARGIN for a, b in zip(*adjacent, strict=True))
            )

        return cruise_price_matrix


def _flight_height_matrix_m(
    ned_m: Floats, height_m: Floats, feasibilities: Sequence[SortieFeasibility]
) -> Floats:
    """Return flight heights between a start or landing (row) and a customer (column), (n, n)."""
    count = len(ned_m)
    level_m = np.broadcast_to(height_m[None, :], (count, count))
    hills = feasibilities[0].hills if feasibilities else None
    if hills is None:
        return level_m
    first, second = np.triu_indices(count)
    least_m = np.empty((count, count))
    least_m[first, second] = hills.min_flight_height_above_depot_m(
        ned_m[first, :2], ned_m[second, :2]
    )
    least_m[second, first] = least_m[first, second]
    return flight_height_over_hills_m(feasibilities[0].mission, level_m, least_m)


def _cruise_price_by_course(
    cruise: _LinearPrice, course_index: np.ndarray, length_m: Floats
) -> Price:
    return Price(
        *(
            b[course_index] + length_m * m[course_index]
            for b, m in zip(cruise.base, cruise.per_m, strict=True)
        )
    )


def _energy_std_chord_slope(
    feasibility: SortieFeasibility, rates: list[_PhaseRates], budgets: list[tuple[float, float]]
) -> float:
    """Return the slope k of `hypot(s, c) <= c + k s` for every deviation s within the budget.

    mean + z s <= budget and s <= r mean imply s <= budget / (z + 1 / r).
    """
    ratio = max(rate.max_energy_std_to_mean_ratio() for rate in rates)
    most_wh = max(budget for budget, _ in budgets)
    most_std_wh = max(most_wh, 1e-9) / (feasibility.sigmas + 1.0 / max(ratio, 1e-9))
    least_battery_wh = min(std for _, std in budgets)
    return (math.hypot(most_std_wh, least_battery_wh) - least_battery_wh) / most_std_wh


def _phase_rates(feasibility: SortieFeasibility, payload_kg: float) -> _PhaseRates:
    ground, low, high = (0.0, 0.0, 0.0), (0.0, 0.0, -LOW_M), (0.0, 0.0, -HIGH_M)
    before = Leg(LegKind.HOVER, low, low, payload_kg)
    after = Leg(LegKind.CRUISE, (-LONG_M, 0.0, -LOW_M), low, payload_kg)
    after_high = Leg(LegKind.CRUISE, (-LONG_M, 0.0, -HIGH_M), high, payload_kg)
    angles = np.arange(COURSES) * (2.0 * np.pi / COURSES)

    def cruise_legs_by_course(length_m: float) -> list[Leg]:
        return [
            Leg(LegKind.CRUISE, low, _cruise_end_ned_m(length_m, angle), payload_kg)
            for angle in angles
        ]

    def vertical_phase_price(
        kind: LegKind, leg_before_low: Leg | None, leg_before_high: Leg | None
    ) -> _LinearPrice:
        up = kind is LegKind.CLIMB
        leg_list = [
            Leg(kind, ground, top, payload_kg) if up else Leg(kind, top, ground, payload_kg)
            for top in (low, high)
        ]
        line = _fit_price_line_over_length(
            feasibility,
            leg_list[:1],
            leg_list[1:],
            [leg_before_low],
            [leg_before_high],
            LOW_M,
            HIGH_M,
        )
        return _LinearPrice(_price_of_first_leg(line.base), _price_of_first_leg(line.per_m))

    def hover_price(seconds: float) -> Price:
        leg = Leg(LegKind.HOVER, low, low, payload_kg, duration_s=seconds)
        mean_time_energy, gradient = _leg_time_energy_and_wind_gradient(feasibility, [leg], [None])
        return _price_of_first_leg(_price_with_energy_std(feasibility, mean_time_energy, gradient))

    hovers = [before] * COURSES
    near, far = cruise_legs_by_course(SHORT_M), cruise_legs_by_course(LONG_M)
    return _PhaseRates(
        cruise=_fit_price_line_over_length(feasibility, near, far, hovers, hovers, SHORT_M, LONG_M),
        climb=vertical_phase_price(LegKind.CLIMB, None, None),
        descend=vertical_phase_price(LegKind.DESCEND, after, after_high),
        land=vertical_phase_price(LegKind.LAND, after, after_high),
        settle=hover_price(feasibility.loiter_before_departure_s),
        drop=hover_price(DROP_TOTAL_S),
    )


def _cruise_end_ned_m(length_m: float, angle: float) -> Ned:
    return length_m * float(np.cos(angle)), length_m * float(np.sin(angle)), -LOW_M


def _price_of_first_leg(price: Price) -> Price:
    return Price(*(table[0] for table in price))


def _fit_price_line_over_length(
    feasibility: SortieFeasibility,
    short: list[Leg],
    long: list[Leg],
    before_short: Sequence[Leg | None],
    before_long: Sequence[Leg | None],
    short_m: float,
    long_m: float,
) -> _LinearPrice:
    """Fit the line through the prices of the same legs at two lengths."""
    (s, wh), gradient = _leg_time_energy_and_wind_gradient(feasibility, short, before_short)
    (far_s, far_wh), far_gradient = _leg_time_energy_and_wind_gradient(
        feasibility, long, before_long
    )
    over_m = long_m - short_m
    rise_s = (far_s - s) / over_m
    possible = np.isfinite(wh) & np.isfinite(far_wh)  # else the price at zero length is infinite
    rise_wh = np.subtract(far_wh, wh, where=possible, out=np.zeros_like(wh)) / over_m
    rise_gradient = (far_gradient - gradient) / over_m
    base = (s - short_m * rise_s, wh - short_m * rise_wh)
    return _LinearPrice(
        _price_with_energy_std(feasibility, base, gradient - short_m * rise_gradient),
        _price_with_energy_std(feasibility, (rise_s, rise_wh), rise_gradient),
    )


def _leg_time_energy_and_wind_gradient(
    feasibility: SortieFeasibility, leg_list: Sequence[Leg], previous_legs: Sequence[Leg | None]
) -> tuple[tuple[Floats, Floats], Floats]:
    """Return time and mean energy of each leg, and the gradient of its energy to the wind."""
    compiled = feasibility.energy.group_legs_by_cost_formula(tuple(leg_list), tuple(previous_legs))
    costs = feasibility.energy.leg_costs_wind_major(compiled, feasibility.wind_to_ne_mps[None, :])
    wh = np.where(costs.feasible[0], costs.energy_wh[0], np.inf)
    return (costs.time_s[0], wh), feasibility.energy.leg_energy_gradients_wh_per_mps(
        compiled, feasibility.wind_to_ne_mps
    )


def _price_with_energy_std(
    feasibility: SortieFeasibility, mean_time_energy: tuple[Floats, Floats], gradient: Floats
) -> Price:
    """Add the standard deviation due to wind error and power model error."""
    s, wh = mean_time_energy
    wind = np.einsum("li,ij,lj->l", gradient, feasibility.wind_cov_ne_m2ps2, gradient)
    model_wh = feasibility.airframe.power_rotor.model_std_frac * np.abs(wh)
    infeasible = ~np.isfinite(wh)
    std_wh = np.hypot(np.sqrt(np.maximum(wind, 0.0)), np.where(infeasible, 0.0, model_wh))
    return Price(s, np.where(infeasible, np.inf, wh), std_wh)
