"""Wind as a Markov chain: what the planner is told about how the wind may change.

The chain either comes with a scenario or is derived from a continuous process (`WindProcess`),
so that one planner serves both a known chain and an estimate with covariance.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.wind.forecast import LEG_S
from companion.core.wind.process import WindProcessParams

CONDITION_LIMIT = 1e6  # of the eigenvectors; beyond it the spectral formula loses digits

_PRIOR_STD_MPS = 4.0  # per axis: any wind up to a gale
_PRIOR_REACH_MPS = 3.0 * _PRIOR_STD_MPS
_PRIOR_LAG_S = 300.0  # about half of a mission: where the prior's change is the process's
_PRIOR_STEPS = 4  # of the lattice, to each side of its centre


@dataclass(frozen=True)
class WindChain:
    """A continuous-time Markov chain over wind vectors (to east, to north), and its start.

    Shapes: states_en_mps (S, 2), rate_per_s (S, S) with rows that sum to 0, initial (S,).
    """

    states_en_mps: Floats
    rate_per_s: Floats
    initial: Floats

    @property
    def state_count(self) -> int:
        return len(self.states_en_mps)

    def transition(self, duration_s: float) -> Floats:
        """P[s, s'] after `duration_s`: expm(Q t); shape (S, S)."""
        return _as_probabilities(np.asarray(expm(self.rate_per_s * duration_s), dtype=float))

    def transition_rows(self, state: ArrayLike, duration_s: ArrayLike) -> Floats:
        """Row `state` of expm(Q t) for each pair (state, t); shape (..., S).

        By eigenvectors where they are well conditioned, else by uniformisation
        (Stewart, Numerical Solution of Markov Chains, 1994, ch. 8).
        """
        state, duration = np.broadcast_arrays(np.asarray(state), np.asarray(duration_s, float))
        flat_state, flat_duration = state.ravel(), duration.ravel()
        rows = np.empty((flat_state.size, self.state_count))
        spectrum = self._spectrum
        for s in np.unique(flat_state):
            chosen = np.flatnonzero(flat_state == s)
            if spectrum is None:
                rows[chosen] = self._uniformised(int(s), flat_duration[chosen])
            else:
                values, left, right = spectrum
                decay = np.exp(np.multiply.outer(flat_duration[chosen], values))
                rows[chosen] = np.real((decay * left[s]) @ right)
        return _as_probabilities(rows).reshape(*state.shape, self.state_count)

    @cached_property
    def _spectrum(self) -> tuple[NDArray, NDArray, NDArray] | None:
        values, vectors = np.linalg.eig(self.rate_per_s)
        if np.linalg.cond(vectors) > CONDITION_LIMIT:
            return None
        if np.all(np.isreal(values)) and np.all(np.isreal(vectors)):
            values, vectors = np.real(values), np.real(vectors)
        inverse = np.linalg.inv(vectors)
        return values, vectors, inverse

    def _uniformised(self, state: int, duration_s: Floats) -> Floats:
        rate = max(float(-self.rate_per_s.diagonal().min()), 1e-300)
        jump = np.eye(self.state_count) + self.rate_per_s / rate
        unique, back = np.unique(duration_s, return_inverse=True)
        mean = rate * unique
        row = np.zeros(self.state_count)
        row[state] = 1.0
        rows = np.zeros((len(unique), self.state_count))
        log_weight = -mean
        last = int(mean.max(initial=0.0) + 10.0 * np.sqrt(mean.max(initial=0.0)) + 30.0)
        with np.errstate(divide="ignore"):
            log_mean = np.log(mean)
        for n in range(last + 1):
            rows += np.exp(log_weight)[:, None] * row
            row = row @ jump
            log_weight = log_weight + log_mean - np.log(n + 1)
        return rows[back]


def _as_probabilities(rows: Floats) -> Floats:
    rows = np.maximum(rows, 0.0)
    return rows / rows.sum(axis=-1, keepdims=True)


@dataclass(frozen=True)
class Sight:
    """What a planner sees of the wind: which states look alike, and as which vector.

    Shapes: of_state (S,) index of what is seen in each state; seen_en_mps (O, 2).
    """

    of_state: Ints
    seen_en_mps: Floats

    @property
    def count(self) -> int:
        return len(self.seen_en_mps)

    def reveals_state(self) -> bool:
        """True when no two states look alike."""
        return self.count == len(self.of_state)


def class_centre(wind_en_mps: ArrayLike, classes: int) -> Floats:
    """The wind with its direction moved to the centre of its sector; speed kept; (..., 2).

    `classes` equal sectors, the first centred on east, counted towards north
    (docs/reference/outcomes.md); a direction on a boundary belongs to the sector that begins there.
    """
    if classes not in (4, 8):
        raise LeewayError(f"wind classes = {classes}: expected 4 or 8")
    wind = np.asarray(wind_en_mps, dtype=float)
    speed = np.hypot(wind[..., 0], wind[..., 1])
    width = 2.0 * np.pi / classes
    sector = np.floor(np.arctan2(wind[..., 1], wind[..., 0]) / width + 0.5 + 1e-12)
    angle = sector * width
    return np.stack([speed * np.cos(angle), speed * np.sin(angle)], axis=-1)


def sight_of(chain: WindChain, classes: int | None) -> Sight:
    """What is seen of each state: its vector, or with `classes` the centre of its sector."""
    seen = chain.states_en_mps if classes is None else class_centre(chain.states_en_mps, classes)
    keys = np.round(seen, 9) + 0.0  # speeds that differ by rounding only are one speed
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return Sight(of_state=inverse.reshape(-1).astype(np.int64), seen_en_mps=seen[first])


def time_window_s(chain: WindChain, sight: Sight) -> Floats:
    """Mean time for which a class's edge costs stay valid; infinite for one never left; (O,).

    The mean stay in the set of states that look alike, entered with the chain's initial shares
    (uniform where these are 0): solves Q_oo m = -1 (phase-type distribution, Neuts 1981).
    """
    windows = np.full(sight.count, np.inf)
    for o in range(sight.count):
        members = np.flatnonzero(sight.of_state == o)
        block = chain.rate_per_s[np.ix_(members, members)]
        share = chain.initial[members]
        share = (
            share / share.sum() if share.sum() > 0.0 else np.full(len(members), 1 / len(members))
        )
        if np.linalg.matrix_rank(block) == len(members):
            windows[o] = float(share @ np.linalg.solve(block, -np.ones(len(members))))
    return windows


class WindProcess(Protocol):
    """A model of how the wind may change, from which a planner's chain is derived."""

    def chain(self) -> WindChain:
        """The process as a chain over wind vectors."""
        ...


@dataclass(frozen=True)
class OrnsteinUhlenbeckWind:
    """Wind that drifts as an isotropic Ornstein-Uhlenbeck process about a mean, as a chain.

    `std_mps` is the stationary std per axis. The lattice of `spacing_mps` reaches `reach_mps`
    from `mean_en_mps`; neighbours exchange at the rates that match the process's drift and
    diffusion (upwind-free birth-death scheme; Kushner & Dupuis 2001, ch. 5).
    """

    mean_en_mps: tuple[float, float] = (0.0, 0.0)
    std_mps: float = 4.0
    time_constant_s: float = 3600.0
    spacing_mps: float = 2.0
    reach_mps: float = 12.0

    def chain(self) -> WindChain:
        steps = round(self.reach_mps / self.spacing_mps)
        axis = np.arange(-steps, steps + 1, dtype=np.float64) * self.spacing_mps
        one = self._birth_death(axis)
        size = len(axis)
        rate = np.kron(one, np.eye(size)) + np.kron(np.eye(size), one)
        states = np.column_stack([np.repeat(axis, size), np.tile(axis, size)]).astype(np.float64)
        weight = np.exp(-0.5 * np.sum(states**2, axis=1) / self.std_mps**2)
        return WindChain(
            states_en_mps=states + np.asarray(self.mean_en_mps),
            rate_per_s=rate,
            initial=weight / weight.sum(),
        )

    def _birth_death(self, axis: Floats) -> Floats:
        """Rates between lattice points with the stationary law exp(-x^2 / 2 std^2) (detailed)."""
        diffusion = self.std_mps**2 / self.time_constant_s  # m^2/s^3, half the variance's growth
        base = diffusion / self.spacing_mps**2
        ratio = np.exp(-0.25 * np.diff(axis**2) / self.std_mps**2)
        rate = np.diag(base * ratio, 1) + np.diag(base / ratio, -1)
        return rate - np.diag(rate.sum(axis=1))

    def predictive_cov_m2ps2(self, lag_s: ArrayLike) -> Floats:
        """Covariance of the wind `lag_s` after it was seen; shape (..., 2, 2)."""
        lag = np.asarray(lag_s, dtype=float)
        variance = self.std_mps**2 * -np.expm1(-2.0 * lag / self.time_constant_s)
        return variance[..., None, None] * np.eye(2)


def lattice_belief(chain: WindChain, wind_en_mps: ArrayLike, spacing_mps: float) -> Floats:
    """Shares of the lattice states that stand for each seen wind (n, 2): bilinear; (n, S).

    Winds beyond the lattice go to its edge.
    """
    wind = np.asarray(wind_en_mps, dtype=float).reshape(-1, 2)
    low = chain.states_en_mps.min(axis=0)
    high = chain.states_en_mps.max(axis=0)
    inside = np.clip(wind, low, high)
    gap = np.abs(inside[:, None, :] - chain.states_en_mps[None, :, :]) / spacing_mps
    share = np.prod(np.maximum(0.0, 1.0 - gap), axis=2)
    return share / share.sum(axis=1, keepdims=True)


def prior_wind(
    process: WindProcessParams,
    spacing_mps: float = _PRIOR_REACH_MPS / _PRIOR_STEPS,
    reach_mps: float = _PRIOR_REACH_MPS,
) -> OrnsteinUhlenbeckWind:
    """Any wind, that changes within minutes as the process does: before a wind is known.

    One Ornstein-Uhlenbeck process whose mean squared change after `_PRIOR_LAG_S`,
    `2 std^2 (1 - exp(-lag/T))`, is that of the fitted one at its reference wind.
    """
    change = float(process.mean_squared_change_m2ps2(np.array([_PRIOR_LAG_S]), LEG_S)[0])
    share = min(change / (2.0 * _PRIOR_STD_MPS**2), 0.9)
    return OrnsteinUhlenbeckWind(
        std_mps=_PRIOR_STD_MPS,
        time_constant_s=-_PRIOR_LAG_S / math.log1p(-share),
        spacing_mps=spacing_mps,
        reach_mps=reach_mps,
    )
