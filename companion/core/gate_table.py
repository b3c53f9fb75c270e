"""What every leg of the remaining mission costs in every sampled wind, priced all at once.

Decision point 0 is here and now; point i is the end of stage i. Winds are read at each leg's
middle, at the time that it is flown in the mean wind.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.core.gate_paths import PathSampler
from companion.core.geo import course_rad, horizontal_m, wrap_pi
from companion.core.remaining import Ahead, Stage
from companion.core.route_energy import Leg, LegKind, RouteEnergy
from companion.core.wind_estimator import WindBelief
from companion.core.wind_outlook import WindForecast, WindOutlook

FloatArray = NDArray[np.float64]

_NODES_S = np.array([0.0, 20.0, 45.0, 90.0, 150.0, 240.0, 360.0, 540.0, 800.0, 1200.0])
_MERGE_M = 450.0  # straight cruise legs are priced together up to this length
_MERGE_TURN_RAD = math.radians(3.0)
# Every other sample follows the later gates: that is the most work, and needs no tail of its own.
POLICY = slice(None, None, 2)
_POINTS = 6  # decision points that a later gate is followed through


@dataclass(frozen=True, slots=True)
class _Span:
    """Rows of the table that belong to one stage or way home."""

    first: int
    last: int

    @property
    def rows(self) -> slice:
        return slice(self.first, self.last)


class LegTable:
    """Energy of stages and ways home, (K,) Wh each, for one `Ahead`."""

    def __init__(
        self,
        route_energy: RouteEnergy,
        ahead: Ahead,
        wind: WindBelief,
        outlook: WindOutlook,
        sampler: PathSampler,
        quantile: float,
    ) -> None:
        """`quantile`: of the standard normal, at which a later gate asks for its promise."""
        self._route_energy = route_energy
        self._legs: list[Leg] = []
        self._before: list[Leg | None] = []
        self._seen_from: list[int] = []  # the decision point at which a leg is predicted
        self._stage: list[_Span] = []
        self._ways: list[list[_Span]] = [[]]
        self._unattended: _Span | None = None
        self._lay_out(ahead)
        self._compiled = route_energy.compile(tuple(self._legs), tuple(self._before))
        mean = wind.mean_to_ne_mps
        times = route_energy.costs(self._compiled, mean[None, :]).time_s[0]
        middle, arrival = self._schedule(times)
        self._quantile = quantile
        self._price(outlook.forecast(wind, _NODES_S), middle, arrival, sampler)

    @property
    def stages(self) -> int:
        """How many stages there are: the last decision point's number."""
        return len(self._stage)

    def ways(self, point: int) -> int:
        """How many ways home a decision point has."""
        return len(self._ways[point])

    def stage_wh(self, stage: int) -> FloatArray:
        """Energy of stage 1, 2, ... in every sample."""
        return _sum(self._energy, self._stage[stage - 1])

    def way_wh(self, point: int, way: int) -> FloatArray:
        """Energy of a way home from a decision point in every sample."""
        return _sum(self._energy, self._ways[point][way])

    def chosen_way_wh(self, point: int, way: NDArray[np.int64]) -> FloatArray:
        """The same with each POLICY sample's own choice of way."""
        energies = np.stack([self.way_wh(point, i)[POLICY] for i in range(self.ways(point))])
        return energies[way, np.arange(way.size)]

    def whole_wh(self) -> FloatArray:
        """Energy of all stages and the first way home after them, in every sample."""
        total = sum((self.stage_wh(i + 1) for i in range(self.stages)), np.zeros(1))
        return total + self.way_wh(self.stages, 0)

    def unattended_wh(self) -> FloatArray | None:
        """Energy to come home when no further command arrives.

        On to the next waypoint, and from there the first of the ways: the mission aboard knows
        no other, and nobody is there to choose.
        """
        if self._unattended is None:
            return None
        return _sum(self._energy, self._unattended) + (self.stage_wh(1) if self._stage else 0.0)

    def predicted(self, point: int) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """What the gate at a later point will think that flying on and then home needs.

        (in the wind it expects, in the wind at its quantile, way home from the point itself) for
        every POLICY sample; that gate knows only its own wind until then.
        """
        stage, after, here = self._stage[point], self._ways[point + 1], self._ways[point]
        expected, at_quantile = (
            _sum(seen, stage) + np.min([_sum(seen, way) for way in after], axis=0)
            for seen in (self._seen, self._seen_worse)
        )
        way = np.argmin([_sum(self._seen, span) for span in here], axis=0)
        return expected, np.maximum(at_quantile, expected), way

    # -- laying out and pricing ----------------------------------------------------------------

    def _lay_out(self, ahead: Ahead) -> None:
        ahead = thinned(ahead)
        moving = ahead.stages[0].legs[0] if ahead.stages and ahead.stages[0].legs else None
        for way in ahead.ways_home_now:
            last = None
            if moving is not None and moving.kind is LegKind.CRUISE and way.legs:
                last = replace(moving, to_ned_m=way.legs[0].from_ned_m)
            self._ways[0].append(self._add(way.legs, 0, last))
        last = None
        for number, stage in enumerate(ahead.stages):
            self._stage.append(self._add(stage.legs, number, last))
            last = stage.legs[-1] if stage.legs else last
            self._ways.append([self._add(way.legs, number, last) for way in stage.ways_home])
        aboard = ahead.stages[0].ways_home[0] if ahead.stages else ahead.ways_home_now[0]
        if aboard.unattended_legs:
            last = ahead.stages[0].legs[-1] if ahead.stages and ahead.stages[0].legs else None
            self._unattended = self._add(aboard.unattended_legs, 0, last)

    def _add(self, legs: tuple[Leg, ...], seen_from: int, before: Leg | None) -> _Span:
        merged = merge_straight(legs)
        first = len(self._legs)
        self._legs += merged
        self._before += [before, *merged[:-1]][: len(merged)]
        self._seen_from += [seen_from] * len(merged)
        return _Span(first, len(self._legs))

    def _schedule(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Each leg's middle and each decision point's time from now, in the mean wind."""
        middle = np.zeros(len(self._legs))
        arrival = np.zeros(self.stages + 1)
        for point in range(self.stages + 1):
            if point > 0:
                span = self._stage[point - 1]
                _fill(middle, times, span, arrival[point - 1])
                arrival[point] = arrival[point - 1] + times[span.rows].sum()
            for span in self._ways[point]:
                _fill(middle, times, span, arrival[point])
        if self._unattended is not None:
            _fill(middle, times, self._unattended, arrival[min(1, self.stages)])
        return np.minimum(middle, _NODES_S[-1]), np.minimum(arrival, _NODES_S[-1])

    def _price(
        self,
        forecast: WindForecast,
        middle: FloatArray,
        arrival: FloatArray,
        sampler: PathSampler,
    ) -> None:
        at_leg, at_point = _weights(middle), _weights(arrival)
        walk = sampler.walk(forecast)
        self._energy = self._priced(at_leg @ walk + sampler.error(forecast))
        if self.stages > 1:
            self._predict(forecast, at_leg, at_point, at_point @ walk[:, :, POLICY])

    def _priced(self, wind: FloatArray) -> FloatArray:
        """(legs, K) Wh in winds (2, legs, K)."""
        return self._route_energy.costs_by_leg(self._compiled, wind[0], wind[1]).energy_wh

    def _predict(
        self,
        forecast: WindForecast,
        at_leg: FloatArray,
        at_point: FloatArray,
        point_walk: FloatArray,
    ) -> None:
        """Price the legs as the gate at the decision point before them will see them.

        Its forecast is the regression of a leg's wind on its wind then: the walk is Gaussian.
        """
        cov, mean = forecast.walk_cov_m2ps2, forecast.mean_to_ne_mps
        origin = np.array(self._seen_from)
        variance = np.maximum(np.einsum("pn,nm,pm->p", at_point, cov, at_point), 1e-9)
        share = (at_leg @ cov @ at_point.T) / variance
        news = point_walk - (at_point @ mean).T[:, :, None]
        own = share[np.arange(origin.size), origin][:, None]
        seen = (at_leg @ mean).T[:, :, None] + own * news[:, origin]
        # Energy's gradient at the mean wind tells each point's worst direction.
        gradient = self._route_energy.gradient_wh_per_mps(self._compiled, mean.mean(axis=0))
        leg_leg = at_leg @ cov @ at_leg.T
        worst = np.zeros((2, self.stages))
        for point in range(self.stages):
            legs = [*_rows(self._stage[point]), *_rows(self._ways[point + 1][0])]
            total = gradient[legs].sum(axis=0)
            way = total / max(math.hypot(*total), 1e-9)
            slope = gradient[legs] @ way
            known = share[legs, point]
            left = leg_leg[np.ix_(legs, legs)] - variance[point] * np.outer(known, known)
            lasting = float(way @ forecast.error_cov_m2ps2 @ way)
            weight = slope / max(abs(float(slope.sum())), 0.3 * float(np.abs(slope).sum()), 1e-9)
            std = math.sqrt(max(float(weight @ left @ weight), 0.0) + lasting)
            worst[:, point] = self._quantile * std * way
        self._seen = self._priced(seen)
        self._seen_worse = self._priced(seen + worst[:, origin, None])


def thinned(ahead: Ahead) -> Ahead:
    """The same mission with fewer decision points: the next and the last two, some between.

    A gate that may decide less often comes home a little less often: what is said errs low.
    """
    count = len(ahead.stages)
    if count <= _POINTS:
        return ahead
    kept = {0, count - 2, count - 1}
    kept |= {round(i) for i in np.linspace(0, count - 2, _POINTS - 1)}
    stages: list[Stage] = []
    legs: tuple[Leg, ...] = ()
    for i, stage in enumerate(ahead.stages):
        legs += stage.legs
        if i in kept:
            stages.append(replace(stage, legs=legs))
            legs = ()
    return replace(ahead, stages=tuple(stages))


def merge_straight(legs: tuple[Leg, ...]) -> list[Leg]:
    """The same way with straight cruise legs joined: priced once, at the wind in their middle."""
    merged: list[Leg] = []
    for leg in legs:
        before = merged[-1] if merged else None
        if before is not None and _goes_straight_on(before, leg):
            merged[-1] = replace(before, to_ned_m=leg.to_ned_m)
        else:
            merged.append(leg)
    return merged


def _goes_straight_on(before: Leg, leg: Leg) -> bool:
    if before.kind is not LegKind.CRUISE or leg.kind is not LegKind.CRUISE:
        return False
    alike = (before.payload_kg, before.airspeed_mps, before.ground_speed_mps) == (
        leg.payload_kg,
        leg.airspeed_mps,
        leg.ground_speed_mps,
    )
    if not alike or before.to_ned_m != leg.from_ned_m:
        return False
    if horizontal_m(before.from_ned_m, leg.to_ned_m) > _MERGE_M:
        return False
    before_rad = course_rad(before.from_ned_m, before.to_ned_m)
    turn_rad = wrap_pi(course_rad(leg.from_ned_m, leg.to_ned_m) - before_rad)
    return abs(turn_rad) < _MERGE_TURN_RAD


def _sum(energy: FloatArray, span: _Span) -> FloatArray:
    return energy[span.rows].sum(axis=0)


def _rows(span: _Span) -> range:
    return range(span.first, span.last)


def _fill(middle: FloatArray, times: FloatArray, span: _Span, start_s: float) -> None:
    lasts = times[span.rows]
    middle[span.rows] = start_s + np.cumsum(lasts) - 0.5 * lasts


def _weights(at_s: FloatArray) -> FloatArray:
    """Rows that interpolate linearly between the forecast's nodes, (len, nodes)."""
    index = np.clip(np.searchsorted(_NODES_S, at_s, side="right") - 1, 0, _NODES_S.size - 2)
    share = (at_s - _NODES_S[index]) / (_NODES_S[index + 1] - _NODES_S[index])
    rows = np.zeros((at_s.size, _NODES_S.size))
    rows[np.arange(at_s.size), index] = 1.0 - share
    rows[np.arange(at_s.size), index + 1] = share
    return rows
