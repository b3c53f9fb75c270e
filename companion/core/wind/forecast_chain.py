"""The wind outlook as a chain that the value table can be made on."""

import math

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.forecast import LEG_S, WindForecast
from companion.core.wind.markov_chain import OrnsteinUhlenbeckWind
from companion.core.wind.process import WindProcessParams

STEPS = 4  # of the lattice, to each side of its centre
REACH_STDS = 3.0
LEAST_STD_MPS = 0.6
HORIZONS_S = np.array([0.0, 20.0, 45.0, 90.0, 150.0, 240.0, 360.0, 540.0, 800.0])
_TIME_CONSTANTS_S = np.geomspace(40.0, 6000.0, 26)

_PRIOR_STD_MPS = 4.0  # per axis: any wind up to a gale
_PRIOR_REACH_MPS = REACH_STDS * _PRIOR_STD_MPS
_PRIOR_LAG_S = 300.0  # about half of a mission: where the prior's change is the process's


def prior_wind(
    process: WindProcessParams,
    spacing_mps: float = _PRIOR_REACH_MPS / STEPS,
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


def nearest_process(forecast: WindForecast) -> OrnsteinUhlenbeckWind:
    """The process whose mean and covariance come nearest to the forecast's.

    By least squares over the forecast's horizons, each weighted by the time that it stands for.
    """
    time_s = forecast.horizon_s
    weight = np.gradient(time_s)
    std, constant = _nearest_walk(time_s, weight, forecast.walk_cov_m2ps2)
    now, gone = forecast.mean_to_ne_mps[0], np.exp(-time_s / constant)
    share = weight * (1.0 - gone)
    to = forecast.mean_to_ne_mps - now * gone[:, None]
    centre = (share @ to) / float(share @ (1.0 - gone))
    away = float(np.abs(now - centre).max())
    reach = max(REACH_STDS * std, away + 2.0 * std)
    return OrnsteinUhlenbeckWind(
        mean_en_mps=(float(centre[1]), float(centre[0])),
        std_mps=std,
        time_constant_s=constant,
        spacing_mps=reach / STEPS,
        reach_mps=reach,
    )


def _nearest_walk(time_s: Floats, weight: Floats, cov_m2ps2: Floats) -> tuple[float, float]:
    """Stationary std and time constant of the walk from a wind that is known now."""
    weights = np.outer(weight, weight)
    best = (math.inf, LEAST_STD_MPS, float(_TIME_CONSTANTS_S[0]))
    for constant in _TIME_CONSTANTS_S:
        earlier = np.minimum.outer(time_s, time_s)
        apart = np.abs(np.subtract.outer(time_s, time_s))
        unit = np.exp(-apart / constant) * -np.expm1(-2.0 * earlier / constant)
        variance = float((weights * unit * cov_m2ps2).sum() / (weights * unit**2).sum())
        error = float((weights * (variance * unit - cov_m2ps2) ** 2).sum())
        if error < best[0]:
            best = (error, max(math.sqrt(max(variance, 0.0)), LEAST_STD_MPS), float(constant))
    return best[1], best[2]


def axis_shares(
    process: OrnsteinUhlenbeckWind, wind_en_mps: Floats, std_en_mps: Floats
) -> tuple[Floats, Floats]:
    """Shares of the lattice's rows (east) and columns (north) for a wind as believed.

    Three points of a Gauss rule per axis (0 and +-sqrt(3) std, 2/3 and 1/6), each shared between
    its two neighbours; their product is `wind_chain.lattice_belief` spread by the belief's error.
    """
    points = wind_en_mps[:, None] + std_en_mps[:, None] * _GAUSS_POINTS
    steps = round(process.reach_mps / process.spacing_mps)
    place = (points - np.array(process.mean_en_mps)[:, None]) / process.spacing_mps
    place = np.minimum(np.maximum(place, -steps), steps)
    gap = np.abs(place[:, :, None] - np.arange(-steps, steps + 1))
    shares = _GAUSS_WEIGHTS @ np.maximum(0.0, 1.0 - gap)
    return shares[0], shares[1]


_GAUSS_POINTS = np.array([-math.sqrt(3.0), 0.0, math.sqrt(3.0)])
_GAUSS_WEIGHTS = np.array([1.0, 4.0, 1.0]) / 6.0
