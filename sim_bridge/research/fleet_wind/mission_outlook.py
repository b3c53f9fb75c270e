"""What one mission's vehicle foresees with what the fleet tells it, by the code that flies.

`companion.core.wind_field.fleet_wind` decides whether it is used; a front counts only against
flying on, as aboard. Times are the mission's: 0 at its start.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindAhead, WindForecast
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.fleet_wind import OWN, FleetWind
from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.shared_outlook import FrontOutlook, SharedOutlook
from companion.core.wind_field.shared_winds import MOST_TOLD
from companion.core.wind_field.tellings import WindTelling
from sim_bridge.research.fleet_wind.front_stages import FrontsTold
from sim_bridge.research.fleet_wind.patrols import HEIGHT_M
from sim_bridge.research.fleet_wind.worlds import FleetWorld
from sim_bridge.research.promise.planner import HISTORY_S, SpreadOutlook


@dataclass(frozen=True, slots=True)
class _AtOnePlace:
    """Another outlook, of the place whose wind the mission meets wherever it is."""

    outlook: WindAhead

    def on_way(self, belief: WindBelief, horizon_s: Floats, place_ne_m: Floats) -> WindForecast:
        return self.outlook.on_way(belief, horizon_s, np.zeros_like(place_ne_m))


class FleetForesight:
    """One mission's, which begins at `start_s` of its world and meets the wind of one place.

    It is the world's first drone; it has heard the others since its own wind is known. `fronts`:
    as the desk tells them, in order of time. `lie_ne_mps`: what is added to all that it is told.
    """

    def __init__(
        self,
        world: FleetWorld,
        fronts: FrontsTold,
        process: WindProcessParams,
        place_ne_m: Floats,
        start_s: float,
        lie_ne_mps: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self._lie = lie_ne_mps
        self._world, self._start_s = world, start_s
        self._place = float(place_ne_m[0]), float(place_ne_m[1])
        self._own = SpreadOutlook(process, 1.0)
        self._fleet = FleetWind(FieldProcess(process))
        self._tail_dof = process.tail_dof
        begin_s = start_s - HISTORY_S
        self._next = int(np.searchsorted(world.told_s, begin_s))
        self._fronts = [
            (known_s - start_s, None if one is None else _moved(one, -start_s))
            for known_s, one in fronts
            if known_s > begin_s
        ]
        self.asked = self.used = 0
        """Looks, and those at which the fleet was used."""

    def observe(self, belief: WindBelief) -> None:
        """Take one's own wind, and before that all that was told until then."""
        self._hear_until(belief.t_s)
        self._own.observe(belief)
        north, east = (float(x) for x in belief.mean_to_ne_mps)
        nn, ee = float(belief.cov_ne_m2ps2[0, 0]), float(belief.cov_ne_m2ps2[1, 1])
        own = WindTelling(OWN, belief.t_s, self._place, HEIGHT_M, (north, east), (nn, 0.0, ee))
        self._fleet.feel(own)

    def outlooks(self, t_s: float) -> tuple[WindAhead, ...]:
        """The field's outlook or one's own; and the same with a front that was told."""
        self._hear_until(t_s)
        field = self._fleet.used(t_s)
        self.asked += 1
        self.used += field is not None
        calm: WindAhead = self._own
        if field is not None:
            calm = _AtOnePlace(SharedOutlook(field, HEIGHT_M, self._place, self._tail_dof))
        front = self._fleet.front_at(t_s, self._place)
        if front is None:
            return (calm,)
        return calm, _AtOnePlace(FrontOutlook(calm, front, self._place))

    def _hear_until(self, t_s: float) -> None:
        told_s = self._world.told_s
        while self._next < told_s.size and told_s[self._next] - self._start_s <= t_s:
            now_s = float(told_s[self._next]) - self._start_s
            front, withdrawn = self._front_of(now_s)
            self._fleet.hear(self._nearest(now_s), front, now_s)
            if withdrawn:
                self._fleet.withdraw_front()
            self._next += 1

    def _nearest(self, now_s: float) -> list[WindTelling]:
        """The newest of the others nearest to it, as a desk tells them."""
        others = range(1, len(self._world.drones))
        told = [self._world.telling(k, self._next) for k in others]
        told.sort(key=lambda one: math.dist(one.place_ne_m, self._place))
        north, east = self._lie
        return [
            replace(
                one,
                t_s=now_s,
                mean_to_ne_mps=(one.mean_to_ne_mps[0] + north, one.mean_to_ne_mps[1] + east),
            )
            for one in told[:MOST_TOLD]
        ]

    def _front_of(self, now_s: float) -> tuple[FrontAhead | None, bool]:
        """The newest that has become known since the last word, and whether it is withdrawn."""
        front, withdrawn = None, False
        while self._fronts and self._fronts[0][0] <= now_s:
            front = self._fronts.pop(0)[1]
            withdrawn = front is None
        return front, withdrawn


def _moved(front: FrontAhead, by_s: float) -> FrontAhead:
    """The same on another clock."""
    felt = tuple(replace(one, t_s=one.t_s + by_s) for one in front.felt)
    return replace(front, noticed_s=front.noticed_s + by_s, t0_s=front.t0_s + by_s, felt=felt)
