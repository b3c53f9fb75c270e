"""Energy and time of the remaining legs in many winds, down to the landed vehicle.

A leg is what one mission item makes the autopilot do (safety rules 4 and 6). In AUTO an autopilot
flies a GROUND speed until its tilt saturates. So the companion commands, for each leg, the ground
speed that the wind triangle gives for the speed to fly. A leg that gets no further command keeps
the last ground speed. Winds are (K, 2) or (K, legs, 2): north and east, where the air moves to.
Energies are in Wh.
"""

import math
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Protocol

import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.base.geo import Ned, course_rad, horizontal_m, wrap_pi
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import GRAVITY_MPS2, flown_frac
from companion.core.vehicle.speed_to_fly import (
    CruiseTable,
    SpeedRule,
    SteadyPower,
    fastest_airspeed_mps,
    slowest_airspeed_mps,
)

_Priced = tuple[Floats, Floats, Bools]

LEAST_GROUND_SPEED_MPS = 0.5  # slower is no way made: priced at this speed, and called infeasible
TOUCHDOWN_S = 4.0  # landing detected and motors stopped, at hover power
OVER_M = 1.0  # a climb or a cruise shorter than this is not flown
SLOPE_FRAC = 0.8
"""Of its climb or descent rate that a sloping leg asks for: beginning to climb takes a second, too,
and the vehicle is to be in height where the leg ends.
"""
_SLOPE_FROM_M = 3.0  # a smaller change of height is done within a second or two, and slows no leg
_WIND_STEP_MPS = 0.25  # for gradients
_TABLES = 64  # cruise tables kept, of 0.1 MB each; the oldest goes


class LegKind(Enum):
    """What the vehicle does on a leg."""

    CLIMB = "climb"  # straight up over a point (take-off too)
    CRUISE = "cruise"  # along a straight line; climbs or sinks on it where heights differ
    DESCEND = "descend"  # straight down, still flying
    HOVER = "hover"  # waits `duration_s`: settle, drop, loiter
    LAND = "land"  # descends and touches down; ends with motors off


@dataclass(frozen=True, slots=True)
class Leg:
    """One leg. `ground_speed_mps` None: the companion commands the wind triangle's speed for the
    speed to fly, at least `airspeed_mps` (None: the rule's); a number: that ground speed, no
    further command arrives.
    """

    kind: LegKind
    from_ned_m: Ned
    to_ned_m: Ned
    payload_kg: float
    duration_s: float = 0.0
    airspeed_mps: float | None = None
    ground_speed_mps: float | None = None


def cruise_legs(a: Ned, b: Ned, payload_kg: float) -> tuple[Leg, ...]:
    """The cruise between two points; none where they are nearer than `OVER_M`."""
    if horizontal_m(a, b) <= OVER_M:
        return ()
    return (Leg(LegKind.CRUISE, a, b, payload_kg),)


@dataclass(frozen=True, slots=True)
class LegCosts:
    """Energy (Wh) and time (s) of legs under K winds, each (K, legs); `feasible` likewise.

    A leg on which no way is made over the ground costs what it would at LEAST_GROUND_SPEED_MPS,
    so that costs stay finite and rise with the wind.
    """

    energy_wh: Floats
    time_s: Floats
    feasible: Bools


@dataclass(frozen=True, slots=True)
class _Group:
    """Legs that are priced alike: indices into the route, and their geometry as (legs, 1)."""

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
class CompiledLegs:
    """Legs made ready for many winds by `RouteEnergy.compile`."""

    count: int
    groups: tuple[_Group, ...]


class SpeedChoice(Protocol):
    """The speeds that an operator asks for; a flight file's `[mission]` table has them."""

    @property
    def cruise_airspeed_mps(self) -> float | None:
        """The cruise airspeed; None: the airframe's."""
        ...

    @property
    def speed_rule(self) -> SpeedRule:
        """How the airspeed of each leg is chosen."""
        ...


