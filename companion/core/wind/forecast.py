"""How the wind may move from now on, over minutes.

The process that the outlook rests on comes from a file (`process`, params/wind): on each
axis a level plus a few Ornstein-Uhlenbeck processes. A small Kalman filter over these parts takes
the place of running averages over 30 and 300 s: it weighs the history
as the process itself would have it.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import msgspec
import numpy as np
from scipy.special import chdtri

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.process import WindProcessParams, averaged_share, speed_mps

SNAPSHOT_FORMAT = "wind-outlook/1"

LEG_S = 60.0
"""What a leg meets of gusts is an average over about a minute."""

_OBSERVE_EVERY_S = 5.0
_MEAN_WIND_S = 60.0
"""Parts that remember longer make up the mean wind, which turbulence grows with."""


@dataclass(frozen=True, slots=True)
class WindForecast:
    """Joint law of the wind (about a minute's mean) at `horizon_s` (n,) from now.

    `mean_to_ne_mps` (n, 2); `walk_cov_m2ps2` (n, n) is how the wind itself may move, the same on
    both axes and independent; `error_cov_m2ps2` (2, 2) is the estimate's own lasting error, the
    same at every horizon. With `tail_dof` the walk is Student's t of that covariance: one draw of
    its scale for a whole path, as gusty hours are gusty throughout; None: Gaussian.
    """

    horizon_s: Floats
    mean_to_ne_mps: Floats
    walk_cov_m2ps2: Floats
    error_cov_m2ps2: Floats
    tail_dof: float | None = None

    @property
    def cov_m2ps2(self) -> Floats:
        """Both together, (2n, 2n), in the order n0 e0 n1 e1 ..."""
        count = self.horizon_s.size
        everywhere = np.ones((count, count))
        return np.kron(self.walk_cov_m2ps2, np.eye(2)) + np.kron(everywhere, self.error_cov_m2ps2)

    def sample(self, count: int, rng: np.random.Generator) -> Floats:
        """`count` wind paths, (count, n, 2)."""
        size = self.horizon_s.size
        walk = rng.standard_normal((count, size, 2))
        paths = np.einsum("ij,kjc->kic", _root(self.walk_cov_m2ps2), walk)
        if self.tail_dof is not None:
            paths *= tail_scale(self.tail_dof, rng.uniform(size=count))[:, None, None]
        error = rng.standard_normal((count, 1, 2)) @ _root(self.error_cov_m2ps2).T
        return self.mean_to_ne_mps + paths + error


class WindAhead(Protocol):
    """Who foresees the wind along a way: from one's own wind, or with what others told."""

    def on_way(self, belief: WindBelief, horizon_s: Floats, place_ne_m: Floats) -> WindForecast:
        """The wind at each horizon (>= 0) at the place (n, 2) where one is then."""
        ...


class WindOutlook:
    """Follows the belief over the flight and forecasts the wind; one per vehicle."""

    def __init__(self, process: WindProcessParams) -> None:
        self._process = process
        # The last part is the level: it keeps what it is.
        self._memory_s = np.array([*process.memory_s, math.inf])
        self._variance = np.array([*process.variance_m2ps2, process.level_std_mps**2])
        self._slow = self._memory_s > _MEAN_WIND_S
        self._noise_m2ps2 = process.seen_noise_std_mps**2
        self._t_s: float | None = None
        self._parts = np.zeros((self._memory_s.size, 2))
        self._cov = np.diag(self._variance)

    def observe(self, belief: WindBelief) -> None:
        """Take a belief (any rate; thinned inside). Invalid ones are ignored."""
        if not belief.valid:
            return
        if self._t_s is None or belief.t_s - self._t_s >= _OBSERVE_EVERY_S:
            self._parts, self._cov = self._taken(belief)
            self._t_s = belief.t_s

    def forecast(
        self, belief: WindBelief, horizon_s: Floats, averaged_s: float = LEG_S
    ) -> WindForecast:
        """The wind at each horizon (>= 0), given the belief now and the history observed.

        `averaged_s`: what is asked at a horizon is the mean over about so long.
        """
        parts, cov = self._taken(belief)
        scale = self._scale(belief)
        decay = np.exp(-horizon_s[:, None] / self._memory_s)
        mean = decay @ parts
        fresh = _fresh(self._process, tuple(horizon_s.tolist()), averaged_s)
        walk = (decay @ cov @ decay.T) + scale * fresh
        noise = min(self._noise_m2ps2, float(np.linalg.eigvalsh(belief.cov_ne_m2ps2)[0]))
        error = belief.cov_ne_m2ps2 - noise * np.eye(2)
        return WindForecast(horizon_s, mean, walk, error, self._process.tail_dof)

    def on_way(self, belief: WindBelief, horizon_s: Floats, place_ne_m: Floats) -> WindForecast:
        """The same wherever one is: one vehicle alone knows of one place."""
        del place_ne_m
        return self.forecast(belief, horizon_s)

    def snapshot(self) -> dict[str, object]:
        """What a checkpoint keeps (plain numbers and lists)."""
        return {
            "format": SNAPSHOT_FORMAT,
            "t_s": self._t_s,
            "parts": self._parts.tolist(),
            "cov": self._cov.tolist(),
        }

    def restore(self, snapshot: dict[str, object]) -> None:
        """Go on from a checkpoint; raises LeewayError when it is not one."""
        if snapshot.get("format") != SNAPSHOT_FORMAT:
            raise LeewayError(f"checkpoint: expected a {SNAPSHOT_FORMAT} snapshot")
        try:
            t_s = msgspec.convert(snapshot["t_s"], float | None)
            parts = np.array(msgspec.convert(snapshot["parts"], list[list[float]]))
            cov = np.array(msgspec.convert(snapshot["cov"], list[list[float]]))
        except (KeyError, ValueError, msgspec.ValidationError) as error:
            raise LeewayError(f"checkpoint: {error}") from error
        count = self._memory_s.size
        shaped = parts.shape == (count, 2) and cov.shape == (count, count)
        if not shaped or not np.isfinite([*parts.ravel(), *cov.ravel()]).all():
            raise LeewayError(f"checkpoint: expected {count} parts of the wind and covariance")
        self._t_s, self._parts, self._cov = t_s, parts, cov

    def _taken(self, belief: WindBelief) -> tuple[Floats, Floats]:
        """The parts and their covariance after this belief, without keeping them."""
        parts, cov = self._parts, self._cov
        variance = self._variance.copy()
        variance[:-1] *= self._scale(belief)
        if self._t_s is None:
            cov = np.diag(variance)
        else:
            waited_s = max(belief.t_s - self._t_s, 0.0)
            decay = np.exp(-waited_s / self._memory_s)
            parts = decay[:, None] * parts
            cov = decay[:, None] * cov * decay + np.diag(variance * (1.0 - decay**2))
        if belief.valid:
            gain = cov.sum(axis=1)
            total = float(gain.sum()) + self._noise_m2ps2
            parts = parts + np.outer(gain / total, belief.mean_to_ne_mps - parts.sum(axis=0))
            cov = cov - np.outer(gain, gain) / total
        return parts, cov

    def _scale(self, belief: WindBelief) -> float:
        """Variance here over variance at the reference wind.

        By the mean wind of the history; a lull or a gust of the moment says nothing of it. Taken
        from the wind of the moment, a lull was called steady just when it was about to end.
        """
        if self._t_s is None:
            return self._process.variance_scale(speed_mps(belief.mean_to_ne_mps))
        return self._process.variance_scale(speed_mps(self._parts[self._slow].sum(axis=0)))


@lru_cache(maxsize=32)  # a flight asks for the same few horizons, several times a second
def _fresh(process: WindProcessParams, horizon_s: tuple[float, ...], averaged_s: float) -> Floats:
    """Covariance between horizons of what the processes add after now, at the reference wind."""
    horizon = np.array(horizon_s)
    earlier = np.minimum.outer(horizon, horizon)
    apart = np.abs(np.subtract.outer(horizon, horizon))
    memories = np.array(process.memory_s)
    shares = np.array(process.variance_m2ps2) * averaged_share(memories, averaged_s)
    total = np.zeros_like(earlier)
    for memory_s, variance in zip(memories, shares, strict=True):
        total += variance * -np.expm1(-2.0 * earlier / memory_s) * np.exp(-apart / memory_s)
    total.setflags(write=False)
    return total


def tail_scale(dof: float, uniform: Floats) -> Floats:
    """Factors that make normal draws Student's t of the same variance; by quantiles in (0, 1).

    t = z / sqrt(chi2 / dof) has variance dof / (dof - 2).
    """
    return np.sqrt((dof - 2.0) / chdtri(dof, uniform))


def _root(cov: Floats) -> Floats:
    """A matrix whose product with its transpose is `cov` (symmetric, may be singular)."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))
