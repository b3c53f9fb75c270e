"""Best result with perfect knowledge of the wind: the flight through the true mean wind.

The route is integrated through the future wind recording or ramp. Each leg uses the constant
ground speed with the lowest energy that an autopilot can fly, with the truth's steady power and
battery. Phases are take-off, climb, settling, cruise with acceleration and braking, descent, drop,
climb, return and landing, at the declared site with the largest remaining energy. Turbulence and
turns are not modelled.
"""

import copy
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from sim_bridge.truth.battery import Battery
from sim_bridge.truth.steady_flight import SteadyFlight

STEP_S = 1.0
MAX_LEG_STEPS = 900
MIN_GROUND_MPS = 0.3  # below this ground speed the vehicle makes no progress
SPEED_STEP_MPS = 0.5
WindAt = Callable[[float, float], tuple[float, float]]
PointNe = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ClairvoyantResult:
    """Result of a flight with known wind."""

    home: bool
    margin_wh: float

    @property
    def outcome(self) -> str:
        """SUC, or ABRT if the clairvoyant would not take off."""
        return "SUC" if self.home else "ABRT"


@dataclass(frozen=True, slots=True)
class SpeedLimits:
    """Range of commanded ground speeds, maximum airspeed and acceleration."""

    min_ground_mps: float
    max_ground_mps: float
    max_airspeed_mps: float
    accel_mps2: float

    def candidate_ground_speeds_mps(self) -> list[float]:
        """Return the candidate ground speeds (m/s)."""
        count = int((self.max_ground_mps - self.min_ground_mps) / SPEED_STEP_MPS) + 1
        return [self.min_ground_mps + k * SPEED_STEP_MPS for k in range(count)]


@dataclass(slots=True)
class _FlightIntegrator:
    flight: SteadyFlight
    battery: Battery
    wind_at: WindAt
    t_s: float
    payload_kg: float
    height_m: float = 0.0
    _power_cache_w: dict[tuple[int, float], float] = field(default_factory=dict)

    def draw_energy_and_advance_time(self, power_w: float, dt_s: float) -> None:
        self.battery.discharge_at_power(power_w, dt_s)
        self.t_s += dt_s

    def integrate_hover(self, duration_s: float) -> None:
        while duration_s > 0.0 and not self.battery.cut_off:
            dt_s = min(STEP_S, duration_s)
            self.draw_energy_and_advance_time(
                self._steady_flight_power_w(math.hypot(*self.wind_at(self.t_s, self.height_m))),
                dt_s,
            )
            duration_s -= dt_s

    def integrate_height_change(self, target_height_m: float, vertical_speed_mps: float) -> None:
        while abs(target_height_m - self.height_m) > 1e-6 and not self.battery.cut_off:
            dt_s = min(STEP_S, abs(target_height_m - self.height_m) / vertical_speed_mps)
            climb = math.copysign(vertical_speed_mps, target_height_m - self.height_m)
            wind = math.hypot(*self.wind_at(self.t_s, max(self.height_m, 1.0)))
            self.draw_energy_and_advance_time(self._steady_flight_power_w(wind, climb), dt_s)
            self.height_m += climb * dt_s

    def integrate_leg_at_best_speed(
        self,
        start_ne_m: PointNe,
        end_ne_m: PointNe,
        limits: "SpeedLimits",
        *,
        from_rest: bool,
        to_rest: bool,
    ) -> bool:
        """Fly one leg at the ground speed of lowest energy; return True if its end is reached.

        `from_rest` and `to_rest`: from rest, to rest. Each acceleration adds half of its duration,
        at the power of the leg.
        """
        length_m = math.dist(start_ne_m, end_ne_m)
        if length_m < 1.0:
            return True
        unit = ((end_ne_m[0] - start_ne_m[0]) / length_m, (end_ne_m[1] - start_ne_m[1]) / length_m)
        flown = [
            self._leg_power_and_duration_steps(unit, length_m, speed, limits)
            for speed in limits.candidate_ground_speeds_mps()
        ]
        steps = min((f for f in flown if f), key=lambda f: sum(p * dt for p, dt in f), default=[])
        if not steps:
            return False
        for power_w, dt_s in steps:
            if self.battery.cut_off:
                return False
            self.draw_energy_and_advance_time(power_w, dt_s)
        mean_mps = length_m / sum(dt for _, dt in steps)
        lost_s = (from_rest + to_rest) * 0.5 * mean_mps / limits.accel_mps2
        self.draw_energy_and_advance_time(steps[-1][0], lost_s)
        return not self.battery.cut_off

    def _leg_power_and_duration_steps(
        self,
        unit_direction_ne: PointNe,
        length_m: float,
        commanded_ground_speed_mps: float,
        limits: "SpeedLimits",
    ) -> list[tuple[float, float]]:
        """Return (power, seconds) steps of a leg at a commanded ground speed; empty: unreachable.

        As in the autopilot, the ground speed is held until the tilt saturates.
        """
        steps: list[tuple[float, float]] = []
        remaining_m, t_s = length_m, self.t_s
        for _ in range(MAX_LEG_STEPS):
            north, east = self.wind_at(t_s, self.height_m)
            tail = north * unit_direction_ne[0] + east * unit_direction_ne[1]
            cross = east * unit_direction_ne[0] - north * unit_direction_ne[1]
            if abs(cross) >= limits.max_airspeed_mps:
                return []
            max_reachable_mps = tail + math.sqrt(limits.max_airspeed_mps**2 - cross**2)
            ground = min(commanded_ground_speed_mps, max_reachable_mps)
            dt_s = STEP_S if ground < MIN_GROUND_MPS else min(STEP_S, remaining_m / ground)
            steps.append(
                (self._cached_level_flight_power_w(math.hypot(ground - tail, cross)), dt_s)
            )
            remaining_m -= max(ground, 0.0) * dt_s
            t_s += dt_s
            if remaining_m <= 1e-6:
                return steps
        return []

    def _cached_level_flight_power_w(self, airspeed_mps: float) -> float:
        key = (round(airspeed_mps * 10.0), self.payload_kg)
        if key not in self._power_cache_w:
            self._power_cache_w[key] = self._steady_flight_power_w(key[0] / 10.0)
        return self._power_cache_w[key]

    def _steady_flight_power_w(self, airspeed_mps: float, climb_mps: float = 0.0) -> float:
        state = self.flight.steady_state(
            airspeed_mps, payload_kg=self.payload_kg, climb_mps=climb_mps
        )
        return state.power_w


