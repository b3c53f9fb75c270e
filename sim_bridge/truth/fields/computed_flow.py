"""Wind computed by a flow solver among buildings or over hills, as a ratio to the free wind.

A grid is a steady flow for one direction of the free wind, in the text format of RotorS' wind
plugin for Gazebo: columns over an even grid of x (east) and y (north), each evenly spaced between
its bottom (ground) and its top. Gusts follow the mean flow without delay (quasi-steady). Vertical
wind is not read.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.params import Range, RangedTable

Floats = NDArray[np.float64]
Shares = NDArray[np.complex128]

_SINGLE = ("min_x", "min_y", "n_x", "n_y", "res_x", "res_y")
_LISTS = ("vertical_spacing_factors", "bottom_z", "top_z", "u", "v")
MAX_SPEED_RATIO = 5.0
"""Largest plausible ratio of flow speed to free wind; above it the stated speed is wrong."""


class FlowFile(RangedTable, frozen=True, kw_only=True):
    """A computed flow for one direction of the free wind."""

    table: ClassVar[str] = "flow"

    file: str
    """File of the grid in the format of Gazebo's RotorS wind plugin, in the field file's folder."""
    from_deg: Annotated[float, Range(0.0, 360.0)]
    """Direction that the grid's free wind blows from."""
    speed_mps: Annotated[float, Range(0.5, 60.0)]
    """The free wind's speed in it, 40 m above the ground."""
    north_m: Annotated[float, Range(-100_000.0, 100_000.0)] = 0.0
    """The grid's x = y = 0, about the site's middle."""
    east_m: Annotated[float, Range(-100_000.0, 100_000.0)] = 0.0
    """The grid's x = y = 0, about the site's middle."""

    @property
    def downwind_unit_complex(self) -> complex:
        """Direction that the free wind blows to: unit vector, north + 1j * east."""
        return -complex(
            math.cos(math.radians(self.from_deg)), math.sin(math.radians(self.from_deg))
        )


class ComputedFlow:
    """One grid, loaded for interpolation."""

    def __init__(self, flow_file: FlowFile, folder: Path) -> None:
        """Load the grid. Raises TruthError with file and key if it is invalid."""
        path = folder / flow_file.file
        values = _read_values_by_key(path)
        n_x, n_y = (_grid_node_count(path, values, key) for key in ("n_x", "n_y"))
        east, north = (
            shift
            + _single_value(path, values, low)
            + _grid_spacing_m(path, values, step) * np.arange(count)
            for shift, low, step, count in (
                (flow_file.east_m, "min_x", "res_x", n_x),
                (flow_file.north_m, "min_y", "res_y", n_y),
            )
        )
        factors = values["vertical_spacing_factors"]
        if (
            factors.size < 2
            or factors[0] != 0.0
            or factors[-1] != 1.0
            or np.any(np.diff(factors) <= 0.0)
        ):
            raise TruthError(
                f"{path}: vertical_spacing_factors: expected rising numbers from 0 to 1"
            )
        bottom, top = (
            _values_of_size(path, values, key, n_x * n_y) for key in ("bottom_z", "top_z")
        )
        if not np.all(top > bottom):
            raise TruthError(f"{path}: top_z: expected it above bottom_z in each column")
        u, v = (_values_of_size(path, values, key, factors.size * n_x * n_y) for key in ("u", "v"))
        share = (v + 1j * u) / (flow_file.speed_mps * flow_file.downwind_unit_complex)
        if (most := float(np.abs(share).max())) > MAX_SPEED_RATIO:
            raise TruthError(
                f"{path}: u and v are up to {most:.1f} times speed_mps = {flow_file.speed_mps:g}:"
                f" expected at most {MAX_SPEED_RATIO:g} times"
            )
        self._column_depth = RegularGridInterpolator(
            (north, east), (top - bottom).reshape(n_y, n_x), bounds_error=False
        )
        shape = (factors.size, n_y, n_x)
        self._share = RegularGridInterpolator(
            (factors, north, east), share.reshape(shape), bounds_error=False
        )

    def complex_wind_ratio(self, north_m: Floats, east_m: Floats, height_m: Floats) -> Shares:
        """(n,): wind over free wind, both north + i east; NaN outside the grid.

        Linear between nodes, at heights above the ground by their part of the column.
        """
        position = np.stack([north_m, east_m], axis=-1)
        part = np.maximum(height_m, 0.0) / self._column_depth(position)
        return self._share(np.stack([part, north_m, east_m], axis=-1))


