"""The route of the mission loaded on a drone."""

from dataclasses import dataclass, field
from functools import lru_cache

from companion.core.base.errors import LeewayError
from companion.fleet.messages import State
from companion.fleet.polyline import Point, decode_polyline


@dataclass(frozen=True, slots=True)
class MissionRoute:
    """Waypoints to the customer and from there home. `landing_positions`: alternative landing
    positions.
    """

    outbound: tuple[Point, ...]
    homebound: tuple[Point, ...]
    landing_positions: dict[str, Point] = field(default_factory=dict)


def route_from_state(state: State) -> MissionRoute | None:
    """Return the route that a state reports; None: no route, or one that cannot be decoded."""
    return (
        _decode_route(state.outbound_route, state.return_route)
        if state.outbound_route and state.return_route
        else None
    )


@lru_cache(maxsize=1024)
def _decode_route(outbound: str, homebound: str) -> MissionRoute | None:
    try:
        return MissionRoute(decode_polyline(outbound), decode_polyline(homebound))
    except LeewayError:
        return None
