"""Energy and time of the remaining legs in many winds, down to the landed vehicle.

A leg is the motion that one mission item commands (safety rules 4 and 6). In AUTO an autopilot
holds a GROUND speed until its tilt saturates. So the companion commands, for each leg, the ground
speed that the wind triangle gives for the speed to fly. A leg without a further command keeps the
last ground speed. Winds are (K, 2) or (K, legs, 2): north and east, direction the air moves to.
Energies are in Wh.
"""

import math
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Protocol

import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.base.geo import Ned, course_rad, horizontal_distance_m, wrap_pi
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import GRAVITY_MPS2, measured_over_modelled_power
from companion.core.vehicle.speed_to_fly import (
    CruiseTable,
    SpeedRule,
    SteadyPower,
    fastest_planning_airspeed_mps,
    slowest_airspeed_of_rule_mps,
)

_CostArrays = tuple[Floats, Floats, Bools]

LEAST_GROUND_SPEED_MPS = 0.5  # a slower leg is infeasible and costs what it costs at this speed
TOUCHDOWN_S = 4.0  # landing detected and motors stopped, at hover power
MIN_LEG_M = 1.0  # a climb or a cruise shorter than this is not flown
SLOPE_FRAC = 0.8
"""Fraction of the climb or descent rate that a sloping leg uses. The rest covers the second until
the climb begins, so that the vehicle is at its height where the leg ends.
"""
_MIN_SLOPE_HEIGHT_M = (
    3.0  # a smaller change of height takes a second or two and does not slow a leg
)
_WIND_STEP_MPS = 0.25  # for gradients
_LIMIT_STEP_LOG = math.log(1.05)
_MAX_CACHED_TABLES = 64  # cached cruise tables, 0.1 MB each; the oldest is evicted


class LegKind(Enum):
    """Manoeuvre of one leg."""

    CLIMB = "climb"  # vertical climb (take-off included)
    CRUISE = "cruise"  # straight line; climbs or sinks along it where heights differ
    DESCEND = "descend"  # vertical descent without landing
    HOVER = "hover"  # holds position for `duration_s`: wind measurement, drop, loiter
    LAND = "land"  # descends and touches down; ends with motors off


@dataclass(frozen=True, slots=True)
class Leg:
    """One leg of a route. With `ground_speed_to_command_mps` None the companion commands the ground
    speed of the speed to fly, whose airspeed is at least `airspeed_mps` (None: that of the speed
    rule). A number is the ground speed that the autopilot keeps without a further command.
    """

    kind: LegKind
    from_ned_m: Ned
    to_ned_m: Ned
    payload_kg: float
    duration_s: float = 0.0
    airspeed_mps: float | None = None
    ground_speed_mps: float | None = None


def cruise_leg_unless_too_short(a: Ned, b: Ned, payload_kg: float) -> tuple[Leg, ...]:
    """Return the cruise leg between two points; empty where they are within `MIN_LEG_M`."""
    if horizontal_distance_m(a, b) <= MIN_LEG_M:
        return ()
    return (Leg(LegKind.CRUISE, a, b, payload_kg),)


@dataclass(frozen=True, slots=True)
class LegCosts:
    """Energy (Wh) and time (s) of legs under K winds, each (K, legs); `feasible` likewise.

    A leg slower over the ground than LEAST_GROUND_SPEED_MPS costs what it does at that speed, so
    that costs stay finite and rise with the wind.
    """

    energy_wh: Floats
    time_s: Floats
    feasible: Bools


@dataclass(frozen=True, slots=True)
class _LegGroup:
    """Legs with the same cost formula: indices into the route, and geometry as (legs, 1)."""

    index: Ints
    payload_kg: float
    cruise: bool
    climbing: bool
    sinking: bool
    airspeed_mps: float | None
    ground_speed_mps: float | None
    north: Floats
    east: Floats
    length_m: Floats
    climb_m: Floats
    vertical_s: Floats
    stops: Floats
    duration_s: Floats


@dataclass(frozen=True, slots=True)
class LegBatch:
    """Legs grouped by `RouteEnergy.group_legs_by_cost_formula` for evaluation under many winds."""

    count: int
    groups: tuple[_LegGroup, ...]


class SpeedSettings(Protocol):
    """Speeds configured by the operator, as in the `[mission]` table of a flight file."""

    @property
    def cruise_airspeed_mps(self) -> float | None:
        """Cruise airspeed; None selects the airframe's."""
        ...

    @property
    def speed_rule(self) -> SpeedRule:
        """Rule that selects the airspeed of each leg."""
        ...


