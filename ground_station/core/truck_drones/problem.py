"""One truck, its drones and their customers, as times and energies.

Nodes are numbered: 0 the depot (or the truck's position), 1 to c the customers, c + 1 the depot at
the end. A sortie is priced by two legs, outbound with the parcel and return without, so any energy
model fits, including direction-dependent costs due to wind.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError


@dataclass(frozen=True, slots=True)
class LegTables:
    """Time and energy of one kind of drone between nodes, as (c + 2) x (c + 2) tables.

    `out_*[i, j]`: from launch at i to delivery at customer j. `back_*[j, k]`: from there to landing
    at k. Energy is expressed as equivalent seconds of hover: the rest of `endurance_hover_s` is
    available to hover until the driver is free. No NaN; inf: infeasible.
    """

    out_s: Floats
    back_s: Floats
    out_hover_s: Floats
    back_hover_s: Floats
    endurance_hover_s: float


@dataclass(frozen=True, slots=True)
class DroneKind:
    """`count` identical drones, and the driver's time to launch and recover one."""

    count: int
    launch_s: float
    recover_s: float
    can_serve: Bools
    """By node: the payload and the order's service permit a drone."""
    from_s: float = 0.0
    """Earliest launch: until then a drone is airborne or its pack is exchanged."""


@dataclass(frozen=True, slots=True)
class LayeredAirspace:
    """The airspace, for days with planned separation of drones (safety rule 7).

    By node: position (north, east), the lowest layer with ground clearance, and the first layer
    that is too high. `pads` pads form a ring at `pads_m` from each stop. A drone takes off
    `ready_s` after its launch and may land `slack_s` late. Sorties are separated at `separation_m`
    or more. The legs are priced in layer `priced`; each layer above it adds `layer_s` and the
    energy of `layer_hover_s` of hover, by kind of drone. `bends` (from, to, number): indices of the
    corners (`corners_ne_m`) on a route, -1 after the last; empty if all routes are straight.
    """

    ne_m: Floats
    lowest: NDArray[np.int64]
    layers: NDArray[np.int64]
    pads: int
    pads_m: float
    rings_m: float
    ready_s: float
    separation_m: float
    slack_s: float
    priced: int
    layer_s: tuple[float, ...]
    layer_hover_s: tuple[float, ...]
    bends: NDArray[np.int64]
    corners_ne_m: Floats


LATE_PRICE = 3.0
"""[est] Of a second of lateness, in seconds of makespan, in the search."""


@dataclass(frozen=True, slots=True)
class TimedOrders:
    """Delivery windows and priorities by node, from the truck's departure.

    No delivery is before `opens_s`. The cost of a plan is its makespan, `late_price` for each
    second after `closes_s`, and `time_price` for each second until the delivery.
    """

    opens_s: Floats
    closes_s: Floats
    late_price: Floats
    time_price: Floats

    def of_nodes(self, nodes: list[int]) -> "TimedOrders":
        """Return those of these nodes only."""
        rows = (self.opens_s, self.closes_s, self.late_price, self.time_price)
        return TimedOrders(*(row[nodes] for row in rows))


@dataclass(frozen=True, slots=True)
class TruckAndDrones:
    """The complete problem. `travel_s` is directed; `deliver_s` is 0 at nodes without a customer.

    `pads`: each drone has its own pad at each stop. It may be recovered at its launch stop, lands
    autonomously at least `lead_s` after the truck's arrival, and waits on the ground. Without pads
    (the published mFSTSP) it is recovered at a later stop and hovers until the driver recovers it.
    `takeoff_wait_s`: time from a launch to take-off, during which the truck stays. `loops_only`:
    each drone is recovered at its launch stop. `hold_s`: earliest departure from the first node.
    `release_s`, by customer: earliest start of its launch (a launch slot). `air`: set if drones
    must be separated. `timed`: set if orders have windows or priorities.
    """

    travel_s: Floats
    deliver_s: Floats
    kinds: tuple[DroneKind, ...]
    leg_tables: tuple[LegTables, ...]
    truck_can_serve: Bools
    """By node; a customer without road access must be served by a drone."""
    pads: bool = False
    lead_s: float = 0.0
    takeoff_wait_s: float = 0.0
    loops_only: bool = False
    hold_s: float = 0.0
    release_s: Floats | None = None
    air: LayeredAirspace | None = None
    timed: TimedOrders | None = None

    def __post_init__(self) -> None:
        nodes = self.nodes
        if self.travel_s.shape != (nodes, nodes) or nodes < 2:
            raise LeewayError(f"travel_s: is {self.travel_s.shape}, expected n x n with n >= 2")
        if len(self.kinds) != len(self.leg_tables) or not self.kinds:
            raise LeewayError(
                f"kinds: {len(self.kinds)}, legs: {len(self.leg_tables)}; one of each"
            )
        for name, by_node in (
            ("deliver_s", self.deliver_s),
            ("truck_can_serve", self.truck_can_serve),
            *(("can_serve", kind.can_serve) for kind in self.kinds),
        ):
            if by_node.shape != (nodes,):
                raise LeewayError(f"{name}: is {by_node.shape}, expected one for each of {nodes}")

    @property
    def nodes(self) -> int:
        """Number of customers plus two for the depot."""
        return len(self.travel_s)

    @property
    def customers(self) -> int:
        """Number of nodes without the depot and its copy."""
        return self.nodes - 2

    @property
    def end_node(self) -> int:
        """The depot's copy, the end of the tour."""
        return self.nodes - 1

    def unreachable_customers(self) -> list[int]:
        """Return the customers that neither the truck nor any drone can serve from any node."""
        return [
            j
            for j in range(1, self.end_node)
            if not self.truck_can_serve[j] and not self._can_any_drone_serve(j)
        ]

    def _can_any_drone_serve(self, customer: int) -> bool:
        return any(
            bool(kind.can_serve[customer])
            and leg_tables.out_hover_s[:, customer].min() + leg_tables.back_hover_s[customer].min()
            <= leg_tables.endurance_hover_s
            for kind, leg_tables in zip(self.kinds, self.leg_tables, strict=True)
        )
