"""The best result with perfect knowledge of the wind: the flight through the true mean wind.

The route is flown through the recording or the ramp as it will be, each leg at the one ground
speed that costs least on it, as an autopilot can fly it, with the truth's own steady power and
battery, to the ground: take-off, climb, settling, cruise with its speeding up and stopping,
descent, drop, climb, return, landing. It lands at whichever declared site leaves the most. Gusts
of simulated turbulence and the moments of turning are left out.
"""

import copy
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from sim_bridge.truth.battery import Battery
from sim_bridge.truth.steady_flight import SteadyFlight

STEP_S = 1.0
LONGEST_LEG_STEPS = 900
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


@dataclass(frozen=True, slots=True)
class SpeedLimits:
    """Between which ground speeds it is commanded, its most airspeed, how it gains speed."""

    slowest_mps: float
    fastest_mps: float
    most_air_mps: float
    accel_mps2: float

    def choices(self) -> list[float]:
        """Ground speeds to choose from."""
        count = int((self.fastest_mps - self.slowest_mps) / SPEED_STEP_MPS) + 1
        return [self.slowest_mps + k * SPEED_STEP_MPS for k in range(count)]


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

    def along(
        self, start: Ne, end: Ne, limits: "SpeedLimits", *, starts: bool, stops: bool
    ) -> bool:
        """Fly one leg at the one ground speed that costs least; tells whether it got there.

        `starts` and `stops`: from rest, to rest. Half of a speed-up's time is lost against
        flying through, at the leg's own power.
        """
        length_m = math.dist(start, end)
        if length_m < 1.0:
            return True
        unit = ((end[0] - start[0]) / length_m, (end[1] - start[1]) / length_m)
        flown = [self._steps(unit, length_m, speed, limits) for speed in limits.choices()]
        steps = min((f for f in flown if f), key=lambda f: sum(p * dt for p, dt in f), default=[])
        if not steps:
            return False
        for power_w, dt_s in steps:
            if self.battery.cut_off:
                return False
            self.spend(power_w, dt_s)
        mean_mps = length_m / sum(dt for _, dt in steps)
        lost_s = (starts + stops) * 0.5 * mean_mps / limits.accel_mps2
        self.spend(steps[-1][0], lost_s)
        return not self.battery.cut_off

    def _steps(
        self, unit: Ne, length_m: float, ground_mps: float, limits: "SpeedLimits"
    ) -> list[tuple[float, float]]:
        """(power, seconds) along a leg at a commanded ground speed; empty: it never gets there.

        As the autopilot flies it: the ground speed is held until the tilt saturates.
        """
        steps: list[tuple[float, float]] = []
        left_m, t_s = length_m, self.t_s
        for _ in range(LONGEST_LEG_STEPS):
            north, east = self.wind_at(t_s, self.height_m)
            tail = north * unit[0] + east * unit[1]
            cross = east * unit[0] - north * unit[1]
            if abs(cross) >= limits.most_air_mps:
                return []
            reach = tail + math.sqrt(limits.most_air_mps**2 - cross**2)
            ground = min(ground_mps, reach)
            dt_s = STEP_S if ground < SLOWEST_MPS else min(STEP_S, left_m / ground)
            steps.append((self._level_power(math.hypot(ground - tail, cross)), dt_s))
            left_m -= max(ground, 0.0) * dt_s
            t_s += dt_s
            if left_m <= 1e-6:
                return steps
        return []

    def _level_power(self, airspeed_mps: float) -> float:
        key = (round(airspeed_mps * 10.0), self.payload_kg)
        if key not in self._powers:
            self._powers[key] = self._power(key[0] / 10.0)
        return self._powers[key]

    def _power(self, airspeed_mps: float, climb_mps: float = 0.0) -> float:
        state = self.flight.state(airspeed_mps, payload_kg=self.payload_kg, climb_mps=climb_mps)
        return state.power_w


@dataclass(frozen=True, slots=True)
class WayBack:
    """From over the customer (north, east) to over a landing site, and its ground's height."""

    path_ne_m: list[Ne]
    ground_up_m: float


@dataclass(frozen=True, slots=True)
class Itinerary:
    """What is to be flown. Heights are above the depot; `hover_s` is spent at the drop.

    The way back is flown at `return_height_m`. `ways_back` are alternatives; each starts over the
    customer.
    """

    out_ne_m: list[Ne]
    ways_back: list[WayBack]
    cruise_height_m: float
    return_height_m: float
    drop_up_m: float
    settle_s: float
    hover_s: float
    speeds: SpeedLimits
    takeoff_mps: float
    climb_mps: float
    descent_mps: float
    landing_mps: float
    slow_below_m: float


@dataclass(frozen=True, slots=True)
class Means:
    """The truth that is flown with. `reference_draw_w` is what usable energy is counted at."""

    flight: SteadyFlight
    wind_at: WindAt
    payload_kg: float
    reserve_wh: float
    reference_draw_w: float


def foresee(
    itinerary: Itinerary, means: Means, new_battery: Callable[[], Battery], start_s: float
) -> Foresight:
    """Integrate the whole mission from take-off at `start_s`, by the best of the ways back."""
    flyer = _Flyer(means.flight, new_battery(), means.wind_at, start_s, means.payload_kg)
    if not _deliver(itinerary, flyer):
        left_wh = flyer.battery.usable_wh(means.reference_draw_w) - means.reserve_wh
        return Foresight(False, left_wh, flyer.t_s - start_s)
    ends = [
        _end(itinerary, way, means, replace(flyer, battery=copy.deepcopy(flyer.battery)), start_s)
        for way in itinerary.ways_back
    ]
    return max(ends, key=lambda end: (end.home, end.margin_wh))


def _deliver(plan: Itinerary, flyer: _Flyer) -> bool:
    """From take-off to over the customer, the parcel gone; False where it does not get there."""
    flyer.to_height(plan.cruise_height_m, plan.takeoff_mps)
    flyer.hover(plan.settle_s)
    if not _fly(flyer, plan.out_ne_m, plan.speeds):
        return False
    flyer.to_height(plan.drop_up_m, plan.descent_mps)
    flyer.hover(plan.hover_s)
    flyer.payload_kg = 0.0
    flyer.to_height(plan.return_height_m, plan.climb_mps)
    return not flyer.battery.cut_off


def _end(plan: Itinerary, way: WayBack, means: Means, flyer: _Flyer, start_s: float) -> Foresight:
    flown = _fly(flyer, way.path_ne_m, plan.speeds)
    slow_from_m = min(way.ground_up_m + plan.slow_below_m, plan.return_height_m)
    flyer.to_height(slow_from_m, plan.descent_mps)
    flyer.to_height(way.ground_up_m, plan.landing_mps)
    margin_wh = flyer.battery.usable_wh(means.reference_draw_w) - means.reserve_wh
    home = flown and not flyer.battery.cut_off and margin_wh >= 0.0
    return Foresight(home, margin_wh, flyer.t_s - start_s)


def _fly(flyer: _Flyer, path: list[Ne], speeds: SpeedLimits) -> bool:
    legs = list(itertools.pairwise(path))
    return all(
        flyer.along(a, b, speeds, starts=k == 0, stops=k == len(legs) - 1)
        for k, (a, b) in enumerate(legs)
    )
