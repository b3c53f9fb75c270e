"""Flies a policy over episodes and counts goals, collisions, times and energies."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from companion.adapters.files.params import read_airframe
from companion.core.base.arrays import Floats
from companion.core.separation.separation_filter import SeparationFilter
from companion.core.vehicle.power import GRAVITY_MPS2, multirotor_power_w
from sim_bridge.adapters.wall_clock import process_cpu_s
from sim_bridge.research.avoidance.compared_policies import VelocityPolicy
from sim_bridge.research.avoidance.scenes import draw_random_scene
from sim_bridge.research.avoidance.world import (
    GOAL_RADIUS_M,
    MAX_SPEED_MPS,
    TICK_S,
    TICKS,
    AvoidanceWorld,
)

EVALUATION_SCENES = 16  # from another random stream than the 24 of training
LONGEST_S = 150.0
TIMED_TICKS = 100
AIRFRAME = "m100"
FASTEST_MPS = 30.0


@dataclass(frozen=True)
class FlightResults:
    """Results of the flights of some episodes; flat arrays, one value per flight."""

    arrived: NDArray[np.bool_]
    hit_drone: NDArray[np.bool_]
    hit_obstacle: NDArray[np.bool_]
    time_ratio: Floats  # NaN where not arrived
    energy_ratio: Floats
    min_separation: Floats  # minimum separation, in required separations


@lru_cache(maxsize=1)
def evaluation_world(agent_count: int, has_wind: bool) -> AvoidanceWorld:
    """Return a world of towns that are not used in training."""
    scenes = [draw_random_scene(np.random.default_rng([2, k])) for k in range(EVALUATION_SCENES)]
    return AvoidanceWorld(scenes, agent_count, has_wind)


def run_episodes(
    world: AvoidanceWorld,
    policy: VelocityPolicy,
    separation: SeparationFilter | None,
    seeds: list[int],
) -> FlightResults:
    """Fly the episodes of these seeds to their end, at most 150 s."""
    world.start_random_episodes(seeds)
    power_w, climb_j_per_m = make_level_flight_power_function(), climb_energy_j_per_m()
    energy_j = np.zeros(world.active.shape)
    straight_s, straight_j = _straight_flight_time_s_and_energy_j(world, power_w)
    for tick in range(round(LONGEST_S / TICK_S)):
        active = world.active.copy()
        if not active.any():
            break
        velocity_mps = policy.choose_velocities_mps(world, tick)
        if separation is not None:
            velocity_mps = world.filter_velocities(velocity_mps, separation)
        before = world.vel_mps
        world.tick(velocity_mps)
        ground = np.where(active[..., None], before, 0.0)
        air = np.linalg.norm(ground[..., :2] - world.wind_ne_mps[:, None], axis=-1)
        climbing = np.maximum(-ground[..., 2], 0.0)
        energy_j += active * TICK_S * (power_w(air) + climb_j_per_m * climbing)
    return FlightResults(
        world.arrived.ravel(),
        world.hit_drone.ravel(),
        world.hit_obstacle.ravel(),
        (world.arrived_s / straight_s).ravel(),
        np.where(world.arrived, energy_j / straight_j, np.nan).ravel(),
        world.min_separation.ravel(),
    )


def measure_decision_cpu_us(
    world: AvoidanceWorld,
    policy: VelocityPolicy,
    separation: SeparationFilter | None,
    seeds: list[int],
) -> list[float]:
    """Measure the CPU time of one drone's decision, policy and filter, one episode at a time."""
    costs = []
    for seed in seeds:
        world.start_random_episodes([seed])
        for tick in range(TIMED_TICKS):
            rows = np.flatnonzero(world.active)
            if not len(rows):
                break
            start_s = process_cpu_s()
            velocity_mps = policy.choose_velocities_mps(world, tick)
            policy_end_s = process_cpu_s()
            if separation is not None:
                world.filter_velocities(velocity_mps, separation, rows[:1])
            if tick % TICKS == 0:  # ticks that include a query of the actor
                costs.append(
                    1e6 * ((policy_end_s - start_s) / len(rows) + process_cpu_s() - policy_end_s)
                )
            if separation is not None:
                velocity_mps = world.filter_velocities(velocity_mps, separation)
            world.tick(velocity_mps)
    return costs


def _straight_flight_time_s_and_energy_j(
    world: AvoidanceWorld, power_w: Callable[[Floats], Floats]
) -> tuple[Floats, Floats]:
    """Return seconds and joules straight to the goal's edge, at full speed, in the same wind."""
    bearing, distance = world.goal_bearing_rad_and_distance_m()
    ground = world.attainable_velocity_mps(bearing, np.full(bearing.shape, MAX_SPEED_MPS))[..., :2]
    seconds = (distance - GOAL_RADIUS_M) / np.linalg.norm(ground, axis=-1)
    air = np.linalg.norm(ground - world.wind_ne_mps[:, None], axis=-1)
    return seconds, seconds * power_w(air)


def mean_and_ci95_half_width_by_episode(
    values: Floats, agents_per_episode: int
) -> tuple[float | None, float | None]:
    """Return the mean of the finite values and half of its 95 % interval, clustered by episode.

    A ratio of sums over episodes (Cochran, Sampling Techniques, 1977, 6.3); None if too few.
    """
    by_row = values.reshape(-1, agents_per_episode)
    count = np.isfinite(by_row).sum(axis=1)
    if not count.sum():
        return None, None
    total = np.where(np.isfinite(by_row), by_row, 0.0).sum(axis=1)
    mean = total.sum() / count.sum()
    if len(by_row) < 2:
        return float(mean), None
    spread = ((total - mean * count) ** 2).sum() * len(by_row) / (len(by_row) - 1)
    return float(mean), float(1.96 * np.sqrt(spread) / count.sum())


def make_level_flight_power_function() -> Callable[[Floats], Floats]:
    """Return a function from airspeeds to electrical power in level flight, empty, W."""
    airframe_model = read_airframe(AIRFRAME)
    speeds = np.linspace(0.0, FASTEST_MPS, 121)
    power = multirotor_power_w(airframe_model, airframe_model.flying_mass_kg(0.0), speeds)
    return lambda airspeed_mps: np.interp(airspeed_mps, speeds, power)


def climb_energy_j_per_m() -> float:
    """Return the energy of one metre of climb: the weight over the drive efficiency, J/m."""
    airframe = read_airframe(AIRFRAME)
    weight_n = airframe.flying_mass_kg(0.0) * GRAVITY_MPS2
    return weight_n / airframe.power_rotor.drive_efficiency
