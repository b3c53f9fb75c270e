"""What a plan asks of the road, before it is driven."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ground_station.core.planning.launch_slots import SortieRequest


@dataclass(frozen=True, slots=True)
class AskedDay:
    """The route by its nodes, and the sorties in the order in which they are to be launched.

    By customer, where the plan says so: the time before which the driver does not begin its launch,
    and the layer that it gets if it is free.
    """

    route: tuple[int, ...]
    wishes: tuple[SortieRequest, ...]
    not_before_s: Mapping[int, float] = field(default_factory=dict[int, float])
    layers: Mapping[int, int] = field(default_factory=dict[int, int])

    def as_soon_as_can_be(self) -> "AskedDay":
        """The same, with each launch as soon as it can be, as low as it can be."""
        return AskedDay(self.route, self.wishes)

    def by_truck(self, customer: int) -> "AskedDay":
        """The same, with this customer brought by truck before the stop of its recovery."""
        meet = next(wish.meet for wish in self.wishes if wish.customer == customer)
        at = max(1, self.route.index(meet))
        left = tuple(wish for wish in self.wishes if wish.customer != customer)
        return replace(self, route=(*self.route[:at], customer, *self.route[at:]), wishes=left)
