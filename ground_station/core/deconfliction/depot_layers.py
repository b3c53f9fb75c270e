"""Layers over a depot without a plan: one for each drone in the air (safety rule 7)."""

from dataclasses import dataclass

import msgspec

from companion.core.mission.flight_file import Mission
from ground_station.core.deconfliction.separation import LAYER_GAP_M


@dataclass(frozen=True, slots=True)
class DepotLayers:
    """Layers stacked upwards from one mission's own heights; none is higher than `max_height_m`
    above the ground, unless the mission itself is.
    """

    mission: Mission
    max_height_m: float

    def mission_in_layer(self, layer: int) -> Mission:
        """Return the mission with its heights in a layer; unchanged in layer 0."""
        if layer == 0:
            return self.mission
        up_m, back_m = self._layer_height_offset_m(layer), self.mission.return_height_m
        return msgspec.structs.replace(
            self.mission,
            cruise_height_m=self.mission.cruise_height_m + up_m,
            clearance_m=self.mission.clearance_m + up_m,  # separates lifted routes, too
            return_height_m=None if back_m is None else back_m + up_m,
        )

    def _layer_height_offset_m(self, layer: int) -> float:
        """Return the height of a layer; each has the mission's range of heights, plus the gap."""
        low_m, high_m = self.level_flight_height_range_m(0)
        return layer * (high_m - low_m + LAYER_GAP_M)

    def level_flight_height_range_m(self, layer: int) -> tuple[float, float]:
        """Return the lowest and highest level flight in a layer, above the depot."""
        mission = self.mission_in_layer(layer)
        back_m = mission.return_height_m
        heights_m = (mission.cruise_height_m, mission.cruise_height_m if back_m is None else back_m)
        return min(heights_m), max(heights_m)

    def lowest_free_layer_below_max_height(
        self, occupied_layers: set[int], ground_above_depot_m: float
    ) -> int | None:
        """Return the lowest unoccupied layer; None: it would be too high above some ground.

        `ground_above_depot_m`: the lowest ground under the flight, above the depot.
        """
        layer = next(n for n in range(len(occupied_layers) + 1) if n not in occupied_layers)
        fits = self.level_flight_height_range_m(layer)[1] <= self.max_height_m + min(
            0.0, ground_above_depot_m
        )
        return layer if fits or layer == 0 else None
