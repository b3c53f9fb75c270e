"""How the mean wind may move from now on, over minutes: a sum of Ornstein-Uhlenbeck processes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.wind_estimator import WindBelief

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WindForecast:
    """Joint Gaussian of the mean wind at `horizon_s` (n,) from now.

    `mean_to_ne_mps` (n, 2); `cov_m2ps2` (2n, 2n) in the order n0 e0 n1 e1 ...
    """

    horizon_s: FloatArray
    mean_to_ne_mps: FloatArray
    cov_m2ps2: FloatArray


class WindOutlook:
    """Follows the belief over the flight and forecasts the mean wind; one per vehicle."""

    def observe(self, belief: WindBelief) -> None:
        """Take a belief (any rate; thinned inside). Invalid ones are ignored."""
        raise NotImplementedError

    def forecast(self, belief: WindBelief, horizon_s: FloatArray) -> WindForecast:
        """The wind at each horizon (>= 0), given the belief now and the history observed."""
        raise NotImplementedError

    def snapshot(self) -> dict[str, object]:
        """What a checkpoint keeps (plain numbers and lists)."""
        raise NotImplementedError

    def restore(self, snapshot: dict[str, object]) -> None:
        """Go on from a checkpoint; raises LeewayError when it is not one."""
        raise NotImplementedError
