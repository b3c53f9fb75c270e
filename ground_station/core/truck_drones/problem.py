"""One truck, its drones and their customers, as times and energies.

Nodes are numbered: 0 the depot (or where the truck is now), 1 to c the customers, c + 1 the depot
again at the end. A sortie is priced by two legs, out with the parcel and back without, so any
energy model fits, also one in which wind makes the way back different from the way out.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError


@dataclass(frozen=True, slots=True)
class Legs:
    """What one kind of drone needs from node to node, as (c + 2) x (c + 2) tables.

    `out_*[i, j]`: launched at i, the customer j served. `back_*[j, k]`: from there to above k
    and down. Energy is expressed as the seconds of hover that it would pay for: what is left of
    `endurance_hover_s` can be spent hovering until the driver is free. No NaN; inf: impossible.
    """

    out_s: Floats
    back_s: Floats
    out_hover_s: Floats
    back_hover_s: Floats
    endurance_hover_s: float


class SortieModel(Protocol):
    """An energy model for the day's planner."""

    def legs(self, drone_kind: int) -> Legs:
        """Times and energies of this kind of drone between all nodes."""
        ...


@dataclass(frozen=True, slots=True)
class DroneKind:
    """Drones that are alike: `count` of them, and the driver's time for one of them."""

    count: int
    launch_s: float
    recover_s: float
    can_serve: Bools
    """By node: parcel light enough, service of a kind that a drone can give."""
    from_s: float = 0.0
    """Before this none can be launched: still in the air, or its pack is being changed."""


@dataclass(frozen=True, slots=True)
class Air:
    """The airspace, for days on which drones are separated by plan (safety rule 7).

    By node: its place (north, east), the lowest layer with room above its ground, and the first
    layer that is too high over it. `pads` pads lie in a ring, `pads_m` from each stop. A drone
    takes off `ready_s` after its launch and may land `slack_s` late. Sorties are separated from
    `apart_m` on. The legs are priced in layer `priced`; each layer above it takes `layer_s` longer
    and as much energy as `layer_hover_s` of hover, by kind of drone. `bends` (from, to, some): the
    numbers of the corners (`corners_ne_m`) around which a way goes, -1 after the last; of no size
    where all ways are straight.
    """

    ne_m: Floats
    lowest: NDArray[np.int32]
    layers: NDArray[np.int32]
    pads: int
    pads_m: float
    rings_m: float
    ready_s: float
    apart_m: float
    slack_s: float
    priced: int
    layer_s: tuple[float, ...]
    layer_hover_s: tuple[float, ...]
    bends: NDArray[np.int32]
    corners_ne_m: Floats


@dataclass(frozen=True, slots=True)
class TruckAndDrones:
    """The whole problem. `travel_s` is directed; `deliver_s` is 0 where nobody is served.

    `pads`: each drone has its own pad at each stop. It may be recovered where it was launched,
    lands by itself at least `lead_s` after the truck has come, and waits on the ground. Without
    pads (the published mFSTSP) it is recovered at a later stop and hovers until the driver takes
    it. `stay_s`: so long after a launch the truck stays, until the drone has taken off.
    `loops_only`: every drone is recovered where it was launched. `hold_s`: the truck does
    not leave the first node before. `release_s`, by customer: the driver does not begin its
    launch before (a launch slot). `air`: set where drones must be separated.
    """

    travel_s: Floats
    deliver_s: Floats
    kinds: tuple[DroneKind, ...]
    legs: tuple[Legs, ...]
    truck_can_serve: Bools
    """By node; a customer that no road reaches must be served by a drone."""
    pads: bool = False
    lead_s: float = 0.0
    stay_s: float = 0.0
    loops_only: bool = False
    hold_s: float = 0.0
    release_s: Floats | None = None
    air: Air | None = None

    def __post_init__(self) -> None:
        nodes = self.nodes
        if self.travel_s.shape != (nodes, nodes) or nodes < 2:
            raise LeewayError(f"travel_s: is {self.travel_s.shape}, expected n x n with n >= 2")
        if len(self.kinds) != len(self.legs) or not self.kinds:
            raise LeewayError(f"kinds: {len(self.kinds)}, legs: {len(self.legs)}; one of each")
        for name, by_node in (
            ("deliver_s", self.deliver_s),
            ("truck_can_serve", self.truck_can_serve),
            *(("can_serve", kind.can_serve) for kind in self.kinds),
        ):
            if by_node.shape != (nodes,):
                raise LeewayError(f"{name}: is {by_node.shape}, expected one for each of {nodes}")

    @property
    def nodes(self) -> int:
        """Customers, and two for the depot."""
        return len(self.travel_s)

    @property
    def customers(self) -> int:
        """Nodes without the depot and its copy."""
        return self.nodes - 2

    @property
    def end(self) -> int:
        """The depot's copy, where the tour ends."""
        return self.nodes - 1

    def unreachable(self) -> list[int]:
        """Customers that neither the truck nor any drone can serve, from anywhere."""
        return [j for j in range(1, self.end) if not self.truck_can_serve[j] and not self._flies(j)]

    def _flies(self, customer: int) -> bool:
        return any(
            bool(kind.can_serve[customer])
            and legs.out_hover_s[:, customer].min() + legs.back_hover_s[customer].min()
            <= legs.endurance_hover_s
            for kind, legs in zip(self.kinds, self.legs, strict=True)
        )
