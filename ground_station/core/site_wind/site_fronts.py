"""Fronts over a site: who may raise one, and those of the last half hour."""

from dataclasses import dataclass, field

from companion.core.wind_field.fronts import FrontAhead, FrontNews, FrontWatch, FrontWithdrawn
from companion.core.wind_field.tellings import WindTelling
from ground_station.core.site_wind.tellers import Teller, Tellers

FRONT_HEIGHT_SHARE = 0.5
"""Of cruise height: who comes down into weaker wind feels no front. A landing in 15 m/s looks like
a change of 16 m/s.
"""

OUT_S = 60.0
"""Who has been left out so long raises no alert. Not sooner: who meets a front first contradicts
the others, too.
"""

FRONT_KEPT_S = 1800.0
"""A front has left any site by then."""


@dataclass(slots=True)
class SiteFronts:
    """One listener's. `height_m`: cruise height above ground."""

    watch: FrontWatch
    tellers: Tellers
    height_m: float
    known: list[FrontAhead] = field(default_factory=list)
    """Each as it is known best, oldest first."""

    def hear(self, telling: WindTelling, teller: Teller, t_s: float) -> FrontNews | None:
        """Take a telling; a front that is new, better known or withdrawn by it, else None."""
        low = telling.height_m < FRONT_HEIGHT_SHARE * self.height_m
        if low or (teller.out and t_s - teller.out_s > OUT_S):
            return None
        found = self.watch.hear(telling)
        if isinstance(found, FrontWithdrawn):
            before = len(self.known)
            self.known = [one for one in self.known if one.noticed_s != found.front.noticed_s]
            return found if len(self.known) < before else None
        if found is None or self._by_one_station(found):
            return None
        self.known = [*(one for one in self.known if one.noticed_s != found.noticed_s), found]
        return found

    def now(self, now_s: float) -> list[FrontAhead]:
        """Those that may still be on the site."""
        self.known = [one for one in self.known if now_s - one.noticed_s <= FRONT_KEPT_S]
        return self.known

    def _by_one_station(self, front: FrontAhead) -> bool:
        """One station alone may be broken: a second one, or a drone, has to feel it."""
        felt = {one.member for one in front.felt}
        return len(felt) == 1 and felt <= self.tellers.stations