@dataclass(frozen=True, slots=True)
class ReturnRoute:
    """Path from the customer (north, east) to a landing site, and the site's ground height."""

    path_ne_m: list[PointNe]
    ground_up_m: float


@dataclass(frozen=True, slots=True)
class MissionProfile:
    """Route and speeds of a mission. Heights are above the depot; `hover_s` is the drop time.

    The return is flown at `return_height_m`. `return_routes` are alternatives; each starts above
    the customer.
    """

    out_ne_m: list[PointNe]
    return_routes: list[ReturnRoute]
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
class TrueConditions:
    """True flight conditions. `reference_draw_w` is the reference power for usable energy."""

    flight: SteadyFlight
    wind_at: WindAt
    payload_kg: float
    reserve_wh: float
    reference_draw_w: float


def compute_clairvoyant_result(
    mission_profile: MissionProfile,
    conditions: TrueConditions,
    battery: Battery,
    takeoff_time_s: float,
) -> ClairvoyantResult:
    """Integrate the mission from take-off at `takeoff_time_s`, with the best return route."""
    integrator = _FlightIntegrator(
        conditions.flight, battery, conditions.wind_at, takeoff_time_s, conditions.payload_kg
    )
    if not _integrate_flight_to_drop(mission_profile, integrator):
        left_wh = integrator.battery.usable_wh(conditions.reference_draw_w) - conditions.reserve_wh
        return ClairvoyantResult(False, left_wh)
    ends = [
        _integrate_return_and_landing(
            mission_profile,
            route,
            conditions,
            replace(integrator, battery=copy.deepcopy(integrator.battery)),
        )
        for route in mission_profile.return_routes
    ]
    return max(ends, key=lambda end: (end.home, end.margin_wh))


def _integrate_flight_to_drop(
    mission_profile: MissionProfile, integrator: _FlightIntegrator
) -> bool:
    """Fly from take-off to the drop; return False if the customer is not reached."""
    integrator.integrate_height_change(mission_profile.cruise_height_m, mission_profile.takeoff_mps)
    integrator.integrate_hover(mission_profile.settle_s)
    if not _integrate_path_at_best_speeds(
        integrator, mission_profile.out_ne_m, mission_profile.speeds
    ):
        return False
    integrator.integrate_height_change(mission_profile.drop_up_m, mission_profile.descent_mps)
    integrator.integrate_hover(mission_profile.hover_s)
    integrator.payload_kg = 0.0
    integrator.integrate_height_change(mission_profile.return_height_m, mission_profile.climb_mps)
    return not integrator.battery.cut_off


def _integrate_return_and_landing(
    mission_profile: MissionProfile,
    route: ReturnRoute,
    conditions: TrueConditions,
    integrator: _FlightIntegrator,
) -> ClairvoyantResult:
    flown = _integrate_path_at_best_speeds(integrator, route.path_ne_m, mission_profile.speeds)
    slow_from_m = min(
        route.ground_up_m + mission_profile.slow_below_m, mission_profile.return_height_m
    )
    integrator.integrate_height_change(slow_from_m, mission_profile.descent_mps)
    integrator.integrate_height_change(route.ground_up_m, mission_profile.landing_mps)
    margin_wh = integrator.battery.usable_wh(conditions.reference_draw_w) - conditions.reserve_wh
    home = flown and not integrator.battery.cut_off and margin_wh >= 0.0
    return ClairvoyantResult(home, margin_wh)


def _integrate_path_at_best_speeds(
    integrator: _FlightIntegrator, path_ne_m: list[PointNe], speeds: SpeedLimits
) -> bool:
    leg_list = list(itertools.pairwise(path_ne_m))
    return all(
        integrator.integrate_leg_at_best_speed(
            a, b, speeds, from_rest=k == 0, to_rest=k == len(leg_list) - 1
        )
        for k, (a, b) in enumerate(leg_list)
    )
