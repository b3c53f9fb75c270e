"""What is left to fly, as the gate asks about it: stages between decision points, ways home."""

from dataclasses import dataclass, replace

from companion.core.routing.leg_energy import Leg, LegKind


@dataclass(frozen=True, slots=True)
class WayHome:
    """One way to a landing site: its name ("depot" or a rally point's) and legs to the ground.

    `unattended_legs`: the same when no further command arrives (fixed ground speeds).
    """

    landing: str
    legs: tuple[Leg, ...]
    unattended_legs: tuple[Leg, ...] = ()


@dataclass(frozen=True, slots=True)
class Stage:
    """Legs to the next decision point, and the ways home from there, the preferred first.

    `delivers` marks the stage that ends with the parcel released.
    """

    legs: tuple[Leg, ...]
    ways_home: tuple[WayHome, ...]
    delivers: bool = False


@dataclass(frozen=True, slots=True)
class Ahead:
    """The whole remaining mission: ways home from here, and the stages that are left.

    After delivery, or on the way back, `stages` is empty and `delivered` tells which.
    """

    ways_home_now: tuple[WayHome, ...]
    stages: tuple[Stage, ...] = ()
    delivered: bool = False

    def __post_init__(self) -> None:
        ways = (self.ways_home_now, *(stage.ways_home for stage in self.stages))
        if not all(ways):
            raise ValueError("every decision point needs a way home")


def hurried(ahead: Ahead, airspeed_mps: float) -> Ahead:
    """The same mission with every commanded cruise leg flown at this airspeed or faster."""

    def legs(of: tuple[Leg, ...]) -> tuple[Leg, ...]:
        return tuple(
            replace(leg, airspeed_mps=airspeed_mps)
            if leg.kind is LegKind.CRUISE and leg.ground_speed_mps is None
            else leg
            for leg in of
        )

    def ways(of: tuple[WayHome, ...]) -> tuple[WayHome, ...]:
        return tuple(replace(way, legs=legs(way.legs)) for way in of)

    stages = tuple(
        replace(stage, legs=legs(stage.legs), ways_home=ways(stage.ways_home))
        for stage in ahead.stages
    )
    return replace(ahead, ways_home_now=ways(ahead.ways_home_now), stages=stages)
