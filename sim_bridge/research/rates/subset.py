"""Subset simulation: the chance of a rare failure as a product of chances that are not rare.

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

LEVEL_SHARE = 0.1
WANTED_ACCEPTANCE = 0.44
ONE_SIDED_95 = 1.645
LEAST_ACCEPTANCE = 0.05
"""Chains that accept less stand still: what they count is no estimate."""

Performance = Callable[[Floats], float]
"""Of one vector of standard normal numbers; above 0 is failure."""


@dataclass(frozen=True, slots=True)
class SubsetEstimate:
    """`chance` of failure with its coefficient of variation, chains' correlation counted;
    `upper95` its one-sided 95 % limit; `first` the performance of the first level's samples, which
    are plain Monte Carlo."""

    chance: float
    variation: float
    upper95: float
    levels: tuple[float, ...]
    evaluations: int
    first: Floats


def subset_simulation(
    performance: Performance,
    dimensions: int,
    samples: int,
    rng: np.random.Generator,
    most_levels: int = 8,
) -> SubsetEstimate:
    """Chance that `performance` is above 0; `samples` a level, a multiple of ten.

    A chance under LEVEL_SHARE ** most_levels comes back as 0 with infinite variation, and so does
    one whose chains stood still: then only `upper95` says something. It is the limit of the chance
    to pass the last level that was counted, which failing implies.
    """
    states = rng.standard_normal((samples, dimensions))
    values = np.array([performance(state) for state in states])
    first, evaluations = values.copy(), samples
    chance, squares, levels = 1.0, 0.0, []
    seeds = round(LEVEL_SHARE * samples)
    shape, proposal = (seeds, samples // seeds), _Proposal()
    for level in range(most_levels):
        order = np.argsort(values, kind="stable")[::-1]
        bound = float(0.5 * (values[order[seeds - 1]] + values[order[seeds]]))
        last = bound >= 0.0
        bound = 0.0 if last else bound
        passed = values > bound
        share = float(passed.mean())
        chains = None if level == 0 else passed.reshape(shape)
        squares += _variance(share, samples, chains)
        if share == 0.0:
            none_of = samples if level == 0 else seeds
            upper = min(_upper95(chance, squares) * none_seen_upper95(none_of), 1.0)
            return SubsetEstimate(0.0, math.inf, upper, tuple(levels), evaluations, first)
        chance *= share
        if last:
            upper = _upper95(chance, squares)
            return SubsetEstimate(
                chance, math.sqrt(squares), upper, tuple(levels), evaluations, first
            )
        levels.append(bound)
        states, values, accepted = _grown(
            performance, states[passed], values[passed], bound, shape, proposal, rng
        )
        evaluations += samples - seeds
        if accepted < LEAST_ACCEPTANCE:
            break
    upper = _upper95(chance, squares)
    return SubsetEstimate(0.0, math.inf, upper, tuple(levels), evaluations, first)


def none_seen_upper95(count: int) -> float:
    """One-sided 95 % limit of a chance of which `count` independent trials saw nothing: about 3
    over the count (Clopper and Pearson, Biometrika 26, 1934)."""
    return 1.0 - 0.05 ** (1.0 / count)


def _upper95(chance: float, relative_variance: float) -> float:
    """One-sided 95 % limit of a product of estimated shares, taken as log-normal."""
    spread = math.sqrt(math.log1p(relative_variance))
    return min(chance * math.exp(ONE_SIDED_95 * spread), 1.0)


@dataclass(slots=True)
class _Proposal:
    """How far a proposal goes, adapted after every step to accept WANTED_ACCEPTANCE of them
    (Papaioannou et al., 4.3)."""

    step: float = 0.6
    tuned: int = 0

    def draw(self, state: Floats, rng: np.random.Generator) -> Floats:
        """A vector of standard normals, correlated with the state."""
        keep = math.sqrt(1.0 - self.step**2)
        return keep * state + self.step * rng.standard_normal(state.size)

    def adapt(self, accepted: float) -> None:
        """After a step of all chains."""
        self.tuned += 1
        gain = (accepted - WANTED_ACCEPTANCE) / math.sqrt(self.tuned)
        self.step = float(np.clip(self.step * math.exp(gain), 0.01, 1.0))


def _grown(
    performance: Performance,
    states: Floats,
    values: Floats,
    bound: float,
    shape: tuple[int, int],
    proposal: _Proposal,
    rng: np.random.Generator,
) -> tuple[Floats, Floats, float]:
    """Markov chains from the samples that passed, row by row one chain after another; and the
    share of proposals that was accepted."""
    chains, length = shape
    picked = rng.permutation(len(states))[np.arange(chains) % len(states)]
    kept_states = np.empty((chains, length, states.shape[1]))
    kept_values = np.empty((chains, length))
    kept_states[:, 0], kept_values[:, 0] = states[picked], values[picked]
    accepted = []
    for step in range(1, length):
        moved = 0
        for chain in range(chains):
            state, value = kept_states[chain, step - 1], kept_values[chain, step - 1]
            tried = proposal.draw(state, rng)
            found = performance(tried)
            if found > bound:
                state, value, moved = tried, found, moved + 1
            kept_states[chain, step], kept_values[chain, step] = state, value
        accepted.append(moved / chains)
        proposal.adapt(moved / chains)
    flat = chains * length
    return (
        kept_states.reshape(flat, -1),
        kept_values.reshape(flat),
        float(np.mean(accepted)) if accepted else 1.0,
    )


def _variance(share: float, samples: int, chains: Bools | None) -> float:
    """Of the share, relative and squared (Au and Beck, equations 28 to 30)."""
    if share <= 0.0:
        return 0.0
    plain = (1.0 - share) / (share * samples)
    if chains is None or chains.shape[1] < 2 or share >= 1.0:
        return plain
    length = chains.shape[1]
    off = chains.astype(float) - share
    spread = share * (1.0 - share)
    gamma = 0.0
    for lag in range(1, length):
        correlation = float((off[:, :-lag] * off[:, lag:]).mean()) / spread
        gamma += 2.0 * (1.0 - lag / length) * correlation
    return plain * (1.0 + max(gamma, 0.0))
