"""Tables of what sorties cost, for thousands of them: the energy model of `Reach`, leg by leg.

`Reach` asks of a whole sortie whether `budget - mean - z hypot(wind, model, battery)` is left, with
z for the accepted loss. That is not a sum of a table out and a table back, but an upper bound of it
is: the deviation of a sum is at most the sum of the legs' deviations (Minkowski), and
`hypot(s, c) <= c + k s` for every s that the budget can pay for, where k is the slope of the chord.
So what is feasible here is feasible there, and keeps the accepted loss. Energy is expressed as
seconds of hover without a parcel in that wind.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.mission.flight_plan import DROP_S
from companion.core.routing.leg_energy import Leg, LegKind
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes, Price
from ground_station.core.feasibility.reach import PAYLOAD_STEP_KG, Reach, over_hills_m
from ground_station.core.truck_drones.problem import Legs

COURSES = 360
BETWEEN_COURSES = 1.0 + 1e-4
"""A leg is priced as the dearer of the two courses beside its own. Half a degree from both the
price exceeds them by at most (pi / 360)^2 / 2 = 4e-5, for a price that varies with the cosine."""
SHORT_M, LONG_M = 100.0, 1100.0
LOW_M, HIGH_M = 30.0, 90.0


@dataclass(frozen=True, slots=True)
class _Line:
    """A price that is linear in a length: at zero length, and for each metre. Scalars, or by
    course.
    """

    base: Price
    per_m: Price

    def at(self, metres: Floats) -> Price:
        """The price of this length."""
        grown = (b + metres * m for b, m in zip(self.base, self.per_m, strict=True))
        return Price(*grown)

    def worst_ratio(self) -> float:
        """The largest standard deviation for each Wh of the mean."""
        found = 0.0
        for price in (self.base, self.per_m):
            some = np.isfinite(price.wh) & (price.wh > 1e-12)
            ratio = np.divide(price.std_wh, price.wh, where=some, out=np.zeros_like(price.wh))
            found = max(found, float(ratio.max(initial=0.0)))
        return found


@dataclass(frozen=True, slots=True)
class _Rates:
    """Prices of one payload: cruise by course, climb, descent to the drop, landing, waiting."""

    cruise: _Line
    climb: _Line
    descend: _Line
    land: _Line
    settle: Price
    drop: Price

    def worst_ratio(self) -> float:
        """The largest standard deviation for each Wh of the mean, over all."""
        lines = (self.cruise, self.climb, self.descend, self.land)
        return max(line.worst_ratio() for line in lines)


class WindSorties:
    """`SortieModel` over places (NED about the depot, on the ground), with one `Reach` for each
    kind.
    """

    def __init__(
        self,
        ned_m: Floats,
        payload_kg: Floats,
        height_m: Floats,
        reaches: Sequence[Reach],
        ways: ObstacleRoutes,
        beside_m: float = 0.0,
    ) -> None:
        """`height_m`: height above the depot of the flight to each place, over the reaches' hills
        more. `beside_m`: how far pads may be from their stop; each cruise is priced as that much
        longer.
        """
        self._ned_m, self._reaches = ned_m, reaches
        self._height_m = _heights_m(ned_m, height_m, reaches)
        self._steps = np.ceil(payload_kg / PAYLOAD_STEP_KG - 1e-9).astype(np.int64)
        self._ways, self._beside_m = ways, beside_m

    def legs(self, drone_kind: int) -> Legs:
        """Times and energies of this kind of drone between all places."""
        reach = self._reaches[drone_kind]
        steps = np.unique(self._steps).tolist()
        rates = {step: _rates(reach, step * PAYLOAD_STEP_KG) for step in {0, *steps}}
        budgets = {step: reach.budget_wh(step * PAYLOAD_STEP_KG) for step in rates}
        slope = _chord_slope(reach, list(rates.values()), list(budgets.values()))
        weight = reach.sigmas * slope
        count = len(self._ned_m)
        out_s, out_wh = np.empty((count, count)), np.empty((count, count))
        sure_wh = {step: wh - reach.sigmas * std for step, (wh, std) in budgets.items()}
        for step in steps:
            to = self._steps == step
            out = self._out(rates[step])
            out_s[:, to] = out.s[:, to]
            less_wh = max(0.0, sure_wh[0] - sure_wh[step])
            out_wh[:, to] = (out.wh + weight * out.std_wh)[:, to] + less_wh
        back = self._back(rates[0])
        hover = rates[0].settle
        hover_wh_per_s = float((hover.wh + weight * hover.std_wh) / hover.s)
        return Legs(
            out_s=out_s,
            back_s=back.s,
            out_hover_s=out_wh / hover_wh_per_s,
            back_hover_s=(back.wh + weight * back.std_wh) / hover_wh_per_s,
            endurance_hover_s=max(0.0, sure_wh[0] / hover_wh_per_s),
        )

    def rise(self, drone_kind: int, by_m: float) -> tuple[float, float]:
        """What flying so much higher adds to a sortie: seconds, and seconds of hover (energy), for
        the heaviest parcel that it may get.
        """
        reach = self._reaches[drone_kind]
        loaded, empty = (
            _rates(reach, step * PAYLOAD_STEP_KG) for step in (int(self._steps.max()), 0)
        )
        both = (loaded.climb, loaded.descend, empty.climb, empty.land)
        added = [Price(*(by_m * part for part in line.per_m)) for line in both]
        weight = reach.sigmas
        hover_wh_per_s = float(empty.settle.wh / empty.settle.s)
        wh = sum(float(one.wh + weight * one.std_wh) for one in added)
        return sum(float(one.s) for one in added), wh / hover_wh_per_s

    def _out(self, rates: _Rates) -> Price:
        """From each place (row), with the parcel, to each place (column) and its drop."""
        up_m = -self._ned_m[:, 2]
        rise_m = np.maximum(self._height_m - up_m[:, None], 0.0)
        mission = self._reaches[0].mission
        sink_m = np.maximum(self._height_m - up_m[None, :] - mission.drop_height_m, 0.0)
        verticals = rates.climb.at(rise_m).plus(rates.descend.at(sink_m))
        waits = rates.settle.plus(rates.drop)
        return self._ways.priced(self._cruise(rates)).plus(verticals).plus(waits)

    def _back(self, rates: _Rates) -> Price:
        """From each place's drop (row) to the ground at each place (column)."""
        up_m = -self._ned_m[:, 2]
        mission = self._reaches[0].mission
        height_m = self._height_m.T
        rise_m = np.maximum(height_m - up_m[:, None] - mission.drop_height_m, 0.0)
        sink_m = np.maximum(height_m - up_m[None, :], 0.0)
        verticals = rates.climb.at(rise_m).plus(rates.land.at(sink_m))
        return self._ways.priced(self._cruise(rates)).plus(verticals)

    def _cruise(self, rates: _Rates):
        def price_of(a_ne_m: Floats, b_ne_m: Floats) -> Price:
            away = b_ne_m[None, :, :] - a_ne_m[:, None, :2]
            # Not 0: an infinite price times no length would be NaN.
            length_m = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-6) + self._beside_m
            turn = np.arctan2(away[..., 1], away[..., 0]) / (2.0 * np.pi) * COURSES
            below = np.floor(turn).astype(np.int64) % COURSES
            sides = [
                _by_course(rates.cruise, side % COURSES, length_m) for side in (below, below + 1)
            ]
            return Price(*(np.maximum(a, b) * BETWEEN_COURSES for a, b in zip(*sides, strict=True)))

        return price_of