class ComputedFlows:
    """The flows of a site, one for each direction that was computed."""

    def __init__(self, flow_file: Sequence[FlowFile], folder: Path) -> None:
        """Load at least one grid, in any order. Raises TruthError for an unusable grid."""
        by_heading = sorted(flow_file, key=lambda one: np.angle(one.downwind_unit_complex))
        self._headings = np.array(
            [float(np.angle(one.downwind_unit_complex)) for one in by_heading]
        )
        self._flows = [ComputedFlow(one, folder) for one in by_heading]

    def complex_wind_ratio(
        self, north_m: Floats, east_m: Floats, height_m: Floats, free_wind_to_ne: Floats
    ) -> Shares:
        """(n,): wind over free wind towards `free_wind_to_ne` (n, 2); NaN outside the grids.

        Between two computed directions it goes over linearly with the angle.
        """
        shares = np.stack(
            [one.complex_wind_ratio(north_m, east_m, height_m) for one in self._flows]
        )
        if len(self._flows) == 1:
            return shares[0]
        heading = np.arctan2(free_wind_to_ne[:, 1], free_wind_to_ne[:, 0])
        after = np.searchsorted(self._headings, heading) % self._headings.size
        before = after - 1  # -1: the last, from which it goes over to the first
        turn = (heading - self._headings[before]) % (2.0 * math.pi)
        angle_rad = (self._headings[after] - self._headings[before]) % (2.0 * math.pi)
        part = turn / np.where(angle_rad > 0.0, angle_rad, 2.0 * math.pi)
        each = np.arange(heading.size)
        return (1.0 - part) * shares[before, each] + part * shares[after, each]


def _read_values_by_key(path: Path) -> dict[str, Floats]:
    """Values by key. A key ends with a colon; its values follow."""
    try:
        words = path.read_text(encoding="ascii").split()
    except OSError as error:
        raise TruthError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise TruthError(f"{path}: expected text of a wind grid, found other bytes") from error
    keys = [k for k, word in enumerate(words) if word.endswith(":")]
    values: dict[str, Floats] = {}
    for first, end in zip(keys, [*keys[1:], len(words)], strict=True):
        key = words[first][:-1]
        try:
            found = np.array(words[first + 1 : end], dtype=np.float64)
        except ValueError as error:
            raise TruthError(f"{path}: {key}: expected numbers ({error})") from error
        if not np.isfinite(found).all():
            raise TruthError(f"{path}: {key}: expected finite numbers")
        values[key] = found
    if missing := [key for key in (*_SINGLE, *_LISTS) if key not in values]:
        raise TruthError(f"{path}: expected the keys of a wind grid; missing: {', '.join(missing)}")
    return values


def _single_value(path: Path, values: dict[str, Floats], key: str) -> float:
    return float(_values_of_size(path, values, key, 1)[0])


def _grid_node_count(path: Path, values: dict[str, Floats], key: str) -> int:
    count = _single_value(path, values, key)
    if count != int(count) or count < 2:
        raise TruthError(f"{path}: {key} = {count:g}: expected a whole number, 2 or more")
    return int(count)


def _grid_spacing_m(path: Path, values: dict[str, Floats], key: str) -> float:
    step = _single_value(path, values, key)
    if step <= 0.0:
        raise TruthError(f"{path}: {key} = {step:g}: expected it above 0")
    return step


def _values_of_size(path: Path, values: dict[str, Floats], key: str, size: int) -> Floats:
    if values[key].size != size:
        raise TruthError(f"{path}: {key}: {values[key].size} values, expected {size}")
    return values[key]
