"""The field over a site twice: by drones alone, and with stations; and who is believed in it.

Drones judge one another, and the stations. No station decides which drone is believed.
"""

import numpy as np

from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_belief import FieldBelief
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.settled_field import SettledField, WindPrior
from companion.core.wind_field.tellings import TELLING_S, WindTelling
from ground_station.core.schema.day import Forecast
from ground_station.core.site_wind.believed_wind import BelievedWind, believed_at, blows_from_deg
from ground_station.core.site_wind.tellers import Teller, Tellers

SETTLE_S = TELLING_S
"""The belief is worked out anew at most so often: a telling is a mean over as long."""

PRIOR_TIMES = 5.0
"""The forecast's error is taken so many times as large as stated: when it is wrong it is wrong for
hours, and what is felt is to outweigh it within a minute or two.
"""

BACK_S, BACK_SQUARE = 120.0, 9.21
"""Who contradicted the others is believed again when its wind has fitted theirs for so long, within
what chance passes once in a hundred times (chi-square of two degrees). Judged by all that it told
it would come back by itself: a lie makes the air look gustier, and then it fits.
"""

STATION_SQUARE = 30.0
"""A station that differs by more (chi-square of two degrees: once in three million) from what the
drones tell, or alone from the forecast, is not believed.
"""


