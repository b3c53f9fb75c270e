"""How high a day's flights must go over the ground between two places, by its elevation tiles.

As the companion plans it (`companion.core.routing.flight_heights`): a straight line is flown at the
clearance over the highest ground beside it, and counts as low as its lower end, so that a drone
climbs before a hill and sinks behind it. What is between is priced as level there.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from companion.core.base.arrays import Floats, Ints
from companion.core.base.geo import moved_deg
from companion.core.base.place import Place
from companion.core.mission.flight_plan import CLEARANCE_UP_M
from ground_station.core.schema.day import Day
from ground_station.core.schema.elevation import SPACING_M, SiteElevation

MOST_LOOKS = 2_000_000
"""At ground in one go: 16 MB for each array of them."""


@dataclass(frozen=True, slots=True)
class Hills:
    """The ground about a depot. `clearance_m` is kept over it, with the plan's own spare beside.

    Ground that nobody knows counts for nothing: the vehicle refuses what leads over it.
    """

    elevation: SiteElevation
    depot: Place
    clearance_m: float

    def least_height_m(self, a_ne_m: Floats, b_ne_m: Floats) -> Floats:
        """Of each line from a (n, 2) to b (n, 2), the least height above the depot's ground to fly
        it at, (n,); -infinity where no ground is known.
        """
        found = np.full(len(a_ne_m), -np.inf)
        length_m = np.hypot(*(b_ne_m - a_ne_m).T)
        steps = int(np.ceil(length_m.max(initial=0.0) / SPACING_M)) + 1
        share = np.linspace(0.0, 1.0, steps + 1)[None, :, None]
        rows = max(1, MOST_LOOKS // (steps + 1))
        for first in range(0, len(a_ne_m), rows):
            a, b = a_ne_m[first : first + rows, None], b_ne_m[first : first + rows, None]
            looked = (a + share * (b - a)).reshape(-1, 2)
            tops = self._tops_amsl_m(looked).reshape(a.shape[0], steps + 1)
            found[first : first + rows] = tops.max(axis=1)
        return found - (self.depot.alt_amsl_m or 0.0) + self.clearance_m + CLEARANCE_UP_M

    def _tops_amsl_m(self, ne_m: Floats) -> Floats:
        """The highest ground within a cell of each place (n, 2)."""
        lat_deg, lon_deg = moved_deg(
            self.depot.lat_deg or 0.0, self.depot.lon_deg or 0.0, ne_m[:, 0], ne_m[:, 1]
        )
        row, rows = _nearest(self.elevation.lat_deg, lat_deg)
        column, columns = _nearest(self.elevation.lon_deg, lon_deg)
        window = self.elevation.amsl_m[rows, columns]
        tops = maximum_filter(np.where(np.isnan(window), -np.inf, window), size=3, mode="nearest")
        inside = _within(self.elevation.lat_deg, lat_deg) & _within(self.elevation.lon_deg, lon_deg)
        return np.where(inside, tops[row, column], -np.inf)


def hills_of(day: Day, elevation: SiteElevation | None) -> Hills | None:
    """The day's ground, by what was read of its tiles; None where it names none."""
    if elevation is None:
        return None
    return Hills(elevation, day.depot.place, day.mission.clearance_m)


def _nearest(axis: Floats, at: Floats) -> tuple[Ints, slice]:
    """The nearest place on a rising axis of each value, counted in a window one wider all about."""
    after = np.clip(np.searchsorted(axis, at), 1, len(axis) - 1)
    nearest = after - (at - axis[after - 1] < axis[after] - at)
    first = max(int(nearest.min()) - 1, 0)
    return nearest - first, slice(first, int(nearest.max()) + 2)


def _within(axis: Floats, at: Floats) -> np.ndarray:
    return (at >= axis[0]) & (at <= axis[-1])
