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

STATION_SQUARE = 30.0
"""A station that differs by more (chi-square of two degrees: once in three million) from what the
drones tell, or alone from the forecast, is not believed.
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


_Vector = tuple[float, float]


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
        self._forecast = forecast
        self._process = FieldProcess(process)
        self._belief = FieldBelief(self._process, prior)
        """By drones alone: they judge one another, and the stations."""
        self._wide = FieldBelief(self._process, prior)
        """By drones and stations."""
        self._stations: set[str] = set()
        self._watch = FrontWatch(process)
        self._tellers: dict[str, _Teller] = {}
        self._refused: dict[str, tuple[float, str]] = {}
        self._settled: SettledField | None = None
        self._by_drones_only: SettledField | None = None

    def on_state(self, state: State, t_s: float) -> FrontAhead | None:
        """Take a state; a front that is new or better known by it, else None."""
        telling = self._telling(state, t_s)
        if telling is None:
            return None
        teller = self._teller_of(telling, t_s)
        if teller is None:
            return None
        if teller.out:
            self._try(teller, t_s)
        elif why := self._belief.tell(telling, t_s):
            self._refused[telling.member] = t_s, why
            self._wide.tell(telling, t_s)
            return None
        else:
            self._wide.tell(telling, t_s)
        self.settled(t_s)
        return self._front_of(telling, teller, t_s)

    def on_station(self, telling: WindTelling, t_s: float) -> FrontAhead | None:
        """Take what a station measures; a front that is new or better known by it, else None.

        It never decides who of the drones is believed. Where it does not fit what they tell, or
        where nobody else tells and it does not fit the forecast, it is left out.
        """
        teller = self._teller_of(telling, t_s)
        if teller is None:
            return None
        self._stations.add(telling.member)
        if teller.out:
            self._try(teller, t_s)
        elif why := self._contradicts(telling, t_s):
            self._wide.drop(telling.member)
            teller.leave_out(why, t_s)
            self._settled = None
        elif why := self._wide.tell(telling, t_s):
            self._refused[telling.member] = t_s, why
            return None
        self.settled(t_s)
        return self._front_of(telling, teller, t_s)

    def _teller_of(self, telling: WindTelling, t_s: float) -> _Teller | None:
        """Who tells this, its newest telling noted; None: it can be no wind."""
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
        return teller

    def _front_of(self, telling: WindTelling, teller: _Teller, t_s: float) -> FrontAhead | None:
        low = telling.height_m < FRONT_HEIGHT_SHARE * self.height_m
        if low or (teller.out and t_s - teller.out_s > OUT_S):
            return None
        return self._front(telling)

    def expect(self, forecast: Forecast) -> None:
        """What is expected now before anybody tells, at cruise height: a forecast moves on."""
        self._forecast = forecast
        for belief in (self._belief, self._wide):
            belief.expect(_prior(forecast, self.height_m))

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
        settled = self._by_drones_only = self._belief.settle(t_s)
        self._leave_out(settled, t_s)
        if self._stations:
            drones = frozenset(self._tellers.keys() - self._stations)
            settled = self._wide.settle(t_s, firm=drones)
            self._leave_out(settled, t_s)
        self._settled = settled
        return settled

    def _drones_field(self, t_s: float) -> SettledField:
        """By drones alone, as believed now or a few seconds ago."""
        self.settled(t_s)
        assert self._by_drones_only is not None
        return self._by_drones_only

    def _leave_out(self, settled: SettledField, t_s: float) -> None:
        for name, why in settled.left_out.items():
            self._belief.drop(name)
            self._wide.drop(name)
            if name in self._tellers:
                self._tellers[name].leave_out(why, t_s)

    def _contradicts(self, telling: WindTelling, t_s: float) -> str:
        """Why a station is not believed; empty: it fits, or there is nothing to hold it against."""
        found = self._others_expect(telling, t_s)
        if found is None or _misfit_square(telling, *found) <= STATION_SQUARE:
            return ""
        north, east = found[0]
        from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
        whom = "drones tell" if self._by_drones(t_s) else "the forecast alone says"
        return f"{whom} {math.hypot(north, east):.1f} m/s from {from_deg:.0f} there"

    def _others_expect(self, telling: WindTelling, t_s: float) -> tuple[_Vector, _Vector] | None:
        """Mean and variances (north, east) that a station should tell: by drones; where none is
        known, and no other station is, by the forecast. None: nothing says.
        """
        if self._by_drones(t_s):
            wind = _at(
                self._drones_field(t_s), telling.place_ne_m, telling.height_m, t_s, TELLING_S
            )
            return wind.to_ne_mps, (wind.cov_m2ps2[0], wind.cov_m2ps2[2])
        others = [o for o in self.believed(t_s) if o.member != telling.member]
        if others or self._forecast is None:
            return None
        forecast = self._forecast
        grown, doubt = self._process.shear(np.array([telling.height_m]), self.height_m)
        mean = float(grown[0]) * np.array(forecast.to_ne_mps)
        doubt_mps = float(doubt[0]) * float(np.hypot(*mean))
        process = self._process.process
        eddies = process.variance_scale(float(np.hypot(*mean))) * sum(process.variance_m2ps2)
        variance = forecast.std_mps**2 + doubt_mps**2 + eddies
        return (float(mean[0]), float(mean[1])), (variance, variance)

    def _try(self, teller: _Teller, t_s: float) -> None:
        """Whether one that was left out fits the others again, and for long enough."""
        if t_s - teller.tried_s < TELLING_S:
            return
        told, teller.tried_s = teller.newest, t_s
        if told.member in self._stations:
            expected = self._others_expect(told, t_s)
        else:
            wind = _at(self._drones_field(t_s), told.place_ne_m, told.height_m, t_s, TELLING_S)
            expected = wind.to_ne_mps, (wind.cov_m2ps2[0], wind.cov_m2ps2[2])
        if expected is not None and _misfit_square(told, *expected) > BACK_SQUARE:
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
        """Whether a drone that is believed has told of late, for long enough. Stations alone may
        all be wrong: `by_stations` is what they make known.
        """
        return any(self._by_drones(t_s))

    def _by_drones(self, t_s: float) -> list[str]:
        names = {telling.member for telling in self.believed(t_s)}
        return self._long_enough(names - self._stations)

    def _long_enough(self, names: set[str]) -> list[str]:
        tellers = {name: self._tellers[name] for name in names}
        return [n for n, one in tellers.items() if one.newest.t_s - one.first_s >= LEAST_SPAN_S]

    def by_stations(self, now_s: float, ahead_s: float, averaged_s: float) -> BelievedWind | None:
        """The wind over the depot at cruise height some time from now where only stations tell it;
        None: drones do, or nobody does.
        """
        names = {telling.member for telling in self.believed(now_s)}
        if self.is_known(now_s) or not self._long_enough(names & self._stations):
            return None
        return self.at(now_s, (0.0, 0.0), self.height_m, now_s + ahead_s, averaged_s)

    def at(
        self,
        now_s: float,
        place_ne_m: tuple[float, float],
        height_m: float,
        t_s: float,
        averaged_s: float = TELLING_S,
    ) -> BelievedWind:
        """The wind at a place, height above ground and time, as a mean about that time."""
        return _at(self.settled(now_s), place_ne_m, height_m, t_s, averaged_s)

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
        stations = sum(one.member in self._stations for one in told)
        counts = {"drone": len(told) - stations, "station": stations}
        who = " and ".join(f"{n} {kind}{'s' * (n > 1)}" for kind, n in counts.items() if n)
        return (
            f"wind {wind.speed_mps:.1f} +- {wind.std_mps:.1f} m/s from {wind.from_deg:.0f}"
            f" at {height_m:.0f} m, by {who}{self._out_words(now_s)}"
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
        felt = set[str]() if found is None else {one.member for one in found.felt}
        if found is not None and len(felt) == 1 and felt <= self._stations:
            return None  # one station alone may be broken: a second one, or a drone, has to feel it
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


def _at(
    field: SettledField, place_ne_m: _Vector, height_m: float, t_s: float, averaged_s: float
) -> BelievedWind:
    points = FieldPoints(np.array([place_ne_m]), np.array([height_m]), np.array([t_s]))
    found = field.forecast(points, averaged_s)
    north, east = (float(x) for x in found.mean_to_ne_mps[0])
    nn, ee = _only(found.north_cov_m2ps2), _only(found.east_cov_m2ps2)
    return BelievedWind((north, east), (nn, 0.0, ee))


def _misfit_square(told: WindTelling, mean_ne: _Vector, variance: _Vector) -> float:
    """Chi-square of two degrees of a telling under what is expected of it."""
    off = np.subtract(told.mean_to_ne_mps, mean_ne)
    return float(np.sum(off**2 / np.add(told.variance_m2ps2, variance)))


def _only(cov: Floats) -> float:
    return float(cov[0, 0])
