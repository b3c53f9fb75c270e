"""The wind over a site, as one desk, map or `watch` believes it from what all drones in the air
tell, and stations; and fronts that come.
"""

import numpy as np

from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.fronts import FrontAhead, FrontNews, FrontWatch, FrontWithdrawn
from companion.core.wind_field.tellings import TELLING_S, WindTelling
from companion.fleet.messages import State
from ground_station.core.schema.day import Forecast
from ground_station.core.site_wind.believed_wind import BelievedWind, believed_at
from ground_station.core.site_wind.site_belief import SiteBelief
from ground_station.core.site_wind.site_fronts import SiteFronts
from ground_station.core.site_wind.state_tellings import StateTellings
from ground_station.core.site_wind.tellers import KNOWN_S, Teller, Tellers


class SiteWind:
    """Follows the states of a fleet. All times are of one clock of the listener's own.

    Places are metres (north, east) about the depot; where none is given, about the first place told
    (then only words for people and fronts' times mean something).
    """

    def __init__(
        self,
        process: WindProcessParams,
        depot_deg: tuple[float, float] | None = None,
        forecast: Forecast | None = None,
        height_m: float = 40.0,
        *,
        watches_fronts: bool = True,
    ) -> None:
        """`depot_deg`: latitude and longitude. `forecast` at `height_m` above ground is what is
        expected before anybody tells; None: any wind. `watches_fronts` False: none is ever told.
        """
        self.height_m = height_m
        self._states = StateTellings(depot_deg)
        self._tellers = Tellers()
        self._belief = SiteBelief(process, self._tellers, forecast, height_m)
        self._watches_fronts = watches_fronts
        self._fronts = SiteFronts(FrontWatch(process), self._tellers, height_m)

    def on_state(self, state: State, t_s: float) -> FrontNews | None:
        """Take a state; a front that is new, better known or withdrawn by it, else None."""
        telling = self._states.telling(state, t_s)
        teller = None if telling is None else self._tellers.note(telling, t_s)
        if telling is None or teller is None:
            return None
        if not self._belief.take_drone(telling, teller, t_s):
            return None
        return self._front(telling, teller, t_s)

    def on_station(self, telling: WindTelling, t_s: float) -> FrontNews | None:
        """Take what a station measures; a front that is new, better known or withdrawn by it."""
        teller = self._tellers.note(telling, t_s)
        if teller is None:
            return None
        self._tellers.stations.add(telling.member)
        if not self._belief.take_station(telling, teller, t_s):
            return None
        return self._front(telling, teller, t_s)

    def _front(self, telling: WindTelling, teller: Teller, t_s: float) -> FrontNews | None:
        if not self._watches_fronts:
            return None
        self._belief.settled(t_s)  # who is left out by now raises none
        self._fronts.watch.expect_ground(self._belief.standing_share)
        found = self._fronts.hear(telling, teller, t_s)
        if isinstance(found, FrontWithdrawn):
            self._belief.expect_front(None)
        elif found is not None:
            self._belief.expect_front(found)
        return found

    def expect(self, forecast: Forecast) -> None:
        """What is expected now before anybody tells, at cruise height: a forecast moves on."""
        self._belief.expect(forecast)

    def place_ne_m(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """A place in metres about the depot."""
        return self._states.place_ne_m(lat_deg, lon_deg)

    # --- who tells -----------------------------------------------------------------------------

    @property
    def stations(self) -> frozenset[str]:
        """Who of those who tell stands on the ground."""
        return frozenset(self._tellers.stations)

    def believed(self, t_s: float, within_s: float = KNOWN_S) -> list[WindTelling]:
        """The newest telling of each who has told of late and is not left out, by name."""
        return self._belief.believed(t_s, within_s)

    def left_out(self, t_s: float) -> dict[str, str]:
        """Who is not believed now, and why."""
        return self._belief.left_out(t_s)

    def is_known(self, t_s: float) -> bool:
        """Whether a drone that is believed has told of late, for long enough. Stations alone may
        all be wrong: `by_stations` is what they make known.
        """
        return bool(self._belief.known_drones(t_s))

    # --- the field -----------------------------------------------------------------------------

    def at(
        self,
        now_s: float,
        place_ne_m: tuple[float, float],
        height_m: float,
        t_s: float,
        averaged_s: float = TELLING_S,
    ) -> BelievedWind:
        """The wind at a place, height above ground and time, as a mean about that time."""
        return believed_at(self._belief.settled(now_s), place_ne_m, height_m, t_s, averaged_s)

    def ahead(self, now_s: float, ahead_s: float, averaged_s: float) -> BelievedWind | None:
        """The wind over the depot at cruise height some time from now; None: not known."""
        if not self.is_known(now_s):
            return None
        return self.at(now_s, (0.0, 0.0), self.height_m, now_s + ahead_s, averaged_s)

    def by_stations(self, now_s: float, ahead_s: float, averaged_s: float) -> BelievedWind | None:
        """The same where only stations tell it; None: drones do, or nobody does."""
        if self.is_known(now_s) or not self._belief.known_stations(now_s):
            return None
        return self.at(now_s, (0.0, 0.0), self.height_m, now_s + ahead_s, averaged_s)

    def here(self, now_s: float) -> BelievedWind | None:
        """The wind now in the middle of those who tell, at their mean height; None: nobody does."""
        told = self.believed(now_s)
        if not told:
            return None
        north, east, height = np.mean([(*one.place_ne_m, one.height_m) for one in told], axis=0)
        return self.at(now_s, (float(north), float(east)), float(height), now_s)

    # --- fronts --------------------------------------------------------------------------------

    @property
    def fronts(self) -> list[FrontAhead]:
        """Fronts of the last half hour, each as it is known best, oldest first."""
        return self._fronts.known

    def fronts_now(self, now_s: float) -> list[FrontAhead]:
        """Fronts that may still be on the site."""
        return self._fronts.now(now_s)
