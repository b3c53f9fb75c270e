"""Checks the estimates of a wind estimator from another package."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.plugin import WIND_ESTIMATORS, PluginGuard, load_plugin
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.observation import WindBelief, WindFilter, WindObservation

MAX_WIND_MPS = 100.0
SYMMETRY_TOLERANCE = 1e-6

WindFilterFactory = Callable[[Airframe], WindFilter]
"""Builds an estimator for an airframe: a class, or a function."""


class CheckedWindFilter:
    """A wind estimator whose exceptions and invalid estimates become a LeewayError.

    An estimate has a mean (2,) below 100 m/s and a symmetric, positive definite covariance (2, 2),
    both finite.
    """

    def __init__(self, label: str, factory: WindFilterFactory, airframe: Airframe) -> None:
        self._guard = PluginGuard(f"wind estimator {label}")
        self._filter: Any = self._guard.call("constructor", factory, airframe)

    def update(self, observation: WindObservation) -> tuple[str, ...]:
        """Process one observation; returns a message for each rejected measurement."""
        return tuple(self._guard.call("update", self._filter.update, observation) or ())

    def belief(self, t_s: float) -> WindBelief:
        """Return the checked estimate, its arrays as numpy arrays of float64."""
        found = self._guard.call("belief", self._filter.belief, t_s)
        try:
            mean = np.asarray(found.mean_to_ne_mps, dtype=float)
            cov = np.asarray(found.cov_ne_m2ps2, dtype=float)
        except (AttributeError, TypeError, ValueError) as error:
            raise self._error(t_s, f"{error}; expected a WindBelief") from error
        if mean.shape != (2,) or not np.hypot(*mean) < MAX_WIND_MPS:
            expected = f"2 numbers, below {MAX_WIND_MPS:.0f} m/s"
            raise self._error(t_s, f"mean_to_ne_mps = {mean.tolist()}: expected {expected}")
        if cov.shape != (2, 2) or not _is_covariance(cov):
            expected = "2 x 2, finite, symmetric, positive definite"
            raise self._error(t_s, f"cov_ne_m2ps2 = {cov.tolist()}: expected {expected}")
        return replace(found, mean_to_ne_mps=mean, cov_ne_m2ps2=cov)

    def snapshot(self) -> dict[str, object]:
        """Return the estimator's checkpoint; empty if it has none."""
        save = getattr(self._filter, "snapshot", None)
        return self._guard.call("snapshot", save) if save else {}

    def restore(self, snapshot: dict[str, object]) -> None:
        """Restore a checkpoint; an estimator without checkpoints starts again."""
        restore = getattr(self._filter, "restore", None)
        if restore:
            self._guard.call("restore", restore, snapshot)

    def _error(self, t_s: float, text: str) -> LeewayError:
        return self._guard.error(f"belief at {t_s:.2f} s: {text}")


def _is_covariance(cov: Floats) -> bool:
    is_symmetric = bool(np.abs(cov - cov.T).max() <= SYMMETRY_TOLERANCE * np.abs(cov).max())
    is_definite = cov[0, 0] > 0.0 and cov[0, 0] * cov[1, 1] > cov[0, 1] * cov[1, 0]
    return bool(np.isfinite(cov).all()) and is_symmetric and bool(is_definite)


def checked_filter_factory(
    estimator: str | WindFilterFactory,
) -> Callable[[Airframe], CheckedWindFilter]:
    """Return a factory of checked estimators: a plug-in by name, or a class of the caller."""
    if isinstance(estimator, str):
        plugin = load_plugin(WIND_ESTIMATORS, estimator)
        label, factory = plugin.label, plugin.target
    else:
        label, factory = getattr(estimator, "__name__", type(estimator).__name__), estimator
    return lambda airframe: CheckedWindFilter(label, factory, airframe)
