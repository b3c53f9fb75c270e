"""The true missions: straight out, deliver, straight back, through the recording at 1 s steps.

This is the truth's side of `promise`; it imports nothing of the planner's. The vehicle holds its
airspeed. Ground speed follows the wind triangle each second; where the wind allows no progress it
burns energy in place. Power is the truth's steady power at that airspeed, or at the wind's speed
where it hovers, climbs or descends over one place. A stop or a start costs the time airspeed /
(2 acceleration) at the mean of cruise and hover power; turning back costs both. A mission starts at
cruise height over the depot, under way. It is home if it lands at the depot within its budget.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats, Ints
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.steady_flight import SteadyFlight

_POWER_STEP_MPS = 0.5
_POWER_TOP_MPS = 45.0


@dataclass(frozen=True, slots=True)
class Profile:
    """Flight profile of every mission except its distance; speeds are the autopilots' defaults."""

    airspeed_mps: float
    payload_kg: float = 0.6
    cruise_height_m: float = 40.0
    drop_height_m: float = 6.0
    hover_s: float = 5.0
    climb_mps: float = 3.0
    descent_mps: float = 2.0
    landing_mps: float = 0.7
    land_slow_height_m: float = 10.0
    touchdown_s: float = 4.0
    accel_mps2: float = 2.5
    reserve_frac: float = 0.15

    @property
    def stop_s(self) -> float:
        """Time (s) lost by a stop, or by a start."""
        return 0.5 * self.airspeed_mps / self.accel_mps2

    @property
    def sinking_s(self) -> float:
        """Descent time from cruise height to drop height."""
        return (self.cruise_height_m - self.drop_height_m) / self.descent_mps

    @property
    def climbing_s(self) -> float:
        """Climb time from drop height to cruise height."""
        return (self.cruise_height_m - self.drop_height_m) / self.climb_mps

    @property
    def landing_s(self) -> float:
        """Time from cruise height to motors off."""
        fast_m = self.cruise_height_m - self.land_slow_height_m
        slow_s = self.land_slow_height_m / self.landing_mps
        return fast_m / self.descent_mps + slow_s + self.touchdown_s


class TruePower:
    """The truth's electrical power, tabulated over airspeed."""

    def __init__(self, truth: AirframeTruth, profile: Profile) -> None:
        steady = SteadyFlight(truth)
        speeds = np.arange(0.0, _POWER_TOP_MPS, _POWER_STEP_MPS)
        load = profile.payload_kg
        self._speeds = speeds

        def table(payload_kg: float, climb_mps: float) -> Floats:
            states = (steady.state(v, payload_kg=payload_kg, climb_mps=climb_mps) for v in speeds)
            return np.array([state.power_w for state in states])

        self._loaded_hover, self._loaded_sink = table(load, 0.0), table(load, -profile.descent_mps)
        self._empty_climb = table(0.0, profile.climb_mps)
        self._sink = {
            True: (self._loaded_sink, table(load, -profile.landing_mps)),
            False: (table(0.0, -profile.descent_mps), table(0.0, -profile.landing_mps)),
        }
        self.loaded_w = steady.level_flight_power_w(profile.airspeed_mps, load)
        self.empty_w = steady.level_flight_power_w(profile.airspeed_mps, 0.0)
        self._loaded_stop_w = 0.5 * (self.loaded_w + float(self._loaded_hover[0]))
        self._empty_stop_w = 0.5 * (self.empty_w + steady.hover_power_w(0.0))
        self.budget_wh = (1.0 - profile.reserve_frac) * Battery(truth.battery).usable_wh(
            0.5 * (self.loaded_w + self.empty_w)
        )
        self._profile = profile

    def deliver_wh(self, wind_mps: Floats) -> Floats:
        """Energy (n,) at the customer in this wind speed: stop, descent, hover, climb and start."""
        p = self._profile
        joule = p.sinking_s * np.interp(wind_mps, self._speeds, self._loaded_sink)
        joule += p.hover_s * np.interp(wind_mps, self._speeds, self._loaded_hover)
        joule += p.climbing_s * np.interp(wind_mps, self._speeds, self._empty_climb)
        return (joule + p.stop_s * (self._loaded_stop_w + self._empty_stop_w)) / 3600.0

    def land_wh(self, wind_mps: Floats, *, loaded: bool) -> Floats:
        """Energy (n,) from cruise flight over the depot to motors off."""
        p = self._profile
        fast, slow = self._sink[loaded]
        fast_s = (p.cruise_height_m - p.land_slow_height_m) / p.descent_mps
        joule = fast_s * np.interp(wind_mps, self._speeds, fast)
        joule += (p.landing_s - fast_s) * np.interp(wind_mps, self._speeds, slow)
        return (joule + p.stop_s * (self._loaded_stop_w if loaded else self._empty_stop_w)) / 3600.0

    @property
    def turn_wh(self) -> float:
        """Energy to stop and start back, loaded."""
        return 2.0 * self._profile.stop_s * self._loaded_stop_w / 3600.0

    @property
    def endurance_s(self) -> float:
        """Upper bound on a mission's flight time within its budget."""
        p = self._profile
        ground_s = p.sinking_s + p.hover_s + p.climbing_s + p.landing_s + 6.0 * p.stop_s
        return self.budget_wh * 3600.0 / min(self.loaded_w, self.empty_w) + ground_s

    def round_trip_wh_per_m(self, wind_ne_mps: Floats, unit_ne: Floats) -> Floats:
        """Wh per metre, out loaded and back empty, in constant wind (n, 2); inf without
        progress.
        """
        out = ground_speed_mps(self._profile.airspeed_mps, wind_ne_mps, unit_ne)
        back = ground_speed_mps(self._profile.airspeed_mps, wind_ne_mps, -unit_ne)
        with np.errstate(divide="ignore"):
            return (self.loaded_w / out + self.empty_w / back) / 3600.0


