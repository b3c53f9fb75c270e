"""Flies a policy over episodes and counts goals, collisions, times and energies."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from companion.adapters.files.params import read_airframe
from companion.core.base.arrays import Floats
from companion.core.separation.separation_filter import SeparationFilter
from companion.core.vehicle.power import multirotor_power_w
from sim_bridge.research.avoidance.scenes import make_scene
from sim_bridge.research.avoidance.world import GOAL_M, MAX_SPEED_MPS, TICK_S, TICKS, AvoidanceWorld
from sim_bridge.research.avoidance.yardsticks import Pilot

EVALUATION_SCENES = 16  # drawn from another stream than the 24 of training
LONGEST_S = 150.0
TIMED_TICKS = 100
AIRFRAME = "m100"
GRAVITY_MPS2 = 9.80665
FASTEST_MPS = 30.0


@dataclass(frozen=True)
class Flights:
    """What came of the flights of some episodes; flat arrays, one value a flight."""

    arrived: NDArray[np.bool_]
    hit_drone: NDArray[np.bool_]
    hit_building: NDArray[np.bool_]
    time_ratio: Floats  # NaN where not arrived
    energy_ratio: Floats
    apart: Floats  # least, in separations

    def joined(self, other: "Flights") -> "Flights":
        names = self.__dataclass_fields__
        return Flights(*(np.concatenate([getattr(self, n), getattr(other, n)]) for n in names))


def evaluation_world(agents: int, wind: bool) -> AvoidanceWorld:
    """Towns that training never saw."""
    scenes = [make_scene(np.random.default_rng([2, k])) for k in range(EVALUATION_SCENES)]
    return AvoidanceWorld(scenes, agents, wind)


def fly(
    world: AvoidanceWorld,
    pilot: Pilot,
    separation: SeparationFilter | None,
    seeds: list[int],
    watch: Callable[[AvoidanceWorld], None] = lambda _: None,
) -> Flights:
    """The episodes of these seeds to their end, or for 150 s."""
    world.reset(seeds)
    power_w, climb_j_per_m = power_of(AIRFRAME), climb_cost_j_per_m(AIRFRAME)
    energy_j = np.zeros(world.active.shape)
    straight_s, straight_j = _straight(world, power_w)
    for tick in range(round(LONGEST_S / TICK_S)):
        flying = world.active.copy()
        if not flying.any():
            break
        wanted = pilot.wanted(world, tick)
        if separation is not None:
            wanted, _ = world.filtered(wanted, separation)
        before = world.vel_mps
        world.tick(wanted)
        ground = np.where(flying[..., None], before, 0.0)
        air = np.linalg.norm(ground[..., :2] - world.wind_ne_mps[:, None], axis=-1)
        climbing = np.maximum(-ground[..., 2], 0.0)
        energy_j += flying * TICK_S * (power_w(air) + climb_j_per_m * climbing)
        watch(world)
    return Flights(
        world.arrived.ravel(),
        world.hit_drone.ravel(),
        world.hit_building.ravel(),
        (world.arrived_s / straight_s).ravel(),
        np.where(world.arrived, energy_j / straight_j, np.nan).ravel(),
        world.apart.ravel(),
    )


def decision_us(
    world: AvoidanceWorld,
    pilot: Pilot,
    separation: SeparationFilter | None,
    seeds: list[int],
    cpu_s: Callable[[], float],
) -> Floats:
    """What one drone's decision costs, policy and filter, in flights of one episode at a time."""
    costs = []
    for seed in seeds:
        world.reset([seed])
        for tick in range(TIMED_TICKS):
            rows = np.flatnonzero(world.active)
            if not len(rows):
                break
            began = cpu_s()
            wanted = pilot.wanted(world, tick)
            asked = cpu_s()
            if separation is not None:
                world.filtered(wanted, separation, rows[:1])
            if tick % TICKS == 0:  # when the actor is asked, too
                costs.append((asked - began) / len(rows) + cpu_s() - asked)
            if separation is not None:
                wanted, _ = world.filtered(wanted, separation)
            world.tick(wanted)
    return 1e6 * np.array(costs)


def _straight(world: AvoidanceWorld, power_w: Callable[[Floats], Floats]) -> tuple[Floats, Floats]:
    """Seconds and joules straight to the goal's edge, at full speed, in the same wind."""
    bearing, distance = world.to_goal()
    ground = world.velocity_of(bearing, np.full(bearing.shape, MAX_SPEED_MPS))[..., :2]
    seconds = (distance - GOAL_M) / np.linalg.norm(ground, axis=-1)
    air = np.linalg.norm(ground - world.wind_ne_mps[:, None], axis=-1)
    return seconds, seconds * power_w(air)


def upper95(count: int, of: int) -> float:
    """One-sided 95 % bound on a share (Clopper and Pearson, Biometrika 26, 1934)."""
    return 1.0 if count >= of else float(beta.ppf(0.95, count + 1, of - count))


def summary(
    policy: str, agents: int, episodes: int, found: Flights, decision_us: Floats
) -> dict[str, object]:
    """The figures of `--json` (docs/reference/benchmarks.md); 95 % intervals are by episode."""
    flights, horizontal_m = len(found.arrived), 5.0
    drones = int(found.hit_drone.sum())
    time, time_half = by_episode(found.time_ratio, agents)
    energy, energy_half = by_episode(found.energy_ratio, agents)
    return {
        "policy": policy,
        "agents": agents,
        "episodes": episodes,
        "flights": flights,
        "goals": int(found.arrived.sum()),
        "drone_collisions": drones,
        "building_collisions": int(found.hit_building.sum()),
        "drone_collision_rate_upper95": upper95(drones, flights),
        "time_ratio_mean": time,
        "time_ratio_ci95": time_half,
        "energy_ratio_mean": energy,
        "energy_ratio_ci95": energy_half,
        "separation_min_m": float(found.apart.min()) * horizontal_m if agents > 1 else None,
        "decision_us_median": float(np.median(decision_us)),
        "decision_us_p99": float(np.percentile(decision_us, 99)),
    }


def by_episode(values: Floats, agents: int) -> tuple[float | None, float | None]:
    """Mean of what is finite and half of its 95 % interval, drones of an episode being alike.

    A ratio of sums over episodes (Cochran, Sampling Techniques, 1977, 6.3); None where too few.
    """
    of = values.reshape(-1, agents)
    count = np.isfinite(of).sum(axis=1)
    if not count.sum():
        return None, None
    total = np.where(np.isfinite(of), of, 0.0).sum(axis=1)
    mean = total.sum() / count.sum()
    if len(of) < 2:
        return float(mean), None
    spread = ((total - mean * count) ** 2).sum() * len(of) / (len(of) - 1)
    return float(mean), float(1.96 * np.sqrt(spread) / count.sum())


def power_of(airframe: str) -> Callable[[Floats], Floats]:
    """Electrical power in level flight, empty, W, for any array of airspeeds."""
    believed = read_airframe(airframe)
    speeds = np.linspace(0.0, FASTEST_MPS, 121)
    power = multirotor_power_w(believed, believed.mass_kg(0.0), speeds)
    return lambda airspeed_mps: np.interp(airspeed_mps, speeds, power)


def climb_cost_j_per_m(airframe: str) -> float:
    """What a metre of height costs: its weight over the drive's efficiency, J."""
    believed = read_airframe(airframe)
    return believed.mass_kg(0.0) * GRAVITY_MPS2 / believed.power_rotor.drive_efficiency
