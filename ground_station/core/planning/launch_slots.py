"""Launch slots: pad, drone and layer of each launch, separated from all airborne flights.

Of the drones on the truck, select the one whose pads deviate least from the route. Of the layers,
select the lowest with separation from all airborne sorties and sufficient energy.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.geo import Ned
from ground_station.core.deconfliction.pads import StopPads, unobstructed_pad_positions
from ground_station.core.deconfliction.separation import OperationalVolume, Proximity, proximity
from ground_station.core.feasibility.reach import SortieGeometry, SortieNeed
from ground_station.core.planning.day_problem import (
    DayProblem,
    layer_height_m,
    layer_range_by_position,
    max_layer_height_m,
)

MAX_PAD_CANDIDATES = 24
"""Maximum number of drone and pad combinations that are tried for a launch."""

Points = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class SortieRequest:
    """A sortie as requested by the search: launch and rendezvous nodes, and drone kind."""

    customer: int
    kind: int
    launch: int
    rendezvous: int

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Launch, customer and rendezvous."""
        return self.launch, self.customer, self.rendezvous


@dataclass(frozen=True, slots=True)
class LaunchSlot:
    """A sortie with drone, pads, times (from the truck's arrival at the start) and volume."""

    request: SortieRequest
    drone: str
    from_pad_ned_m: Ned
    to_pad_ned_m: Ned
    launched_s: float
    landed_s: float
    volume: OperationalVolume
    drop_s: float


@dataclass(frozen=True, slots=True)
class NoSlot:
    """No slot now. `until_s`: time at which a layer becomes free; None: no layer is feasible."""

    until_s: float | None


