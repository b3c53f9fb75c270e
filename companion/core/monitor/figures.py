"""What one flight tells the monitor: numbers only, each with what makes it usable."""

import math
from dataclasses import dataclass

MOST_FACTOR = 4.0
"""No vehicle that flew drew so many times its model's power, or so little: the figures err."""


@dataclass(frozen=True, slots=True)
class LogRatio:
    """Log of what was found over what was promised, and its own standard deviation."""

    value: float
    std: float

    @property
    def is_usable(self) -> bool:
        """Finite, with a std, and nothing that only a broken sensor tells."""
        sound = math.isfinite(self.value) and math.isfinite(self.std) and self.std > 0.0
        return sound and abs(self.value) <= math.log(MOST_FACTOR)


@dataclass(frozen=True, slots=True)
class FlightFigures:
    """A flight at its end. None: it did not tell.

    `draw` is energy used over what the power model says for the flown track; `pack` the charge that
    fell over what the energy drawn takes from a pack as stated (above 0: less capacity); of
    `wind_checks` forecasts a minute ahead, `wind_misses` were outside their 95 % ellipse.
    """

    draw: LogRatio | None = None
    pack: LogRatio | None = None
    wind_misses: int = 0
    wind_checks: int = 0
