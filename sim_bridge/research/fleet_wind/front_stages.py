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
from companion.core.wind_field.fronts import FrontAhead, FrontNews, FrontWithdrawn
from sim_bridge.research.fleet_wind.alert_study import beliefs, felt_s, front_news
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


FrontsTold = tuple[tuple[float, FrontAhead | None], ...]
"""Fronts as a watch tells them, each with when; None: the last one is withdrawn."""


@dataclass(frozen=True, slots=True)
class FrontsOfWorld:
    """`told`: by the fleet's watch, false alerts as well; `real`: the one there is; `told_s`: when
    that one was told (inf: never).
    """

    told: FrontsTold = ()
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
    found = front_news(told, [one.name for one in drones], process)
    known = tuple(front_known(news) for news in found)
    if real is None:
        return FrontsOfWorld(known)
    began_s = float(felt_s(real, told).min()) - real.passing_s
    of_real = (t_s for t_s, front in known if front is not None and front.noticed_s >= began_s)
    return FrontsOfWorld(known, real, min(of_real, default=math.inf))


def front_known(news: FrontNews) -> tuple[float, FrontAhead | None]:
    """When a front has become known so well; None: withdrawn."""
    if isinstance(news, FrontWithdrawn):
        return news.t_s, None
    return max(news.noticed_s, *(one.t_s for one in news.felt)), news