class RouteEnergy:
    """Energy model of an airframe's legs, from tables built once per payload. Planner, gate and
    dispatcher share it.

    `density_kgpm3` is the air density of all costs: set by the constructor, and by
    `set_air_density_and_clear_cached_tables` once the flight has measured it.
    """

    def __init__(
        self,
        airframe: Airframe,
        density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
        cruise_airspeed_mps: float | None = None,
        speed_rule: SpeedRule = "least_energy",
        *,
        fixed_airspeed: bool = False,
    ) -> None:
        """`fixed_airspeed`: cruise at the rule's slowest airspeed in any wind, never faster."""
        self.airframe = airframe
        self.cruise_airspeed_mps = cruise_airspeed_mps or airframe.speeds.cruise_airspeed_mps
        self.speed_rule: SpeedRule = speed_rule
        self.slowest_airspeed_mps = slowest_airspeed_of_rule_mps(
            speed_rule, self.cruise_airspeed_mps
        )
        self.density_kgpm3 = density_kgpm3
        self.power_limit_w = math.inf
        self._fixed_airspeed = fixed_airspeed
        self._sinking_frac = float(
            measured_over_modelled_power(airframe, -1.0)
            / measured_over_modelled_power(airframe, 0.0)
        )
        self._power: dict[int, SteadyPower] = {}
        self._cruise: dict[tuple[int, bool, float], CruiseTable] = {}

    @classmethod
    def for_mission(
        cls, airframe: Airframe, mission: SpeedSettings, density_kgpm3: float
    ) -> "RouteEnergy":
        """Return a model with the operator's speeds at the air density of the site."""
        cruise = mission.cruise_airspeed_mps
        return cls(airframe, density_kgpm3, cruise, mission.speed_rule)

    def set_air_density_and_clear_cached_tables(self, density_kgpm3: float) -> None:
        """Set the air density of all later costs. Call it on the ground, before planning."""
        self.density_kgpm3 = density_kgpm3
        self._power.clear()
        self._cruise.clear()

    def set_power_limit_w(self, limit_w: float, payload_kg: float) -> None:
        """Limit the power of chosen airspeeds, in steps of 5 %; no limit where none binds."""
        top_mps = self.level_airspeed_at_max_tilt_mps(payload_kg)
        binds = limit_w < self.steady_flight_power_w(payload_kg, top_mps)
        steps = math.floor(math.log(max(limit_w, 1.0)) / _LIMIT_STEP_LOG) if binds else 0
        stepped_w = math.exp(steps * _LIMIT_STEP_LOG) if binds else math.inf
        if stepped_w != self.power_limit_w:
            self.power_limit_w = stepped_w
            self.set_air_density_and_clear_cached_tables(self.density_kgpm3)

    def overload_reason_or_empty(self, payload_kg: float) -> str:
        """Return the reason that the parcel is too heavy in this air; `""` if it is not."""
        return self.airframe.overload_reason_or_empty(payload_kg, self.density_kgpm3)

    def fastest_planning_airspeed_mps(self, payload_kg: float) -> float:
        """Return the fastest airspeed used for planning in this air."""
        return fastest_planning_airspeed_mps(self.airframe, payload_kg, self.density_kgpm3)

    def group_legs_by_cost_formula(
        self, leg_sequence: tuple[Leg, ...], preceding_legs: tuple[Leg | None, ...] | None = None
    ) -> LegBatch:
        """Group legs with the same cost formula.

        `preceding_legs` holds the preceding leg of each leg or None, and gives the time lost to
        stopping, starting and turning. By default each leg follows the one before it where they
        join.
        """
        if preceding_legs is None:
            preceding_legs = (None, *leg_sequence[:-1])
        members: dict[tuple[object, ...], list[int]] = {}
        for index, leg in enumerate(leg_sequence):
            cruise = leg.kind is LegKind.CRUISE
            speeds = (leg.airspeed_mps, leg.ground_speed_mps) if cruise else (None, None)
            sinking = leg.kind in (LegKind.DESCEND, LegKind.LAND)
            key = (cruise, leg.kind is LegKind.CLIMB, sinking, leg.payload_kg, *speeds)
            members.setdefault(key, []).append(index)
        stops = [
            _junction_time_loss_factor(b, leg)
            for b, leg in zip(preceding_legs, leg_sequence, strict=True)
        ]
        groups = tuple(
            self._build_leg_group(leg_sequence, stops, indices) for indices in members.values()
        )
        return LegBatch(len(leg_sequence), groups)

    def build_level_cruise_batch(
        self, course_rad: Floats, length_m: Floats, payload_kg: float
    ) -> LegBatch:
        """Return level cruise legs of these courses and lengths (n,), without turns between."""
        zero = np.zeros((len(course_rad), 1))
        group = _LegGroup(
            index=np.arange(len(course_rad)),
            payload_kg=payload_kg,
            cruise=True,
            climbing=False,
            sinking=False,
            airspeed_mps=None,
            ground_speed_mps=None,
            north=np.cos(course_rad)[:, None],
            east=np.sin(course_rad)[:, None],
            length_m=length_m[:, None],
            climb_m=zero,
            vertical_s=zero,
            stops=zero,
            duration_s=zero,
        )
        return LegBatch(len(course_rad), (group,))

    def _build_leg_group(
        self, leg_sequence: tuple[Leg, ...], stop_factors: list[float], leg_indices: list[int]
    ) -> _LegGroup:
        selected = [leg_sequence[i] for i in leg_indices]
        first = selected[0]
        courses = _to_column_array([course_rad(leg.from_ned_m, leg.to_ned_m) for leg in selected])
        cruise = first.kind is LegKind.CRUISE
        return _LegGroup(
            index=np.array(leg_indices),
            payload_kg=first.payload_kg,
            cruise=cruise,
            climbing=first.kind is LegKind.CLIMB,
            sinking=first.kind in (LegKind.DESCEND, LegKind.LAND),
            airspeed_mps=first.airspeed_mps if cruise else None,
            ground_speed_mps=first.ground_speed_mps if cruise else None,
            north=np.cos(courses),
            east=np.sin(courses),
            length_m=_to_column_array(
                [horizontal_distance_m(leg.from_ned_m, leg.to_ned_m) for leg in selected]
            ),
            climb_m=_to_column_array(
                [max(leg.from_ned_m[2] - leg.to_ned_m[2], 0.0) for leg in selected]
            ),
            vertical_s=_to_column_array(
                [self._min_height_change_duration_s(leg) for leg in selected]
            ),
            stops=_to_column_array([stop_factors[i] for i in leg_indices]),
            duration_s=_to_column_array(
                [
                    0.0
                    if cruise
                    else self._leg_duration_with_stops_s(leg_sequence[i], stop_factors[i])
                    for i in leg_indices
                ]
            ),
        )

    def _leg_duration_with_stops_s(self, leg: Leg, stop_factor: float) -> float:
        speeds = self.airframe.speeds
        stopping_s = stop_factor * self.cruise_airspeed_mps / speeds.accel_mps2
        return stopping_s + self._vertical_or_hover_duration_s(leg)

    def _min_height_change_duration_s(self, leg: Leg) -> float:
        """Return the minimum duration (s) of a cruise leg that changes height.

        ArduCopter and PX4 up to 1.17 slow down for it; for PX4 1.18 the companion does.
        """
        speeds, up_m = self.airframe.speeds, leg.from_ned_m[2] - leg.to_ned_m[2]
        least_s = max(up_m / speeds.climb_mps, -up_m / speeds.descent_mps)
        return least_s / SLOPE_FRAC if abs(up_m) > _MIN_SLOPE_HEIGHT_M else least_s

    def _vertical_or_hover_duration_s(self, leg: Leg) -> float:
        speeds = self.airframe.speeds
        height_m = abs(leg.to_ned_m[2] - leg.from_ned_m[2])
        if leg.kind is LegKind.CLIMB:
            return height_m / speeds.climb_mps + leg.duration_s
        if leg.kind is LegKind.DESCEND:
            return height_m / speeds.descent_mps + leg.duration_s
        if leg.kind is LegKind.LAND:
            slow_m = min(height_m, speeds.land_slow_height_m)
            fast_m = height_m - slow_m
            return fast_m / speeds.descent_mps + slow_m / speeds.landing_mps + TOUCHDOWN_S
        return leg.duration_s

    def leg_costs_wind_major(
        self, leg_sequence: tuple[Leg, ...] | LegBatch, wind_to_ne_mps: Floats
    ) -> LegCosts:
        """Return the cost of each leg under each wind."""
        compiled = (
            leg_sequence
            if isinstance(leg_sequence, LegBatch)
            else self.group_legs_by_cost_formula(leg_sequence)
        )
        wind = wind_to_ne_mps[:, None, :] if wind_to_ne_mps.ndim == 2 else wind_to_ne_mps
        by_leg = self.leg_costs_leg_major(compiled, wind[..., 0].T, wind[..., 1].T)
        return LegCosts(by_leg.energy_wh.T, by_leg.time_s.T, by_leg.feasible.T)

    def leg_costs_leg_major(
        self, leg_batch: LegBatch, wind_n_mps: Floats, wind_e_mps: Floats
    ) -> LegCosts:
        """Return costs (legs, K) for winds (legs or 1, K); `leg_costs_wind_major` is slower."""
        shape = (leg_batch.count, wind_n_mps.shape[1])
        energy, time, feasible = np.empty(shape), np.empty(shape), np.empty(shape, np.bool_)
        for group in leg_batch.groups:
            at = group.index
            each = wind_n_mps.shape[0] > 1
            north, east = (w[at] if each else w for w in (wind_n_mps, wind_e_mps))
            price = self._cruise_leg_costs if group.cruise else self._vertical_or_hover_costs
            energy[at], time[at], feasible[at] = price(group, north, east)
        return LegCosts(energy, time, feasible)

    def _cruise_leg_costs(
        self, group: _LegGroup, wind_n_mps: Floats, wind_e_mps: Floats
    ) -> _CostArrays:
        ground, draw = self._cached_cruise_table(group).interpolate_ground_speed_and_power(
            *_tailwind_and_crosswind_mps(group, wind_n_mps, wind_e_mps)
        )
        feasible = ground >= LEAST_GROUND_SPEED_MPS
        np.maximum(ground, LEAST_GROUND_SPEED_MPS, out=ground)
        time = np.maximum(group.length_m / ground, group.vertical_s)
        time += ground * (group.stops / self.airframe.speeds.accel_mps2)
        draw *= time
        weight_n = self.airframe.flying_mass_kg(group.payload_kg) * GRAVITY_MPS2
        draw += weight_n * group.climb_m / self.airframe.power_rotor.drive_efficiency
        draw /= 3600.0
        return draw, time, feasible

    def _vertical_or_hover_costs(
        self, group: _LegGroup, wind_n_mps: Floats, wind_e_mps: Floats
    ) -> _CostArrays:
        power = self._cached_steady_power(group.payload_kg)
        speed = np.hypot(wind_n_mps, wind_e_mps)
        draw = power.climb_power_w(speed) if group.climbing else power.level_flight_power_w(speed)
        if group.sinking:
            draw = draw * self._sinking_frac
        energy = draw * (group.duration_s / 3600.0)
        return energy, group.duration_s, speed <= power.max_airspeed_mps

    def leg_energy_gradients_wh_per_mps(
        self, leg_sequence: tuple[Leg, ...] | LegBatch, wind_to_ne_mps: Floats
    ) -> Floats:
        """Return dE/dw of each leg, (legs, 2), at one wind (2,), by central differences."""
        steps = _WIND_STEP_MPS * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        energy = self.leg_costs_wind_major(leg_sequence, wind_to_ne_mps[None, :] + steps).energy_wh
        return (energy[[0, 2]] - energy[[1, 3]]).T / (2.0 * _WIND_STEP_MPS)

    def route_energy_std_wh(
        self,
        leg_sequence: tuple[Leg, ...] | LegBatch,
        wind_to_ne_mps: Floats,
        cov_ne_m2ps2: Floats,
    ) -> float:
        """Return `|sum_e dE_e/dw|_Sigma`: one wind error affects all legs, so gradients add."""
        gradient = self.leg_energy_gradients_wh_per_mps(leg_sequence, wind_to_ne_mps).sum(axis=0)
        return math.sqrt(max(float(gradient @ cov_ne_m2ps2 @ gradient), 0.0))

    def ground_speed_to_command_mps(self, leg: Leg, wind_to_ne_mps: Floats) -> float:
        """Return the ground speed to command on a cruise leg (DO_CHANGE_SPEED).

        Follows from the wind triangle; lower where the leg needs more time to climb or descend.
        """
        if leg.ground_speed_mps is not None:
            return leg.ground_speed_mps
        group = self.group_legs_by_cost_formula((leg,)).groups[0]
        tailwind, crosswind = _tailwind_and_crosswind_mps(
            group, wind_to_ne_mps[:1, None], wind_to_ne_mps[1:, None]
        )
        ground, _ = self._cached_cruise_table(group).interpolate_ground_speed_and_power(
            tailwind, crosswind
        )
        target_mps = float(ground[0, 0])
        if abs(leg.from_ned_m[2] - leg.to_ned_m[2]) > _MIN_SLOPE_HEIGHT_M:
            length_m = horizontal_distance_m(leg.from_ned_m, leg.to_ned_m)
            target_mps = min(target_mps, length_m / self._min_height_change_duration_s(leg))
        return max(target_mps, LEAST_GROUND_SPEED_MPS)

    def level_airspeed_at_max_tilt_mps(self, payload_kg: float) -> float:
        """Return the level airspeed at maximum tilt."""
        return self._cached_steady_power(payload_kg).max_airspeed_mps

    def steady_flight_power_w(
        self, payload_kg: float, airspeed_mps: float, climb_mps: float = 0.0
    ) -> float:
        """Return electrical power in steady flight (the ledger's modelled power)."""
        power = self._cached_steady_power(payload_kg)
        speed = np.array([airspeed_mps])
        level = float(power.level_flight_power_w(speed)[0])
        share = min(max(climb_mps / self.airframe.speeds.climb_mps, 0.0), 2.0)
        if share == 0.0:
            return level
        return level + share * (float(power.climb_power_w(speed)[0]) - level)

    def hover_power_w(self, payload_kg: float) -> float:
        """Return electrical power in still-air hover. A drop reduces it."""
        return self.steady_flight_power_w(payload_kg, 0.0)

    def cruise_climb_power_w(self, payload_kg: float) -> float:
        """Return electrical power in a climb at the cruise airspeed."""
        climb_mps = self.airframe.speeds.climb_mps
        return self.steady_flight_power_w(payload_kg, self.cruise_airspeed_mps, climb_mps)

    def _cached_steady_power(self, payload_kg: float) -> SteadyPower:
        key = round(payload_kg * 1000.0)
        if key not in self._power:
            self._power[key] = SteadyPower(
                self.airframe, key / 1000.0, self.density_kgpm3, self.power_limit_w
            )
        return self._power[key]

    def _cached_cruise_table(self, group: _LegGroup) -> CruiseTable:
        fixed, least = group.ground_speed_mps, group.airspeed_mps or self.slowest_airspeed_mps
        speed = least if fixed is None else fixed
        key = (round(group.payload_kg * 1000.0), fixed is None, round(speed, 1))
        if key not in self._cruise:
            if len(self._cruise) >= _MAX_CACHED_TABLES:
                self._cruise.pop(next(iter(self._cruise)))
            power = self._cached_steady_power(group.payload_kg)
            cruise = (
                power.achieved_speeds_for_airspeed_mps
                if self._fixed_airspeed
                else power.achieved_speeds_of_least_energy_mps
            )
            fly = cruise if fixed is None else power.achieved_speeds_for_ground_speed_mps
            self._cruise[key] = CruiseTable(power, partial(fly, key[2]))
        return self._cruise[key]


