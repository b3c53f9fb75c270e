"""Missions flown on the energy graph, many at a time: `evaluation.md` section 2 to the letter.

The wind of a mission is a function of time that no planner's choice changes: every planner that
is given the same `ChainWinds` or `LogWinds` meets the same wind, mission by mission.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from companion.core.energy_graph import WH_PER_J, EnergyGraph, sector_of
from companion.core.planners.interface import STAY, Decider, Look
from companion.core.wind_chain import Sight, WindChain, class_centre

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

JUMPS_AT_ONCE = 2


class Outcome(IntEnum):
    """How a mission ended (`evaluation.md`, 1)."""

    SUC = 0
    DEL = 1
    FAIL = 2
    ABRT = 3


@dataclass(frozen=True)
class Flown:
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
    """Winds of a Markov chain: one path of jumps for each mission, drawn as far as needed.

    Times are asked for in ascending order within a mission; `restart` goes back to departure.
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
        self._jump_share = _cumulative_jumps(chain.rate_per_s)
        start = np.searchsorted(np.cumsum(chain.initial)[:-1], random.random(count), side="right")
        self._state = start.astype(np.int64)[None, :]  # (jumps so far + 1, n)
        self._until_s = self._stay_s(self._state)
        self._jump = np.zeros(count, dtype=np.int64)
        self._looked = np.zeros(count, dtype=np.int64)  # the state at the last look

    @property
    def count(self) -> int:
        return self._state.shape[1]

    def restart(self) -> None:
        """Let the next planner meet the same winds."""
        self._jump[:] = 0

    def state_at(self, mission: Ints, time_s: Floats) -> Ints:
        """The chain's state at `time_s` after departure."""
        jump = self._jump[mission]
        late = np.arange(len(mission))
        while True:
            late = late[self._until_s[jump[late], mission[late]] <= time_s[late]]
            if not len(late):
                break
            jump[late] += 1
            if jump[late].max() == len(self._state):
                self._draw_jumps()
        self._jump[mission] = jump
        return self._state[jump, mission]

    def _draw_jumps(self) -> None:
        """The next states of all missions and how long they hold; for all, whoever asks."""
        states, until = [self._state], [self._until_s]
        for _ in range(JUMPS_AT_ONCE):
            uniform = self._random.random(self.count)
            before = states[-1][-1]
            place = np.searchsorted(self._jump_share, before + uniform, side="right")
            after = np.clip(place - before * self._chain.state_count, 0, None)[None, :]
            states.append(after)
            until.append(until[-1][-1:] + self._stay_s(after))
        self._state = np.concatenate(states)
        self._until_s = np.concatenate(until)

    def _stay_s(self, state: Ints) -> Floats:
        rate = -self._chain.rate_per_s[state, state]
        draw = self._random.exponential(size=state.shape)
        return np.where(rate > 0.0, draw / np.where(rate > 0.0, rate, 1.0), np.inf)

    def look(self, mission: Ints, time_s: Floats) -> tuple[Ints, Floats]:
        state = self.state_at(mission, time_s)
        self._looked[mission] = state
        seen = self._sight.of_state[state]
        return seen, self._sight.seen_en_mps[seen]

    def fly(
        self, mission: Ints, edge: Ints, time_s: Floats, energy_wh: Floats, delivered: NDArray
    ) -> tuple[Floats, Floats]:
        duration = self._duration_s[edge, self._looked[mission]]
        power = self._power_wh_per_s[delivered.astype(np.int64)]
        return duration, duration * power


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

    @property
    def count(self) -> int:
        return len(self.start_s)

    def restart(self) -> None:
        """Nothing to do: a recording is the same for whoever reads it."""

    def wind_at(self, mission: Ints, time_s: Floats) -> Floats:
        """The wind at `time_s` after each departure; (n, 2)."""
        when = self.start_s[mission] + time_s
        return np.stack([np.interp(when, self._t_s, self._wind[:, i]) for i in (0, 1)], axis=1)

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


def _ground_speed_mps(course_en: Floats, wind_en_mps: Floats, airspeed_mps: float) -> Floats:
    """Ground speed of each course in its own wind, 0 where the vehicle makes no way; (n,)."""
    along = np.sum(course_en * wind_en_mps, axis=1)
    across = course_en[:, 0] * wind_en_mps[:, 1] - course_en[:, 1] * wind_en_mps[:, 0]
    vertical = np.all(course_en == 0.0, axis=1)
    across = np.where(vertical, np.hypot(wind_en_mps[:, 0], wind_en_mps[:, 1]), across)
    room = airspeed_mps**2 - across**2
    speed = np.sqrt(np.maximum(room, 0.0)) + along
    return np.where((room >= 0.0) & (speed > 0.0), speed, 0.0)


def fly_missions(graph: EnergyGraph, budget_wh: float, winds: Winds, decider: Decider) -> Flown:
    """Fly every mission to its end."""
    count = winds.count
    outcome = np.full(count, Outcome.FAIL, dtype=np.int8)
    vertex = np.full(count, graph.depot, dtype=np.int64)
    delivered = np.zeros(count, dtype=bool)
    energy = np.full(count, float(budget_wh))
    time = np.zeros(count)
    decisions = np.zeros(count, dtype=np.int64)
    power = np.asarray(graph.power_w) * WH_PER_J
    flying = np.arange(count)
    for edges_flown in range(4 * graph.vertex_count + 1):
        if not len(flying):
            break
        seen, wind = winds.look(flying, time[flying])
        look = Look(flying, vertex[flying], delivered[flying], energy[flying], seen, wind)
        edge = np.asarray(decider.decide(look), dtype=np.int64)
        decisions[flying] += 1
        stays = (edge == STAY) & (look.vertex == graph.depot) & ~look.delivered
        outcome[flying[stays]] = Outcome.ABRT
        took = np.full(len(flying), np.inf)
        used = np.full(len(flying), np.inf)
        goes = np.flatnonzero((edge >= 0) & (edges_flown < 4 * graph.vertex_count))
        if len(goes):
            took[goes], used[goes] = winds.fly(
                flying[goes],
                edge[goes],
                time[flying[goes]],
                energy[flying[goes]],
                look.delivered[goes],
            )
        arrives = used <= look.energy_wh
        lost = ~arrives & ~stays
        at = flying[lost]
        outcome[at] = np.where(delivered[at], Outcome.DEL, Outcome.FAIL)
        time[at] += energy[at] / power[delivered[at].astype(np.int64)]
        energy[at] = 0.0
        at = flying[arrives]
        energy[at] -= used[arrives]
        time[at] += took[arrives]
        vertex[at] = graph.head[edge[arrives]]
        delivered[at] |= vertex[at] == graph.target
        home = delivered[at] & (vertex[at] == graph.depot)
        outcome[at[home]] = Outcome.SUC
        flying = at[~home]
    return Flown(outcome, budget_wh - energy, time, decisions)
