"""Energy of every leg of the remaining mission under every sampled wind, in one vectorised pass.

Decision point 0 is the current position; point i is the end of stage i. The wind of a leg is that
at its midpoint, at the time of the midpoint in the mean wind.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.geo import Ned
from companion.core.return_budget.power_need import PowerNeed, additional_need_wh
from companion.core.return_budget.remaining_mission import (
    RemainingMission,
    merge_straight_cruise_legs,
    reduce_decision_points,
)
from companion.core.return_budget.wind_samples import NeedSpread, PathSampler
from companion.core.routing.leg_energy import Leg, LegBatch, LegKind, RouteEnergy
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindForecast, WindForecaster

_NODES_S = np.array([0.0, 20.0, 45.0, 90.0, 150.0, 240.0, 360.0, 540.0, 800.0, 1200.0])
# Later gates are simulated for every other sample only: it is the most costly part.
POLICY_SAMPLES = slice(None, None, 2)


@dataclass(frozen=True, slots=True)
class _Span:
    """Rows `first` to `last` (exclusive) of the leg table: one stage or one route home."""

    first: int
    last: int

    @property
    def row_slice(self) -> slice:
        return slice(self.first, self.last)


@dataclass(frozen=True, slots=True)
class Need:
    """Energy need estimated by a later gate: expected Wh (K,) and standard deviation (Wh)."""

    wh: Floats
    std_wh: float


@dataclass(frozen=True, slots=True)
class PredictedNeeds:
    """Needs estimated by a later gate, for each POLICY sample.

    The needs of turning back there (with the selected route home), of flying to the next decision
    point and turning back there, and of the whole trip.
    """

    turn_back: Need
    turn_back_route: Ints
    next_point: Need
    whole: Need


@dataclass(frozen=True, slots=True)
class _GateSpans:
    """Row spans that the gate at a later point evaluates.

    Routes home from that point; the stage to the next point and the routes home there; the stages
    after that and the routes home from the last point.
    """

    here: tuple[_Span, ...]
    stage: _Span
    next_routes: tuple[_Span, ...]
    later_stages: _Span
    last_routes: tuple[_Span, ...]


class LegTable:
    """Energy (K,) in Wh of each stage and each route home, for one `RemainingMission`."""

    def __init__(
        self,
        route_energy: RouteEnergy,
        remaining: RemainingMission,
        wind: WindBelief,
        outlook: WindForecaster,
        sampler: PathSampler,
        other_std_wh: Callable[[Floats], Floats],
        power_need: PowerNeed | None = None,
    ) -> None:
        self._route_energy, self._power_need = route_energy, power_need
        self._other_std_wh = other_std_wh
        self._leg_list: list[Leg] = []
        self._before: list[Leg | None] = []
        self._stage: list[_Span] = []
        self._routes: list[list[_Span]] = [[]]
        self._unattended: _Span | None = None
        self._build_rows(remaining)
        self._compiled = route_energy.group_legs_by_cost_formula(
            tuple(self._leg_list), tuple(self._before)
        )
        mean = wind.mean_to_ne_mps
        times = route_energy.leg_costs_wind_major(self._compiled, mean[None, :]).time_s[0]
        middle, arrival = self._midpoint_and_arrival_times_s(times)
        positions_ne_m = _vehicle_positions_at_nodes_ne_m(self._leg_list, middle)
        self._compute_energies(
            outlook.forecast_on_route(wind, _NODES_S, positions_ne_m), middle, arrival, sampler
        )

    @property
    def stage_count(self) -> int:
        """Number of stages, which is also the index of the last decision point."""
        return len(self._stage)

    def return_route_count(self, decision_point: int) -> int:
        """Return the number of routes home from a decision point."""
        return len(self._routes[decision_point])

    def stage_energy_wh(self, stage_number: int) -> Floats:
        """Return the energy (K,) of stage 1, 2, ..."""
        return _span_energy_wh(self._energy, self._stage[stage_number - 1])

    def return_route_energy_wh(self, decision_point: int, route_index: int) -> Floats:
        """Return the energy (K,) of one route home from a decision point."""
        return self._need_after_stages_wh(decision_point, self._routes[decision_point][route_index])

    def _need_after_stages_wh(self, decision_point: int, route: _Span) -> Floats:
        """Return the need (K,) of a route, so that the stages before it also have their power."""
        need_wh = _span_energy_wh(self._energy, route)
        if self._remaining_need is None:
            return need_wh
        spans = (*self._stage[:decision_point], route)
        rows = np.array([row for span in spans for row in _row_range(span)], dtype=np.int64)
        return need_wh + additional_need_wh(self._energy[rows], self._remaining_need[rows])

    def selected_route_energy_wh(self, decision_point: int, route_index_by_sample: Ints) -> Floats:
        """Return each POLICY sample's energy of its route home, `route_index_by_sample`."""
        energies = np.stack(
            [
                self.return_route_energy_wh(decision_point, i)[POLICY_SAMPLES]
                for i in range(self.return_route_count(decision_point))
            ]
        )
        return energies[route_index_by_sample, np.arange(route_index_by_sample.size)]

    def whole_mission_energy_wh(self) -> Floats:
        """Return the energy (K,) of all stages and of the first route home after them."""
        total = sum((self.stage_energy_wh(i + 1) for i in range(self.stage_count)), np.zeros(1))
        return total + self.return_route_energy_wh(self.stage_count, 0)

    def unattended_return_energy_wh(self) -> Floats | None:
        """Return the energy (K,) to return home without further commands; None without a route.

        The vehicle flies to the next waypoint and from there the first route home, the only one
        in the uploaded mission.
        """
        if self._unattended is None:
            return None
        point = min(1, self.stage_count)
        return self._need_after_stages_wh(point, self._unattended) + (
            self.stage_energy_wh(1) if self._stage else 0.0
        )

    def predict_needs_at_later_gate(self, decision_point: int) -> PredictedNeeds:
        """Return the needs estimated by the gate at a later point, for each POLICY sample.

        That gate knows the wind of its sample up to that point.
        """
        seen = self._outlooks[decision_point]
        here = [self._later_energy_need([route]) for route in seen.here]
        energies = np.array([need.wh for need in here])
        onward = [self._later_energy_need([seen.stage, route]) for route in seen.next_routes]
        whole = [
            self._later_energy_need([seen.stage, seen.later_stages, route])
            for route in seen.last_routes
        ]
        route = energies.argmin(axis=0)
        return PredictedNeeds(
            turn_back=Need(energies.min(axis=0), here[0].std_wh),
            turn_back_route=route,
            next_point=_minimum_need(onward),
            whole=_minimum_need(whole),
        )

    def _later_energy_need(self, spans: list[_Span]) -> Need:
        """Return the need of these spans; variance of the random walk plus constant error."""
        rows = np.array([row for span in spans for row in _row_range(span)], dtype=np.int64)
        by_leg = self._later_gradient[rows]
        total = by_leg.sum(axis=0)
        constant_error_wh2 = float(total @ self._error_cov @ total)
        left = self._later_cov[rows[:, None], rows]
        random_walk_wh2 = float(np.einsum("ia,ij,ja->", by_leg, left, by_leg))
        std_wh = math.sqrt(max(random_walk_wh2, 0.0) + max(constant_error_wh2, 0.0))
        energy_wh = self._later_energy_wh[rows]
        need_wh = energy_wh.sum(axis=0)
        if self._later_remaining_need is not None:
            need_wh = need_wh + additional_need_wh(energy_wh, self._later_remaining_need[rows])
        return Need(need_wh, std_wh)

    # -- laying out and pricing ----------------------------------------------------------------

    def _build_rows(self, remaining: RemainingMission) -> None:
        remaining = reduce_decision_points(remaining)
        moving = (
            remaining.stages[0].leg_sequence[0]
            if remaining.stages and remaining.stages[0].leg_sequence
            else None
        )
        for route in remaining.current_return_routes:
            last = None
            if moving is not None and moving.kind is LegKind.CRUISE and route.leg_sequence:
                last = _shift_end_to(moving, route.leg_sequence[0].from_ned_m)
            self._routes[0].append(self._add_rows(route.leg_sequence, last))
        last = None
        for stage in remaining.stages:
            self._stage.append(self._add_rows(stage.leg_sequence, last))
            last = stage.leg_sequence[-1] if stage.leg_sequence else last
            self._routes.append(
                [self._add_rows(route.leg_sequence, last) for route in stage.return_routes]
            )
        uploaded_route = (
            remaining.stages[0].return_routes[0]
            if remaining.stages
            else remaining.current_return_routes[0]
        )
        if uploaded_route.unattended_sequence:
            last = (
                remaining.stages[0].leg_sequence[-1]
                if remaining.stages and remaining.stages[0].leg_sequence
                else None
            )
            self._unattended = self._add_rows(uploaded_route.unattended_sequence, last)

    def _add_rows(self, leg_list: tuple[Leg, ...], previous_leg: Leg | None) -> _Span:
        merged = merge_straight_cruise_legs(leg_list)
        first = len(self._leg_list)
        self._leg_list += merged
        self._before += [previous_leg, *merged[:-1]][: len(merged)]
        return _Span(first, len(self._leg_list))

    def _midpoint_and_arrival_times_s(self, leg_durations_s: Floats) -> tuple[Floats, Floats]:
        """Return time (s from now) of leg midpoints and decision points, in the mean wind."""
        middle = np.zeros(len(self._leg_list))
        arrival = np.zeros(self.stage_count + 1)
        for point in range(self.stage_count + 1):
            if point > 0:
                span = self._stage[point - 1]
                _fill_midpoint_times_in_place(middle, leg_durations_s, span, arrival[point - 1])
                arrival[point] = arrival[point - 1] + leg_durations_s[span.row_slice].sum()
            for span in self._routes[point]:
                _fill_midpoint_times_in_place(middle, leg_durations_s, span, arrival[point])
        if self._unattended is not None:
            _fill_midpoint_times_in_place(
                middle, leg_durations_s, self._unattended, arrival[min(1, self.stage_count)]
            )
        return np.minimum(middle, _NODES_S[-1]), np.minimum(arrival, _NODES_S[-1])

    def _compute_energies(
        self,
        forecast: WindForecast,
        midpoint_times_s: Floats,
        arrival_times_s: Floats,
        sampler: PathSampler,
    ) -> None:
        at_leg = _interpolation_weights_at(midpoint_times_s)
        mean = forecast.mean_to_ne_mps.mean(axis=0)
        rows = [
            [row for span in (*self._stage[:point], routes[0]) for row in _row_range(span)]
            for point, routes in enumerate(self._routes)
        ]
        legs = self._route_energy, self._compiled
        draws = sampler.draw(forecast, _need_spreads(*legs, mean, at_leg, rows, self._other_std_wh))
        wind = at_leg @ draws.path_ne_mps + draws.estimate_error_ne_mps
        self.weights = draws.weights
        costs = self._route_energy.leg_costs_leg_major(self._compiled, wind[0], wind[1])
        self._energy = costs.energy_wh
        self._remaining_need = self._power_need and self._power_need.remaining_need_by_leg_wh(
            costs.energy_wh, costs.time_s
        )
        if self.stage_count > 1:
            self._compute_later_needs(
                forecast,
                at_leg,
                _interpolation_weights_at(arrival_times_s),
                draws.path_ne_mps[:, :, POLICY_SAMPLES],
            )

    def _compute_later_needs(
        self,
        forecast: WindForecast,
        node_weights_by_leg: Floats,
        node_weights_by_point: Floats,
        wind_paths_ne_mps: Floats,
    ) -> None:
        """Compute the needs as the gate at each later point will estimate them.

        Its forecast is the regression of a leg's wind on the wind at that point, since the random
        walk is Gaussian. Its uncertainty follows from the energy's gradient at the mean wind.
        """
        leg_list, origin = self._build_later_rows()
        cov, mean = forecast.change_cov_m2ps2, forecast.mean_to_ne_mps
        leg_rows, point_rows = node_weights_by_leg[leg_list], node_weights_by_point[origin]
        variance = np.maximum(np.einsum("rn,nm,rm->r", point_rows, cov, point_rows), 1e-9)
        share = np.einsum("rn,nm,rm->r", leg_rows, cov, point_rows) / variance
        innovation = node_weights_by_point @ (wind_paths_ne_mps - mean.T[:, :, None])
        seen = (leg_rows @ mean).T[:, :, None] + share[:, None] * innovation[:, origin]
        compiled = self._route_energy.group_legs_by_cost_formula(
            tuple(self._leg_list[i] for i in leg_list), tuple(self._before[i] for i in leg_list)
        )
        costs = self._route_energy.leg_costs_leg_major(compiled, seen[0], seen[1])
        self._later_energy_wh = costs.energy_wh
        self._later_remaining_need = self._power_need and self._power_need.remaining_need_by_leg_wh(
            costs.energy_wh, costs.time_s, POLICY_SAMPLES
        )
        mean_wind = mean.mean(axis=0)
        self._later_gradient = self._route_energy.leg_energy_gradients_wh_per_mps(
            compiled, mean_wind
        )
        known = np.outer(share, share) * variance  # used only within one point
        self._later_cov = leg_rows @ cov @ leg_rows.T - known
        self._error_cov = forecast.error_cov_m2ps2

    def _build_later_rows(self) -> tuple[Ints, Ints]:
        """Return (leg, decision point) of each row of the later gates, and fill `_outlooks`."""
        leg_list: list[int] = []
        origin: list[int] = []

        def append_rows(point: int, spans: list[_Span]) -> _Span:
            first = len(leg_list)
            for span in spans:
                leg_list.extend(_row_range(span))
            origin.extend([point] * (len(leg_list) - first))
            return _Span(first, len(leg_list))

        self._outlooks: dict[int, _GateSpans] = {}
        for point in range(1, self.stage_count):
            last = point + 1 == self.stage_count
            next_routes = tuple(append_rows(point, [route]) for route in self._routes[point + 1])
            self._outlooks[point] = _GateSpans(
                here=tuple(append_rows(point, [route]) for route in self._routes[point]),
                stage=append_rows(point, [self._stage[point]]),
                next_routes=next_routes,
                later_stages=append_rows(point, self._stage[point + 1 :]),
                last_routes=next_routes
                if last
                else tuple(append_rows(point, [route]) for route in self._routes[self.stage_count]),
            )
        return np.array(leg_list), np.array(origin)