def _tailwind_and_crosswind_mps(
    group: _LegGroup, wind_n_mps: Floats, wind_e_mps: Floats
) -> tuple[Floats, Floats]:
    tailwind = wind_n_mps * group.north + wind_e_mps * group.east
    return tailwind, wind_e_mps * group.north - wind_n_mps * group.east


def _to_column_array(values: list[float]) -> Floats:
    return np.array(values)[:, None]


def _junction_time_loss_factor(preceding_leg: Leg | None, following_leg: Leg) -> float:
    """Return the time lost where two legs meet, in units of speed / acceleration.

    0.5 to reach a speed or to stop; in a turn, half of the velocity fraction that is lost.
    """
    if preceding_leg is None or preceding_leg.to_ned_m != following_leg.from_ned_m:
        return 0.0
    moving, moves = preceding_leg.kind is LegKind.CRUISE, following_leg.kind is LegKind.CRUISE
    if moving and moves:
        before_rad = course_rad(preceding_leg.from_ned_m, preceding_leg.to_ned_m)
        turn_rad = wrap_pi(
            course_rad(following_leg.from_ned_m, following_leg.to_ned_m) - before_rad
        )
        return 0.5 * (1.0 - math.cos(turn_rad))
    return 0.5 if moving or moves else 0.0
