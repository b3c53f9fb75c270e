"""Subset simulation: a rare failure probability as a product of larger probabilities.

Au and Beck, Probabilistic Engineering Mechanics 16, 2001: levels b1 < b2 < ... of a performance
function g are set so that a share LEVEL_SHARE of the samples passes each; the samples that pass
seed Markov chains conditional on passing. Failure is g > 0. The chains' proposal keeps the standard
normal distribution in any number of dimensions (conditional sampling: Papaioannou, Betz,
Zwirglmaier and Straub, Probabilistic Engineering Mechanics 41, 2015).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Bools, Floats
from sim_bridge.research.study.intervals import share_upper95

LEVEL_SHARE = 0.1
TARGET_ACCEPTANCE = 0.44
ONE_SIDED_95 = 1.645
MIN_ACCEPTANCE = 0.05
"""Minimum acceptance rate; chains with less do not move and give no estimate."""

Performance = Callable[[Floats], float]
"""Performance function of a standard normal vector; above 0 is failure."""


@dataclass(frozen=True, slots=True)
class SubsetEstimate:
    """Failure probability `chance`, its coefficient of variation (with chain correlation) and
    its one-sided 95 % limit `upper95`."""

    chance: float
    variation: float
    upper95: float
    levels: tuple[float, ...]
    evaluations: int


def subset_simulation(
    performance: Performance,
    dimensions: int,
    samples_per_level: int,
    rng: np.random.Generator,
    max_levels: int = 8,
) -> SubsetEstimate:
    """Estimate the probability that `performance` > 0; `samples_per_level`: multiple of 10.

    A probability below LEVEL_SHARE ** max_levels, or one whose chains did not move, is returned as
    0 with infinite variation. Then only `upper95` is valid: the limit of the probability of passing
    the last estimated level, which failure implies.
    """
    seeds = round(LEVEL_SHARE * samples_per_level)
    shape = seeds, samples_per_level // seeds
    chains = _MarkovChains(performance, shape, rng)
    states = rng.standard_normal((samples_per_level, dimensions))
    values = np.array([performance(state) for state in states])
    chance, squares, reached, levels = 1.0, 0.0, False, []
    none_passed = 1.0
    for level in range(max_levels):
        order = np.argsort(values, kind="stable")[::-1]
        bound = float(0.5 * (values[order[seeds - 1]] + values[order[seeds]]))
        last = bound >= 0.0
        bound = min(bound, 0.0)
        passed = values > bound
        share = float(passed.mean())
        squares += _relative_variance_of_share(
            share, samples_per_level, None if level == 0 else passed.reshape(shape)
        )
        if share == 0.0:
            none_passed = share_upper95(0, samples_per_level if level == 0 else seeds)
            break
        chance *= share
        if last:
            reached = True
            break
        levels.append(bound)
        states, values = chains.extend(states[passed], values[passed], bound)
        if chains.acceptance_rate < MIN_ACCEPTANCE:
            break
    evaluations = samples_per_level + chains.evaluations
    upper = min(_log_normal_upper95(chance, squares) * none_passed, 1.0)
    return SubsetEstimate(
        chance if reached else 0.0,
        math.sqrt(squares) if reached else math.inf,
        upper,
        tuple(levels),
        evaluations,
    )


def _log_normal_upper95(probability: float, relative_variance: float) -> float:
    """Return the one-sided 95 % limit of a product of estimated shares, assumed log-normal."""
    spread = math.sqrt(math.log1p(relative_variance))
    return min(probability * math.exp(ONE_SIDED_95 * spread), 1.0)


@dataclass(slots=True)
class _MarkovChains:
    """Chains of standard normal states, `shape`: number and length. The step is adapted to an
    acceptance rate of TARGET_ACCEPTANCE (Papaioannou et al., 4.3)."""

    performance: Performance
    shape: tuple[int, int]
    rng: np.random.Generator
    acceptance_rate: float = 1.0
    evaluations: int = 0
    _step: float = 0.6
    _adaptations: int = 0

    def extend(self, states: Floats, values: Floats, threshold: float) -> tuple[Floats, Floats]:
        """Grow chains from the samples that passed; return states and values, chain after chain."""
        count, length = self.shape
        seed_indices = self.rng.permutation(len(states))[np.arange(count) % len(states)]
        kept_states = np.empty((count, length, states.shape[1]))
        kept_values = np.empty((count, length))
        kept_states[:, 0], kept_values[:, 0] = states[seed_indices], values[seed_indices]
        accepted: list[float] = []
        for step in range(1, length):
            moved = 0
            for chain in range(count):
                state, value = kept_states[chain, step - 1], kept_values[chain, step - 1]
                keep = math.sqrt(1.0 - self._step**2)
                candidate = keep * state + self._step * self.rng.standard_normal(state.size)
                found = self.performance(candidate)
                if found > threshold:
                    state, value, moved = candidate, found, moved + 1
                kept_states[chain, step], kept_values[chain, step] = state, value
            accepted.append(moved / count)
            self._adapt_step(moved / count)
        self.evaluations += count * (length - 1)
        self.acceptance_rate = float(np.mean(accepted))
        return kept_states.reshape(count * length, -1), kept_values.reshape(count * length)

    def _adapt_step(self, acceptance_rate: float) -> None:
        self._adaptations += 1
        gain = (acceptance_rate - TARGET_ACCEPTANCE) / math.sqrt(self._adaptations)
        self._step = float(np.clip(self._step * math.exp(gain), 0.01, 1.0))


def _relative_variance_of_share(share: float, samples: int, passed_by_chain: Bools | None) -> float:
    """Return the relative variance of the share (Au and Beck, equations 28 to 30)."""
    if share <= 0.0:
        return 0.0
    plain = (1.0 - share) / (share * samples)
    if passed_by_chain is None or share >= 1.0:
        return plain
    length = passed_by_chain.shape[1]
    off = passed_by_chain.astype(float) - share
    spread = share * (1.0 - share)
    gamma = 0.0
    for lag in range(1, length):
        correlation = float((off[:, :-lag] * off[:, lag:]).mean()) / spread
        gamma += 2.0 * (1.0 - lag / length) * correlation
    return plain * (1.0 + max(gamma, 0.0))
