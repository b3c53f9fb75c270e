"""How far above the ground a flight keeps, and what that asks of its heights."""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned, horizontal_m
from companion.core.ground.ground_strip import GroundStrip, NoGround, Peak


@dataclass(frozen=True, slots=True)
class GroundClearance:
    """The ground, and the clearance that is kept over it.

    `clearance_m` over the highest ground within `aside_m` of each straight line that is flown.
    Plans keep `spare_m` more, so that barometer drift and tracking leave the clearance.
    """

    strip: GroundStrip
    clearance_m: float
    aside_m: float
    spare_m: float

    def highest(self, a_ned_m: Ned, b_ned_m: Ned) -> Peak | NoGround:
        """The highest ground in the corridor of a line."""
        return self.strip.highest(a_ned_m, b_ned_m, self.aside_m)

    def planned_over_m(self, peak: Peak) -> float:
        """The height above the depot at which to plan over this ground."""
        return peak.up_m + self.clearance_m + self.spare_m

    def spare_at_m(self, points_ned_m: Floats) -> Floats:
        """Metres between points (..., 3) and the clearance below them; 0 over unknown ground."""
        points = points_ned_m.reshape(-1, 3)
        over_m = -points[:, 2] - self.strip.up_m(points[:, :2]) - self.clearance_m
        return np.nan_to_num(over_m, nan=0.0).reshape(points_ned_m.shape[:-1])

    def least_about_m(self, here_ned_m: Ned, within_m: float) -> float:
        """The height above the depot to plan over all known ground so near to a place; below the
        depot where none is.
        """
        up_m = self.strip.highest_known_m(here_ned_m, within_m)
        return up_m + self.clearance_m + self.spare_m

    def is_clear(self, a_ned_m: Ned, b_ned_m: Ned) -> bool:
        """Tell whether the line keeps the clearance, however its height is changed on the way.

        Straight up and down is where a vehicle must be low: always clear.
        """
        if horizontal_m(a_ned_m, b_ned_m) <= self.aside_m:
            return True
        peak = self.highest(a_ned_m, b_ned_m)
        lowest_m = min(-a_ned_m[2], -b_ned_m[2])
        return isinstance(peak, Peak) and lowest_m >= peak.up_m + self.clearance_m
