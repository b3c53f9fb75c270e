"""The wind that all vehicles of a site meet: a carried field, fronts, and what the ground does."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_bridge.truth.fields.computed_flow import ComputedFlows
from sim_bridge.truth.fields.front import PassingFront
from sim_bridge.truth.fields.lees import Obstacle, wind_share

Floats = NDArray[np.float64]

_LEAST_HEIGHT_M = 1.0


class GroundField(Protocol):
    """Wind at a reference height over a site."""

    def to_ne_mps(self, t_s: Floats, north_m: Floats, east_m: Floats) -> Floats:
        """Wind (n, 2), where the air moves to."""
        ...


class SiteWind:
    """A field, its fronts, the power law of its growth with height, and what stands in it."""

    def __init__(
        self,
        field: GroundField,
        fronts: Sequence[PassingFront] = (),
        *,
        profile_exponent: float = 0.0,
        reference_height_m: float = 40.0,
        obstacles: Sequence[Obstacle] = (),
        flows: ComputedFlows | None = None,
    ) -> None:
        """V(h) = V_ref (h / h_ref)^exponent; below 1 m it is held at its value there. Where a flow
        was computed it has its own growth with height.
        """
        self._field, self.fronts = field, tuple(fronts)
        self._exponent, self._reference_m = profile_exponent, reference_height_m
        self._obstacles = tuple(obstacles)
        self._flows = flows

    def to_ne_mps(
        self, t_s: ArrayLike, north_m: ArrayLike, east_m: ArrayLike, height_m: ArrayLike
    ) -> Floats:
        """Wind (n, 2) towards north and east at times, places and heights above the ground (n,)."""
        each = (np.atleast_1d(np.asarray(x, float)) for x in (t_s, north_m, east_m, height_m))
        t_s, north_m, east_m, height_m = np.broadcast_arrays(*each)
        wind = self._field.to_ne_mps(t_s, north_m, east_m)
        for front in self.fronts:
            wind = wind + front.to_ne_mps(t_s, north_m, east_m)
        grown = (np.maximum(height_m, _LEAST_HEIGHT_M) / self._reference_m) ** self._exponent
        if self._obstacles:
            grown = grown * wind_share(north_m, east_m, height_m, wind, self._obstacles)
        if self._flows is not None:
            share = self._flows.share(north_m, east_m, height_m, wind)
            turned = (wind[:, 0] + 1j * wind[:, 1]) * np.where(np.isnan(share), grown, share)
            return np.stack([turned.real, turned.imag], axis=-1)
        return wind * grown[:, None]
