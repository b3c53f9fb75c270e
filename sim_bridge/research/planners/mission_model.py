"""Missions flown on the energy graph, many at a time (docs/reference/outcomes.md).

The wind of a mission is a function of time that no planner's choice changes: every planner that
is given the same `ChainWinds` or `LogWinds` meets the same wind, mission by mission.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import WH_PER_J, EnergyGraph, sector_of
from companion.core.routing.planner_interface import NOWHERE, STAY, Decider, Look
from sim_bridge.research.planners.markov_chain import Sight, WindChain, class_centre


class Outcome(IntEnum):
    """How a mission ended (docs/reference/outcomes.md)."""

    SUC = 0
    DEL = 1
    FAIL = 2
    ABRT = 3


@dataclass(frozen=True)
class MissionResults:
    """What became of n missions; arrays of length n. A lost vehicle has used its whole budget."""

    outcome: NDArray[np.int8]
    energy_wh: Floats
    time_s: Floats
    decisions: Ints


class Winds(Protocol):
    """The winds that n missions meet."""

    @property
    def count(self) -> int: ...

    def look(self, mission: Ints, time_s: Floats) -> tuple[Ints, Floats]:
        """What is seen at `time_s` after each departure: index (-1: none) and vector (n, 2)."""
        ...

    def fly(
        self, mission: Ints, edge: Ints, time_s: Floats, energy_wh: Floats, delivered: NDArray
    ) -> tuple[Floats, Floats]:
        """Seconds and Wh that the edge takes; infinite where it cannot be completed.

        `time_s` is that of the last look: the wind seen is the wind flown in.
        """
        ...


class ChainWinds:
    """Winds of a Markov chain: one path of jumps for each mission, followed as far as needed.

    Times are asked for in ascending order within a mission; `restart` goes back to departure.
    Random numbers are drawn for all missions alike, so that no planner changes another's winds.
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
        self._duration_s = graph.duration_s(chain.states_en_mps)
        self._power_wh_per_s = np.asarray(graph.power_w) * WH_PER_J
        self._of_seen = sight.of_state
        self._jump_share = _cumulative_jumps(chain.rate_per_s)
        self._leave_per_s = -chain.rate_per_s.diagonal()
        start = np.searchsorted(np.cumsum(chain.initial)[:-1], random.random(count), side="right")
        self._start = start.astype(np.int64)
        self._first_until_s = self._until_after(
            np.zeros(count), self._start, random.exponential(size=count)
        )
        # Jump j of mission m: drawn for all missions, followed (`_known` so far) where one asks.
        self._drawn = 0
        self._known = np.zeros(count, dtype=np.int64)
        self._uniform = np.empty((0, count))  # where it leads: drawn,
        self._path = np.empty((0, count), dtype=np.int16)  # followed
        self._leave_s = np.empty((0, count))  # when it ends: drawn in mean stays, followed in s
        self.restart()

    @property
    def count(self) -> int:
        return len(self._start)

    def restart(self) -> None:
        """Let the next planner meet the same winds."""
        self._state, self._until_s = self._start.copy(), self._first_until_s.copy()
        self._jump = np.zeros(self.count, dtype=np.int64)

    def state_at(self, mission: Ints, time_s: Floats) -> Ints:
        """The chain's state at `time_s` after departure."""
        late = np.flatnonzero(self._until_s.take(mission) <= time_s)
        while len(late):
            at = mission[late]
            self._let_jump(at)
            late = late[self._until_s[at] <= time_s[late]]
        return self._state.take(mission)

    def _let_jump(self, mission: Ints) -> None:
        jump = self._jump[mission]
        if jump.max() >= self._drawn:
            self._draw_jump()
        new = jump >= self._known[mission]
        if new.any():
            self._follow(mission[new], jump[new])
        self._state[mission] = self._path[jump, mission]
        self._until_s[mission] = self._leave_s[jump, mission]
        self._jump[mission] = jump + 1

    def _follow(self, mission: Ints, jump: Ints) -> None:
        """Where the drawn numbers lead from where the missions are."""
        before = self._state[mission]
        drawn = before + self._uniform[jump, mission]
        place = np.searchsorted(self._jump_share, drawn, side="right")
        after = np.maximum(place - before * self._chain.state_count, 0)
        stay = self._leave_s[jump, mission]
        self._path[jump, mission] = after
        self._leave_s[jump, mission] = self._until_after(self._until_s[mission], after, stay)
        self._known[mission] = jump + 1

    def _draw_jump(self) -> None:
        """The random numbers of the next jump of all missions, whoever asks."""
        if self._drawn == len(self._uniform):
            room = np.empty((max(2, self._drawn), self.count))
            self._uniform = np.concatenate([self._uniform, room])
            self._leave_s = np.concatenate([self._leave_s, room])
            self._path = np.concatenate([self._path, np.empty(room.shape, dtype=np.int16)])
        self._random.random(out=self._uniform[self._drawn])
        self._random.standard_exponential(out=self._leave_s[self._drawn])
        self._drawn += 1

    def _until_after(self, since_s: Floats, state: Ints, stay: Floats) -> Floats:
        rate = self._leave_per_s.take(state)
        with np.errstate(divide="ignore"):
            return since_s + np.where(rate > 0.0, stay / rate, np.inf)

    def look(self, mission: Ints, time_s: Floats) -> tuple[Ints, Floats]:
        seen = self._of_seen.take(self.state_at(mission, time_s))
        return seen, self._sight.seen_en_mps.take(seen, axis=0)

    def fly(
        self, mission: Ints, edge: Ints, time_s: Floats, energy_wh: Floats, delivered: NDArray
    ) -> tuple[Floats, Floats]:
        cell = edge * self._chain.state_count + self._state.take(mission)
        duration = self._duration_s.take(cell)
        return duration, duration * self._power_wh_per_s.take(delivered.astype(np.int64))


