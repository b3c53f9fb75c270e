"""The gate's random numbers: one set of quasi-random wind paths and model errors, reused."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from companion.core.wind_outlook import WindForecast, tail_scale

FloatArray = NDArray[np.float64]

_COMPONENTS = 5  # of the wind's walk, per axis: they hold over 99 % of its variance
_WALK = slice(0, 2 * _COMPONENTS)
_ERROR = slice(2 * _COMPONENTS, 2 * _COMPONENTS + 2)

# Direction numbers of Sobol's sequence after the first coordinate: degree and inner coefficients
# of the primitive polynomial, and the first odd numbers (Joe and Kuo 2008, new-joe-kuo-6.21201).
_SOBOL_BITS = 30
_SOBOL = (
    (0, (1,)),
    (1, (1, 3)),
    (1, (1, 3, 1)),
    (2, (1, 1, 1)),
    (1, (1, 1, 3, 3)),
    (4, (1, 3, 5, 13)),
    (2, (1, 1, 5, 5, 17)),
    (4, (1, 1, 5, 5, 5)),
    (7, (1, 1, 7, 11, 19)),
    (11, (1, 1, 5, 1, 1)),
    (13, (1, 1, 1, 3, 11)),
    (14, (1, 3, 5, 5, 31)),
    (1, (1, 3, 3, 9, 7, 49)),
)
# A digital shift, the same for all points, keeps the sequence even (Owen 1998); of 64 drawn this is
# the one with which 512 points come nearest to 16,384 in 36 situations (docs/wind.md, "Sampling").
_SHIFT = (
    0x315C125E,
    0x17723A55,
    0x2A3BB4F0,
    0x0CC14168,
    0x3C6D046A,
    0x05AAF0BD,
    0x10F5C27C,
    0x29CDE482,
    0x010EFFB3,
    0x1D65C734,
    0x0968E1E8,
    0x3F3613CC,
    0x15055492,
    0x3680175C,
)


@dataclass(frozen=True, slots=True)
class WindPaths:
    """Sampled winds, north then east: `walk_ne_mps` (2, n, count) at the horizons, mean included;
    the estimate's lasting error (2, 1, count), which adds to all of them.
    """

    walk_ne_mps: FloatArray
    error_ne_mps: FloatArray


class PathSampler:
    """`count` standard-normal points that fill their space evenly (Sobol's sequence).

    The same at every call, so that a gate's answers change only with what it is told, and replay
    is exact.

    The sequence's first coordinate is the evenest, so it is laid along what matters: the direction
    in which an energy need grows fastest. A need is then nearly a function of one number, and a
    margin found four times as well as along the wind's own axes (docs/wind.md).
    """

    def __init__(self, count: int) -> None:
        first, scale, *others, error = evenly(count, 2 * _COMPONENTS + 4)
        self.count = count
        self._normal = np.array([first, *others])
        self._scale = ndtr(scale)
        self._tails: dict[float, FloatArray] = {}
        self.model_error: FloatArray = error
        # Half of them follow the later gates: that is the most work, and needs no tail of its own.
        self.policy = slice(None, None, 2)

    def paths(self, forecast: WindForecast, leaning: FloatArray) -> WindPaths:
        """Winds drawn from a forecast of at least _COMPONENTS horizons.

        `leaning` (2, n): what the need that is to be found well grows by with the wind at each
        horizon, north then east.
        """
        walk_root = self._walk_root(forecast)
        error_root = _root(forecast.error_cov_m2ps2)
        by_error = leaning.sum(axis=1) @ error_root
        towards = np.concatenate([(leaning @ walk_root).ravel(), by_error])
        turned = _turned(self._normal, towards)
        walk = walk_root @ turned[_WALK].reshape(2, _COMPONENTS, self.count)
        if forecast.tail_dof is not None:
            walk *= self._tail(forecast.tail_dof)
        mean = forecast.mean_to_ne_mps.T[:, :, None]
        return WindPaths(mean + walk, (error_root @ turned[_ERROR])[:, None, :])

    @staticmethod
    def _walk_root(forecast: WindForecast) -> FloatArray:
        """The walk's principal components times their standard deviations, (n, _COMPONENTS)."""
        return _root(forecast.walk_cov_m2ps2)[:, ::-1][:, :_COMPONENTS]

    def _tail(self, dof: float) -> FloatArray:
        """Each path's own scale: the same path is wild, or calm, all along."""
        if dof not in self._tails:
            self._tails[dof] = tail_scale(dof, self._scale)
        return self._tails[dof]


def _root(cov: FloatArray) -> FloatArray:
    """A matrix whose product with its transpose is `cov`; the greatest components come last."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _turned(points: FloatArray, towards: FloatArray) -> FloatArray:
    """Points (dimensions, count) mirrored so that their first coordinate lies along `towards`.

    A Householder reflection: standard-normal points stay standard normal.
    """
    length = float(np.linalg.norm(towards))
    if length == 0.0:
        return points
    across = -towards / length
    across[0] += 1.0
    squared = float(across @ across)
    if squared == 0.0:
        return points
    return points - np.outer(across, (2.0 / squared) * (across @ points))


def evenly(count: int, dimensions: int) -> FloatArray:
    """Normal quantiles of Sobol's sequence, digitally shifted, (dimensions, count).

    Each row is put at its ranks' mid-quantiles, so that every margin is exact. (scipy's own would
    cost every start on the vehicle 34 MB and 0.6 s of CPU; a test holds this one against it.)
    """
    points = sobol(count, dimensions) ^ np.array(_SHIFT[:dimensions])[:, None]
    ranks = points.argsort(axis=1).argsort(axis=1)
    return ndtri((ranks + 0.5) / count)


def sobol(count: int, dimensions: int) -> NDArray[np.int64]:
    """The first `count` points of Sobol's sequence in gray-code order, in units of 2**-30.

    (dimensions, count). Bratley and Fox 1988, algorithm 659.
    """
    index = np.arange(count)
    gray = index ^ (index >> 1)
    points = np.zeros((dimensions, count), np.int64)
    for row, numbers in zip(points, _direction_numbers(dimensions), strict=True):
        for bit, number in enumerate(numbers[: max(count - 1, 0).bit_length()]):
            row ^= ((gray >> bit) & 1) * number
    return points


def _direction_numbers(dimensions: int) -> list[list[int]]:
    every = [[1] * _SOBOL_BITS]  # the first coordinate: van der Corput's sequence
    for inner, first in _SOBOL[: dimensions - 1]:
        odd, degree = list(first), len(first)
        while len(odd) < _SOBOL_BITS:
            number = odd[-degree] ^ (odd[-degree] << degree)
            for k in range(1, degree):
                if (inner >> (degree - 1 - k)) & 1:
                    number ^= odd[-k] << k
            odd.append(number)
        every.append(odd)
    return [[m << (_SOBOL_BITS - 1 - i) for i, m in enumerate(odd)] for odd in every]
