"""Separation by plan (safety rule 7): who may be in the air with whom, whatever the companions do.

Each sortie gets an operational volume: its layer over all the ground that it may cross (way out,
way back, and every shortcut between them when it turns back early), and a column from the ground to
that layer at each place where it climbs or descends. Two sorties whose times in the air may overlap
must have volumes that are apart. No rule depends on where along its way a drone is, so a drone that
turns back, waits, or is late stays separated too. Only who is in the air counts, and the desk knows
that at each launch.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import shapely

APART_M = 16.0
"""Horizontal: 10 m between centres, and 3 m of each for position error and gusts."""
LAYER_GAP_M = 12.0
"""Vertical: 10 m between centres, and 1 m of each for barometer error and overshoot."""
SLACK_S = 30.0
"""How much later than planned a sortie may still be in the air."""


@dataclass(frozen=True)
class OperationalVolume:
    """The airspace that one sortie may use.

    `ground_ne_m`: the points between which it flies level. `columns_ne_m`: where it climbs and
    descends. Heights are above the depot, times as planned.
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
        """The hull of all level flight, seen from above."""
        return shapely.convex_hull(shapely.MultiPoint(self.ground_ne_m))

    @cached_property
    def columns(self) -> shapely.Geometry:
        """The columns, seen from above."""
        return shapely.MultiPoint(self.columns_ne_m)


@dataclass(frozen=True, slots=True)
class Proximity:
    """Which parts of two sorties come close, seen from above."""

    layers: bool
    columns: bool
    under_first: bool
    """A column of the second lies below level flight of the first: the first must be the higher
    one."""
    under_second: bool

    def conflict(self, first: tuple[float, float], second: tuple[float, float]) -> str | None:
        """Why they cannot both be in the air with these layers (lowest, highest); None: they
        can.
        """
        if self.columns:
            return "they climb and descend too close to each other"
        if self.layers and not (_above(first, second) or _above(second, first)):
            return "their ways come close in layers that are too close"
        if self.under_first and not _above(first, second):
            return "one flies where the other climbs or descends"
        if self.under_second and not _above(second, first):
            return "one flies where the other climbs or descends"
        return None


def _above(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return one[0] >= other[1] + LAYER_GAP_M - 1e-6


def proximity(first: OperationalVolume, second: OperationalVolume) -> Proximity:
    """Which parts of these two come close."""
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


def launch_conflict(
    sortie: OperationalVolume, in_air_now: Iterable[OperationalVolume]
) -> str | None:
    """The desk's last check before a launch: why the sortie must wait; None: it may go.

    The same check is made before the home of a sortie in the air is moved, with the sortie as it
    would be then.
    """
    for other in in_air_now:
        if other.vehicle == sortie.vehicle:
            return f"{sortie.vehicle} is in the air already, with {other.order}"
        why = conflict(sortie, other)
        if why is not None:
            return f"{other.vehicle} with {other.order} is in the air: {why}"
    return None