def _cumulative_jumps(rate_per_s: Floats) -> Floats:
    """Where jumps lead: cumulative shares of state s's jumps on top of s, in one rising array.

    The place of s + u in it, less s * S, is the next state for a uniform number u.
    """
    jumps = np.where(np.eye(len(rate_per_s), dtype=bool), 0.0, rate_per_s)
    total = jumps.sum(axis=1, keepdims=True)
    share = np.cumsum(jumps, axis=1) / np.where(total > 0.0, total, 1.0)
    # Nothing leads beyond the last state that has a share, whatever the rounding says.
    last = np.max(np.where(jumps > 0.0, np.arange(len(jumps)), -1), axis=1)
    share[np.arange(len(jumps))[None, :] >= last[:, None]] = 1.0
    return (np.arange(len(jumps))[:, None] + share).ravel()


class LogWinds:
    """Winds of a recording: read every second along an edge, interpolated linearly.

    After its last sample a recording holds its last wind.
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
        self._place = np.arange(len(t_s), dtype=float)
        self._step_s = _even_step_s(t_s)

    @property
    def count(self) -> int:
        return len(self.start_s)

    def restart(self) -> None:
        """Nothing to do: a recording is the same for whoever reads it."""

    def wind_at(self, mission: Ints, time_s: Floats) -> Floats:
        """The wind at `time_s` after each departure; (n, 2)."""
        when = np.clip(self.start_s.take(mission) + time_s, self._t_s[0], self._t_s[-1])
        place = (
            np.interp(when, self._t_s, self._place)
            if self._step_s is None
            else ((when - self._t_s[0]) / self._step_s)
        )
        before = np.minimum(place.astype(np.int64), max(len(self._t_s) - 2, 0))
        start = self._wind.take(before, axis=0)
        return start + (place - before)[:, None] * self._change.take(before, axis=0)

    def look(self, mission: Ints, time_s: Floats) -> tuple[Ints, Floats]:
        wind = self.wind_at(mission, time_s)
        seen = wind if self._classes is None else class_centre(wind, self._classes)
        return np.full(len(mission), -1, dtype=np.int64), seen

    def fly(
        self, mission: Ints, edge: Ints, time_s: Floats, energy_wh: Floats, delivered: NDArray
    ) -> tuple[Floats, Floats]:
        power = np.asarray(self._graph.power_w)[delivered.astype(np.int64)] * WH_PER_J
        duration = self.durations_s(mission, edge, time_s, energy_wh / power)
        return duration, duration * power

    def durations_s(self, mission: Ints, edge: Ints, time_s: Floats, limit_s: Floats) -> Floats:
        """Seconds that each edge takes from `time_s`; infinite where that is beyond `limit_s`."""
        course, rest = self._graph.course_en[edge], self._graph.length_m[edge].copy()
        factors = self._graph.wind_factor
        took = np.where(rest > 0.0, np.inf, 0.0)
        flying = np.flatnonzero(rest > 0.0)
        second = 0
        while len(flying):
            wind = self.wind_at(mission[flying], time_s[flying] + second)
            if factors is not None:
                sector = sector_of(wind, factors.shape[1])
                wind = wind * factors[edge[flying], sector][:, None]
            speed = _ground_speed_mps(course[flying], wind, self._graph.airspeed_mps)
            there = rest[flying] <= speed
            done = flying[there]
            took[done] = second + rest[done] / speed[there]
            rest[flying] -= speed
            second += 1
            flying = flying[~there & (second <= limit_s[flying])]
        return np.where(took <= limit_s, took, np.inf)


def _even_step_s(t_s: Floats) -> float | None:
    """The step of a recording that has one: its samples are then found without a search."""
    steps = np.diff(t_s)
    if not len(steps) or np.ptp(steps) > 1e-9 * steps[0]:
        return None
    return float(t_s[-1] - t_s[0]) / len(steps)


def _ground_speed_mps(course_en: Floats, wind_en_mps: Floats, airspeed_mps: float) -> Floats:
    """Ground speed of each course in its own wind, 0 where the vehicle makes no way; (n,)."""
    along = np.sum(course_en * wind_en_mps, axis=1)
    across = course_en[:, 0] * wind_en_mps[:, 1] - course_en[:, 1] * wind_en_mps[:, 0]
    vertical = np.all(course_en == 0.0, axis=1)
    across = np.where(vertical, np.hypot(wind_en_mps[:, 0], wind_en_mps[:, 1]), across)
    room = airspeed_mps**2 - across**2
    speed = np.sqrt(np.maximum(room, 0.0)) + along
    return np.where((room >= 0.0) & (speed > 0.0), speed, 0.0)


def fly_missions(
    graph: EnergyGraph, budget_wh: float, winds: Winds, decider: Decider
) -> MissionResults:
    """Fly every mission to its end."""
    fleet = _Fleet(graph, budget_wh, winds.count)
    most_edges = 4 * graph.vertex_count
    for edges_flown in range(most_edges + 1):
        if not len(fleet.mission):
            break
        seen, wind = winds.look(fleet.mission, fleet.time_s)
        look = Look(fleet.mission, fleet.vertex, fleet.delivered, fleet.energy_wh, seen, wind)
        edge = np.asarray(decider.decide(look), dtype=np.int64)
        if edges_flown == most_edges:
            edge = np.where(edge >= 0, NOWHERE, edge)
        edge = fleet.leave(edge)
        if len(edge):
            fleet.arrive(
                edge,
                *winds.fly(fleet.mission, edge, fleet.time_s, fleet.energy_wh, fleet.delivered),
            )
    return fleet.flown


class _Fleet:
    """Missions under way as arrays without gaps, and what became of those that ended."""

    def __init__(self, graph: EnergyGraph, budget_wh: float, count: int) -> None:
        self._graph, self._budget_wh = graph, float(budget_wh)
        self._power_wh_per_s = np.asarray(graph.power_w) * WH_PER_J
        self.mission = np.arange(count)
        self.vertex = np.full(count, graph.depot, dtype=np.int64)
        self.delivered = np.zeros(count, dtype=bool)
        self.energy_wh = np.full(count, self._budget_wh)
        self.time_s = np.zeros(count)
        self._decisions = 0  # that each of them has taken
        self.flown = MissionResults(
            np.empty(count, dtype=np.int8),
            np.empty(count),
            np.empty(count),
            np.empty(count, dtype=np.int64),
        )

    def leave(self, edge: Ints) -> Ints:
        """End the missions that take no edge; the edges of those that do."""
        self._decisions += 1
        if edge.min() >= 0:
            return edge
        stays = (edge == STAY) & (self.vertex == self._graph.depot) & ~self.delivered
        stops = edge < 0
        self._lose(stops & ~stays)
        self._end(stops, np.where(stays, Outcome.ABRT, self._lost_as())[stops])
        return edge[~stops]

    def arrive(self, edge: Ints, took_s: Floats, used_wh: Floats) -> None:
        """Everyone at the head of their edge, or lost on the way to it."""
        lost = ~(used_wh <= self.energy_wh)
        if lost.any():
            self._lose(lost)
            self._end(lost, self._lost_as()[lost])
            edge, took_s, used_wh = edge[~lost], took_s[~lost], used_wh[~lost]
        self.energy_wh = self.energy_wh - used_wh
        self.time_s = self.time_s + took_s
        self.vertex = self._graph.head.take(edge)
        self.delivered = self.delivered | (self.vertex == self._graph.target)
        home = self.delivered & (self.vertex == self._graph.depot)
        if home.any():
            self._end(home, Outcome.SUC)

    def _lose(self, lost: NDArray[np.bool_]) -> None:
        """All that is left is used, in the air."""
        power = self._power_wh_per_s.take(self.delivered.astype(np.int64))
        self.time_s = np.where(lost, self.time_s + self.energy_wh / power, self.time_s)
        self.energy_wh = np.where(lost, 0.0, self.energy_wh)

    def _lost_as(self) -> NDArray[np.int64]:
        return np.where(self.delivered, Outcome.DEL, Outcome.FAIL)

    def _end(self, which: NDArray[np.bool_], outcome: int | NDArray[np.int64]) -> None:
        at = self.mission[which]
        self.flown.outcome[at] = outcome
        self.flown.energy_wh[at] = self._budget_wh - self.energy_wh[which]
        self.flown.time_s[at] = self.time_s[which]
        self.flown.decisions[at] = self._decisions
        left = ~which
        self.mission, self.vertex = self.mission[left], self.vertex[left]
        self.delivered, self.energy_wh = self.delivered[left], self.energy_wh[left]
        self.time_s = self.time_s[left]
