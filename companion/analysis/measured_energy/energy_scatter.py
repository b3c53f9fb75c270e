"""Scatter of measured about predicted energy: between days, between charges, between flights.

`log(measured / predicted) = mean + day + charge + flight`, each random and normal. Flights of one
day share its air, its pilot and its packs: a new flight on a new day scatters by all three. The
variances are those of restricted maximum likelihood (Patterson and Thompson, Biometrika 58, 1971).
The bound for a new day is a quantile of the sum of a day effect and the deviations of the flights
from their days' means. The day effect has Student's t of the number of days: ten days are few. The
deviations are used as measured, because the tails of flights are not those of a normal.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize, root_scalar
from scipy.stats import t as student_t

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError

_MIN_DAYS = 3
_MIN_STD = 1e-4
_NEW_CHARGE_V = 0.3
"""Rise of the start voltage over the previous flight that indicates another pack or a recharge. A
flight of three minutes lowers it by 1 V."""


@dataclass(frozen=True, slots=True)
class EnergyScatter:
    """Logarithm of measured over predicted energy: mean and its variance, and variances of day,
    charge and flight effects; `days` and `flights` are the numbers fitted. `deviations` of the
    flights from their days' means have the variance of a charge and a flight."""

    mean: float
    mean_variance: float
    day_variance: float
    charge_variance: float
    flight_variance: float
    days: int
    flights: int
    deviations: tuple[float, ...]

    @property
    def std(self) -> float:
        """Standard deviation of a flight on a new day, including the mean's uncertainty."""
        own = self.day_variance + self.charge_variance + self.flight_variance
        return float(np.sqrt(own + self.mean_variance))

    def upper_bound_factor(self, probability: float) -> float:
        """Return the factor on predicted energy that bounds a new day's flight at `probability`.

        Fewer flights than have this quantile (19 for 95 %) are bounded by the days' t on `std`.
        """
        of_days = student_t(self.days - 1)
        quantile = float(of_days.ppf(probability))
        deviations = np.array(self.deviations)
        if probability * (len(deviations) + 1) >= len(deviations):
            return float(np.exp(self.mean + quantile * self.std))
        between_std = float(np.sqrt(self.day_variance + self.mean_variance))

        def missing_probability(bound: float) -> float:
            return probability - float(of_days.cdf((bound - deviations) / between_std).mean())

        low = deviations.min() + (quantile - 1.0) * between_std
        high = deviations.max() + (quantile + 1.0) * between_std
        return float(np.exp(self.mean + root_scalar(missing_probability, bracket=(low, high)).root))

    @property
    def median_factor(self) -> float:
        """Factor that converts predicted energy to the median of measured energy."""
        return float(np.exp(self.mean))


def charge_number_by_flight(
    day_by_flight: Sequence[str], start_voltage_v_by_flight: Sequence[float]
) -> list[int]:
    """Return the number of the pack charge of each flight, in order of flight start.

    A new charge starts with each day and at each rise of the voltage before take-off.
    """
    numbers: list[int] = []
    before: tuple[str, float] | None = None
    for day, volt in zip(day_by_flight, start_voltage_v_by_flight, strict=True):
        is_recharged = before is None or before[0] != day or volt > before[1] + _NEW_CHARGE_V
        numbers.append((numbers[-1] if numbers else -1) + int(is_recharged))
        before = (day, volt)
    return numbers


def fit_energy_ratio_scatter(
    log_energy_ratios: Floats, day_by_flight: Sequence[str], charge_by_flight: Sequence[int]
) -> EnergyScatter:
    """Fit variances (n,) by restricted maximum likelihood; LeewayError under three days."""
    log_energy_ratios = np.asarray(log_energy_ratios, np.float64)
    count = len(set(day_by_flight))
    if count < _MIN_DAYS:
        raise LeewayError(f"scatter by days: {count} days, at least {_MIN_DAYS} expected")
    parts = [
        _label_equality_matrix(day_by_flight),
        _label_equality_matrix(charge_by_flight),
        np.eye(len(log_energy_ratios)),
    ]
    start = np.full(3, max(float(np.std(log_energy_ratios)), _MIN_STD) / np.sqrt(3.0))

    def restricted_loss_of_stds(stds: Floats) -> float:
        return _restricted_loss_mean_and_mean_variance(
            log_energy_ratios, _scatter_covariance(parts, stds)
        )[0]

    found = minimize(
        restricted_loss_of_stds,
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-6, "maxiter": 2000},
    )
    variances = found.x**2
    _, mean, mean_variance = _restricted_loss_mean_and_mean_variance(
        log_energy_ratios, _scatter_covariance(parts, found.x)
    )
    return EnergyScatter(
        mean,
        mean_variance,
        *(float(v) for v in variances[:2]),
        flight_variance=float(variances[2] + _MIN_STD**2),
        days=count,
        flights=len(log_energy_ratios),
        deviations=_deviations_from_day_means(
            log_energy_ratios, parts[0], float(np.sum(variances[1:])) + _MIN_STD**2
        ),
    )


def _deviations_from_day_means(
    log_energy_ratios: Floats, is_same_day: Floats, variance: float
) -> tuple[float, ...]:
    """Return the deviations of flights on days with several, scaled to this variance."""
    counts = is_same_day.sum(axis=1)
    several = counts > 1.0
    deviations = (log_energy_ratios - is_same_day @ log_energy_ratios / counts)[several]
    deviations *= np.sqrt(counts / np.maximum(counts - 1.0, 1.0))[several]
    mean_square = max(float(np.mean(deviations**2)), _MIN_STD**2) if several.any() else 1.0
    return tuple(deviations * np.sqrt(variance / mean_square))


def _label_equality_matrix(labels: Sequence[object]) -> Floats:
    """Return a matrix with 1 for each pair of flights with equal labels."""
    _, number = np.unique(np.asarray(labels), return_inverse=True)
    return (number[:, None] == number[None, :]).astype(np.float64)


def _scatter_covariance(equality_matrices: list[Floats], stds: Floats) -> Floats:
    own = _MIN_STD**2 * equality_matrices[-1]
    return own + sum(std**2 * part for std, part in zip(stds, equality_matrices, strict=True))


def _restricted_loss_mean_and_mean_variance(
    log_energy_ratios: Floats, cov: Floats
) -> tuple[float, float, float]:
    """Return minus twice the restricted log-likelihood, the mean and its variance."""
    root = cho_factor(cov, lower=True)
    unit_vector = np.ones_like(log_energy_ratios)
    information = float(unit_vector @ cho_solve(root, unit_vector))
    mean = float(unit_vector @ cho_solve(root, log_energy_ratios)) / information
    residuals = log_energy_ratios - mean
    determinant = 2.0 * float(np.log(np.diag(root[0])).sum())
    loss = determinant + np.log(information) + float(residuals @ cho_solve(root, residuals))
    return loss, mean, 1.0 / information
