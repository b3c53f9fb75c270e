"""How measured energy scatters about the predicted: between days, between charges, between flights.

`log(measured / predicted) = mean + day + charge + flight`, each random and normal. Flights of one
day share its air, its pilot and its packs: a new flight on a new day scatters by all three. The
variances are those of restricted maximum likelihood (Patterson and Thompson, Biometrika 58, 1971).
The bound for a new day uses Student's t with Satterthwaite's degrees of freedom (Biometrics
Bulletin 2, 1946): ten days are few.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.stats import t as student_t

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError

_LEAST_DAYS = 3
_LEAST_STD = 1e-4
_NEW_CHARGE_V = 0.3
"""Start voltage that rises by this since the flight before: another pack, or charged again. A
flight of three minutes takes 1 V."""


@dataclass(frozen=True, slots=True)
class EnergyScatter:
    """Logarithms of measured over predicted energy: the mean with its variance, and the variances
    of one day, one charge of a pack and one flight about it; from so many days and flights."""

    mean: float
    mean_variance: float
    day_variance: float
    charge_variance: float
    flight_variance: float
    days: int
    flights: int

    @property
    def std(self) -> float:
        """Of one flight on a new day, the mean's uncertainty included."""
        own = self.day_variance + self.charge_variance + self.flight_variance
        return float(np.sqrt(own + self.mean_variance))

    @property
    def freedom(self) -> float:
        """Satterthwaite's degrees of freedom of `std`."""
        between = self.day_variance + self.mean_variance
        within = self.charge_variance + self.flight_variance
        spread = between**2 / max(self.days - 1, 1)
        spread += within**2 / max(self.flights - self.days, 1)
        return float((between + within) ** 2 / spread)

    def bound(self, share: float) -> float:
        """Factor on a predicted energy that a flight on a new day stays under with this chance."""
        quantile = float(student_t.ppf(share, self.freedom))
        return float(np.exp(self.mean + quantile * self.std))

    @property
    def factor(self) -> float:
        """Factor on a predicted energy that makes it the median of what is measured."""
        return float(np.exp(self.mean))


def charges_of(days: Sequence[str], start_v: Sequence[float]) -> list[int]:
    """Number of the pack's charge that each flight was flown on, flights in order of their start.

    A new one begins with each day and where the voltage before take-off is higher than the last's.
    """
    numbers: list[int] = []
    before: tuple[str, float] | None = None
    for day, volt in zip(days, start_v, strict=True):
        fresh = before is None or before[0] != day or volt > before[1] + _NEW_CHARGE_V
        numbers.append((numbers[-1] if numbers else -1) + int(fresh))
        before = (day, volt)
    return numbers


def fit_scatter(logs: Floats, days: Sequence[str], charges: Sequence[int]) -> EnergyScatter:
    """Variances by restricted maximum likelihood; (n,) each; LeewayError under three days."""
    logs = np.asarray(logs, np.float64)
    count = len(set(days))
    if count < _LEAST_DAYS:
        raise LeewayError(f"scatter by days: {count} days, at least {_LEAST_DAYS} expected")
    parts = [_same(days), _same(charges), np.eye(len(logs))]
    start = np.full(3, max(float(np.std(logs)), _LEAST_STD) / np.sqrt(3.0))

    def loss(stds: Floats) -> float:
        return _restricted_loss(logs, _covariance(parts, stds))[0]

    found = minimize(
        loss, start, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-6, "maxiter": 2000}
    )
    variances = found.x**2
    _, mean, mean_variance = _restricted_loss(logs, _covariance(parts, found.x))
    return EnergyScatter(
        mean,
        mean_variance,
        *(float(v) for v in variances[:2]),
        flight_variance=float(variances[2] + _LEAST_STD**2),
        days=count,
        flights=len(logs),
    )


def _same(labels: Sequence[object]) -> Floats:
    """1 where two flights share a label."""
    _, number = np.unique(np.asarray(labels), return_inverse=True)
    return (number[:, None] == number[None, :]).astype(np.float64)


def _covariance(parts: list[Floats], stds: Floats) -> Floats:
    own = _LEAST_STD**2 * parts[-1]
    return own + sum(std**2 * part for std, part in zip(stds, parts, strict=True))


def _restricted_loss(logs: Floats, cov: Floats) -> tuple[float, float, float]:
    """Minus twice the restricted log-likelihood; the mean and its variance at it."""
    root = cho_factor(cov, lower=True)
    ones = np.ones_like(logs)
    information = float(ones @ cho_solve(root, ones))
    mean = float(ones @ cho_solve(root, logs)) / information
    left = logs - mean
    determinant = 2.0 * float(np.log(np.diag(root[0])).sum())
    loss = determinant + np.log(information) + float(left @ cho_solve(root, left))
    return loss, mean, 1.0 / information