def _vehicle_positions_at_nodes_ne_m(leg_list: list[Leg], midpoint_times_s: Floats) -> Floats:
    """Return the vehicle's position at each forecast node, (nodes, 2): the weighted mean of the
    legs that may be flown then, or the position at the previous node without one.
    """
    positions_ne_m = np.zeros((_NODES_S.size, 2))
    if not leg_list:
        return positions_ne_m
    ends = np.array([(leg.from_ned_m[:2], leg.to_ned_m[:2]) for leg in leg_list])
    at_leg, position = _interpolation_weights_at(midpoint_times_s), ends[0, 0]
    weight, weighted_sum = at_leg.sum(axis=0), at_leg.T @ ends.mean(axis=1)
    for node in range(_NODES_S.size):
        position = weighted_sum[node] / weight[node] if weight[node] > 0.0 else position
        positions_ne_m[node] = position
    return positions_ne_m


def _need_spreads(
    route_energy: RouteEnergy,
    legs: LegBatch,
    mean_wind_to_ne_mps: Floats,
    node_weights_by_leg: Floats,
    rows_by_route: list[list[int]],
    other_std_wh: Callable[[Floats], Floats],
) -> list[NeedSpread]:
    """Return the spread of the need of each return route (rows of legs), at the mean wind."""
    gradient = route_energy.leg_energy_gradients_wh_per_mps(legs, mean_wind_to_ne_mps)
    energy_wh = route_energy.leg_costs_wind_major(legs, mean_wind_to_ne_mps[None, :]).energy_wh[0]
    return [
        NeedSpread(
            node_weights_by_leg[rows].T @ gradient[rows], float(other_std_wh(energy_wh[rows].sum()))
        )
        for rows in rows_by_route
    ]


