"""Remaining mission as input of the gate: stages between decision points, and routes home."""

from dataclasses import dataclass, replace

from companion.core.routing.leg_energy import Leg, LegKind


@dataclass(frozen=True, slots=True)
class ReturnRoute:
    """Route to a landing site: its name ("depot" or a rally point's) and its legs to the ground.

    `unattended_sequence`: the same legs without further commands (fixed ground speeds).
    """

    landing: str
    leg_sequence: tuple[Leg, ...]
    unattended_sequence: tuple[Leg, ...] = ()


@dataclass(frozen=True, slots=True)
class Stage:
    """Legs to the next decision point, and the routes home from there, the preferred first.

    `delivers` is true for the stage that ends with the parcel released.
    """

    leg_sequence: tuple[Leg, ...]
    return_routes: tuple[ReturnRoute, ...]
    delivers: bool = False


@dataclass(frozen=True, slots=True)
class RemainingMission:
    """Remaining mission: routes home from the current position, and the stages to fly.

    `stages` is empty on the return flight, where `delivered` is true after a delivery.
    """

    current_return_routes: tuple[ReturnRoute, ...]
    stages: tuple[Stage, ...] = ()
    delivered: bool = False

    def __post_init__(self) -> None:
        routes = (self.current_return_routes, *(stage.return_routes for stage in self.stages))
        if not all(routes):
            raise ValueError("remaining mission: decision point without a route home")


def with_min_airspeed(remaining: RemainingMission, airspeed_mps: float) -> RemainingMission:
    """Return the mission with this least airspeed on every cruise leg of commanded speed."""

    def legs_with_min_airspeed(legs: tuple[Leg, ...]) -> tuple[Leg, ...]:
        return tuple(
            replace(leg, airspeed_mps=airspeed_mps)
            if leg.kind is LegKind.CRUISE and leg.ground_speed_mps is None
            else leg
            for leg in legs
        )

    def routes_with_min_airspeed(routes: tuple[ReturnRoute, ...]) -> tuple[ReturnRoute, ...]:
        return tuple(
            replace(route, leg_sequence=legs_with_min_airspeed(route.leg_sequence))
            for route in routes
        )

    stages = tuple(
        replace(
            stage,
            leg_sequence=legs_with_min_airspeed(stage.leg_sequence),
            return_routes=routes_with_min_airspeed(stage.return_routes),
        )
        for stage in remaining.stages
    )
    return replace(
        remaining,
        current_return_routes=routes_with_min_airspeed(remaining.current_return_routes),
        stages=stages,
    )
