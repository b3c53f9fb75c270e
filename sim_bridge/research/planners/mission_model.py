"""Simulates many missions on the energy graph at once (docs/reference/outcomes.md).

The wind of a mission is a function of time, independent of the planner's choices. All planners that
receive the same `ChainWinds` or `LogWinds` fly in the same wind, mission by mission.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import WH_PER_J, EnergyGraph, wind_sector_indices
from companion.core.routing.planner_interface import (
    NO_EDGE,
    STOP_AT_DEPOT,
    BatchPlanner,
    PlannerObservation,
)
from sim_bridge.research.planners.markov_chain import (
    Sight,
    WindChain,
    snap_direction_to_sector_centre,
)
from sim_bridge.research.promise.truth import ground_speed_mps


class Outcome(IntEnum):
    """Outcome of a mission (docs/reference/outcomes.md)."""

    SUC = 0
    DEL = 1
    FAIL = 2
    ABRT = 3


@dataclass(frozen=True)
class MissionResults:
    """Results of n missions; arrays of length n. A lost vehicle has used its whole budget."""

    outcome: NDArray[np.int8]
    energy_wh: Floats
    time_s: Floats
    decisions: Ints


class Winds(Protocol):
    """The winds of n missions."""

    @property
    def mission_count(self) -> int: ...

    def observe_wind_index_and_vector(
        self, mission_index: Ints, time_s: Floats
    ) -> tuple[Ints, Floats]:
        """Return the wind seen at `time_s` after departure: index (-1: none) and vector (n, 2)."""
        ...

    def edge_durations_s_and_energies_wh(
        self, mission: Ints, edge: Ints, time_s: Floats, remaining_wh: Floats, delivered: NDArray
    ) -> tuple[Floats, Floats]:
        """Return seconds and Wh that the edge takes; infinite where it cannot be completed.

        `time_s` is that of the last observation: the vehicle flies in the wind it observed.
        """
        ...


class ChainWinds:
    """Winds of a Markov chain: one sequence of jumps per mission, generated on demand.

    Requested times must ascend within a mission. `restart_at_departure` returns to departure.
    Random numbers are drawn for all missions at once, so that planners do not affect the winds.
    """

    def __init__(
        self,
        graph: EnergyGraph,
        chain: WindChain,
        sight: Sight,
        count: int,
        random: np.random.Generator,
    ) -> None:
        self._graph, self._chain, self._sight = graph, chain, sight
        self._random = random
        self._duration_s = graph.edge_duration_s(chain.states_en_mps)
        self._power_wh_per_s = np.asarray(graph.power_w) * WH_PER_J
        self._wind_index = sight.of_state
        self._jump_share = _cumulative_jump_probabilities(chain.rate_per_s)
        self._exit_rate_per_s = -chain.rate_per_s.diagonal()
        start = np.searchsorted(np.cumsum(chain.initial)[:-1], random.random(count), side="right")
        self._start = start.astype(np.int64)
        self._initial_end_s = self._dwell_end_s(
            np.zeros(count), self._start, random.exponential(size=count)
        )
        # Jump j of mission m: drawn for all missions, resolved (`_known` so far) on request.
        self._drawn_count = 0
        self._known = np.zeros(count, dtype=np.int64)
        self._jump_uniform = np.empty((0, count))  # selects the next state: drawn,
        self._jump_state = np.empty((0, count), dtype=np.int16)  # resolved
        self._jump_end_s = np.empty((0, count))  # end: drawn in mean dwell times, resolved in s
        self.restart_at_departure()

    @property
    def mission_count(self) -> int:
        return len(self._start)

    def restart_at_departure(self) -> None:
        """Return to departure, so that the next planner flies in the same winds."""
        self._state, self._state_end_s = self._start.copy(), self._initial_end_s.copy()
        self._jump = np.zeros(self.mission_count, dtype=np.int64)

    def advance_to_states_at(self, mission: Ints, time_s: Floats) -> Ints:
        """Return the chain's state at `time_s` after departure."""
        late = np.flatnonzero(self._state_end_s.take(mission) <= time_s)
        while len(late):
            at = mission[late]
            self._advance_to_next_jump(at)
            late = late[self._state_end_s[at] <= time_s[late]]
        return self._state.take(mission)

    def _advance_to_next_jump(self, mission: Ints) -> None:
        jump = self._jump[mission]
        if jump.max() >= self._drawn_count:
            self._draw_next_jump_random_numbers()
        new = jump >= self._known[mission]
        if new.any():
            self._store_resolved_jump(mission[new], jump[new])
        self._state[mission] = self._jump_state[jump, mission]
        self._state_end_s[mission] = self._jump_end_s[jump, mission]
        self._jump[mission] = jump + 1

    def _store_resolved_jump(self, mission: Ints, jump: Ints) -> None:
        """Resolve the drawn numbers to next states and their end times."""
        before = self._state[mission]
        drawn = before + self._jump_uniform[jump, mission]
        position = np.searchsorted(self._jump_share, drawn, side="right")
        after = np.maximum(position - before * self._chain.state_count, 0)
        dwell = self._jump_end_s[jump, mission]
        self._jump_state[jump, mission] = after
        self._jump_end_s[jump, mission] = self._dwell_end_s(
            self._state_end_s[mission], after, dwell
        )
        self._known[mission] = jump + 1

    def _draw_next_jump_random_numbers(self) -> None:
        """Draw the random numbers of the next jump for all missions."""
        if self._drawn_count == len(self._jump_uniform):
            spare = np.empty((max(2, self._drawn_count), self.mission_count))
            self._jump_uniform = np.concatenate([self._jump_uniform, spare])
            self._jump_end_s = np.concatenate([self._jump_end_s, spare])
            self._jump_state = np.concatenate(
                [self._jump_state, np.empty(spare.shape, dtype=np.int16)]
            )
        self._random.random(out=self._jump_uniform[self._drawn_count])
        self._random.standard_exponential(out=self._jump_end_s[self._drawn_count])
        self._drawn_count += 1

    def _dwell_end_s(self, since_s: Floats, state: Ints, unit_exponential: Floats) -> Floats:
        rate = self._exit_rate_per_s.take(state)
        with np.errstate(divide="ignore"):
            return since_s + np.where(rate > 0.0, unit_exponential / rate, np.inf)

    def observe_wind_index_and_vector(
        self, mission_index: Ints, time_s: Floats
    ) -> tuple[Ints, Floats]:
        seen = self._wind_index.take(self.advance_to_states_at(mission_index, time_s))
        return seen, self._sight.seen_en_mps.take(seen, axis=0)

    def edge_durations_s_and_energies_wh(
        self, mission: Ints, edge: Ints, time_s: Floats, remaining_wh: Floats, delivered: NDArray
    ) -> tuple[Floats, Floats]:
        cell = edge * self._chain.state_count + self._state.take(mission)
        duration = self._duration_s.take(cell)
        return duration, duration * self._power_wh_per_s.take(delivered.astype(np.int64))