def _shift_end_to(leg: Leg, position: Ned) -> Leg:
    """Shift a leg so that it ends at `position`; its course gives the turn angle there.

    The leg in progress begins at the vehicle, so shortening it would change its course.
    """
    moved = tuple(p - to for p, to in zip(position, leg.to_ned_m, strict=True))
    north, east, down = (f + m for f, m in zip(leg.from_ned_m, moved, strict=True))
    return replace(leg, from_ned_m=(north, east, down), to_ned_m=position)


def _minimum_need(needs: list[Need]) -> Need:
    """Return the minimum of alternative needs per sample, with the std of the first."""
    return Need(np.min([need.wh for need in needs], axis=0), needs[0].std_wh)


def _span_energy_wh(energy: Floats, span: _Span) -> Floats:
    return energy[span.row_slice].sum(axis=0)


def _row_range(span: _Span) -> range:
    return range(span.first, span.last)


def _fill_midpoint_times_in_place(
    midpoint_times_s: Floats, leg_durations_s: Floats, span: _Span, start_s: float
) -> None:
    durations_s = leg_durations_s[span.row_slice]
    midpoint_times_s[span.row_slice] = start_s + np.cumsum(durations_s) - 0.5 * durations_s


def _interpolation_weights_at(times_s: Floats) -> Floats:
    """Return linear interpolation weights between the forecast's nodes, (len, nodes)."""
    index = np.clip(np.searchsorted(_NODES_S, times_s, side="right") - 1, 0, _NODES_S.size - 2)
    share = (times_s - _NODES_S[index]) / (_NODES_S[index + 1] - _NODES_S[index])
    rows = np.zeros((times_s.size, _NODES_S.size))
    rows[np.arange(times_s.size), index] = 1.0 - share
    rows[np.arange(times_s.size), index + 1] = share
    return rows
