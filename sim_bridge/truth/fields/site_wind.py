"""The wind that all vehicles of a site meet: a carried field, fronts, and what the ground does."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_bridge.truth.fields.computed_flow import ComputedFlows
from sim_bridge.truth.fields.front import LinearFront
from sim_bridge.truth.fields.lees import Obstacle, wind_speed_ratio

Floats = NDArray[np.float64]

_MIN_HEIGHT_M = 1.0


class GroundField(Protocol):
    """Wind at a reference height over a site."""

    def to_ne_mps(self, t_s: Floats, north_m: Floats, east_m: Floats) -> Floats:
        """Wind (n, 2), where the air moves to."""
        ...


class SiteWind:
    """A field with its fronts, power-law profile over height, and obstacles."""

    def __init__(
        self,
        field: GroundField,
        fronts: Sequence[LinearFront] = (),
        *,
        profile_exponent: float = 0.0,
        reference_height_m: float = 40.0,
        obstacles: Sequence[Obstacle] = (),
        flows: ComputedFlows | None = None,
    ) -> None:
        """Use V(h) = V_ref (h / h_ref)^exponent, constant below 1 m. A computed flow has its own
        profile over height.
        """
        self._field, self.fronts = field, tuple(fronts)
        self._exponent, self._reference_m = profile_exponent, reference_height_m
        self._obstacles = tuple(obstacles)
        self._flows = flows

    def to_ne_mps(
        self, t_s: ArrayLike, north_m: ArrayLike, east_m: ArrayLike, height_m: ArrayLike
    ) -> Floats:
        """Compute wind (n, 2), north and east, at times, positions and heights above ground."""
        each = (np.atleast_1d(np.asarray(x, float)) for x in (t_s, north_m, east_m, height_m))
        t_s, north_m, east_m, height_m = np.broadcast_arrays(*each)
        wind = self._field.to_ne_mps(t_s, north_m, east_m)
        for front in self.fronts:
            wind = wind + front.added_wind_to_ne_mps(t_s, north_m, east_m)
        height_factor = (np.maximum(height_m, _MIN_HEIGHT_M) / self._reference_m) ** self._exponent
        if self._obstacles:
            height_factor = height_factor * wind_speed_ratio(
                north_m, east_m, height_m, wind, self._obstacles
            )
        if self._flows is not None:
            share = self._flows.complex_wind_ratio(north_m, east_m, height_m, wind)
            local_wind = (wind[:, 0] + 1j * wind[:, 1]) * np.where(
                np.isnan(share), height_factor, share
            )
            return np.stack([local_wind.real, local_wind.imag], axis=-1)
        return wind * height_factor[:, None]
