"""The way that a drone's mission takes, as it is aboard."""

from dataclasses import dataclass, field
from functools import lru_cache

from companion.core.base.errors import LeewayError
from companion.fleet.messages import State
from companion.fleet.polyline import Point, decoded


@dataclass(frozen=True, slots=True)
class RouteAboard:
    """Waypoints out to the customer and home from there. `places`: where it could land instead."""

    out: tuple[Point, ...]
    home: tuple[Point, ...]
    places: dict[str, Point] = field(default_factory=dict)


def route_of(state: State) -> RouteAboard | None:
    """The route that a state tells; None: it tells none, or words that are no way."""
    return _route(state.way_out, state.way_home) if state.way_out and state.way_home else None


@lru_cache(maxsize=1024)
def _route(out: str, home: str) -> RouteAboard | None:
    try:
        return RouteAboard(decoded(out), decoded(home))
    except LeewayError:
        return None
