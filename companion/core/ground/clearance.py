"""Clearance of a flight above the ground, and the heights that it requires."""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned, horizontal_distance_m
from companion.core.ground.ground_strip import GroundStrip, Peak, UnknownGround


@dataclass(frozen=True, slots=True)
class GroundClearance:
    """The ground, and the clearance above it.

    `clearance_m` over the highest ground within `aside_m` of each straight line that is flown.
    Plans add `spare_m`, so that barometer drift and tracking errors leave the clearance.
    """

    strip: GroundStrip
    clearance_m: float
    aside_m: float
    spare_m: float

    def highest_ground_in_corridor(self, a_ned_m: Ned, b_ned_m: Ned) -> Peak | UnknownGround:
        """Return the highest ground in the corridor of a line."""
        return self.strip.highest_ground_in_corridor(a_ned_m, b_ned_m, self.aside_m)

    def plan_height_over_m(self, peak: Peak) -> float:
        """Return the height above the depot at which to plan over this ground."""
        return peak.up_m + self.clearance_m + self.spare_m

    def height_above_clearance_m(self, points_ned_m: Floats) -> Floats:
        """Return metres between points (..., 3) and the clearance height; 0 over unknown ground."""
        points = points_ned_m.reshape(-1, 3)
        over_m = -points[:, 2] - self.strip.ground_heights_m(points[:, :2]) - self.clearance_m
        return np.nan_to_num(over_m, nan=0.0).reshape(points_ned_m.shape[:-1])

    def min_plan_height_near_m(self, position_ned_m: Ned, search_radius_m: float) -> float:
        """Return the height above the depot to plan over all known ground near a position; minus
        infinity if none is known."""
        up_m = self.strip.highest_known_ground_m(position_ned_m, search_radius_m)
        return up_m + self.clearance_m + self.spare_m

    def keeps_ground_clearance(self, a_ned_m: Ned, b_ned_m: Ned) -> bool:
        """Return whether a line keeps the clearance at any height profile between its ends.

        Vertical lines are always clear: take-off and landing are low.
        """
        if horizontal_distance_m(a_ned_m, b_ned_m) <= self.aside_m:
            return True
        peak = self.highest_ground_in_corridor(a_ned_m, b_ned_m)
        lowest_m = min(-a_ned_m[2], -b_ned_m[2])
        return isinstance(peak, Peak) and lowest_m >= peak.up_m + self.clearance_m
