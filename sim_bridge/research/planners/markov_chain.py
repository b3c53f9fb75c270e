"""Wind as a Markov chain: the planner's model of how the wind can change.

The chain either comes with a scenario or is derived from a continuous process,
so that one planner serves both a known chain and an estimate with covariance.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from companion.core.base.arrays import Floats, Ints
from companion.core.wind.forecast import LEG_AVERAGING_S
from companion.core.wind.process import WindProcessParams

CONDITION_LIMIT = 1e6  # of the eigenvectors; above it the spectral formula loses digits

_PRIOR_STD_MPS = 4.0  # per axis: covers winds up to a gale
_PRIOR_EXTENT_MPS = 3.0 * _PRIOR_STD_MPS
_PRIOR_LAG_S = 300.0  # about half of a mission: the prior's change equals the process's here
_PRIOR_STEPS = 4  # of the lattice, to each side of its centre


@dataclass(frozen=True)
class WindChain:
    """A continuous-time Markov chain over wind vectors (to east, to north).

    Shapes: states_en_mps (S, 2), rate_per_s (S, S) with rows that sum to 0, initial (S,).
    """

    states_en_mps: Floats
    rate_per_s: Floats
    initial: Floats

    @property
    def state_count(self) -> int:
        return len(self.states_en_mps)

    def transition_matrix(self, duration_s: float) -> Floats:
        """Return P[s, s'] after `duration_s`: expm(Q t); shape (S, S)."""
        return _normalize_rows(np.asarray(expm(self.rate_per_s * duration_s), dtype=float))

    def transition_probability_rows(self, state: ArrayLike, duration_s: ArrayLike) -> Floats:
        """Return row `state` of expm(Q t) for each pair (state, t); shape (..., S).

        Uses eigenvectors where they are well conditioned, else scipy's matrix exponential.
        """
        state, duration = np.broadcast_arrays(np.asarray(state), np.asarray(duration_s, float))
        flat_state, flat_duration = state.ravel(), duration.ravel()
        rows = np.empty((flat_state.size, self.state_count))
        spectrum = self._eigendecomposition
        for s in np.unique(flat_state):
            selected = np.flatnonzero(flat_state == s)
            if spectrum is None:
                unique, back = np.unique(flat_duration[selected], return_inverse=True)
                rows[selected] = np.stack([self.transition_matrix(t)[s] for t in unique])[back]
            else:
                values, left, right = spectrum
                decay = np.exp(np.multiply.outer(flat_duration[selected], values))
                rows[selected] = np.real((decay * left[s]) @ right)
        return _normalize_rows(rows).reshape(*state.shape, self.state_count)

    @cached_property
    def _eigendecomposition(self) -> tuple[NDArray, NDArray, NDArray] | None:
        values, vectors = np.linalg.eig(self.rate_per_s)
        if np.linalg.cond(vectors) > CONDITION_LIMIT:
            return None
        if np.all(np.isreal(values)) and np.all(np.isreal(vectors)):
            values, vectors = np.real(values), np.real(vectors)
        inverse = np.linalg.inv(vectors)
        return values, vectors, inverse


def _normalize_rows(rows: Floats) -> Floats:
    rows = np.maximum(rows, 0.0)
    return rows / rows.sum(axis=-1, keepdims=True)


@dataclass(frozen=True)
class Sight:
    """The planner's observation of the wind: groups of indistinguishable states, one vector each.

    Shapes: of_state (S,) index of the observed wind in each state; seen_en_mps (O, 2).
    """

    of_state: Ints
    seen_en_mps: Floats

    @property
    def observed_wind_count(self) -> int:
        return len(self.seen_en_mps)

    def reveals_state(self) -> bool:
        """Return True if every state has its own observed wind."""
        return self.observed_wind_count == len(self.of_state)


def snap_direction_to_sector_centre(wind_en_mps: ArrayLike, sector_count: int) -> Floats:
    """Move each wind's direction to the centre of its sector, with the same speed; (..., 2).

    `sector_count` equal sectors, the first centred on east, counted towards north
    (docs/reference/outcomes.md). A direction on a boundary belongs to the sector that starts there.
    """
    wind = np.asarray(wind_en_mps, dtype=float)
    speed = np.hypot(wind[..., 0], wind[..., 1])
    width = 2.0 * np.pi / sector_count
    sector = np.floor(np.arctan2(wind[..., 1], wind[..., 0]) / width + 0.5 + 1e-12)
    angle = sector * width
    return np.stack([speed * np.cos(angle), speed * np.sin(angle)], axis=-1)


def build_observed_wind_by_state(chain: WindChain, sector_count: int | None) -> Sight:
    """Return each state's observation: its vector, or with `sector_count` its sector's centre."""
    seen = (
        chain.states_en_mps
        if sector_count is None
        else snap_direction_to_sector_centre(chain.states_en_mps, sector_count)
    )
    keys = np.round(seen, 9) + 0.0  # merges speeds that differ by rounding only
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return Sight(of_state=inverse.reshape(-1).astype(np.int64), seen_en_mps=seen[first])


@dataclass(frozen=True)
class OrnsteinUhlenbeckWind:
    """Wind that drifts as an isotropic Ornstein-Uhlenbeck process about still air, as a chain.

    `std_mps` is the stationary std per axis. The lattice is square around calm;
    neighbours exchange at the rates that match the process's drift and
    diffusion (upwind-free birth-death scheme; Kushner & Dupuis 2001, ch. 5).
    """

    std_mps: float
    time_constant_s: float
    spacing_mps: float
    extent_mps: float

    def build_lattice_chain(self) -> WindChain:
        steps = round(self.extent_mps / self.spacing_mps)
        axis = np.arange(-steps, steps + 1, dtype=np.float64) * self.spacing_mps
        one = self._axis_rates_per_s(axis)
        size = len(axis)
        rate = np.kron(one, np.eye(size)) + np.kron(np.eye(size), one)
        states = np.column_stack([np.repeat(axis, size), np.tile(axis, size)]).astype(np.float64)
        weight = np.exp(-0.5 * np.sum(states**2, axis=1) / self.std_mps**2)
        return WindChain(
            states_en_mps=states,
            rate_per_s=rate,
            initial=weight / weight.sum(),
        )

    def _axis_rates_per_s(self, axis: Floats) -> Floats:
        """Rates between lattice points; detailed balance with exp(-x^2 / 2 std^2)."""
        diffusion = self.std_mps**2 / self.time_constant_s  # m^2/s^3, half the variance's growth
        base = diffusion / self.spacing_mps**2
        ratio = np.exp(-0.25 * np.diff(axis**2) / self.std_mps**2)
        rate = np.diag(base * ratio, 1) + np.diag(base / ratio, -1)
        return rate - np.diag(rate.sum(axis=1))

    def predictive_variance_m2ps2(self, lag_s: ArrayLike) -> Floats:
        """Return the variance of each axis of the wind `lag_s` after observation."""
        return self.std_mps**2 * -np.expm1(-2.0 * np.asarray(lag_s, float) / self.time_constant_s)


def build_prior_wind(
    process: WindProcessParams,
    spacing_mps: float = _PRIOR_EXTENT_MPS / _PRIOR_STEPS,
    extent_mps: float = _PRIOR_EXTENT_MPS,
) -> OrnsteinUhlenbeckWind:
    """Return the prior for an unknown wind, which changes within minutes as the process does.

    One Ornstein-Uhlenbeck process. Its mean squared change after `_PRIOR_LAG_S`,
    `2 std^2 (1 - exp(-lag/T))`, equals that of the fitted process at its reference wind.
    """
    change = float(process.mean_squared_change_m2ps2(np.array([_PRIOR_LAG_S]), LEG_AVERAGING_S)[0])
    share = min(change / (2.0 * _PRIOR_STD_MPS**2), 0.9)
    return OrnsteinUhlenbeckWind(
        std_mps=_PRIOR_STD_MPS,
        time_constant_s=-_PRIOR_LAG_S / math.log1p(-share),
        spacing_mps=spacing_mps,
        extent_mps=extent_mps,
    )
