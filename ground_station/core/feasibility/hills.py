"""Minimum height of a day's flights over the terrain between two positions, from elevation tiles.

Same rule as the companion's (`companion.core.routing.flight_heights`): a straight line is flown at
the clearance over the highest terrain near it, and its ends count as low as the lower end, so a
drone climbs before a hill and descends after it. The line between is priced as level flight.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from companion.core.base.arrays import Floats, Ints
from companion.core.base.geo import offset_position_deg
from companion.core.base.location import Location
from companion.core.mission.flight_plan import VERTICAL_CLEARANCE_M
from ground_station.core.schema.day import Day
from ground_station.core.schema.elevation import GRID_SPACING_M, SiteElevation

MAX_TERRAIN_SAMPLES = 2_000_000
"""Terrain samples in one batch: 16 MB for each array."""


@dataclass(frozen=True, slots=True)
class Hills:
    """The terrain about a depot. Flights keep `clearance_m` and the plan's own margin above it.

    Unknown terrain is ignored here: the vehicle rejects routes over it.
    """

    elevation: SiteElevation
    depot: Location
    clearance_m: float

    def min_flight_height_above_depot_m(self, starts_ne_m: Floats, ends_ne_m: Floats) -> Floats:
        """Return the minimum flight height above the depot's ground of each line from a (n, 2) to
        b (n, 2), (n,); -infinity if no terrain is known.
        """
        found = np.full(len(starts_ne_m), -np.inf)
        length_m = np.hypot(*(ends_ne_m - starts_ne_m).T)
        steps = int(np.ceil(length_m.max(initial=0.0) / GRID_SPACING_M)) + 1
        share = np.linspace(0.0, 1.0, steps + 1)[None, :, None]
        rows = max(1, MAX_TERRAIN_SAMPLES // (steps + 1))
        for first in range(0, len(starts_ne_m), rows):
            a, b = starts_ne_m[first : first + rows, None], ends_ne_m[first : first + rows, None]
            samples_ne_m = (a + share * (b - a)).reshape(-1, 2)
            tops = self._highest_terrain_near_amsl_m(samples_ne_m).reshape(a.shape[0], steps + 1)
            found[first : first + rows] = tops.max(axis=1)
        return found - (self.depot.alt_amsl_m or 0.0) + self.clearance_m + VERTICAL_CLEARANCE_M

    def _highest_terrain_near_amsl_m(self, ne_m: Floats) -> Floats:
        """Return the highest terrain within one cell of each position (n, 2)."""
        lat_deg, lon_deg = offset_position_deg(
            self.depot.lat_deg or 0.0, self.depot.lon_deg or 0.0, ne_m[:, 0], ne_m[:, 1]
        )
        row, rows = _nearest_indices_and_window(self.elevation.lat_deg, lat_deg)
        column, columns = _nearest_indices_and_window(self.elevation.lon_deg, lon_deg)
        window = self.elevation.amsl_m[rows, columns]
        tops = maximum_filter(np.where(np.isnan(window), -np.inf, window), size=3, mode="nearest")
        inside = _are_within_axis(self.elevation.lat_deg, lat_deg) & _are_within_axis(
            self.elevation.lon_deg, lon_deg
        )
        return np.where(inside, tops[row, column], -np.inf)


def hills_of(day: Day, elevation: SiteElevation | None) -> Hills | None:
    """Return the day's terrain from its elevation tiles; None if the day has no tiles."""
    if elevation is None:
        return None
    return Hills(elevation, day.depot.location, day.mission.clearance_m)


def _nearest_indices_and_window(axis: Floats, values: Floats) -> tuple[Ints, slice]:
    """Return indices nearest to the values on an ascending axis, within a window with margin 1."""
    after = np.clip(np.searchsorted(axis, values), 1, len(axis) - 1)
    nearest = after - (values - axis[after - 1] < axis[after] - values)
    first = max(int(nearest.min()) - 1, 0)
    return nearest - first, slice(first, int(nearest.max()) + 2)


def _are_within_axis(axis: Floats, values: Floats) -> np.ndarray:
    return (values >= axis[0]) & (values <= axis[-1])