def _cumulative_jump_probabilities(rate_per_s: Floats) -> Floats:
    """Return the cumulative jump shares of each state s, offset by s, in one ascending array.

    The insertion index of s + u, less s * S, is the next state for a uniform number u.
    """
    jumps = np.where(np.eye(len(rate_per_s), dtype=bool), 0.0, rate_per_s)
    total = jumps.sum(axis=1, keepdims=True)
    share = np.cumsum(jumps, axis=1) / np.where(total > 0.0, total, 1.0)
    # The last state with a share takes the remainder, independent of rounding.
    last = np.max(np.where(jumps > 0.0, np.arange(len(jumps)), -1), axis=1)
    share[np.arange(len(jumps))[None, :] >= last[:, None]] = 1.0
    return (np.arange(len(jumps))[:, None] + share).ravel()


class LogWinds:
    """Winds of a recording, read every second along an edge, interpolated linearly.

    After its last sample the last wind remains.
    """

    def __init__(
        self,
        graph: EnergyGraph,
        t_s: Floats,
        wind_en_mps: Floats,
        start_s: Floats,
        classes: int | None,
    ) -> None:
        self._graph, self._t_s, self._wind, self._classes = graph, t_s, wind_en_mps, classes
        self.start_s = start_s
        self._change = np.diff(wind_en_mps, axis=0, append=wind_en_mps[-1:])
        self._sample_index = np.arange(len(t_s), dtype=float)
        self._step_s = _constant_interval_s(t_s)

    @property
    def mission_count(self) -> int:
        return len(self.start_s)

    def restart_at_departure(self) -> None:
        """Do nothing: a recording has no state."""

    def wind_at(self, mission: Ints, time_s: Floats) -> Floats:
        """Return the wind at `time_s` after each departure; (n, 2)."""
        when = np.clip(self.start_s.take(mission) + time_s, self._t_s[0], self._t_s[-1])
        position = (
            np.interp(when, self._t_s, self._sample_index)
            if self._step_s is None
            else ((when - self._t_s[0]) / self._step_s)
        )
        before = np.minimum(position.astype(np.int64), max(len(self._t_s) - 2, 0))
        start = self._wind.take(before, axis=0)
        return start + (position - before)[:, None] * self._change.take(before, axis=0)

    def observe_wind_index_and_vector(
        self, mission_index: Ints, time_s: Floats
    ) -> tuple[Ints, Floats]:
        wind = self.wind_at(mission_index, time_s)
        seen = (
            wind if self._classes is None else snap_direction_to_sector_centre(wind, self._classes)
        )
        return np.full(len(mission_index), -1, dtype=np.int64), seen

    def edge_durations_s_and_energies_wh(
        self, mission: Ints, edge: Ints, time_s: Floats, remaining_wh: Floats, delivered: NDArray
    ) -> tuple[Floats, Floats]:
        power = np.asarray(self._graph.power_w)[delivered.astype(np.int64)] * WH_PER_J
        duration = self.edge_durations_s(mission, edge, time_s, remaining_wh / power)
        return duration, duration * power

    def edge_durations_s(
        self, mission: Ints, edge: Ints, time_s: Floats, limit_s: Floats
    ) -> Floats:
        """Return the seconds of each edge from `time_s`; infinite where above `limit_s`."""
        course, remaining_m = (
            self._graph.edge_course_unit_vector_en[edge],
            self._graph.edge_length_m[edge].copy(),
        )
        factors = self._graph.wind_factor
        travel_s = np.where(remaining_m > 0.0, np.inf, 0.0)
        active = np.flatnonzero(remaining_m > 0.0)
        second = 0
        while len(active):
            wind = self.wind_at(mission[active], time_s[active] + second)
            if factors is not None:
                sector = wind_sector_indices(wind, factors.shape[1])
                wind = wind * factors[edge[active], sector][:, None]
            speed = _ground_speed_mps(course[active], wind, self._graph.airspeed_mps)
            arriving = remaining_m[active] <= speed
            done = active[arriving]
            travel_s[done] = second + remaining_m[done] / speed[arriving]
            remaining_m[active] -= speed
            second += 1
            active = active[~arriving & (second <= limit_s[active])]
        return np.where(travel_s <= limit_s, travel_s, np.inf)


