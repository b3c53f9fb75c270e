"""Energy of every leg of the remaining mission under every sampled wind, in one vectorised pass.

Decision point 0 is here and now; point i is the end of stage i. Each leg's wind is read at its
midpoint, at the time it is flown in the mean wind.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.geo import Ned, course_rad, horizontal_m, wrap_pi
from companion.core.return_budget.remaining_mission import Ahead, Stage
from companion.core.return_budget.wind_samples import PathSampler
from companion.core.routing.leg_energy import OVER_M, Leg, LegKind, RouteEnergy
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindAhead, WindForecast

_NODES_S = np.array([0.0, 20.0, 45.0, 90.0, 150.0, 240.0, 360.0, 540.0, 800.0, 1200.0])
_MERGE_M = 450.0  # straight cruise legs are merged up to this length
_MERGE_TURN_RAD = math.radians(3.0)
# Only every other sample is followed through the later gates: that is the most costly part, and it
# needs no tail of its own.
POLICY = slice(None, None, 2)
_POINTS = 6  # most decision points after thinning


@dataclass(frozen=True, slots=True)
class _Span:
    """Rows `first` to `last` (exclusive) of the leg table: one stage or one way home."""

    first: int
    last: int

    @property
    def rows(self) -> slice:
        return slice(self.first, self.last)


@dataclass(frozen=True, slots=True)
class Need:
    """An energy need as a later gate will see it: expected Wh (K,) and standard deviation (Wh)."""

    wh: Floats
    std_wh: float


@dataclass(frozen=True, slots=True)
class Foreseen:
    """What a later gate will see, for each POLICY sample.

    The needs of turning back there (and the way home chosen), of flying to the next decision point
    and turning back there, and of the whole trip.
    """

    turning: Need
    turning_way: Ints
    next_point: Need
    whole: Need


@dataclass(frozen=True, slots=True)
class _Outlook:
    """Row spans that the gate at a later point prices.

    Ways home from that point; the stage to the next point and the ways home there; the stages after
    that and the ways home from the last point.
    """

    here: tuple[_Span, ...]
    stage: _Span
    next_ways: tuple[_Span, ...]
    further: _Span
    last_ways: tuple[_Span, ...]


class LegTable:
    """Energy (K,) in Wh of each stage and each way home, for one `Ahead`."""

    def __init__(
        self,
        route_energy: RouteEnergy,
        ahead: Ahead,
        wind: WindBelief,
        outlook: WindAhead,
        sampler: PathSampler,
    ) -> None:
        self._route_energy = route_energy
        self._legs: list[Leg] = []
        self._before: list[Leg | None] = []
        self._stage: list[_Span] = []
        self._ways: list[list[_Span]] = [[]]
        self._unattended: _Span | None = None
        self._lay_out(ahead)
        self._compiled = route_energy.compile(tuple(self._legs), tuple(self._before))
        mean = wind.mean_to_ne_mps
        times = route_energy.costs(self._compiled, mean[None, :]).time_s[0]
        middle, arrival = self._schedule(times)
        places = self._places_ne_m(middle)
        self._price(outlook.on_way(wind, _NODES_S, places), middle, arrival, sampler)

    @property
    def stages(self) -> int:
        """Number of stages, which is also the index of the last decision point."""
        return len(self._stage)

    def ways(self, point: int) -> int:
        """Number of ways home from a decision point."""
        return len(self._ways[point])

    def stage_wh(self, stage: int) -> Floats:
        """Energy (K,) of stage 1, 2, ..."""
        return _sum(self._energy, self._stage[stage - 1])

    def way_wh(self, point: int, way: int) -> Floats:
        """Energy (K,) of one way home from a decision point."""
        return _sum(self._energy, self._ways[point][way])

    def chosen_way_wh(self, point: int, way: Ints) -> Floats:
        """Energy of the way home that each POLICY sample chose; `way` has its index per sample."""
        energies = np.stack([self.way_wh(point, i)[POLICY] for i in range(self.ways(point))])
        return energies[way, np.arange(way.size)]

    def whole_wh(self) -> Floats:
        """Energy (K,) of all stages and of the first way home after them."""
        total = sum((self.stage_wh(i + 1) for i in range(self.stages)), np.zeros(1))
        return total + self.way_wh(self.stages, 0)

    def unattended_wh(self) -> Floats | None:
        """Energy (K,) to come home if no further command arrives; None if there is no such route.

        The vehicle flies to the next waypoint and from there takes the first way home. The mission
        on the autopilot holds no other.
        """
        if self._unattended is None:
            return None
        return _sum(self._energy, self._unattended) + (self.stage_wh(1) if self._stage else 0.0)

    def predicted(self, point: int) -> Foreseen:
        """Needs that the gate at a later point will estimate, for each POLICY sample.

        That gate knows only its own sample's wind until then.
        """
        seen = self._outlooks[point]
        here = [self._need([way]) for way in seen.here]
        energies = np.array([need.wh for need in here])
        onward = [self._need([seen.stage, way]) for way in seen.next_ways]
        whole = [self._need([seen.stage, seen.further, way]) for way in seen.last_ways]
        way = energies.argmin(axis=0)
        return Foreseen(
            turning=Need(energies.min(axis=0), here[0].std_wh),
            turning_way=way,
            next_point=_least(onward),
            whole=_least(whole),
        )

    def _need(self, spans: list[_Span]) -> Need:
        """Need of these spans together. Its variance: the wind's walk plus its lasting error."""
        rows = np.array([row for span in spans for row in _rows(span)], dtype=np.int64)
        by_leg = self._seen_gradient[rows]
        total = by_leg.sum(axis=0)
        lasting = float(total @ self._error_cov @ total)
        left = self._seen_cov[rows[:, None], rows]
        walk = float(np.einsum("ia,ij,ja->", by_leg, left, by_leg))
        std_wh = math.sqrt(max(walk, 0.0) + max(lasting, 0.0))
        return Need(self._seen[rows].sum(axis=0), std_wh)

    # -- laying out and pricing ----------------------------------------------------------------

    def _lay_out(self, ahead: Ahead) -> None:
        ahead = thinned(ahead)
        moving = ahead.stages[0].legs[0] if ahead.stages and ahead.stages[0].legs else None
        for way in ahead.ways_home_now:
            last = None
            if moving is not None and moving.kind is LegKind.CRUISE and way.legs:
                last = _ended_at(moving, way.legs[0].from_ned_m)
            self._ways[0].append(self._add(way.legs, last))
        last = None
        for stage in ahead.stages:
            self._stage.append(self._add(stage.legs, last))
            last = stage.legs[-1] if stage.legs else last
            self._ways.append([self._add(way.legs, last) for way in stage.ways_home])
        aboard = ahead.stages[0].ways_home[0] if ahead.stages else ahead.ways_home_now[0]
        if aboard.unattended_legs:
            last = ahead.stages[0].legs[-1] if ahead.stages and ahead.stages[0].legs else None
            self._unattended = self._add(aboard.unattended_legs, last)

    def _add(self, legs: tuple[Leg, ...], before: Leg | None) -> _Span:
        merged = merge_straight(legs)
        first = len(self._legs)
        self._legs += merged
        self._before += [before, *merged[:-1]][: len(merged)]
        return _Span(first, len(self._legs))

    def _schedule(self, times: Floats) -> tuple[Floats, Floats]:
        """Time (s from now) of each leg's midpoint and each decision point, in the mean wind."""
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

    def _places_ne_m(self, middle: Floats) -> Floats:
        """Where the vehicle is at each of the forecast's nodes, (nodes, 2): the mean of the legs
        that may be flown about then. Where none is, as at the node before.
        """
        places = np.zeros((_NODES_S.size, 2))
        if not self._legs:
            return places
        ends = np.array([(leg.from_ned_m[:2], leg.to_ned_m[:2]) for leg in self._legs])
        at_leg, place = _weights(middle), ends[0, 0]
        weight, moment = at_leg.sum(axis=0), at_leg.T @ ends.mean(axis=1)
        for node in range(_NODES_S.size):
            place = moment[node] / weight[node] if weight[node] > 0.0 else place
            places[node] = place
        return places

    def _price(
        self,
        forecast: WindForecast,
        middle: Floats,
        arrival: Floats,
        sampler: PathSampler,
    ) -> None:
        at_leg = _weights(middle)
        walk = sampler.walk(forecast)
        wind = at_leg @ walk + sampler.error(forecast)
        self._energy = self._route_energy.costs_by_leg(self._compiled, wind[0], wind[1]).energy_wh
        if self.stages > 1:
            self._foresee(forecast, at_leg, _weights(arrival), walk[:, :, POLICY])

    def _foresee(
        self,
        forecast: WindForecast,
        at_leg: Floats,
        at_point: Floats,
        walk: Floats,
    ) -> None:
        """Price what the gate at each later point will price, as it will see it.

        Its forecast is the regression of a leg's wind on the wind at that point, since the walk is
        Gaussian. Its uncertainty comes from the energy's gradient at the mean wind.
        """
        legs, origin = self._lay_out_foreseen()
        cov, mean = forecast.walk_cov_m2ps2, forecast.mean_to_ne_mps
        leg_rows, point_rows = at_leg[legs], at_point[origin]
        variance = np.maximum(np.einsum("rn,nm,rm->r", point_rows, cov, point_rows), 1e-9)
        share = np.einsum("rn,nm,rm->r", leg_rows, cov, point_rows) / variance
        news = at_point @ (walk - mean.T[:, :, None])
        seen = (leg_rows @ mean).T[:, :, None] + share[:, None] * news[:, origin]
        chosen = self._route_energy.compile(
            tuple(self._legs[i] for i in legs), tuple(self._before[i] for i in legs)
        )
        self._seen = self._route_energy.costs_by_leg(chosen, seen[0], seen[1]).energy_wh
        mean_wind = mean.mean(axis=0)
        self._seen_gradient = self._route_energy.gradient_wh_per_mps(chosen, mean_wind)
        known = np.outer(share, share) * variance  # used only within one point
        self._seen_cov = leg_rows @ cov @ leg_rows.T - known
        self._error_cov = forecast.error_cov_m2ps2

    def _lay_out_foreseen(self) -> tuple[Ints, Ints]:
        """(leg, decision point) of each row that a later gate prices; fills `_outlooks`."""
        legs: list[int] = []
        origin: list[int] = []

        def take(point: int, spans: list[_Span]) -> _Span:
            first = len(legs)
            for span in spans:
                legs.extend(_rows(span))
            origin.extend([point] * (len(legs) - first))
            return _Span(first, len(legs))

        self._outlooks: dict[int, _Outlook] = {}
        for point in range(1, self.stages):
            last = point + 1 == self.stages
            next_ways = tuple(take(point, [way]) for way in self._ways[point + 1])
            self._outlooks[point] = _Outlook(
                here=tuple(take(point, [way]) for way in self._ways[point]),
                stage=take(point, [self._stage[point]]),
                next_ways=next_ways,
                further=take(point, self._stage[point + 1 :]),
                last_ways=next_ways
                if last
                else tuple(take(point, [way]) for way in self._ways[self.stages]),
            )
        return np.array(legs), np.array(origin)


