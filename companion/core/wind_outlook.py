"""How the wind may move from now on, over minutes.

Each axis of the wind is a level plus three Ornstein-Uhlenbeck processes, `dx = -x/T dt + noise`,
with stationary variance v. Fitted to the variogram of 10 s means of a coastal recording
(shared/data/wind/coast_2023_1hz.csv, mean wind 8.6 m/s; half the mean squared change, m^2/s^2):

| lag s | recording | v = 1.0, 0.6, 1.5 at T = 15, 150, 1500 s |
| --- | --- | --- |
| 20 | 0.81 | 0.83 |
| 120 | 1.52 | 1.45 |
| 300 | 1.79 | 1.79 |
| 600 | 2.18 | 2.08 |
| 1200 | 2.45 | 2.43 |

which also gives evaluation.md section 6: a forecast from the last 30 s errs by 1.2 m/s, one that
also uses the last 300 s by 0.7 to 1.0. A small Kalman filter over the four parts takes the place
of running averages over 30 and 300 s: it weighs the history as the process itself would have it.
"""

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.core.errors import LeewayError
from companion.core.wind_estimator import WindBelief

FloatArray = NDArray[np.float64]

SNAPSHOT_FORMAT = "wind-outlook/1"

_MEMORY_S = np.array([15.0, 150.0, 1500.0, math.inf])
_VARIANCE_M2PS2 = np.array([1.0, 0.6, 1.5, 100.0])  # the level: any wind
_REFERENCE_WIND_MPS = 8.6
_LEAST_SCALE, _MOST_SCALE = 0.75, 1.8  # of standard deviations, with the wind's own speed
# What a leg meets of the fastest part is an average over about a minute: 2 T / 60 s of it.
_FAST_AVERAGED_FRAC = 0.4
_OBSERVE_EVERY_S = 5.0
# The part of the belief's variance that is noise, new each time; the rest stays (trim, drag gain).
_NOISE_M2PS2 = 0.4**2


@dataclass(frozen=True, slots=True)
class WindForecast:
    """Joint Gaussian of the wind (about a minute's mean) at `horizon_s` (n,) from now.

    `mean_to_ne_mps` (n, 2); `walk_cov_m2ps2` (n, n) is how the wind itself may move, the same on
    both axes and independent; `error_cov_m2ps2` (2, 2) is the estimate's own lasting error, the
    same at every horizon.
    """

    horizon_s: FloatArray
    mean_to_ne_mps: FloatArray
    walk_cov_m2ps2: FloatArray
    error_cov_m2ps2: FloatArray

    @property
    def cov_m2ps2(self) -> FloatArray:
        """Both together, (2n, 2n), in the order n0 e0 n1 e1 ..."""
        count = self.horizon_s.size
        everywhere = np.ones((count, count))
        return np.kron(self.walk_cov_m2ps2, np.eye(2)) + np.kron(everywhere, self.error_cov_m2ps2)

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """`count` wind paths, (count, n, 2)."""
        size = self.horizon_s.size
        walk = rng.standard_normal((count, size, 2))
        paths = np.einsum("ij,kjc->kic", _root(self.walk_cov_m2ps2), walk)
        error = rng.standard_normal((count, 1, 2)) @ _root(self.error_cov_m2ps2).T
        return self.mean_to_ne_mps + paths + error


class WindOutlook:
    """Follows the belief over the flight and forecasts the wind; one per vehicle."""

    def __init__(self) -> None:
        self._t_s: float | None = None
        self._parts = np.zeros((4, 2))
        self._cov = np.diag(_VARIANCE_M2PS2)

    def observe(self, belief: WindBelief) -> None:
        """Take a belief (any rate; thinned inside). Invalid ones are ignored."""
        if not belief.valid:
            return
        if self._t_s is None or belief.t_s - self._t_s >= _OBSERVE_EVERY_S:
            self._parts, self._cov = self._taken(belief)
            self._t_s = belief.t_s

    def forecast(self, belief: WindBelief, horizon_s: FloatArray) -> WindForecast:
        """The wind at each horizon (>= 0), given the belief now and the history observed."""
        parts, cov = self._taken(belief)
        scale = _scale(belief)
        decay = np.exp(-horizon_s[:, None] / _MEMORY_S)
        mean = decay @ parts
        walk = (decay @ cov @ decay.T) + self._fresh(horizon_s, scale)
        noise = min(_NOISE_M2PS2, float(np.linalg.eigvalsh(belief.cov_ne_m2ps2)[0]))
        error = belief.cov_ne_m2ps2 - noise * np.eye(2)
        return WindForecast(horizon_s, mean, walk, error)

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
        shaped = parts.shape == (4, 2) and cov.shape == (4, 4)
        if not shaped or not np.isfinite([*parts.ravel(), *cov.ravel()]).all():
            raise LeewayError("checkpoint: expected 4 parts of the wind and their covariance")
        self._t_s, self._parts, self._cov = t_s, parts, cov

    def _taken(self, belief: WindBelief) -> tuple[FloatArray, FloatArray]:
        """The parts and their covariance after this belief, without keeping them."""
        parts, cov = self._parts, self._cov
        scale = _scale(belief)
        if self._t_s is None:
            cov = np.diag(_VARIANCE_M2PS2 * np.array([scale, scale, scale, 1.0]))
        else:
            waited_s = max(belief.t_s - self._t_s, 0.0)
            decay = np.exp(-waited_s / _MEMORY_S)
            parts = decay[:, None] * parts
            added = scale * _VARIANCE_M2PS2 * (1.0 - decay**2)
            cov = decay[:, None] * cov * decay + np.diag(np.where(decay < 1.0, added, 0.0))
        if belief.valid:
            gain = cov.sum(axis=1)
            total = float(gain.sum()) + _NOISE_M2PS2
            parts = parts + np.outer(gain / total, belief.mean_to_ne_mps - parts.sum(axis=0))
            cov = cov - np.outer(gain, gain) / total
        return parts, cov

    @staticmethod
    def _fresh(horizon_s: FloatArray, scale: float) -> FloatArray:
        """Covariance between horizons of what the processes add after now."""
        earlier = np.minimum.outer(horizon_s, horizon_s)
        later = np.maximum.outer(horizon_s, horizon_s)
        total = np.zeros_like(earlier)
        for memory_s, variance, share in zip(
            _MEMORY_S[:3], _VARIANCE_M2PS2[:3], (_FAST_AVERAGED_FRAC, 1.0, 1.0), strict=True
        ):
            grown = 1.0 - np.exp(-2.0 * earlier / memory_s)
            total += share * scale * variance * grown * np.exp(-(later - earlier) / memory_s)
        return total


def _scale(belief: WindBelief) -> float:
    """Variance here over variance at the reference wind."""
    speed = math.hypot(float(belief.mean_to_ne_mps[0]), float(belief.mean_to_ne_mps[1]))
    return min(max(speed / _REFERENCE_WIND_MPS, _LEAST_SCALE), _MOST_SCALE) ** 2


def _root(cov: FloatArray) -> FloatArray:
    """A matrix whose product with its transpose is `cov` (symmetric, may be singular)."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))
