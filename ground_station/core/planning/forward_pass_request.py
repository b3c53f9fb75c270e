"""The requests of a plan to the forward pass."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ground_station.core.planning.launch_slots import SortieRequest


@dataclass(frozen=True, slots=True)
class ForwardPassRequest:
    """The route by its nodes, and the sorties in the requested order of launch.

    By customer, if the plan specifies it: the earliest time at which the driver begins the launch,
    and the preferred layer.
    """

    route: tuple[int, ...]
    requests: tuple[SortieRequest, ...]
    earliest_launch_s: Mapping[int, float] = field(default_factory=dict[int, float])
    layers: Mapping[int, int] = field(default_factory=dict[int, int])

    def with_customer_served_by_truck(self, customer_node: int) -> "ForwardPassRequest":
        """Return a copy in which the truck serves this customer before the recovery stop."""
        rendezvous = next(
            request.rendezvous for request in self.requests if request.customer == customer_node
        )
        at = max(1, self.route.index(rendezvous))
        left = tuple(request for request in self.requests if request.customer != customer_node)
        return replace(
            self, route=(*self.route[:at], customer_node, *self.route[at:]), requests=left
        )
