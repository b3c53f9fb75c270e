"""Grid cells as part of the keys of tracks: a vehicle subscribes to the cells around it and so
receives the tracks of nearby vehicles and few others.

The Earth has 20,000 rows of equal latitude. Each row has the number of columns that makes its cells
1 km wide at its centre. The grid is fixed, so all members compute the same names, also near the
poles and the 180th meridian.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from companion.core.separation.traffic_tracks import TRACK_LIFETIME_S

ROWS = 20_000
"""Rows of 0.009 degrees of latitude: 995 m at the equator, 1,005 m at a pole."""

EQUATOR_COLUMNS = 40_000

LEAST_RADIUS_M = 6_335_439.0
"""Lower bound of arc length over angle on WGS 84, for geodetic latitude and longitude used as on a
sphere: its least radius of curvature, a (1 - e^2), that of the meridian at the equator.
"""

RECEPTION_RADIUS_M = 1000.0
"""Distance within which all tracks are received."""

SUBSCRIPTION_MARGIN_M = 200.0
"""Additional distance of subscribed cells: 10 s at 20 m/s, until a subscription is effective."""

CELL_LIFETIME_S = TRACK_LIFETIME_S
"""Time for which a cell stays subscribed after it was left, equal to the lifetime of a track. So a
vehicle along an edge does not repeat subscriptions, and a jump of the position loses no neighbour.
"""

SEARCH_INTERVAL_S = 0.5
"""Interval of the search for nearby cells: 10 m at 20 m/s."""

MAX_CELLS = 64
"""Maximum number of subscribed cells. About 10 are near, at most 16; the oldest are dropped."""


def cell_name_or_none(lat_deg: float, lon_deg: float) -> str | None:
    """Return the name row/column of the cell at a position; None for an invalid position."""
    if not _is_valid_position(lat_deg, lon_deg):
        return None
    row = _row_at_latitude(lat_deg)
    columns = column_count_in_row(row)
    column = math.floor((lon_deg + 180.0) % 360.0 / 360.0 * columns)
    return _cell_name_from_row_and_column(row, min(column, columns - 1))


def cell_names_within(lat_deg: float, lon_deg: float, radius_m: float) -> frozenset[str]:
    """Return all cells within this distance of a position, with at most a small excess.

    Empty for an invalid position."""
    if not _is_valid_position(lat_deg, lon_deg):
        return frozenset()
    radius_rad = radius_m / LEAST_RADIUS_M
    radius_deg = math.degrees(radius_rad)
    rows = range(_row_at_latitude(lat_deg - radius_deg), _row_at_latitude(lat_deg + radius_deg) + 1)
    return frozenset(
        _cell_name_from_row_and_column(row, column)
        for row in rows
        for column in _columns_of_row_within(row, lat_deg, lon_deg, radius_rad)
    )


def column_count_in_row(row: int) -> int:
    """Return the number of cells in a row."""
    return max(1, round(EQUATOR_COLUMNS * math.cos(_south_edge_latitude_rad(row + 0.5))))


def _columns_of_row_within(
    row: int, lat_deg: float, lon_deg: float, radius_rad: float
) -> list[int]:
    """Return the columns of a row within reach, by the haversine formula
    sin^2(reach / 2) = sin^2(north / 2) + cos(lat) cos(lat') sin^2(east / 2). `north` uses the row's
    latitude nearest to the position, lat' the one nearest to a pole: an upper bound of `east`.
    """
    columns, lat_rad = column_count_in_row(row), math.radians(lat_deg)
    south_rad, north_rad = _south_edge_latitude_rad(row), _south_edge_latitude_rad(row + 1)
    north = max(south_rad - lat_rad, lat_rad - north_rad, 0.0)
    east_part = max(math.sin(0.5 * radius_rad) ** 2 - math.sin(0.5 * north) ** 2, 0.0)
    narrow = math.cos(lat_rad) * min(math.cos(south_rad), math.cos(north_rad))
    if east_part >= narrow:
        return list(range(columns))
    east_deg = math.degrees(2.0 * math.asin(math.sqrt(east_part / narrow)))
    first, last = (
        math.floor((lon_deg + 180.0 + side_deg) / 360.0 * columns)
        for side_deg in (-east_deg, east_deg)
    )
    return [column % columns for column in range(first, min(last, first + columns - 1) + 1)]


def _is_valid_position(lat_deg: float, lon_deg: float) -> bool:
    return abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0


def _row_at_latitude(lat_deg: float) -> int:
    return min(max(math.floor((lat_deg + 90.0) / 180.0 * ROWS), 0), ROWS - 1)


def _south_edge_latitude_rad(row: float) -> float:
    """Return the latitude of a row's southern edge."""
    return (row / ROWS - 0.5) * math.pi


def _cell_name_from_row_and_column(row: int, column: int) -> str:
    """Return the name as two parts of a key: a router compares a track's key with all subscribed
    keys part by part. With 4,000 cells that takes 0.05 ms, with names of one part 0.5 ms.
    """
    return f"{row}/{column}"


@dataclass(frozen=True, slots=True)
class SubscribedCells:
    """Subscribed cells of a vehicle, each with the time when it was last near. Immutable."""

    near_s: Mapping[str, float] = field(default_factory=dict)
    searched_s: float = -math.inf

    def updated_for_position(self, lat_deg: float, lon_deg: float, t_s: float) -> "SubscribedCells":
        """Return the cells at this position: those near now or within the last `CELL_LIFETIME_S`.

        An invalid position, or a call within `SEARCH_INTERVAL_S` of the last search, changes
        nothing.
        """
        if 0.0 <= t_s - self.searched_s < SEARCH_INTERVAL_S:
            return self
        near = cell_names_within(lat_deg, lon_deg, RECEPTION_RADIUS_M + SUBSCRIPTION_MARGIN_M)
        if not near:
            return self
        kept = {cell: s for cell, s in self.near_s.items() if t_s - s <= CELL_LIFETIME_S}
        newest = sorted((kept | dict.fromkeys(near, t_s)).items(), key=lambda cell: -cell[1])
        return SubscribedCells(dict(newest[:MAX_CELLS]), t_s)