def _constant_interval_s(t_s: Floats) -> float | None:
    """Return the sample interval if it is constant, else None; avoids a search per sample."""
    steps = np.diff(t_s)
    if not len(steps) or np.ptp(steps) > 1e-9 * steps[0]:
        return None
    return float(t_s[-1] - t_s[0]) / len(steps)


def _ground_speed_mps(course_en: Floats, wind_en_mps: Floats, airspeed_mps: float) -> Floats:
    """Ground speed of each course in its own wind, 0 where no progress is possible; (n,)."""
    speed = ground_speed_mps(airspeed_mps, wind_en_mps, course_en)
    vertical = np.all(course_en == 0.0, axis=1)  # all wind is across it
    across = np.hypot(wind_en_mps[:, 0], wind_en_mps[:, 1])
    return np.where(vertical, np.sqrt(np.maximum(airspeed_mps**2 - across**2, 0.0)), speed)


def fly_missions(
    graph: EnergyGraph, budget_wh: float, winds: Winds, planner: BatchPlanner
) -> MissionResults:
    """Fly every mission to its end."""
    fleet = _ActiveMissions(graph, budget_wh, winds.mission_count)
    most_edges = 4 * graph.vertex_count
    for edges_flown in range(most_edges + 1):
        if not len(fleet.mission):
            break
        seen, wind = winds.observe_wind_index_and_vector(fleet.mission, fleet.time_s)
        observation = PlannerObservation(
            fleet.mission, fleet.vertex, fleet.delivered, fleet.energy_wh, seen, wind
        )
        edge = np.asarray(planner.select_edges(observation), dtype=np.int64)
        if edges_flown == most_edges:
            edge = np.where(edge >= 0, NO_EDGE, edge)
        edge = fleet.end_missions_without_edge(edge)
        if len(edge):
            fleet.complete_edges_or_record_losses(
                edge,
                *winds.edge_durations_s_and_energies_wh(
                    fleet.mission, edge, fleet.time_s, fleet.energy_wh, fleet.delivered
                ),
            )
    return fleet.results