class SlotFinder:
    """Finds launch slots for one problem; caches proximities, needs and pads."""

    def __init__(self, nodes: DayProblem, t0_s: float, start_pads: dict[str, Ned]) -> None:
        """`t0_s`: day time at which the truck is at the start."""
        self._nodes, self._t0_s, self._start_pads = nodes, t0_s, start_pads
        self._cruise_m = nodes.cruise_height_m
        self._max_layer_m = max_layer_height_m(nodes.obstacles)
        self._proximities: dict[tuple[Points, Points, Points, Points], Proximity] = {}
        self._needs: dict[tuple[int, SortieGeometry], SortieNeed | None] = {}
        self._pad_positions: dict[int, list[Ned]] = {}

    def stop_pads_at_node(self, node: int, *, is_start: bool) -> StopPads:
        """Return the pads of a stop: all free; at the start with the promised ones assigned."""
        ned = self._nodes.ground_ned_m(node)
        if node not in self._pad_positions:
            self._pad_positions[node] = unobstructed_pad_positions(ned, self._nodes.obstacles)
        return StopPads(ned, self._pad_positions[node], dict(self._start_pads) if is_start else {})

    def find_slot(
        self,
        request: SortieRequest,
        launched_s: float,
        drones: list[str],
        stop_pads_by_node: dict[int, StopPads],
        airborne_volumes: list[OperationalVolume],
        preferred_layer: int | None = None,
    ) -> LaunchSlot | NoSlot:
        """Find a slot for a launch now, separated from `airborne_volumes`: in `preferred_layer` if
        free, else in the lowest free layer. The caller assigns the pads.
        """
        best: LaunchSlot | None = None
        until_s: float | None = None
        for candidate in self._drone_and_pad_candidates(request, drones, stop_pads_by_node):
            found = self._slot_for_candidate(
                request, launched_s, candidate, airborne_volumes, preferred_layer
            )
            if isinstance(found, NoSlot):
                if found.until_s is not None:
                    until_s = found.until_s if until_s is None else min(until_s, found.until_s)
                continue
            if found.volume.low_m == layer_height_m(self._cruise_m, preferred_layer or 0):
                return found
            if best is None or found.volume.low_m < best.volume.low_m:
                best = found
        return best or NoSlot(until_s)

    def _slot_for_candidate(
        self,
        request: SortieRequest,
        launched_s: float,
        drone_and_pads: tuple[str, Ned, Ned],
        airborne_volumes: list[OperationalVolume],
        preferred_layer: int | None,
    ) -> LaunchSlot | NoSlot:
        drone, start_pad, end_pad = drone_and_pads
        geometry = self._nodes.sortie_geometry(request.nodes, start_pad, end_pad, 0.0)
        shape = OperationalVolume(  # without layer and times
            vehicle=drone,
            order=self._nodes.orders[request.customer - 1].id,
            ground_ne_m=geometry.ground_ne_m,
            columns_ne_m=geometry.columns_ne_m,
            low_m=0.0,
            high_m=0.0,
            from_s=0.0,
            to_s=0.0,
        )
        proximities = [(other, self._cached_proximity(shape, other)) for other in airborne_volumes]
        until_s: float | None = None
        for layer in self._candidate_layers(request, start_pad, end_pad, preferred_layer):
            up_m = layer_height_m(self._cruise_m, layer)
            blocking = [
                other.to_s
                for other, near_to in proximities
                if near_to.conflict_reason((up_m, up_m), (other.low_m, other.high_m))
            ]
            if blocking:
                free_s = max(blocking)
                until_s = free_s if until_s is None else min(until_s, free_s)
                continue
            need = self._cached_sortie_need_if_feasible(
                request.kind, replace(geometry, height_m=up_m)
            )
            if need is None:
                continue
            from_s, landed_s = self._t0_s + launched_s, launched_s + need.time_s
            to_s = self._t0_s + landed_s
            volume = replace(shape, low_m=up_m, high_m=up_m, from_s=from_s, to_s=to_s)
            return LaunchSlot(
                request,
                drone,
                start_pad,
                end_pad,
                launched_s,
                landed_s,
                volume,
                launched_s + need.drop_s,
            )
        return NoSlot(until_s)

    def _drone_and_pad_candidates(
        self, request: SortieRequest, drones: list[str], stop_pads_by_node: dict[int, StopPads]
    ) -> list[tuple[str, Ned, Ned]]:
        """Return drones with pads, sorted by deviation from the direct route."""
        ned = self._nodes.ground_ned_m(request.customer)
        candidates: list[tuple[float, str, Ned, Ned]] = []
        assigned = (
            stop_pads_by_node[request.launch].pad_by_drone.keys()
            | stop_pads_by_node[request.rendezvous].pad_by_drone.keys()
        )
        unassigned = [drone for drone in sorted(drones) if drone not in assigned]
        for drone in [
            *unassigned[:1],
            *assigned.intersection(drones),
        ]:  # drones without pads are interchangeable
            for off_rad, start_pad in stop_pads_by_node[
                request.launch
            ].pads_ranked_by_route_angle_rad(drone, ned):
                if request.rendezvous == request.launch:
                    candidates.append((2.0 * off_rad, drone, start_pad, start_pad))
                    continue
                for back_rad, end_pad in stop_pads_by_node[
                    request.rendezvous
                ].pads_ranked_by_route_angle_rad(drone, ned):
                    candidates.append((off_rad + back_rad, drone, start_pad, end_pad))
        candidates.sort()
        return [one[1:] for one in candidates[:MAX_PAD_CANDIDATES]]

    def _candidate_layers(
        self, request: SortieRequest, start_pad: Ned, end_pad: Ned, preferred_layer: int | None
    ) -> Iterator[int]:
        """Yield the sortie's available layers: `preferred_layer`, then the lowest first."""
        grounds_m = np.array(
            [-p[2] for p in (start_pad, self._nodes.ground_ned_m(request.customer), end_pad)]
        )
        lowest, layers = layer_range_by_position(grounds_m, self._cruise_m, self._max_layer_m)
        fit = range(int(lowest.max()), int(layers.min()))
        if preferred_layer is not None and preferred_layer in fit:
            yield preferred_layer
        yield from (layer for layer in fit if layer != preferred_layer)

    def _cached_sortie_need_if_feasible(
        self, kind: int, geometry: SortieGeometry
    ) -> SortieNeed | None:
        """Return the sortie's need; None if the energy is insufficient."""
        key = (kind, geometry)
        if key not in self._needs:
            feasibility = self._nodes.classes[kind].feasibility
            self._needs[key] = feasibility.sortie_need_if_feasible(geometry)
        return self._needs[key]

    def _cached_proximity(self, one: OperationalVolume, other: OperationalVolume) -> Proximity:
        key = (one.ground_ne_m, one.columns_ne_m, other.ground_ne_m, other.columns_ne_m)
        if key not in self._proximities:
            self._proximities[key] = proximity(one, other)
        return self._proximities[key]
