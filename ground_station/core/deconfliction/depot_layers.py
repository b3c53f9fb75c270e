"""Layers over a depot without a plan: each drone in the air has one of its own (safety rule 7)."""

from dataclasses import dataclass

import msgspec

from companion.core.mission.flight_file import Mission
from ground_station.core.deconfliction.separation import LAYER_GAP_M


@dataclass(frozen=True, slots=True)
class DepotLayers:
    """The layers of one mission, from its own heights upwards; none is higher than `top_m` above
    the ground, unless the mission itself is.
    """

    mission: Mission
    top_m: float

    def mission_in(self, layer: int) -> Mission:
        """The mission with its heights in a layer; in layer 0 as it is."""
        if layer == 0:
            return self.mission
        up_m, back_m = self._raised_m(layer), self.mission.return_height_m
        return msgspec.structs.replace(
            self.mission,
            cruise_height_m=self.mission.cruise_height_m + up_m,
            clearance_m=self.mission.clearance_m + up_m,  # so that lifted ways are apart, too
            return_height_m=None if back_m is None else back_m + up_m,
        )

    def _raised_m(self, layer: int) -> float:
        """A layer is as thick as the two heights of the mission are apart, and the gap."""
        low_m, high_m = self.band_m(0)
        return layer * (high_m - low_m + LAYER_GAP_M)

    def band_m(self, layer: int) -> tuple[float, float]:
        """Lowest and highest level flight in a layer, above the depot."""
        mission = self.mission_in(layer)
        back_m = mission.return_height_m
        heights_m = (mission.cruise_height_m, mission.cruise_height_m if back_m is None else back_m)
        return min(heights_m), max(heights_m)

    def lowest_free(self, taken: set[int], ground_up_m: float) -> int | None:
        """The lowest layer that nobody has; None: it would be too high above some ground.

        `ground_up_m`: the lowest ground that is flown over, above the depot.
        """
        layer = next(n for n in range(len(taken) + 1) if n not in taken)
        fits = self.band_m(layer)[1] <= self.top_m + min(0.0, ground_up_m)
        return layer if fits or layer == 0 else None