class RouteEnergy:
    """The airframe's leg costs from tables built once per payload; the one model that planner,
    gate and dispatcher share.

    `density_kgpm3` of the air that it prices in: whoever makes it says so, or a flight once it
    knows (`fly_in`).
    """

    def __init__(
        self,
        airframe: Airframe,
        density_kgpm3: float = REFERENCE_DENSITY_KGPM3,
        cruise_airspeed_mps: float | None = None,
        speed_rule: SpeedRule = "least_energy",
        *,
        holds_airspeed: bool = False,
    ) -> None:
        """`holds_airspeed`: cruises at the rule's slowest airspeed in any wind, never faster."""
        self.airframe = airframe
        self.cruise_airspeed_mps = cruise_airspeed_mps or airframe.speeds.cruise_airspeed_mps
        self.speed_rule: SpeedRule = speed_rule
        self.slowest_airspeed_mps = slowest_airspeed_mps(speed_rule, self.cruise_airspeed_mps)
        self.density_kgpm3 = density_kgpm3
        self._holds_airspeed = holds_airspeed
        self._sinking_frac = float(flown_frac(airframe, -1.0) / flown_frac(airframe, 0.0))
        self._power: dict[int, SteadyPower] = {}
        self._cruise: dict[tuple[int, bool, float], CruiseTable] = {}

    @classmethod
    def for_mission(
        cls, airframe: Airframe, mission: SpeedChoice, density_kgpm3: float
    ) -> "RouteEnergy":
        """With the speeds that the operator asks for, in the air of the site."""
        cruise = mission.cruise_airspeed_mps
        return cls(airframe, density_kgpm3, cruise, mission.speed_rule)

    def fly_in(self, density_kgpm3: float) -> None:
        """Price in this air from now on; for a vehicle that stands, before it has a plan."""
        self.density_kgpm3 = density_kgpm3
        self._power.clear()
        self._cruise.clear()

    def lift_trouble(self, payload_kg: float) -> str:
        """Say why this parcel cannot be carried in this air; `""` where it can."""
        return self.airframe.lift_trouble(payload_kg, self.density_kgpm3)

    def fastest_airspeed_mps(self, payload_kg: float) -> float:
        """The fastest airspeed that is planned with in this air."""
        return fastest_airspeed_mps(self.airframe, payload_kg, self.density_kgpm3)

    def compile(
        self, legs: tuple[Leg, ...], before: tuple[Leg | None, ...] | None = None
    ) -> CompiledLegs:
        """Group legs that are priced alike.

        `before` is the leg flown just before each one, None for none; without it, legs follow one
        another where they join. It tells the time lost to stopping, starting and turning.
        """
        if before is None:
            before = (None, *legs[:-1])
        members: dict[tuple[object, ...], list[int]] = {}
        for index, leg in enumerate(legs):
            cruise = leg.kind is LegKind.CRUISE
            speeds = (leg.airspeed_mps, leg.ground_speed_mps) if cruise else (None, None)
            sinking = leg.kind in (LegKind.DESCEND, LegKind.LAND)
            key = (cruise, leg.kind is LegKind.CLIMB, sinking, leg.payload_kg, *speeds)
            members.setdefault(key, []).append(index)
        stops = [_stop(b, leg) for b, leg in zip(before, legs, strict=True)]
        groups = tuple(self._group(legs, stops, indices) for indices in members.values())
        return CompiledLegs(len(legs), groups)

    def compile_level(
        self, course_rad: Floats, length_m: Floats, payload_kg: float
    ) -> CompiledLegs:
        """Level cruise legs of these courses and lengths (n,), none of which follows another."""
        zero = np.zeros((len(course_rad), 1))
        group = _Group(
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
        return CompiledLegs(len(course_rad), (group,))

    def _group(self, legs: tuple[Leg, ...], stops: list[float], indices: list[int]) -> _Group:
        chosen = [legs[i] for i in indices]
        first = chosen[0]
        courses = _column([course_rad(leg.from_ned_m, leg.to_ned_m) for leg in chosen])
        cruise = first.kind is LegKind.CRUISE
        return _Group(
            index=np.array(indices),
            payload_kg=first.payload_kg,
            cruise=cruise,
            climbing=first.kind is LegKind.CLIMB,
            sinking=first.kind in (LegKind.DESCEND, LegKind.LAND),
            airspeed_mps=first.airspeed_mps if cruise else None,
            ground_speed_mps=first.ground_speed_mps if cruise else None,
            north=np.cos(courses),
            east=np.sin(courses),
            length_m=_column([horizontal_m(leg.from_ned_m, leg.to_ned_m) for leg in chosen]),
            climb_m=_column([max(leg.from_ned_m[2] - leg.to_ned_m[2], 0.0) for leg in chosen]),
            vertical_s=_column([self._rise_or_sink_s(leg) for leg in chosen]),
            stops=_column([stops[i] for i in indices]),
            duration_s=_column(
                [0.0 if cruise else self._duration_s(legs[i], stops[i]) for i in indices]
            ),
        )

    def _duration_s(self, leg: Leg, stop: float) -> float:
        speeds = self.airframe.speeds
        stopping_s = stop * self.cruise_airspeed_mps / speeds.accel_mps2
        return stopping_s + self._vertical_s(leg)

    def _rise_or_sink_s(self, leg: Leg) -> float:
        """What a change of height takes on a cruise leg.

        ArduCopter and PX4 up to 1.17 slow down for it, 1.18 does not: there the companion does.
        """
        speeds, up_m = self.airframe.speeds, leg.from_ned_m[2] - leg.to_ned_m[2]
        least_s = max(up_m / speeds.climb_mps, -up_m / speeds.descent_mps)
        return least_s / SLOPE_FRAC if abs(up_m) > _SLOPE_FROM_M else least_s

    def _vertical_s(self, leg: Leg) -> float:
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

    def costs(self, legs: tuple[Leg, ...] | CompiledLegs, wind_to_ne_mps: Floats) -> LegCosts:
        """Cost of each leg under each wind."""
        compiled = legs if isinstance(legs, CompiledLegs) else self.compile(legs)
        wind = wind_to_ne_mps[:, None, :] if wind_to_ne_mps.ndim == 2 else wind_to_ne_mps
        by_leg = self.costs_by_leg(compiled, wind[..., 0].T, wind[..., 1].T)
        return LegCosts(by_leg.energy_wh.T, by_leg.time_s.T, by_leg.feasible.T)

    def costs_by_leg(
        self, compiled: CompiledLegs, wind_n_mps: Floats, wind_e_mps: Floats
    ) -> LegCosts:
        """The same for winds (legs or 1, K), with costs (legs, K): quicker for many winds."""
        shape = (compiled.count, wind_n_mps.shape[1])
        energy, time, feasible = np.empty(shape), np.empty(shape), np.empty(shape, np.bool_)
        for group in compiled.groups:
            at = group.index
            each = wind_n_mps.shape[0] > 1
            north, east = (w[at] if each else w for w in (wind_n_mps, wind_e_mps))
            price = self._price_cruise if group.cruise else self._price_wait
            energy[at], time[at], feasible[at] = price(group, north, east)
        return LegCosts(energy, time, feasible)

    def _price_cruise(self, group: _Group, north: Floats, east: Floats) -> _Priced:
        ground, draw = self._cruise_table(group).look_up(*_along_across(group, north, east))
        feasible = ground >= LEAST_GROUND_SPEED_MPS
        np.maximum(ground, LEAST_GROUND_SPEED_MPS, out=ground)
        time = np.maximum(group.length_m / ground, group.vertical_s)
        time += ground * (group.stops / self.airframe.speeds.accel_mps2)
        draw *= time
        draw += self._climb_j(group)
        draw /= 3600.0
        return draw, time, feasible

    def _climb_j(self, group: _Group) -> Floats:
        weight_n = self.airframe.mass_kg(group.payload_kg) * GRAVITY_MPS2
        return weight_n * group.climb_m / self.airframe.power_rotor.drive_efficiency

    def _price_wait(self, group: _Group, north: Floats, east: Floats) -> _Priced:
        power = self._steady_power(group.payload_kg)
        speed = np.hypot(north, east)
        draw = power.climb_w(speed) if group.climbing else power.level_w(speed)
        if group.sinking:
            draw = draw * self._sinking_frac
        energy = draw * (group.duration_s / 3600.0)
        return energy, group.duration_s, speed <= power.max_airspeed_mps

    def gradient_wh_per_mps(
        self, legs: tuple[Leg, ...] | CompiledLegs, wind_to_ne_mps: Floats
    ) -> Floats:
        """dE/dw of each leg, (legs, 2), about one wind (2,), by central differences."""
        steps = _WIND_STEP_MPS * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        energy = self.costs(legs, wind_to_ne_mps[None, :] + steps).energy_wh
        return (energy[[0, 2]] - energy[[1, 3]]).T / (2.0 * _WIND_STEP_MPS)

    def route_std_wh(
        self,
        legs: tuple[Leg, ...] | CompiledLegs,
        wind_to_ne_mps: Floats,
        cov_ne_m2ps2: Floats,
    ) -> float:
        """`|sum_e dE_e/dw|_Sigma`: one wind error moves every leg, so gradients add."""
        gradient = self.gradient_wh_per_mps(legs, wind_to_ne_mps).sum(axis=0)
        return math.sqrt(max(float(gradient @ cov_ne_m2ps2 @ gradient), 0.0))

    def ground_speed_mps(self, leg: Leg, wind_to_ne_mps: Floats) -> float:
        """What to command on a cruise leg (DO_CHANGE_SPEED): the wind triangle's ground speed.

        Slower where the leg climbs or sinks so much that its end would be reached out of height.
        """
        if leg.ground_speed_mps is not None:
            return leg.ground_speed_mps
        group = self.compile((leg,)).groups[0]
        along, across = _along_across(group, wind_to_ne_mps[:1, None], wind_to_ne_mps[1:, None])
        ground, _ = self._cruise_table(group).look_up(along, across)
        wanted_mps = float(ground[0, 0])
        if abs(leg.from_ned_m[2] - leg.to_ned_m[2]) > _SLOPE_FROM_M:
            length_m = horizontal_m(leg.from_ned_m, leg.to_ned_m)
            wanted_mps = min(wanted_mps, length_m / self._rise_or_sink_s(leg))
        return max(wanted_mps, LEAST_GROUND_SPEED_MPS)

    def max_airspeed_mps(self, payload_kg: float) -> float:
        """Level airspeed at the largest tilt."""
        return self._steady_power(payload_kg).max_airspeed_mps

    def power_w(self, payload_kg: float, airspeed_mps: float, climb_mps: float = 0.0) -> float:
        """Electrical power in steady flight (the ledger's modelled power)."""
        power = self._steady_power(payload_kg)
        speed = np.array([airspeed_mps])
        level = float(power.level_w(speed)[0])
        share = min(max(climb_mps / self.airframe.speeds.climb_mps, 0.0), 2.0)
        if share == 0.0:
            return level
        return level + share * (float(power.climb_w(speed)[0]) - level)

    def hover_power_w(self, payload_kg: float) -> float:
        """Electrical power in still-air hover; a drop shows as a fall of it."""
        return self.power_w(payload_kg, 0.0)

    def _steady_power(self, payload_kg: float) -> SteadyPower:
        key = round(payload_kg * 1000.0)
        if key not in self._power:
            self._power[key] = SteadyPower(self.airframe, key / 1000.0, self.density_kgpm3)
        return self._power[key]

    def _cruise_table(self, group: _Group) -> CruiseTable:
        fixed, least = group.ground_speed_mps, group.airspeed_mps or self.slowest_airspeed_mps
        speed = least if fixed is None else fixed
        key = (round(group.payload_kg * 1000.0), fixed is None, round(speed, 1))
        if key not in self._cruise:
            if len(self._cruise) >= _TABLES:
                self._cruise.pop(next(iter(self._cruise)))
            power = self._steady_power(group.payload_kg)
            cruise = power.fly_airspeed if self._holds_airspeed else power.fly_least_energy
            fly = cruise if fixed is None else power.fly_ground_speed
            self._cruise[key] = CruiseTable(power, partial(fly, key[2]))
        return self._cruise[key]


def _along_across(group: _Group, north: Floats, east: Floats) -> tuple[Floats, Floats]:
    along = north * group.north + east * group.east
    return along, east * group.north - north * group.east


def _column(values: list[float]) -> Floats:
    return np.array(values)[:, None]


def _stop(before: Leg | None, leg: Leg) -> float:
    """Time lost where two legs meet, in units of speed / acceleration.

    Half of one to reach a speed or to lose it, and in a turn the share of speed that turns.
    """
    if before is None or before.to_ned_m != leg.from_ned_m:
        return 0.0
    moving, moves = before.kind is LegKind.CRUISE, leg.kind is LegKind.CRUISE
    if moving and moves:
        before_rad = course_rad(before.from_ned_m, before.to_ned_m)
        turn_rad = wrap_pi(course_rad(leg.from_ned_m, leg.to_ned_m) - before_rad)
        return 0.5 * (1.0 - math.cos(turn_rad))
    return 0.5 if moving or moves else 0.0
