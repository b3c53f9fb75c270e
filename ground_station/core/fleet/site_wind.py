"""The wind over a site, as one desk, map or `watch` believes it from what all drones in the air
tell; and fronts that come.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import offset_m
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_belief import FieldBelief, SettledField, WindPrior
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.fronts import FrontAhead, FrontWatch
from companion.core.wind_field.tellings import TELLING_S, WindTelling
from companion.fleet.messages import State
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_forecast import LEAST_STD_MPS, MOST_SPEED_MPS, MOST_STD_MPS

UNTOLD_STD_MPS = 1.5
"""Error on each axis of a wind that comes without a covariance, from a companion of before: as much
as our estimator's in its first minute.
"""

AIR_HEIGHT_M = 10.0
"""Lower it is the wind between houses and over the pad."""

FRONT_HEIGHT_SHARE = 0.5
"""Of cruise height: who comes down into weaker wind feels no front. A landing in 15 m/s looks like
a change of 16 m/s.
"""

SETTLE_S = TELLING_S
"""The belief is worked out anew at most so often: a telling is a mean over as long."""

KNOWN_S, LEAST_SPAN_S = 120.0, 60.0
"""A field is known where somebody has told in the last two minutes, for a minute or longer: gusts
and turns of one drone average out over that.
"""

PRIOR_TIMES = 5.0
"""The forecast's error is taken so many times as large as stated: when it is wrong it is wrong for
hours, and what is felt is to outweigh it within a minute or two.
"""

BACK_S, BACK_SQUARE = 120.0, 9.21
"""Who contradicted the others is believed again when its wind has fitted theirs for so long, within
what chance passes once in a hundred times (chi-square of two degrees). Judged by all that it told
it would come back by itself: a lie makes the air look gustier, and then it fits.
"""

OUT_S = 60.0
"""Who has been left out so long raises no alert. Not sooner: who meets a front first contradicts
the others, too.
"""

REFUSED_S = 1.5 * TELLING_S
"""Who tells nothing that can be kept (a frozen wind, an impossible one) is found so once for each
telling that would be kept.
"""

EVERYWHERE_MPS = 50.0
"""No front moves faster: the wind has changed for all at once."""

FRONT_KEPT_S = 1800.0
"""A front has left any site by then."""


@dataclass(frozen=True, slots=True)
class BelievedWind:
    """The wind at a place, height and time, where the air moves to, and its covariance nn, ne, ee.

    The two axes are independent: ne is 0.
    """

    to_ne_mps: tuple[float, float]
    cov_m2ps2: tuple[float, float, float]

    @property
    def speed_mps(self) -> float:
        """The mean wind."""
        return math.hypot(*self.to_ne_mps)

    @property
    def from_deg(self) -> float:
        """Where it blows from, clockwise from north."""
        north, east = self.to_ne_mps
        return math.degrees(math.atan2(-east, -north)) % 360.0

    @property
    def std_mps(self) -> float:
        """Its error on one axis: the larger one, one sigma."""
        return math.sqrt(max(self.cov_m2ps2[0], self.cov_m2ps2[2]))

    @property
    def forecast(self) -> Forecast:
        """The same as the constant wind of a day, within what a day can state."""
        return Forecast(
            speed_mps=min(self.speed_mps, MOST_SPEED_MPS),
            from_deg=self.from_deg,
            std_mps=min(max(self.std_mps, LEAST_STD_MPS), MOST_STD_MPS),
        )


@dataclass(slots=True)
class _Teller:
    """One drone's tellings: the first of an unbroken row, and the newest. `out`: why it is not
    believed, since `out_s`; `agrees_s`: since when it fits the others again.
    """

    first_s: float
    newest: WindTelling
    out: str = ""
    out_s: float = 0.0
    agrees_s: float | None = None
    tried_s: float = -math.inf

    def leave_out(self, why: str, t_s: float) -> None:
        """It is not believed from now on."""
        self.out, self.out_s, self.agrees_s = why, t_s, None


class SiteWind:
    """Follows the states of a fleet. All times are of one clock of the listener's own.

    Places are metres (north, east) about the depot; where none is given, about the first place told
    (then only `words` and fronts' times mean something).
    """

    def __init__(
        self,
        process: WindProcessParams,
        depot_deg: tuple[float, float] | None = None,
        forecast: Forecast | None = None,
        height_m: float = 40.0,
    ) -> None:
        """`depot_deg`: latitude and longitude. `forecast` at `height_m` above ground is what is
        expected before anybody tells; None: any wind.
        """
        prior = None if forecast is None else _prior(forecast, height_m)
        self.height_m = height_m
        self.fronts: list[FrontAhead] = []
        """Fronts of the last half hour, each as it is known best, oldest first."""
        self._origin_deg = depot_deg
        self._belief = FieldBelief(FieldProcess(process), prior)
        self._watch = FrontWatch(process)
        self._tellers: dict[str, _Teller] = {}
        self._refused: dict[str, tuple[float, str]] = {}
        self._settled: SettledField | None = None

    def on_state(self, state: State, t_s: float) -> FrontAhead | None:
        """Take a state; a front that is new or better known by it, else None."""
        telling = self._telling(state, t_s)
        if telling is None:
            return None
        name = telling.member
        if trouble := telling.trouble():
            self._refused[name] = t_s, trouble
            return None
        teller = self._tellers.get(name)
        if teller is None or t_s - teller.newest.t_s > KNOWN_S:
            before = teller
            teller = self._tellers[name] = _Teller(t_s, telling)
            if before is not None and before.out:
                teller.leave_out(before.out, before.out_s)
        teller.newest = telling
        if teller.out:
            self._try(teller, t_s)
        elif why := self._belief.tell(telling, t_s):
            self._refused[name] = t_s, why
            return None
        self.settled(t_s)
        low = telling.height_m < FRONT_HEIGHT_SHARE * self.height_m
        if low or (teller.out and t_s - teller.out_s > OUT_S):
            return None
        return self._front(telling)

    def expect(self, forecast: Forecast) -> None:
        """What is expected now before anybody tells, at cruise height: a forecast moves on."""
        self._belief.expect(_prior(forecast, self.height_m))

    def place_ne_m(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """A place in metres about the depot."""
        if self._origin_deg is None:
            self._origin_deg = lat_deg, lon_deg
        return offset_m(*self._origin_deg, lat_deg, lon_deg)

    # --- the field -----------------------------------------------------------------------------

    def settled(self, t_s: float) -> SettledField:
        """The field as believed now, or a few seconds ago."""
        before = self._settled
        if before is not None and 0.0 <= t_s - before.now_s < SETTLE_S:
            return before
        settled = self._settled = self._belief.settle(t_s)
        for name, why in settled.left_out.items():
            self._belief.drop(name)
            if name in self._tellers:
                self._tellers[name].leave_out(why, t_s)
        return settled

    def _try(self, teller: _Teller, t_s: float) -> None:
        """Whether one that was left out fits the others again, and for long enough."""
        if t_s - teller.tried_s < TELLING_S:
            return
        told, teller.tried_s = teller.newest, t_s
        wind = self.at(t_s, told.place_ne_m, told.height_m, t_s)
        off = np.subtract(told.mean_to_ne_mps, wind.to_ne_mps)
        variance = np.add(told.variance_m2ps2, wind.cov_m2ps2[::2])
        if float(np.sum(off**2 / variance)) > BACK_SQUARE:
            teller.agrees_s = None
        elif teller.agrees_s is None:
            teller.agrees_s = t_s
        elif t_s - teller.agrees_s >= BACK_S:
            teller.out = ""

    def believed(self, t_s: float, within_s: float = KNOWN_S) -> list[WindTelling]:
        """The newest telling of each who has told of late and is not left out, by name."""
        out = self.left_out(t_s)
        return [
            teller.newest
            for name, teller in sorted(self._tellers.items())
            if name not in out and t_s - teller.newest.t_s <= within_s
        ]

    def left_out(self, t_s: float) -> dict[str, str]:
        """Who is not believed now, and why."""
        refused = {
            name: why
            for name, (refused_s, why) in self._refused.items()
            if t_s - refused_s <= REFUSED_S
        }
        self.settled(t_s)
        return refused | {
            name: teller.out
            for name, teller in self._tellers.items()
            if teller.out and t_s - teller.newest.t_s <= KNOWN_S
        }

    def is_known(self, t_s: float) -> bool:
        """Whether somebody who is believed has told of late, for long enough."""
        names = {telling.member for telling in self.believed(t_s)}
        return any(
            self._tellers[name].newest.t_s - self._tellers[name].first_s >= LEAST_SPAN_S
            for name in names
        )

    def at(
        self,
        now_s: float,
        place_ne_m: tuple[float, float],
        height_m: float,
        t_s: float,
        averaged_s: float = TELLING_S,
    ) -> BelievedWind:
        """The wind at a place, height above ground and time, as a mean about that time."""
        points = FieldPoints(np.array([place_ne_m]), np.array([height_m]), np.array([t_s]))
        found = self.settled(now_s).forecast(points, averaged_s)
        north, east = (float(x) for x in found.mean_to_ne_mps[0])
        nn, ee = _only(found.north_cov_m2ps2), _only(found.east_cov_m2ps2)
        return BelievedWind((north, east), (nn, 0.0, ee))

    def ahead(self, now_s: float, ahead_s: float, averaged_s: float) -> BelievedWind | None:
        """The wind over the depot at cruise height some time from now; None: not known."""
        if not self.is_known(now_s):
            return None
        return self.at(now_s, (0.0, 0.0), self.height_m, now_s + ahead_s, averaged_s)

    def here(self, now_s: float) -> BelievedWind | None:
        """The wind now in the middle of those who tell, at their mean height; None: nobody does."""
        told = self.believed(now_s)
        if not told:
            return None
        north, east, height = np.mean([(*one.place_ne_m, one.height_m) for one in told], axis=0)
        return self.at(now_s, (float(north), float(east)), float(height), now_s)

    def words(self, now_s: float) -> str:
        """What the field is, in a line; empty: nobody tells."""
        wind, told = self.here(now_s), self.believed(now_s)
        if wind is None:
            return ""
        height_m = sum(one.height_m for one in told) / len(told)
        drones = "1 drone" if len(told) == 1 else f"{len(told)} drones"
        return (
            f"wind {wind.speed_mps:.1f} +- {wind.std_mps:.1f} m/s from {wind.from_deg:.0f}"
            f" at {height_m:.0f} m, by {drones}{self._out_words(now_s)}"
        )

    def _out_words(self, now_s: float) -> str:
        out = [f"{name} ({why})" for name, why in sorted(self.left_out(now_s).items())]
        return f"; left out: {', '.join(out)}" if out else ""

    # --- fronts --------------------------------------------------------------------------------

    def fronts_now(self, now_s: float) -> list[FrontAhead]:
        """Fronts that may still be on the site."""
        self.fronts = [one for one in self.fronts if now_s - one.noticed_s <= FRONT_KEPT_S]
        return self.fronts

    def _front(self, telling: WindTelling) -> FrontAhead | None:
        found = self._watch.hear(telling)
        if found is not None:
            others = [one for one in self.fronts if one.noticed_s != found.noticed_s]
            self.fronts = [*others, found]
        return found

    # --- states --------------------------------------------------------------------------------

    def _telling(self, state: State, t_s: float) -> WindTelling | None:
        """What a drone in the air tells of the wind; None: nothing."""
        lat_deg, lon_deg, height_m = state.lat_deg, state.lon_deg, state.height_rel_m
        north, east = state.wind_to_n_mps, state.wind_to_e_mps
        if not state.armed or lat_deg is None or lon_deg is None or height_m is None:
            return None
        if north is None or east is None or height_m < AIR_HEIGHT_M:
            return None
        cov = state.wind_cov_m2ps2 or (UNTOLD_STD_MPS**2, 0.0, UNTOLD_STD_MPS**2)
        place = self.place_ne_m(lat_deg, lon_deg)
        return WindTelling(state.vehicle, t_s, place, height_m, (north, east), cov)


def front_words(
    front: FrontAhead, now_s: float, places: Sequence[tuple[str, tuple[float, float]]]
) -> str:
    """A front for people: what it brings, where it goes, and when it comes to whom."""
    change, towards = front.change_ne_mps, math.degrees(front.towards_rad) % 360.0
    felt = ", ".join(one.member for one in front.felt)
    comes: list[str] = []
    for name, place in places:
        t_s, std_s = front.arrives(place)
        if t_s > now_s:
            comes.append(f"{name} in {t_s - now_s:.0f} +- {std_s:.0f} s")
    ahead = f"; comes to {', '.join(comes)}" if comes else ""
    moves = f"moves {front.speed_mps:.0f} m/s towards {towards:.0f}"
    if front.speed_mps > EVERYWHERE_MPS:
        moves = "everywhere at once"
    return (
        f"FRONT: the wind changes by {math.hypot(*change):.0f} m/s, felt by {felt}; {moves}{ahead}"
    )


def _prior(forecast: Forecast, height_m: float) -> WindPrior:
    return WindPrior(forecast.to_ne_mps, PRIOR_TIMES * forecast.std_mps, height_m)


def _only(cov: Floats) -> float:
    return float(cov[0, 0])