def _heights_m(ned_m: Floats, height_m: Floats, reaches: Sequence[Reach]) -> Floats:
    """Heights of the flight between a start or landing (row) and a customer (column), (n, n)."""
    count = len(ned_m)
    level_m = np.broadcast_to(height_m[None, :], (count, count))
    hills = reaches[0].hills if reaches else None
    if hills is None:
        return level_m
    first, second = np.triu_indices(count)
    least_m = np.empty((count, count))
    least_m[first, second] = hills.least_height_m(ned_m[first, :2], ned_m[second, :2])
    least_m[second, first] = least_m[first, second]
    return over_hills_m(reaches[0].mission, level_m, least_m)


def _by_course(cruise: _Line, course: np.ndarray, length_m: Floats) -> Price:
    return Price(
        *(b[course] + length_m * m[course] for b, m in zip(cruise.base, cruise.per_m, strict=True))
    )


def _chord_slope(reach: Reach, rates: list[_Rates], budgets: list[tuple[float, float]]) -> float:
    """The slope k of `hypot(s, c) <= c + k s`, for every deviation s that the budget can pay for.

    From mean + z s <= budget and s <= r mean follows s <= budget / (z + 1 / r).
    """
    ratio = max(rate.worst_ratio() for rate in rates)
    most_wh = max(budget for budget, _ in budgets)
    most_std_wh = max(most_wh, 1e-9) / (reach.sigmas + 1.0 / max(ratio, 1e-9))
    least_battery_wh = min(std for _, std in budgets)
    return (math.hypot(most_std_wh, least_battery_wh) - least_battery_wh) / most_std_wh


