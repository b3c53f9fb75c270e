"""What knowing the wind would have allowed: the flight integrated through the true mean wind.

The route is flown through the recording or the ramp as it will be, at every moment at the airspeed
(cruise or faster) that costs least per metre, with the truth's own steady power and battery, to
the ground: take-off, climb, settling, cruise, descent, drop, climb, return, landing. Gusts and the
moments of turning are left out.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

from sim_bridge.truth.battery import Battery
from sim_bridge.truth.steady_flight import SteadyFlight

STEP_S = 1.0
SLOWEST_MPS = 0.3  # under this ground speed the vehicle makes no way
SPEED_STEP_MPS = 0.5
WindAt = Callable[[float, float], tuple[float, float]]
Ne = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Foresight:
    """How the flight would end that knows its wind."""

    home: bool
    margin_wh: float
    flight_time_s: float

    @property
    def outcome(self) -> str:
        """SUC, or ABRT: the clairvoyant would not have left."""
        return "SUC" if self.home else "ABRT"


@dataclass(slots=True)
class _Flyer:
    flight: SteadyFlight
    battery: Battery
    wind_at: WindAt
    t_s: float
    payload_kg: float
    height_m: float = 0.0
    _powers: dict[tuple[int, float], float] = field(default_factory=dict)

    def spend(self, power_w: float, dt_s: float) -> None:
        self.battery.step(power_w, dt_s)
        self.t_s += dt_s

    def hover(self, seconds: float) -> None:
        while seconds > 0.0 and not self.battery.cut_off:
            dt_s = min(STEP_S, seconds)
            self.spend(self._power(math.hypot(*self.wind_at(self.t_s, self.height_m))), dt_s)
            seconds -= dt_s

    def to_height(self, height_m: float, speed_mps: float) -> None:
        while abs(height_m - self.height_m) > 1e-6 and not self.battery.cut_off:
            dt_s = min(STEP_S, abs(height_m - self.height_m) / speed_mps)
            climb = math.copysign(speed_mps, height_m - self.height_m)
            wind = math.hypot(*self.wind_at(self.t_s, max(self.height_m, 1.0)))
            self.spend(self._power(wind, climb), dt_s)
            self.height_m += climb * dt_s

    def along(self, start: Ne, end: Ne, speeds: list[float], fastest_mps: float) -> bool:
        length = math.dist(start, end)
        if length < 1.0:
            return True
        unit = ((end[0] - start[0]) / length, (end[1] - start[1]) / length)
        left_m = length
        while left_m > 0.0 and not self.battery.cut_off:
            north, east = self.wind_at(self.t_s, self.height_m)
            tail = north * unit[0] + east * unit[1]
            cross = east * unit[0] - north * unit[1]
            ground, power_w = self._cheapest(speeds, tail, cross, fastest_mps)
            if ground < SLOWEST_MPS:
                self.spend(self._level_power(speeds[-1]), STEP_S)
                continue
            dt_s = min(STEP_S, left_m / ground)
            self.spend(power_w, dt_s)
            left_m -= ground * dt_s
        return not self.battery.cut_off

    def _cheapest(
        self, speeds: list[float], tail: float, cross: float, fastest_mps: float
    ) -> tuple[float, float]:
        """Ground speed and power of least energy per metre; speed 0 where no way is made."""
        best = (0.0, 0.0)
        for airspeed in speeds:
            if abs(cross) >= airspeed:
                continue
            ground = min(math.sqrt(airspeed**2 - cross**2) + tail, fastest_mps)
            if ground < SLOWEST_MPS:
                continue
            power_w = self._level_power(math.hypot(ground - tail, cross))
            if best[0] == 0.0 or power_w / ground < best[1] / best[0]:
                best = (ground, power_w)
        return best

    def _level_power(self, airspeed_mps: float) -> float:
        key = (round(airspeed_mps * 10.0), self.payload_kg)
        if key not in self._powers:
            self._powers[key] = self._power(key[0] / 10.0)
        return self._powers[key]

    def _power(self, airspeed_mps: float, climb_mps: float = 0.0) -> float:
        state = self.flight.state(airspeed_mps, payload_kg=self.payload_kg, climb_mps=climb_mps)
        return state.power_w


@dataclass(frozen=True, slots=True)
class Itinerary:
    """What is to be flown. Heights are above the depot; `hover_s` is spent at the drop."""

    out_ne_m: list[Ne]
    back_ne_m: list[Ne]
    cruise_height_m: float
    drop_up_m: float
    settle_s: float
    hover_s: float
    airspeed_mps: float
    max_airspeed_mps: float
    fastest_mps: float
    climb_mps: float
    descent_mps: float
    landing_mps: float


def foresee(
    itinerary: Itinerary,
    *,
    flight: SteadyFlight,
    battery: Battery,
    wind_at: WindAt,
    start_s: float,
    payload_kg: float,
    reserve_wh: float,
    reference_draw_w: float,
) -> Foresight:
    """Integrate the whole mission from take-off at `start_s`; `battery` is used up."""
    plan = itinerary
    flyer = _Flyer(flight, battery, wind_at, start_s, payload_kg)
    flyer.to_height(plan.cruise_height_m, plan.climb_mps)
    flyer.hover(plan.settle_s)
    flown = _fly(flyer, plan.out_ne_m, plan)
    flyer.to_height(plan.drop_up_m, plan.descent_mps)
    flyer.hover(plan.hover_s)
    flyer.payload_kg = 0.0
    flyer.to_height(plan.cruise_height_m, plan.climb_mps)
    flown = flown and _fly(flyer, plan.back_ne_m, plan)
    flyer.to_height(min(10.0, plan.cruise_height_m), plan.descent_mps)
    flyer.to_height(0.0, plan.landing_mps)
    margin_wh = battery.usable_wh(reference_draw_w) - reserve_wh
    home = flown and not battery.cut_off and margin_wh >= 0.0
    return Foresight(home, margin_wh, flyer.t_s - start_s)


def _fly(flyer: _Flyer, path: list[Ne], plan: Itinerary) -> bool:
    faster = max(plan.max_airspeed_mps - plan.airspeed_mps, 0.0)
    count = int(faster / SPEED_STEP_MPS) + 1
    speeds = [plan.airspeed_mps + k * SPEED_STEP_MPS for k in range(count)]
    return all(flyer.along(a, b, speeds, plan.fastest_mps) for a, b in itertools.pairwise(path))
