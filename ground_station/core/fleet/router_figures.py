"""The figures of a running router at one moment, for those who watch it from outside."""

from collections.abc import Mapping
from dataclasses import dataclass

from ground_station.core.fleet.door import DoorFigures


@dataclass(frozen=True, slots=True)
class RouterFigures:
    """Everything. `turned_s`: when the router's loop last came round. `sessions`: programs joined
    to it, by zenoh's kind (client, peer, router). `certificate_end_us`: of the one that it shows.
    """

    turned_s: float
    sessions: Mapping[str, int]
    certificate_end_us: int
    roster_number: int
    door: DoorFigures