def ground_speed_mps(airspeed_mps: float, wind_ne_mps: Floats, unit_ne: Floats) -> Floats:
    """Ground speed along unit vectors by the wind triangle, at least 0; inputs (..., 2)."""
    along = (wind_ne_mps * unit_ne).sum(axis=-1)
    across = wind_ne_mps[..., 1] * unit_ne[..., 0] - wind_ne_mps[..., 0] * unit_ne[..., 1]
    squared = airspeed_mps**2 - across**2
    return np.where(squared >= 0.0, np.maximum(np.sqrt(np.maximum(squared, 0.0)) + along, 0.0), 0.0)


@dataclass(frozen=True, slots=True)
class Missions:
    """Missions by the index of their first second in the wind series."""

    start: Ints
    unit_ne: Floats
    distance_m: Floats


class TrueMissions:
    """Every mission's possible ends, from the recorded wind.

    `wind_ne_mps` (n, seconds + 1, 2): each mission's wind from its start on. Times are seconds
    from its start, energies Wh. A vehicle that never arrives has infinite times.
    """

    def __init__(
        self, missions: Missions, power: TruePower, profile: Profile, wind_ne_mps: Floats
    ) -> None:
        self.missions, self.power, self.profile = missions, power, profile
        self.wind_ne_mps = wind_ne_mps
        self._speed = np.hypot(wind_ne_mps[..., 0], wind_ne_mps[..., 1])
        unit = missions.unit_ne[:, None, :]
        self._out_m = _run(ground_speed_mps(profile.airspeed_mps, wind_ne_mps, unit))
        self._back_m = _run(ground_speed_mps(profile.airspeed_mps, wind_ne_mps, -unit))
        self.arrival_s = _crossing_s(self._out_m, missions.distance_m)
        self.pack_wh = np.zeros(missions.start.size)
        """Each pack's energy beyond the believed budget."""

    def out_m(self, t_s: Floats) -> Floats:
        """Distance out (m) of every mission at its time."""
        return np.minimum(_at(self._out_m, t_s), self.missions.distance_m)

    def out_by_second(self, number: int) -> Floats:
        """Distance out (m) of one mission at each whole second."""
        return np.minimum(self._out_m[number], self.missions.distance_m[number])

    def turning_wh(self, t_s: Floats) -> Floats:
        """Energy of each mission if it turns back at its time, under way or over the customer."""
        p, power = self.profile, self.power
        turned_s = t_s + 2.0 * p.stop_s
        home_s = _crossing_s(self._back_m, _at(self._back_m, turned_s) + self.out_m(t_s))
        cruised = power.loaded_w * (home_s - 2.0 * p.stop_s) / 3600.0
        return cruised + power.turn_wh + self._land_wh(home_s, loaded=True)

    def delivering_wh(self) -> Floats:
        """Energy of each mission if it delivers."""
        p, power = self.profile, self.power
        arrived = self.arrival_s
        spent = power.loaded_w * arrived / 3600.0 + power.deliver_wh(self._speed_at(arrived))
        leave = arrived + p.sinking_s + p.hover_s + p.climbing_s + 2.0 * p.stop_s
        target = _at(self._back_m, leave) + self.missions.distance_m
        home_s = _crossing_s(self._back_m, target)
        return (
            spent + power.empty_w * (home_s - leave) / 3600.0 + self._land_wh(home_s, loaded=False)
        )

    def _land_wh(self, at_s: Floats, *, loaded: bool) -> Floats:
        return self.power.land_wh(self._speed_at(at_s), loaded=loaded)

    def _speed_at(self, t_s: Floats) -> Floats:
        return _at(self._speed, t_s)


def _run(ground_mps: Floats) -> Floats:
    """Metres covered at each whole second, (n, seconds + 1)."""
    run = np.cumsum(ground_mps[:, :-1], axis=1)
    return np.concatenate([np.zeros((run.shape[0], 1)), run], axis=1)


def _at(series: Floats, t_s: Floats) -> Floats:
    """Each row's value at its time, linear between seconds; the last value beyond the end."""
    last = series.shape[1] - 1
    t = np.minimum(np.where(np.isfinite(t_s), t_s, last), last)
    low = np.minimum(t.astype(np.int64), last - 1)
    rows = np.arange(series.shape[0])
    return series[rows, low] + (t - low) * (series[rows, low + 1] - series[rows, low])


def _crossing_s(run_m: Floats, target_m: Floats) -> Floats:
    """When each row's rising series reaches its target; infinite if never."""
    reached = run_m >= target_m[:, None]
    first = reached.argmax(axis=1)
    rows = np.arange(run_m.shape[0])
    low = np.maximum(first - 1, 0)
    step = run_m[rows, first] - run_m[rows, low]
    share = (target_m - run_m[rows, low]) / np.where(step > 0.0, step, 1.0)
    crossed = np.where(first > 0, low + share, 0.0)
    return np.where(reached.any(axis=1), crossed, math.inf)