def _ended_at(leg: Leg, place: Ned) -> Leg:
    """The same leg shifted to end at `place`; its course sets the turn angle there.

    A leg under way begins at the vehicle, so it cannot simply be shortened.
    """
    moved = tuple(p - to for p, to in zip(place, leg.to_ned_m, strict=True))
    north, east, down = (f + m for f, m in zip(leg.from_ned_m, moved, strict=True))
    return replace(leg, from_ned_m=(north, east, down), to_ned_m=place)


def _least(needs: list[Need]) -> Need:
    """Minimum of alternative needs per sample, with the std of the first."""
    return Need(np.min([need.wh for need in needs], axis=0), needs[0].std_wh)


def thinned(ahead: Ahead) -> Ahead:
    """The same mission with at most `_POINTS` decision points: the next, the last two, some others.

    A gate that decides less often brings the vehicle home slightly less often. So the stated
    probabilities err low.
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
    """The same route with straight cruise legs merged; each is priced at its midpoint wind."""
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
    rises_m = [before.to_ned_m[2] - before.from_ned_m[2], leg.to_ned_m[2] - leg.from_ned_m[2]]
    if rises_m[0] * rises_m[1] < 0.0 and min(map(abs, rises_m)) > OVER_M:
        return False  # over a ridge: what the climb costs, sinking does not give back
    before_rad = course_rad(before.from_ned_m, before.to_ned_m)
    turn_rad = wrap_pi(course_rad(leg.from_ned_m, leg.to_ned_m) - before_rad)
    return abs(turn_rad) < _MERGE_TURN_RAD


def _sum(energy: Floats, span: _Span) -> Floats:
    return energy[span.rows].sum(axis=0)


def _rows(span: _Span) -> range:
    return range(span.first, span.last)


def _fill(middle: Floats, times: Floats, span: _Span, start_s: float) -> None:
    lasts = times[span.rows]
    middle[span.rows] = start_s + np.cumsum(lasts) - 0.5 * lasts


def _weights(at_s: Floats) -> Floats:
    """Linear interpolation weights between the forecast's nodes, (len, nodes)."""
    index = np.clip(np.searchsorted(_NODES_S, at_s, side="right") - 1, 0, _NODES_S.size - 2)
    share = (at_s - _NODES_S[index]) / (_NODES_S[index + 1] - _NODES_S[index])
    rows = np.zeros((at_s.size, _NODES_S.size))
    rows[np.arange(at_s.size), index] = 1.0 - share
    rows[np.arange(at_s.size), index + 1] = share
    return rows
