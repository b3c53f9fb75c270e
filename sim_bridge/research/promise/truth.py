"""True missions: straight out, deliver, straight back, through the recording at 1 s steps.

Truth model of `promise`; it imports nothing from the planner. The vehicle holds its airspeed.
Ground speed follows the wind triangle each second; if the wind allows no progress, the vehicle
uses energy without moving. Power is the truth's steady power at the airspeed, or at the wind speed
while hovering, climbing or descending over a fixed position. A stop or a start costs the time
airspeed / (2 acceleration) at the mean of cruise and hover power; turning back costs both. A
mission starts in cruise over the depot. It succeeds if it lands at the depot within its budget.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.steady_flight import SteadyFlight

_POWER_STEP_MPS = 0.5
_POWER_TOP_MPS = 45.0
MIN_DISTANCE_M = 50.0


@dataclass(frozen=True, slots=True)
class Profile:
    """Flight profile of all missions, except distance; speeds are the autopilots' defaults."""

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
    def stop_time_loss_s(self) -> float:
        """Time (s) lost by a stop, or by a start."""
        return 0.5 * self.airspeed_mps / self.accel_mps2

    @property
    def descent_s(self) -> float:
        """Descent time from cruise height to drop height."""
        return (self.cruise_height_m - self.drop_height_m) / self.descent_mps

    @property
    def climb_s(self) -> float:
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

        def power_by_airspeed_w(payload_kg: float, climb_mps: float) -> Floats:
            states = (
                steady.steady_state(v, payload_kg=payload_kg, climb_mps=climb_mps) for v in speeds
            )
            return np.array([state.power_w for state in states])

        self._loaded_hover, self._loaded_sink = (
            power_by_airspeed_w(load, 0.0),
            power_by_airspeed_w(load, -profile.descent_mps),
        )
        self._empty_climb = power_by_airspeed_w(0.0, profile.climb_mps)
        self._sink = {
            True: (self._loaded_sink, power_by_airspeed_w(load, -profile.landing_mps)),
            False: (
                power_by_airspeed_w(0.0, -profile.descent_mps),
                power_by_airspeed_w(0.0, -profile.landing_mps),
            ),
        }
        self.loaded_w = steady.level_flight_power_w(profile.airspeed_mps, load)
        self.empty_w = steady.level_flight_power_w(profile.airspeed_mps, 0.0)
        self.loaded_stop_w = 0.5 * (self.loaded_w + float(self._loaded_hover[0]))
        self._empty_stop_w = 0.5 * (self.empty_w + steady.hover_power_w(0.0))
        self.budget_wh = (1.0 - profile.reserve_frac) * Battery(truth.battery).usable_wh(
            0.5 * (self.loaded_w + self.empty_w)
        )
        self.profile = profile

    def customer_energy_wh(self, wind_mps: Floats) -> Floats:
        """Energy (n,) at the customer in this wind speed: stop, descent, hover, climb and start."""
        p = self.profile
        joule = p.descent_s * np.interp(wind_mps, self._speeds, self._loaded_sink)
        joule += p.hover_s * np.interp(wind_mps, self._speeds, self._loaded_hover)
        joule += p.climb_s * np.interp(wind_mps, self._speeds, self._empty_climb)
        return (joule + p.stop_time_loss_s * (self.loaded_stop_w + self._empty_stop_w)) / 3600.0

    def landing_energy_wh(self, wind_mps: Floats, *, loaded: bool) -> Floats:
        """Energy (n,) from cruise flight over the depot to motors off."""
        p = self.profile
        fast, slow = self._sink[loaded]
        fast_s = (p.cruise_height_m - p.land_slow_height_m) / p.descent_mps
        joule = fast_s * np.interp(wind_mps, self._speeds, fast)
        joule += (p.landing_s - fast_s) * np.interp(wind_mps, self._speeds, slow)
        return (
            joule + p.stop_time_loss_s * (self.loaded_stop_w if loaded else self._empty_stop_w)
        ) / 3600.0

    @property
    def endurance_s(self) -> float:
        """Upper bound on a mission's flight time within its budget."""
        p = self.profile
        ground_s = p.descent_s + p.hover_s + p.climb_s + p.landing_s + 6.0 * p.stop_time_loss_s
        return self.budget_wh * 3600.0 / min(self.loaded_w, self.empty_w) + ground_s

    def distances_that_use_budget_frac_m(
        self, wind_ne_mps: Floats, unit_ne: Floats, budget_frac: Floats
    ) -> Floats:
        """Return distances (n,) whose round trip, out loaded and back empty, uses `budget_frac` in
        constant wind (n, 2).
        """
        airspeed_mps = self.profile.airspeed_mps
        out = ground_speed_mps(airspeed_mps, wind_ne_mps, unit_ne)
        back = ground_speed_mps(airspeed_mps, wind_ne_mps, -unit_ne)
        with np.errstate(divide="ignore"):  # no progress against the wind
            wh_per_m = (self.loaded_w / out + self.empty_w / back) / 3600.0
        speed = np.hypot(wind_ne_mps[:, 0], wind_ne_mps[:, 1])
        fixed_wh = self.customer_energy_wh(speed) + self.landing_energy_wh(speed, loaded=False)
        return np.maximum((budget_frac * self.budget_wh - fixed_wh) / wh_per_m, MIN_DISTANCE_M)