def _rates(reach: Reach, payload_kg: float) -> _Rates:
    ground, low, high = (0.0, 0.0, 0.0), (0.0, 0.0, -LOW_M), (0.0, 0.0, -HIGH_M)
    before = Leg(LegKind.HOVER, low, low, payload_kg)
    after = Leg(LegKind.CRUISE, (-LONG_M, 0.0, -LOW_M), low, payload_kg)
    after_high = Leg(LegKind.CRUISE, (-LONG_M, 0.0, -HIGH_M), high, payload_kg)
    angles = np.arange(COURSES) * (2.0 * np.pi / COURSES)

    def cruises(length_m: float) -> list[Leg]:
        return [Leg(LegKind.CRUISE, low, _beyond(length_m, angle), payload_kg) for angle in angles]

    def vertical(kind: LegKind, first: Leg | None, second: Leg | None) -> _Line:
        up = kind is LegKind.CLIMB
        legs = [
            Leg(kind, ground, top, payload_kg) if up else Leg(kind, top, ground, payload_kg)
            for top in (low, high)
        ]
        line = _line(reach, legs[:1], legs[1:], [first], [second], LOW_M, HIGH_M)
        return _Line(_first(line.base), _first(line.per_m))

    def wait(seconds: float) -> Price:
        leg = Leg(LegKind.HOVER, low, low, payload_kg, duration_s=seconds)
        means, gradient = _priced(reach, [leg], [None])
        return _first(_with_std(reach, means, gradient))

    hovers = [before] * COURSES
    near, far = cruises(SHORT_M), cruises(LONG_M)
    return _Rates(
        cruise=_line(reach, near, far, hovers, hovers, SHORT_M, LONG_M),
        climb=vertical(LegKind.CLIMB, None, None),
        descend=vertical(LegKind.DESCEND, after, after_high),
        land=vertical(LegKind.LAND, after, after_high),
        settle=wait(reach.settle_s),
        drop=wait(DROP_S),
    )


def _beyond(length_m: float, angle: float) -> Ned:
    return length_m * float(np.cos(angle)), length_m * float(np.sin(angle)), -LOW_M


def _first(price: Price) -> Price:
    return Price(*(table[0] for table in price))


def _line(
    reach: Reach,
    short: list[Leg],
    long: list[Leg],
    before_short: Sequence[Leg | None],
    before_long: Sequence[Leg | None],
    short_m: float,
    long_m: float,
) -> _Line:
    """The line through the prices of the same legs at two lengths."""
    (s, wh), gradient = _priced(reach, short, before_short)
    (far_s, far_wh), far_gradient = _priced(reach, long, before_long)
    over_m = long_m - short_m
    rise_s = (far_s - s) / over_m
    possible = np.isfinite(wh) & np.isfinite(far_wh)  # else the price at zero length is infinite
    rise_wh = np.subtract(far_wh, wh, where=possible, out=np.zeros_like(wh)) / over_m
    rise_gradient = (far_gradient - gradient) / over_m
    base = (s - short_m * rise_s, wh - short_m * rise_wh)
    return _Line(
        _with_std(reach, base, gradient - short_m * rise_gradient),
        _with_std(reach, (rise_s, rise_wh), rise_gradient),
    )


def _priced(
    reach: Reach, legs: Sequence[Leg], before: Sequence[Leg | None]
) -> tuple[tuple[Floats, Floats], Floats]:
    """Time and mean energy of each leg, and the gradient of its energy to the wind."""
    compiled = reach.energy.compile(tuple(legs), tuple(before))
    costs = reach.energy.costs(compiled, reach.wind_to_ne_mps[None, :])
    wh = np.where(costs.feasible[0], costs.energy_wh[0], np.inf)
    return (costs.time_s[0], wh), reach.energy.gradient_wh_per_mps(compiled, reach.wind_to_ne_mps)


def _with_std(reach: Reach, means: tuple[Floats, Floats], gradient: Floats) -> Price:
    """With the standard deviation that the wind's error and the power model's make."""
    s, wh = means
    wind = np.einsum("li,ij,lj->l", gradient, reach.wind_cov_ne_m2ps2, gradient)
    model_wh = reach.airframe.power_rotor.model_std_frac * np.abs(wh)
    impossible = ~np.isfinite(wh)
    std_wh = np.hypot(np.sqrt(np.maximum(wind, 0.0)), np.where(impossible, 0.0, model_wh))
    return Price(s, np.where(impossible, np.inf, wh), std_wh)
