"""Safety rule 7: who may be in the air with whom, by plan, whatever their companions decide.

A sortie fills its layer over the whole ground that it may cross (way out, way back, and every way
from the one to the other when it turns back early), and a column from the ground to that layer at
each place where it goes up or down. Two sorties whose times in the air may overlap must be apart by
that alone: no rule leans on where along its way a drone is, so a drone that turns back, waits, or
is late stays apart too. Only who is in the air counts, and that the desk knows at each launch.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import shapely

APART_M = 16.0
"""Sideways: 10 m between centres, and 3 m of each for position error and gusts."""
LAYER_GAP_M = 12.0
"""Up: 10 m between centres, and 1 m of each for barometers and overshoot."""
SLACK_S = 30.0
"""How much later than planned a sortie may still be in the air, when a plan is made."""


@dataclass(frozen=True)
class OperationalVolume:
    """What one sortie may fill: `ground_ne_m` are the points between which it moves level,
    `columns_ne_m` where it goes up and down; heights above the depot. Times as planned.
    """

    vehicle: str
    order: str
    ground_ne_m: tuple[tuple[float, float], ...]
    columns_ne_m: tuple[tuple[float, float], ...]
    low_m: float
    high_m: float
    from_s: float
    to_s: float

    @cached_property
    def ground(self) -> shapely.Geometry:
        """The hull of all level movement."""
        return shapely.convex_hull(shapely.MultiPoint(self.ground_ne_m))

    @cached_property
    def columns(self) -> shapely.Geometry:
        """The feet of the columns."""
        return shapely.MultiPoint(self.columns_ne_m)


@dataclass(frozen=True, slots=True)
class Proximity:
    """What of two sorties comes near one another as seen from above."""

    layers: bool
    columns: bool
    under_first: bool
    """A column of the second stands under the first's way: the first must be the higher one."""
    under_second: bool

    def conflict(self, first: tuple[float, float], second: tuple[float, float]) -> str | None:
        """Why they cannot both be in the air in these layers (lowest, highest); None: they can."""
        if self.columns:
            return "they go up and down too near one another"
        if self.layers and not (_above(first, second) or _above(second, first)):
            return "their ways come near in layers that are too near"
        if self.under_first and not _above(first, second):
            return "one flies where the other goes up or down"
        if self.under_second and not _above(second, first):
            return "one flies where the other goes up or down"
        return None


def _above(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return one[0] >= other[1] + LAYER_GAP_M - 1e-6


def proximity(first: OperationalVolume, second: OperationalVolume) -> Proximity:
    """What of these two comes near."""
    return Proximity(
        layers=_close(first.ground, second.ground),
        columns=_close(first.columns, second.columns),
        under_first=_close(first.ground, second.columns),
        under_second=_close(second.ground, first.columns),
    )


def _close(one: shapely.Geometry, other: shapely.Geometry) -> bool:
    return bool(shapely.dwithin(one, other, APART_M))


def conflict(first: OperationalVolume, second: OperationalVolume) -> str | None:
    """Why these two cannot be in the air at once; None: they can."""
    layers = (first.low_m, first.high_m), (second.low_m, second.high_m)
    return proximity(first, second).conflict(*layers)


def may_launch(sortie: OperationalVolume, in_air_now: Iterable[OperationalVolume]) -> str | None:
    """The desk's last check: why this one must wait; None: it may go, whatever the others do.

    The same check, with the sortie as it would be then, is asked before its home is moved.
    """
    for other in in_air_now:
        if other.vehicle == sortie.vehicle:
            return f"{sortie.vehicle} is in the air already, with {other.order}"
        why = conflict(sortie, other)
        if why is not None:
            return f"{other.vehicle} with {other.order} is in the air: {why}"
    return None