class SiteBelief:
    """One listener's. All times are of its own clock."""

    def __init__(
        self,
        process: WindProcessParams,
        tellers: Tellers,
        forecast: Forecast | None,
        height_m: float,
    ) -> None:
        """`forecast` at `height_m` above ground is what is expected before anybody tells; None:
        any wind.
        """
        prior = None if forecast is None else _prior(forecast, height_m)
        self._forecast, self._height_m = forecast, height_m
        self._tellers = tellers
        self._process = FieldProcess(process)
        self._by_drones = FieldBelief(self._process, prior)
        self._by_all = FieldBelief(self._process, prior)
        self._settled: SettledField | None = None
        self._drones_settled: SettledField | None = None

    def expect(self, forecast: Forecast) -> None:
        """What is expected now before anybody tells, at cruise height: a forecast moves on."""
        self._forecast = forecast
        for belief in (self._by_drones, self._by_all):
            belief.expect(_prior(forecast, self._height_m))

    def expect_front(self, front: FrontAhead | None) -> None:
        """A front that is believed from now on, or better known; None: it is none."""
        for belief in (self._by_drones, self._by_all):
            belief.expect_front(front)
        self._settled = None

    def take_drone(self, telling: WindTelling, teller: Teller, t_s: float) -> bool:
        """Take what a drone tells; whether it is a wind, even one that is not believed."""
        if teller.out:
            self._try(teller, t_s)
            return True
        why = self._by_drones.tell(telling, t_s)
        if why:
            self._tellers.refuse(telling.member, why, t_s)
        self._by_all.tell(telling, t_s)
        return not why

    def take_station(self, telling: WindTelling, teller: Teller, t_s: float) -> bool:
        """The same of a station. It is left out where it does not fit what drones tell, or where
        nobody else tells and it does not fit the forecast.
        """
        if teller.out:
            self._try(teller, t_s)
        elif why := self._contradicts(telling, t_s):
            self._by_all.drop(telling.member)
            teller.leave_out(why, t_s)
            self._settled = None
        elif why := self._by_all.tell(telling, t_s):
            self._tellers.refuse(telling.member, why, t_s)
            return False
        return True

    # --- the fields ----------------------------------------------------------------------------

    def settled(self, t_s: float) -> SettledField:
        """The field as believed now, or a few seconds ago."""
        before = self._settled
        if before is not None and 0.0 <= t_s - before.now_s < SETTLE_S:
            return before
        settled = self._drones_settled = self._by_drones.settle(t_s)
        self._leave_out(settled, t_s)
        if self._tellers.stations:
            settled = self._by_all.settle(t_s, firm=self._tellers.drones)
            self._leave_out(settled, t_s)
        self._settled = settled
        return settled

    @property
    def standing_share(self) -> float:
        """What drones have seen the ground do to the wind, over the mean wind."""
        return self._by_drones.standing_share

    def _drones_field(self, t_s: float) -> SettledField:
        """By drones alone, as believed now or a few seconds ago."""
        self.settled(t_s)
        assert self._drones_settled is not None
        return self._drones_settled

    def _leave_out(self, settled: SettledField, t_s: float) -> None:
        for name, why in settled.left_out.items():
            self._by_drones.drop(name)
            self._by_all.drop(name)
            self._tellers.leave_out(name, why, t_s)

    # --- who is believed -----------------------------------------------------------------------

    def left_out(self, t_s: float) -> dict[str, str]:
        """Who is not believed now, and why."""
        self.settled(t_s)
        return self._tellers.left_out(t_s)

    def believed(self, t_s: float, within_s: float) -> list[WindTelling]:
        """The newest telling of each who has told of late and is not left out, by name."""
        self.settled(t_s)
        return self._tellers.believed(t_s, within_s)

    def known_drones(self, t_s: float) -> list[str]:
        """Drones that are believed and have told of late, for long enough."""
        self.settled(t_s)
        return self._tellers.known_drones(t_s)

    def known_stations(self, t_s: float) -> list[str]:
        """The same of stations."""
        self.settled(t_s)
        return self._tellers.known_stations(t_s)

    def _contradicts(self, telling: WindTelling, t_s: float) -> str:
        """Why a station is not believed; empty: it fits, or there is nothing to hold it against."""
        found = self._others_expect(telling, t_s)
        if found is None or found.misfit_square(telling) <= STATION_SQUARE:
            return ""
        whom = "drones tell" if self.known_drones(t_s) else "the forecast alone says"
        from_deg = blows_from_deg(found.to_ne_mps)
        return f"{whom} {found.speed_mps:.1f} m/s from {from_deg:.0f} there"

    def _others_expect(self, telling: WindTelling, t_s: float) -> BelievedWind | None:
        """What a station should tell: by drones; where none is known, and no other station is, by
        the forecast. None: nothing says.
        """
        if self.known_drones(t_s):
            return self._drones_expect(telling, t_s)
        believed = self._tellers.believed(t_s)
        others = [one for one in believed if one.member != telling.member]
        if others or self._forecast is None:
            return None
        return self._forecast_at(self._forecast, telling.height_m)

    def _drones_expect(self, telling: WindTelling, t_s: float) -> BelievedWind:
        field, height_m = self._drones_field(t_s), telling.height_m
        return believed_at(field, telling.place_ne_m, height_m, t_s, TELLING_S)

    def _forecast_at(self, forecast: Forecast, height_m: float) -> BelievedWind:
        """A single telling at a height as the forecast has it: its error, the shear's, eddies."""
        grown, doubt = self._process.shear(np.array([height_m]), self._height_m)
        north, east = (float(x) for x in float(grown[0]) * np.array(forecast.to_ne_mps))
        speed_mps = float(np.hypot(north, east))
        process = self._process.process
        eddies = process.variance_scale(speed_mps) * sum(process.variance_m2ps2)
        variance = forecast.std_mps**2 + (float(doubt[0]) * speed_mps) ** 2 + eddies
        return BelievedWind((north, east), (variance, 0.0, variance))

    def _try(self, teller: Teller, t_s: float) -> None:
        """Whether one that was left out fits the others again, and for long enough."""
        if t_s - teller.tried_s < TELLING_S:
            return
        told, teller.tried_s = teller.newest, t_s
        is_station = told.member in self._tellers.stations
        expects = self._others_expect if is_station else self._drones_expect
        expected = expects(told, t_s)
        if expected is not None and expected.misfit_square(told) > BACK_SQUARE:
            teller.agrees_s = None
        elif teller.agrees_s is None:
            teller.agrees_s = t_s
        elif t_s - teller.agrees_s >= BACK_S:
            teller.out = ""


def _prior(forecast: Forecast, height_m: float) -> WindPrior:
    return WindPrior(forecast.to_ne_mps, PRIOR_TIMES * forecast.std_mps, height_m)
