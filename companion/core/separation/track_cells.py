"""Grid cells by which tracks are told: a vehicle listens to those about it, and hears all who are
near and few others.

The Earth is cut into 20,000 rows of equal latitude, and each row into as many columns as make its
cells 1 km wide half way up. The grid is fixed, so everybody computes the same names, near the poles
and the 180th meridian too.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from companion.core.separation.traffic_tracks import LOST_S

ROWS = 20_000
"""0.009 degrees of latitude each: 995 m at the equator, 1,005 m at a pole."""

EQUATOR_COLUMNS = 40_000

LEAST_RADIUS_M = 6_335_439.0
"""No arc on WGS 84 is shorter than its angle, geodetic latitude and longitude taken as on a sphere,
times this: its least radius of curvature, a (1 - e^2), that of the meridian at the equator.
"""

HEARD_M = 1000.0
"""Who is nearer is heard."""

AHEAD_M = 200.0
"""So much farther cells are listened to: a way of 10 s at 20 m/s, until the network knows of a new
cell.
"""

KEPT_S = LOST_S
"""A cell that is left is still listened to for as long as neighbours are remembered: a vehicle that
goes along an edge does not tell the network of it again and again, and a place that jumps loses
nobody.
"""

LOOK_S = 0.5
"""So often it is looked which cells are near: 10 m at 20 m/s."""

MOST_CELLS = 64
"""Some 10 are near, at most 16. Whose place jumps about forgets the oldest."""


def cell_of(lat_deg: float, lon_deg: float) -> str | None:
    """The name of the cell about a place, row/column; None: these numbers are no place."""
    if not _is_place(lat_deg, lon_deg):
        return None
    row = _row_of(lat_deg)
    columns = columns_of(row)
    column = math.floor((lon_deg + 180.0) % 360.0 / 360.0 * columns)
    return _name(row, min(column, columns - 1))


def cells_within(lat_deg: float, lon_deg: float, within_m: float) -> frozenset[str]:
    """All cells that hold a place so near, and perhaps one that just does not; none about what is
    no place.
    """
    if not _is_place(lat_deg, lon_deg):
        return frozenset()
    reach_rad = within_m / LEAST_RADIUS_M
    reach_deg = math.degrees(reach_rad)
    rows = range(_row_of(lat_deg - reach_deg), _row_of(lat_deg + reach_deg) + 1)
    return frozenset(
        _name(row, column)
        for row in rows
        for column in _columns_within(row, lat_deg, lon_deg, reach_rad)
    )


def columns_of(row: int) -> int:
    """How many cells a row has."""
    return max(1, round(EQUATOR_COLUMNS * math.cos(_edge_rad(row + 0.5))))


def _columns_within(row: int, lat_deg: float, lon_deg: float, reach_rad: float) -> list[int]:
    """By the haversine formula sin^2(reach / 2) = sin^2(north / 2) + cos(lat) cos(lat') sin^2(east
    / 2), with that latitude of the row that is nearest north or south, and that which is nearest to
    a pole: no place of the row is farther east.
    """
    columns, lat_rad = columns_of(row), math.radians(lat_deg)
    south_rad, north_rad = _edge_rad(row), _edge_rad(row + 1)
    north = max(south_rad - lat_rad, lat_rad - north_rad, 0.0)
    east_part = max(math.sin(0.5 * reach_rad) ** 2 - math.sin(0.5 * north) ** 2, 0.0)
    narrow = math.cos(lat_rad) * min(math.cos(south_rad), math.cos(north_rad))
    if east_part >= narrow:
        return list(range(columns))
    east_deg = math.degrees(2.0 * math.asin(math.sqrt(east_part / narrow)))
    first, last = (
        math.floor((lon_deg + 180.0 + side_deg) / 360.0 * columns)
        for side_deg in (-east_deg, east_deg)
    )
    return [column % columns for column in range(first, min(last, first + columns - 1) + 1)]


def _is_place(lat_deg: float, lon_deg: float) -> bool:
    return abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0


def _row_of(lat_deg: float) -> int:
    return min(max(math.floor((lat_deg + 90.0) / 180.0 * ROWS), 0), ROWS - 1)


def _edge_rad(row: float) -> float:
    """The latitude of a row's southern edge."""
    return (row / ROWS - 0.5) * math.pi


def _name(row: int, column: int) -> str:
    """In two parts of a key: a router compares a track's key with all that are listened to, part
    by part. With 4,000 cells that takes 0.05 ms, with names of one part 0.5 ms.
    """
    return f"{row}/{column}"


@dataclass(frozen=True, slots=True)
class HeardCells:
    """The cells that a vehicle listens to, and when each was last near; `at` gives a new one."""

    near_s: Mapping[str, float] = field(default_factory=dict)
    looked_s: float = -math.inf

    def at(self, lat_deg: float, lon_deg: float, t_s: float) -> "HeardCells":
        """At this place: those that are near now, and those that were of late. What is no place
        changes nothing, nor does another look at once.
        """
        if 0.0 <= t_s - self.looked_s < LOOK_S:
            return self
        near = cells_within(lat_deg, lon_deg, HEARD_M + AHEAD_M)
        if not near:
            return self
        kept = {cell: s for cell, s in self.near_s.items() if t_s - s <= KEPT_S}
        newest = sorted((kept | dict.fromkeys(near, t_s)).items(), key=lambda cell: -cell[1])
        return HeardCells(dict(newest[:MOST_CELLS]), t_s)
