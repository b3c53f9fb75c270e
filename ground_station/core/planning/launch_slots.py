"""Launch slots: a pad, a drone and a layer for each launch, separated from everybody in the air.

Of the drones aboard, the one whose pads lie best on the way. Of the layers, the lowest in which the
sortie is separated from all others in the air and for which its energy suffices.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.geo import Ned
from ground_station.core.deconfliction.pads import StopPads, pad_places
from ground_station.core.deconfliction.separation import OperationalVolume, Proximity, proximity
from ground_station.core.feasibility.reach import SortieNeed
from ground_station.core.planning.day_problem import DayProblem, layer_height_m, layers_over

MOST_CREWS = 24
"""So many pairs of pads are tried for a launch."""

Points = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class SortieRequest:
    """A sortie as the search wants it: nodes of launch and rendezvous, and the kind of drone."""

    customer: int
    kind: int
    launch: int
    meet: int


@dataclass(frozen=True, slots=True)
class LaunchSlot:
    """A sortie with its drone, pads, times and volume; times from the truck's arrival at the
    start.
    """

    wish: SortieRequest
    drone: str
    from_pad_ned_m: Ned
    to_pad_ned_m: Ned
    launched_s: float
    landed_s: float
    volume: OperationalVolume


@dataclass(frozen=True, slots=True)
class Blocked:
    """No slot now. `until_s`: when the first blocked layer is free; None: no layer has energy or
    room.
    """

    until_s: float | None


class SlotFinder:
    """Finds launch slots for one problem; keeps what it has worked out."""

    def __init__(self, nodes: DayProblem, t0_s: float, start_pads: dict[str, Ned]) -> None:
        """`t0_s`: when the truck is at the start, in the day's time."""
        self._nodes, self._t0_s, self._start_pads = nodes, t0_s, start_pads
        self._cruise_m = nodes.cruise_height_m
        self._near: dict[tuple[Points, Points, Points, Points], Proximity] = {}
        self._needs: dict[tuple[SortieRequest, Ned, Ned, int], SortieNeed | None] = {}
        self._places: dict[int, list[Ned]] = {}

    def pads_at(self, node: int, *, first: bool) -> StopPads:
        """The pads of a stop, still free; at the start with those that are promised already."""
        ned = self._nodes.ned(node)
        if node not in self._places:
            self._places[node] = pad_places(ned, self._nodes.obstacles)
        return StopPads(ned, self._places[node], dict(self._start_pads) if first else {})

    def find(
        self,
        wish: SortieRequest,
        launched_s: float,
        drones: list[str],
        pads: dict[int, StopPads],
        in_air: list[OperationalVolume],
        layer: int | None = None,
    ) -> LaunchSlot | Blocked:
        """A slot for a launch now, beside these: in this layer where it is free, otherwise as low
        as can be. Whoever takes it assigns its pads.
        """
        best: LaunchSlot | None = None
        until_s: float | None = None
        for crew in self._crews(wish, drones, pads):
            found = self._slot(wish, launched_s, crew, in_air, layer)
            if isinstance(found, Blocked):
                if found.until_s is not None:
                    until_s = found.until_s if until_s is None else min(until_s, found.until_s)
                continue
            if found.volume.low_m == layer_height_m(self._cruise_m, layer or 0):
                return found
            if best is None or found.volume.low_m < best.volume.low_m:
                best = found
        return best or Blocked(until_s)

    def _slot(
        self,
        wish: SortieRequest,
        launched_s: float,
        crew: tuple[str, Ned, Ned],
        in_air: list[OperationalVolume],
        first: int | None,
    ) -> LaunchSlot | Blocked:
        drone, here, there = crew
        shape = self._filled(wish, drone, here, there)
        beside = [(other, self._near_to(shape, other)) for other in in_air]
        until_s: float | None = None
        for layer in self._layers(wish, here, there, first):
            up_m = layer_height_m(self._cruise_m, layer)
            blocking = [
                other.to_s
                for other, near_to in beside
                if near_to.conflict((up_m, up_m), (other.low_m, other.high_m))
            ]
            if blocking:
                free_s = max(blocking)
                until_s = free_s if until_s is None else min(until_s, free_s)
                continue
            need = self._need(wish, here, there, layer)
            if need is None:
                continue
            from_s, landed_s = self._t0_s + launched_s, launched_s + need.time_s
            to_s = self._t0_s + landed_s
            volume = replace(shape, low_m=up_m, high_m=up_m, from_s=from_s, to_s=to_s)
            return LaunchSlot(wish, drone, here, there, launched_s, landed_s, volume)
        return Blocked(until_s)

    def _crews(
        self, wish: SortieRequest, drones: list[str], pads: dict[int, StopPads]
    ) -> list[tuple[str, Ned, Ned]]:
        """Drones with their pads, those that lie best on the way first."""
        ned = self._nodes.ned(wish.customer)
        able: list[tuple[float, str, Ned, Ned]] = []
        placed = pads[wish.launch].of.keys() | pads[wish.meet].of.keys()
        fresh = [drone for drone in sorted(drones) if drone not in placed]
        for drone in [*fresh[:1], *placed.intersection(drones)]:  # without pads all are alike
            for off_rad, here in pads[wish.launch].ranked(drone, ned):
                if wish.meet == wish.launch:
                    able.append((2.0 * off_rad, drone, here, here))
                    continue
                for back_rad, there in pads[wish.meet].ranked(drone, ned):
                    able.append((off_rad + back_rad, drone, here, there))
        able.sort()
        return [one[1:] for one in able[:MOST_CREWS]]

    def _layers(
        self, wish: SortieRequest, here: Ned, there: Ned, first: int | None
    ) -> Iterator[int]:
        """Layers with room for this sortie: the first, and the others from the lowest up."""
        grounds_m = np.array([-p[2] for p in (here, self._nodes.ned(wish.customer), there)])
        lowest, layers = layers_over(grounds_m, self._cruise_m)
        fit = range(int(lowest.max()), int(layers.min()))
        if first is not None and first in fit:
            yield first
        yield from (layer for layer in fit if layer != first)

    def _need(self, wish: SortieRequest, here: Ned, there: Ned, layer: int) -> SortieNeed | None:
        """Its need in this layer; None where that is more than there is."""
        key = (wish, here, there, layer)
        if key not in self._needs:
            nodes = self._nodes
            reach = nodes.classes[wish.kind].reach
            self._needs[key] = reach.affordable(
                nodes.orders[wish.customer - 1].mass_kg,
                here,
                nodes.ned(wish.customer),
                there,
                layer_height_m(self._cruise_m, layer),
                nodes.ways.via(wish.launch, wish.customer),
                nodes.ways.via(wish.customer, wish.meet),
            )
        return self._needs[key]

    def _filled(self, wish: SortieRequest, drone: str, here: Ned, there: Ned) -> OperationalVolume:
        """Its volume on the ground, without layer and times yet."""
        nodes = self._nodes
        points = (here, nodes.ned(wish.customer), there)
        out = nodes.ways.via(wish.launch, wish.customer)
        back = nodes.ways.via(wish.customer, wish.meet)
        return OperationalVolume(
            vehicle=drone,
            order=nodes.orders[wish.customer - 1].id,
            ground_ne_m=tuple(p[:2] for p in points) + out + back,
            columns_ne_m=tuple(p[:2] for p in dict.fromkeys(points)),
            low_m=0.0,
            high_m=0.0,
            from_s=0.0,
            to_s=0.0,
        )

    def _near_to(self, one: OperationalVolume, other: OperationalVolume) -> Proximity:
        key = (one.ground_ne_m, one.columns_ne_m, other.ground_ne_m, other.columns_ne_m)
        if key not in self._near:
            self._near[key] = proximity(one, other)
        return self._near[key]
