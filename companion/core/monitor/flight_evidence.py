"""Result of one flight for the monitor: numbers with their uncertainty."""

import math
from dataclasses import dataclass

MAX_FACTOR = 4.0
"""Largest plausible factor between measured and modelled power; beyond it the data are faulty."""


@dataclass(frozen=True, slots=True)
class LogRatio:
    """Log of the measured over the expected value, and its standard deviation."""

    value: float
    std: float

    @property
    def is_usable(self) -> bool:
        """Whether it is finite, with a positive std, and within `MAX_FACTOR`."""
        is_finite = math.isfinite(self.value) and math.isfinite(self.std) and self.std > 0.0
        return is_finite and abs(self.value) <= math.log(MAX_FACTOR)


@dataclass(frozen=True, slots=True)
class FlightEvidence:
    """Evidence of a completed flight. None: not measured.

    `draw` is the energy used over the modelled energy of the flown track; `pack` the fall of charge
    over that of a nominal pack for the drawn energy (above 0: less capacity). Of `wind_checks`
    forecasts over one minute, `wind_misses` were outside their 95 % ellipse.
    """

    draw: LogRatio | None = None
    pack: LogRatio | None = None
    wind_misses: int = 0
    wind_checks: int = 0