def ground_speed_mps(airspeed_mps: float, wind_ne_mps: Floats, unit_ne: Floats) -> Floats:
    """Ground speed along unit vectors by the wind triangle, at least 0; inputs (..., 2)."""
    tailwind_mps = (wind_ne_mps * unit_ne).sum(axis=-1)
    across = wind_ne_mps[..., 1] * unit_ne[..., 0] - wind_ne_mps[..., 0] * unit_ne[..., 1]
    squared = airspeed_mps**2 - across**2
    return np.where(
        squared >= 0.0, np.maximum(np.sqrt(np.maximum(squared, 0.0)) + tailwind_mps, 0.0), 0.0
    )


class TrueMissions:
    """Possible outcomes of all missions, computed from the recorded wind.

    `wind_ne_mps` (n, seconds + 1, 2): wind of each mission from its start. Times are seconds from
    the start, energies Wh. A vehicle that never arrives has infinite times.
    """

    def __init__(
        self, power: TruePower, unit_ne: Floats, distance_m: Floats, wind_ne_mps: Floats
    ) -> None:
        self.power, self.profile = power, power.profile
        self.unit_ne, self.distance_m, self.wind_ne_mps = unit_ne, distance_m, wind_ne_mps
        self._speed = np.hypot(wind_ne_mps[..., 0], wind_ne_mps[..., 1])
        self.out_m, self._back_m = (
            _cumulative_distance_m(
                ground_speed_mps(self.profile.airspeed_mps, wind_ne_mps, unit[:, None, :])
            )
            for unit in (unit_ne, -unit_ne)
        )
        self.arrival_s = _first_reach_time_s(self.out_m, distance_m)

    def outbound_distance_m(self, t_s: Floats) -> Floats:
        """Return the outbound distance (m) of every mission at its time."""
        return np.minimum(_interpolate_rows(self.out_m, t_s), self.distance_m)

    def return_energy_wh(self, turn_s: Floats) -> Floats:
        """Return the energy of missions that turn back at `turn_s`, en route or at the customer."""
        p, power = self.profile, self.power
        return_start_s = turn_s + 2.0 * p.stop_time_loss_s
        home_s = _first_reach_time_s(
            self._back_m,
            _interpolate_rows(self._back_m, return_start_s) + self.outbound_distance_m(turn_s),
        )
        cruised = power.loaded_w * (home_s - 2.0 * p.stop_time_loss_s) / 3600.0
        turn_wh = 2.0 * p.stop_time_loss_s * power.loaded_stop_w / 3600.0
        return cruised + turn_wh + self._landing_energy_wh(home_s, loaded=True)

    def delivery_energy_wh(self) -> Floats:
        """Return the energy of each mission if it delivers."""
        p, power = self.profile, self.power
        arrived = self.arrival_s
        used_wh = power.loaded_w * arrived / 3600.0 + power.customer_energy_wh(
            self._wind_speed_at(arrived)
        )
        leave = arrived + p.descent_s + p.hover_s + p.climb_s + 2.0 * p.stop_time_loss_s
        target = _interpolate_rows(self._back_m, leave) + self.distance_m
        home_s = _first_reach_time_s(self._back_m, target)
        return (
            used_wh
            + power.empty_w * (home_s - leave) / 3600.0
            + self._landing_energy_wh(home_s, loaded=False)
        )

    def _landing_energy_wh(self, at_s: Floats, *, loaded: bool) -> Floats:
        return self.power.landing_energy_wh(self._wind_speed_at(at_s), loaded=loaded)

    def _wind_speed_at(self, t_s: Floats) -> Floats:
        return _interpolate_rows(self._speed, t_s)


def _cumulative_distance_m(ground_mps: Floats) -> Floats:
    """Return the distance flown (m) at each whole second, (n, seconds + 1)."""
    run = np.cumsum(ground_mps[:, :-1], axis=1)
    return np.concatenate([np.zeros((run.shape[0], 1)), run], axis=1)


def _interpolate_rows(series: Floats, t_s: Floats) -> Floats:
    """Interpolate each row linearly at its time; beyond the end, return the last value."""
    last = series.shape[1] - 1
    t = np.minimum(np.where(np.isfinite(t_s), t_s, last), last)
    low = np.minimum(t.astype(np.int64), last - 1)
    rows = np.arange(series.shape[0])
    return series[rows, low] + (t - low) * (series[rows, low + 1] - series[rows, low])


def _first_reach_time_s(run_m: Floats, target_m: Floats) -> Floats:
    """Return the time at which each increasing row reaches its target; inf if never."""
    reached = run_m >= target_m[:, None]
    first = reached.argmax(axis=1)
    rows = np.arange(run_m.shape[0])
    low = np.maximum(first - 1, 0)
    step = run_m[rows, first] - run_m[rows, low]
    share = (target_m - run_m[rows, low]) / np.where(step > 0.0, step, 1.0)
    crossed = np.where(first > 0, low + share, 0.0)
    return np.where(reached.any(axis=1), crossed, math.inf)