class _ActiveMissions:
    """State of the active missions as dense arrays, and the results of those that ended."""

    def __init__(self, graph: EnergyGraph, budget_wh: float, count: int) -> None:
        self._graph, self._budget_wh = graph, float(budget_wh)
        self._power_wh_per_s = np.asarray(graph.power_w) * WH_PER_J
        self.mission = np.arange(count)
        self.vertex = np.full(count, graph.depot, dtype=np.int64)
        self.delivered = np.zeros(count, dtype=bool)
        self.energy_wh = np.full(count, self._budget_wh)
        self.time_s = np.zeros(count)
        self._decisions = 0  # made so far, the same for all active missions
        self.results = MissionResults(
            np.empty(count, dtype=np.int8),
            np.empty(count),
            np.empty(count),
            np.empty(count, dtype=np.int64),
        )

    def end_missions_without_edge(self, edge: Ints) -> Ints:
        """End the missions that select no edge. Return the edges of the others."""
        self._decisions += 1
        if edge.min() >= 0:
            return edge
        stays = (edge == STOP_AT_DEPOT) & (self.vertex == self._graph.depot) & ~self.delivered
        stops = edge < 0
        self._consume_all_energy(stops & ~stays)
        self._record_and_remove_missions(
            stops, np.where(stays, Outcome.ABRT, self._loss_outcome())[stops]
        )
        return edge[~stops]

    def complete_edges_or_record_losses(
        self, edge: Ints, elapsed_s: Floats, used_wh: Floats
    ) -> None:
        """Move each mission to the head of its edge, or end it as lost along the edge."""
        lost = ~(used_wh <= self.energy_wh)
        if lost.any():
            self._consume_all_energy(lost)
            self._record_and_remove_missions(lost, self._loss_outcome()[lost])
            edge, elapsed_s, used_wh = edge[~lost], elapsed_s[~lost], used_wh[~lost]
        self.energy_wh = self.energy_wh - used_wh
        self.time_s = self.time_s + elapsed_s
        self.vertex = self._graph.head.take(edge)
        self.delivered = self.delivered | (self.vertex == self._graph.target)
        home = self.delivered & (self.vertex == self._graph.depot)
        if home.any():
            self._record_and_remove_missions(home, Outcome.SUC)

    def _consume_all_energy(self, lost: NDArray[np.bool_]) -> None:
        """Use all remaining energy in the air."""
        power = self._power_wh_per_s.take(self.delivered.astype(np.int64))
        self.time_s = np.where(lost, self.time_s + self.energy_wh / power, self.time_s)
        self.energy_wh = np.where(lost, 0.0, self.energy_wh)

    def _loss_outcome(self) -> NDArray[np.int64]:
        return np.where(self.delivered, Outcome.DEL, Outcome.FAIL)

    def _record_and_remove_missions(
        self, ended: NDArray[np.bool_], outcome: int | NDArray[np.int64]
    ) -> None:
        at = self.mission[ended]
        self.results.outcome[at] = outcome
        self.results.energy_wh[at] = self._budget_wh - self.energy_wh[ended]
        self.results.time_s[at] = self.time_s[ended]
        self.results.decisions[at] = self._decisions
        left = ~ended
        self.mission, self.vertex = self.mission[left], self.vertex[left]
        self.delivered, self.energy_wh = self.delivered[left], self.energy_wh[left]
        self.time_s = self.time_s[left]
