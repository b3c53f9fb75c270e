"""What a fleet knows of the front in a world, and at which stage of it a wind is judged.

Nobody foresees a front that nobody has felt. Whether a covariance means what it says is therefore
asked before, while and after a front is told, each for itself.
"""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.fronts import FrontAhead, FrontWatch
from sim_bridge.research.fleet_wind.alert_study import beliefs, felt_s, fronts_known
from sim_bridge.research.fleet_wind.patrols import Patrol
from sim_bridge.truth.fields.front import PassingFront
from sim_bridge.truth.fields.site_wind import SiteWind

PASSED_S = 900.0
"""So long after it came a front is still in what is kept of a place."""


class FrontStage(Enum):
    """Of a front at a place, over a stretch of time that is judged."""

    WHOLE = "the whole hour"
    NONE = "no front near"
    UNTOLD = "it comes, not told yet"
    TOLD = "it comes, told"
    PASSED = "came in the last 15 min"


@dataclass(frozen=True, slots=True)
class FrontsOfWorld:
    """`told`: fronts as the fleet's watch told them, each with when, false alerts as well; `real`:
    the one there is; `told_s`: when that one was told (inf: never).
    """

    told: tuple[tuple[float, FrontAhead], ...] = ()
    real: PassingFront | None = None
    told_s: float = math.inf

    def newest(self, now_s: float) -> FrontAhead | None:
        """The front that is known now, as it is known best."""
        known = [front for told_s, front in self.told if told_s <= now_s]
        return known[-1] if known else None

    def stage(self, place_ne_m: Floats, now_s: float, until_s: float) -> FrontStage:
        """Of what is forecast now for a place, until then."""
        if self.real is None:
            return FrontStage.NONE
        north, east = place_ne_m
        begins_s = float(self.real.reaches_s(np.array([north]), np.array([east]))[0])
        if begins_s > until_s or now_s > begins_s + PASSED_S:
            return FrontStage.NONE
        if now_s < self.told_s:
            return FrontStage.UNTOLD
        return FrontStage.TOLD if now_s < begins_s + self.real.passing_s else FrontStage.PASSED


NO_FRONTS = FrontsOfWorld()


def fronts_of_world(
    truth: SiteWind,
    drones: list[Patrol],
    seconds: float,
    process: WindProcessParams,
    real: PassingFront | None,
    rng: np.random.Generator,
) -> FrontsOfWorld:
    """What the fleet's watch makes of what is told once a second, false alerts as well."""
    told = beliefs(truth, drones, 0.0, seconds, rng)
    found = fronts_known(told, [one.name for one in drones], FrontWatch(process))
    known = tuple((known_s(front), front) for front in found)
    if real is None:
        return FrontsOfWorld(known)
    began_s = float(felt_s(real, told).min()) - real.passing_s
    of_real = (t_s for t_s, front in known if front.noticed_s >= began_s)
    return FrontsOfWorld(known, real, min(of_real, default=math.inf))


def known_s(front: FrontAhead) -> float:
    """When a front has become known so well."""
    return max(front.noticed_s, *(one.t_s for one in front.felt))
