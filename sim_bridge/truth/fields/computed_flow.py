"""Wind that a flow solver computed among buildings or over hills, as a share of the free wind.

A grid is a steady flow for one direction of the free wind, in the text format of RotorS' wind
plugin for Gazebo: columns over an even grid of x (east) and y (north), in each the same spacing
between its bottom, the ground there, and its top. Gusts are taken to bend as the mean does, at
once (quasi-steady). Vertical wind is not read.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.params import check_range

Floats = NDArray[np.float64]
Shares = NDArray[np.complex128]

_SINGLE = ("min_x", "min_y", "n_x", "n_y", "res_x", "res_y")
_LISTS = ("vertical_spacing_factors", "bottom_z", "top_z", "u", "v")
MOST_TIMES = 5.0
"""No flow is faster than so many times the free wind: its speed is stated wrongly."""


class FlowFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A computed flow for one direction of the free wind."""

    file: str
    """The grid, as Gazebo's RotorS wind plugin reads it; beside the field's file."""
    from_deg: float
    """Where the free wind blows from in it."""
    speed_mps: float
    """The free wind's speed in it, 40 m above the ground."""
    north_m: float = 0.0
    """The grid's x = y = 0, about the site's middle."""
    east_m: float = 0.0
    """The grid's x = y = 0, about the site's middle."""

    def __post_init__(self) -> None:
        check_range("flow from_deg", self.from_deg, 0.0, 360.0)
        check_range("flow speed_mps", self.speed_mps, 0.5, 60.0)
        check_range("flow north_m", self.north_m, -100_000.0, 100_000.0)
        check_range("flow east_m", self.east_m, -100_000.0, 100_000.0)

    @property
    def heading(self) -> complex:
        """Where its free wind blows to: north and east of length 1, as one complex number."""
        return -complex(
            math.cos(math.radians(self.from_deg)), math.sin(math.radians(self.from_deg))
        )


class ComputedFlow:
    """One grid, ready to be asked."""

    def __init__(self, stated: FlowFile, folder: Path) -> None:
        """Raises TruthError with file and key where the grid is none."""
        path = folder / stated.file
        values = _read(path)
        n_x, n_y = (_count(path, values, key) for key in ("n_x", "n_y"))
        east, north = (
            shift + _one(path, values, low) + _step(path, values, step) * np.arange(count)
            for shift, low, step, count in (
                (stated.east_m, "min_x", "res_x", n_x),
                (stated.north_m, "min_y", "res_y", n_y),
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
        bottom, top = (_sized(path, values, key, n_x * n_y) for key in ("bottom_z", "top_z"))
        if not np.all(top > bottom):
            raise TruthError(f"{path}: top_z: expected it above bottom_z in each column")
        u, v = (_sized(path, values, key, factors.size * n_x * n_y) for key in ("u", "v"))
        share = (v + 1j * u) / (stated.speed_mps * stated.heading)
        if (most := float(np.abs(share).max())) > MOST_TIMES:
            raise TruthError(
                f"{path}: u and v are up to {most:.1f} times speed_mps = {stated.speed_mps:g}:"
                f" expected at most {MOST_TIMES:g} times"
            )
        self._deep = RegularGridInterpolator(
            (north, east), (top - bottom).reshape(n_y, n_x), bounds_error=False
        )
        shape = (factors.size, n_y, n_x)
        self._share = RegularGridInterpolator(
            (factors, north, east), share.reshape(shape), bounds_error=False
        )

    def share(self, north_m: Floats, east_m: Floats, height_m: Floats) -> Shares:
        """(n,): wind over free wind, both north + i east; NaN outside the grid.

        Linear between nodes, at heights above the ground by their part of the column.
        """
        place = np.stack([north_m, east_m], axis=-1)
        part = np.maximum(height_m, 0.0) / self._deep(place)
        return self._share(np.stack([part, north_m, east_m], axis=-1))


class ComputedFlows:
    """The flows of a site, one for each direction that was computed."""

    def __init__(self, stated: Sequence[FlowFile], folder: Path) -> None:
        """At least one, in any order. Raises TruthError for a grid that cannot be used."""
        by_heading = sorted(stated, key=lambda one: np.angle(one.heading))
        self._headings = np.array([float(np.angle(one.heading)) for one in by_heading])
        self._flows = [ComputedFlow(one, folder) for one in by_heading]

    def share(self, north_m: Floats, east_m: Floats, height_m: Floats, to_ne: Floats) -> Shares:
        """(n,): wind over free wind towards `to_ne` (n, 2); NaN outside the grids.

        Between two computed directions it goes over linearly with the angle.
        """
        shares = np.stack([one.share(north_m, east_m, height_m) for one in self._flows])
        if len(self._flows) == 1:
            return shares[0]
        heading = np.arctan2(to_ne[:, 1], to_ne[:, 0])
        after = np.searchsorted(self._headings, heading) % self._headings.size
        before = after - 1  # -1: the last, from which it goes over to the first
        turn = (heading - self._headings[before]) % (2.0 * math.pi)
        apart = (self._headings[after] - self._headings[before]) % (2.0 * math.pi)
        part = turn / np.where(apart > 0.0, apart, 2.0 * math.pi)
        each = np.arange(heading.size)
        return (1.0 - part) * shares[before, each] + part * shares[after, each]


def _read(path: Path) -> dict[str, Floats]:
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


def _one(path: Path, values: dict[str, Floats], key: str) -> float:
    return float(_sized(path, values, key, 1)[0])


def _count(path: Path, values: dict[str, Floats], key: str) -> int:
    count = _one(path, values, key)
    if count != int(count) or count < 2:
        raise TruthError(f"{path}: {key} = {count:g}: expected a whole number, 2 or more")
    return int(count)


def _step(path: Path, values: dict[str, Floats], key: str) -> float:
    step = _one(path, values, key)
    if step <= 0.0:
        raise TruthError(f"{path}: {key} = {step:g}: expected it above 0")
    return step


def _sized(path: Path, values: dict[str, Floats], key: str, size: int) -> Floats:
    if values[key].size != size:
        raise TruthError(f"{path}: {key}: {values[key].size} values, expected {size}")
    return values[key]
