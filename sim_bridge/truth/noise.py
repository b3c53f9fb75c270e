"""Gaussian numbers one at a time from a numpy Generator, drawn in blocks for speed."""

import math

import numpy as np

_BLOCK = 2048


class GaussianStream:
    """Standard normal numbers in the generator's order, drawn in blocks.

    One scalar from numpy costs about ten times one popped from a list; a vehicle needs about
    twenty of them per 10 ms.
    """

    __slots__ = ("_buffer", "_rng")

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._buffer: list[float] = []

    def __call__(self) -> float:
        try:
            return self._buffer.pop()
        except IndexError:
            self._buffer = self._rng.standard_normal(_BLOCK).tolist()
            return self._buffer.pop()


class WanderingBias:
    """A slowly varying error: Ornstein-Uhlenbeck, started from its stationary spread.

    std: standard deviation in the quantity's unit; time_s: correlation time. The step is the
    exact discretisation, so that spread does not depend on the step's length.
    """

    __slots__ = ("_dt_s", "_gauss", "_keep", "_spread", "_std", "_time_s", "value")

    def __init__(self, std: float, time_s: float, gauss: GaussianStream) -> None:
        self._std = std
        self._time_s = time_s
        self._gauss = gauss
        self.value = std * gauss()
        self._dt_s: float | None = None

    def advance_and_get_value(self, dt_s: float) -> float:
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._keep = keep = math.exp(-dt_s / self._time_s)
            self._spread = self._std * math.sqrt(1.0 - keep * keep)
        self.value = self._keep * self.value + self._spread * self._gauss()
        return self.value
