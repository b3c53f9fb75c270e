"""Safety filter: from desired velocity set-points to set-points that keep the separation.

A new velocity passes only if its path, one tick at that velocity and then braking, is at every
instant nearer to the vehicle's own braking path than to each neighbour's, by the separation plus
the neighbour's uncertainty (`stopping_paths`). If all vehicles do so, no two paths come closer than
the separation, and braking stays safe at the next tick. The proof and its assumptions are in
docs/explanation/avoidance.md.

Arrays are batched: A vehicles, J neighbours each; (A, ..., 3) local NED at the interface,
(3, A, ...) inside.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from companion.core.base.arrays import Bools, Floats, Ints, Singles
from companion.core.separation.stopping_paths import (
    Instants,
    NearbyNeighbours,
    NeighbourPaths,
    Neighbours,
    SeparationParams,
    braking_paths,
    compute_separation_slack,
    get_instants,
    horizontal_norm,
    paths_of_candidate_velocities,
    predict_neighbour_braking_paths,
    select_neighbours_within_reach,
    velocity_after_one_tick,
)

Clearance = Callable[[Floats, Ints], Floats]
"""Points (a, ..., 3) of the vehicles `rows` (a,) -> lower bound of the distance to obstacles, m."""

DIRECTIONS = 12
CREEP_MPS = 1.0  # speed for leaving a position whose separation is not certain
ROUNDING_M2 = 1e-6  # rounding tolerance
RIGHT_BIAS_MPS = 0.3  # both vehicles turn right, as in the rules of the air (SERA.3210)
DODGE_WEIGHT = 0.3  # cost of 1 m/s vertically relative to 1 m/s horizontally
ESCAPE_S = 3.0  # time horizon of an escape
SINGLE_BATCH_VEHICLES = 3  # up to this number of vehicles all candidates are evaluated at once
FIRST_CANDIDATES = 8  # with more vehicles, the number of candidates evaluated first
RING_ANGLES_RAD = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS


class FilterAction(IntEnum):
    """Action of the filter on the desired velocity."""

    PASSED = 0
    BENT = 1
    BRAKED = 2
    ESCAPED = 3


@dataclass(frozen=True)
class FilterResult:
    """Velocity at the end of this tick (A, 3), and the `FilterAction` of each vehicle (A,)."""

    vel_ned_mps: Floats
    verdict: Ints


@dataclass(frozen=True)
class SeparationFilter:
    """Separation filter of any number of vehicles, without state between calls."""

    params: SeparationParams = field(default_factory=SeparationParams)

    def desired_velocity_is_safe_by_vehicle(
        self,
        pos_ned_m: Floats,
        vel_ned_mps: Floats,
        desired_ned_mps: Floats,
        neighbours: Neighbours,
    ) -> Bools:
        """Return which desired velocities (A, 3) pass unchanged, without regard to obstacles."""
        now, vel = get_instants(self.params), vel_ned_mps.T
        paths = paths_of_candidate_velocities(
            vel, velocity_after_one_tick(vel, desired_ned_mps.T, self.params)[..., None], now
        )
        reports = predict_neighbour_braking_paths(
            select_neighbours_within_reach(pos_ned_m, vel, neighbours, now), now
        )
        return np.asarray(
            compute_separation_slack(paths, braking_paths(vel, now), reports, now)[:, 0] >= 0.0
        )

    def nearest_safe_velocities(
        self,
        pos_ned_m: Floats,
        vel_ned_mps: Floats,
        desired_ned_mps: Floats,
        neighbours: Neighbours,
        avoidance_height_down_m: Floats,
        obstacle_distance_lower_bound: Clearance | None = None,
    ) -> FilterResult:
        """Return the nearest safe velocities; `avoidance_height_down_m` (A,) is the avoidance
        height.
        """
        now, vel, desired = get_instants(self.params), vel_ned_mps.T, desired_ned_mps.T
        if not np.isfinite(desired).all():
            desired = np.nan_to_num(desired)
        first = velocity_after_one_tick(vel, desired, self.params)
        nearby = select_neighbours_within_reach(pos_ned_m, vel, neighbours, now)
        reports, braking = predict_neighbour_braking_paths(nearby, now), braking_paths(vel, now)
        paths = paths_of_candidate_velocities(vel, first[..., None], now)
        slack = compute_separation_slack(paths, braking, reports, now, per_neighbour=True)[:, 0]
        rows = np.arange(len(pos_ned_m))
        blocked = (slack < 0.0).any(axis=1)
        if obstacle_distance_lower_bound is not None:
            blocked |= ~_is_path_clear_of_buildings(
                paths[:, :, 0], pos_ned_m, rows, obstacle_distance_lower_bound, self.params
            )
        verdict = np.zeros(len(rows), dtype=np.int64)
        rows = np.flatnonzero(blocked)
        if len(rows):
            near = reports.select_kept_neighbours(rows, slack[rows] < now.most_change)
            scene = _BlockedVehicles(
                now,
                rows,
                pos_ned_m[rows],
                vel[:, rows],
                braking[:, rows],
                near,
                obstacle_distance_lower_bound,
            )
            dodge = _down_velocity_to_avoidance_height_mps(
                scene.pos_ned_m, avoidance_height_down_m[rows], self.params
            )
            candidates = _candidate_velocities(scene.vel, desired[:, rows], dodge, self.params)
            cost = _candidate_velocity_costs(candidates, desired[:, rows], dodge)
            first[:, rows], verdict[rows] = _choose_velocity_and_action_of_blocked(
                scene, candidates, cost, nearby
            )
        return FilterResult(first.T, verdict)


@dataclass(frozen=True)
class _BlockedVehicles:
    """Vehicles whose desired velocity is rejected: their rows in the batch, and surroundings."""

    now: Instants
    row: Ints
    pos_ned_m: Floats  # (a, 3)
    vel: Floats  # (3, a)
    braking: Floats  # (3, a, T)
    reports: NeighbourPaths
    clearance: Clearance | None

    def subset(self, indices: Ints) -> "_BlockedVehicles":
        """Return a subset of the vehicles."""
        return _BlockedVehicles(
            self.now,
            self.row[indices],
            self.pos_ned_m[indices],
            self.vel[:, indices],
            self.braking[:, indices],
            self.reports.select_vehicles(indices),
            self.clearance,
        )


def _choose_velocity_and_action_of_blocked(
    blocked_vehicles: _BlockedVehicles,
    candidates: Floats,
    cost: Floats,
    nearby_neighbours: NearbyNeighbours,
) -> tuple[Floats, Ints]:
    """Return the cheapest safe candidate and the action, for rejected desired velocities.

    The candidates (3, a, C) and costs (a, C) end with braking. For many vehicles the cheapest
    candidates are evaluated first, and the others only where none of them passes.
    """
    row_indices = np.arange(len(cost))
    if len(row_indices) <= SINGLE_BATCH_VEHICLES:
        is_safe, brake_slack = _candidate_safety_and_brake_slack(blocked_vehicles, candidates)
        choice = _cheapest_safe_index(is_safe, cost)
    else:
        order = cost.argsort(axis=1, kind="stable")
        choice, brake_slack = _cheapest_safe_column_and_brake_slack(
            blocked_vehicles, candidates, cost, order[:, :FIRST_CANDIDATES]
        )
        left = np.flatnonzero(choice < 0)
        if len(left):
            others = order[left, FIRST_CANDIDATES:]
            choice[left], _ = _cheapest_safe_column_and_brake_slack(
                blocked_vehicles.subset(left), candidates[:, left], cost[left], others
            )
    choice[choice < 0] = cost.shape[1] - 1
    verdict = np.where(choice == cost.shape[1] - 1, FilterAction.BRAKED, FilterAction.BENT)
    unsafe = np.flatnonzero(brake_slack < 0.0)  # elsewhere braking keeps the separation
    if len(unsafe):
        unsafe = unsafe[_is_separation_violated_despite_braking(blocked_vehicles.subset(unsafe))]
    if len(unsafe):
        choice[unsafe] = _escape_candidate_index(
            blocked_vehicles.subset(unsafe), candidates[:, unsafe], nearby_neighbours
        )
        verdict[unsafe] = FilterAction.ESCAPED
    return candidates[:, row_indices, choice], verdict.astype(np.int64)


def _cheapest_safe_column_and_brake_slack(
    blocked_vehicles: _BlockedVehicles, candidates: Floats, cost: Floats, candidate_columns: Ints
) -> tuple[Ints, Singles]:
    """Return the cheapest of these columns (a, c) that passes, or -1, and the braking slack."""
    rows = np.arange(len(candidate_columns))
    braking = np.full((len(candidate_columns), 1), cost.shape[1] - 1)
    is_safe, brake_slack = _candidate_safety_and_brake_slack(
        blocked_vehicles, candidates[:, rows[:, None], np.hstack([candidate_columns, braking])]
    )
    best = _cheapest_safe_index(
        is_safe[:, :-1], np.take_along_axis(cost, candidate_columns, axis=1)
    )
    return np.where(best < 0, -1, candidate_columns[rows, best]), brake_slack


def _cheapest_safe_index(is_safe: Bools, cost: Floats) -> Ints:
    """Return the first index of least cost that passes, or -1; (a,)."""
    return np.where(is_safe.any(axis=1), np.where(is_safe, cost, np.inf).argmin(axis=1), -1)


def _candidate_safety_and_brake_slack(
    blocked_vehicles: _BlockedVehicles, candidates: Floats
) -> tuple[Bools, Singles]:
    """Return which velocities (3, a, c), the last one braking, pass, and its slack (a,)."""
    paths = paths_of_candidate_velocities(blocked_vehicles.vel, candidates, blocked_vehicles.now)
    slack = compute_separation_slack(
        paths, blocked_vehicles.braking, blocked_vehicles.reports, blocked_vehicles.now
    )
    is_safe = slack >= 0.0
    brakes = (np.abs(candidates[:2] - candidates[:2, :, -1:]) < 1e-9).all(axis=0)
    creeps = (np.sqrt((candidates**2).sum(axis=0)) <= CREEP_MPS) & (slack[:, -1:] < 0.0)
    a, c = np.nonzero((brakes | creeps) & ~is_safe)
    if len(a):
        is_safe[a, c] = _path_avoids_approach_to_unsafe(blocked_vehicles.subset(a), paths[:, a, c])
    if blocked_vehicles.clearance is not None:
        a, c = np.nonzero(is_safe)
        p = blocked_vehicles.now.params
        is_safe[a, c] = _is_path_clear_of_buildings(
            paths[:, a, c],
            blocked_vehicles.pos_ned_m[a],
            blocked_vehicles.row[a],
            blocked_vehicles.clearance,
            p,
        )
    return is_safe, slack[:, -1]


def _path_avoids_approach_to_unsafe(blocked_vehicles: _BlockedVehicles, paths: Floats) -> Bools:
    """Return whether these paths (3, a, T) do not approach neighbours of negative slack; (a,).

    For every error of the report, the deviation from the braking path leads away from all possible
    positions of the neighbour, horizontally and vertically. The vertical part is free while the
    vertical distance is too small for separation.
    """
    now, reports, p = blocked_vehicles.now, blocked_vehicles.reports, blocked_vehicles.now.params
    slack = compute_separation_slack(
        paths[:, :, None], blocked_vehicles.braking, reports, now, per_neighbour=True
    )[:, 0]
    metre = 1.0 / now.shares[:, None, None]
    offset = blocked_vehicles.braking[:, :, None] - metre * reports.braking
    uncertainty = metre[1:] * np.maximum(reports.uncertainty, 0.0)
    moved = (paths - blocked_vehicles.braking)[:, :, None]
    flat = (
        moved[0] * offset[0] + moved[1] * offset[1]
        >= horizontal_norm(moved) * uncertainty[0] - ROUNDING_M2
    )
    high = moved[2] * offset[2] >= np.abs(moved[2]) * uncertainty[1] - ROUNDING_M2
    longest = 2.0 * p.climb_accel_mps2 * p.tick_s
    longest *= p.max_climb_mps / p.climb_accel_mps2 + p.tick_s
    most = np.abs(offset[2]) + uncertainty[1] + longest
    is_negligible = (most < p.vertical_m + 2.0 * p.tracking_vertical_m).all(axis=-1)
    away = flat.all(axis=-1) & (is_negligible | high.all(axis=-1))
    return np.asarray(((slack >= 0.0) | away).all(axis=-1))


def _is_separation_violated_despite_braking(blocked_vehicles: _BlockedVehicles) -> Bools:
    """Return whether braking is insufficient even for the most favourable report error; (a,)."""
    now, reports, p = blocked_vehicles.now, blocked_vehicles.reports, blocked_vehicles.now.params
    metre = 1.0 / now.shares[:, None, None]
    away = blocked_vehicles.braking[:, :, None] - metre * reports.braking
    flat = (horizontal_norm(away) + metre[0] * reports.uncertainty[0]) / p.horizontal_m
    high = (np.abs(away[2]) + metre[2] * reports.uncertainty[1]) / p.vertical_m
    close = (np.maximum(flat, high) < 1.0).any(axis=-1) & (reports.uncertainty[0, ..., 0] >= 0.0)
    return np.asarray(close.any(axis=1))


def _escape_candidate_index(
    blocked_vehicles: _BlockedVehicles, candidates: Floats, nearby_neighbours: NearbyNeighbours
) -> Ints:
    """Return the candidate of largest distance to neighbours at constant velocity; (a,)."""
    now, p, rows = blocked_vehicles.now, blocked_vehicles.now.params, blocked_vehicles.row
    in_horizon = now.times_s <= ESCAPE_S
    paths = paths_of_candidate_velocities(blocked_vehicles.vel, candidates, now)
    vel, away = nearby_neighbours.vel_mps[:, rows], nearby_neighbours.away_m[:, rows]
    flown = (nearby_neighbours.age_s[rows][..., None] + now.times_s[in_horizon]) * vel[..., None]
    off = paths[:, :, :, None, in_horizon] - (away[..., None] + flown)[:, :, None]
    # The sum, not the maximum: where neither part suffices, each metre of either helps.
    offset = horizontal_norm(off) / p.horizontal_m + np.abs(off[2]) / p.vertical_m
    offset = np.where(nearby_neighbours.present[rows][:, None, :, None], offset, np.inf)
    margin = offset.min(axis=(2, 3))
    if blocked_vehicles.clearance is not None:
        a, c = (k.ravel() for k in np.indices(margin.shape))
        clear = _is_path_clear_of_buildings(
            paths[:, a, c], blocked_vehicles.pos_ned_m[a], rows[a], blocked_vehicles.clearance, p
        )
        margin = np.where(clear.reshape(margin.shape), margin, -np.inf)
    least = np.finfo(margin.dtype).min
    margin[:, -1] = np.maximum(margin[:, -1], least)  # braking is always available
    return margin.argmax(axis=1)


def _is_path_clear_of_buildings(
    paths: Floats,
    pos_ned_m: Floats,
    vehicle_indices: Ints,
    obstacle_distance_lower_bound: Clearance,
    p: SeparationParams,
) -> Bools:
    """Return whether each path (3, n, T) from (n, 3) is clear of buildings at all times."""
    step = horizontal_norm(np.diff(paths, axis=-1))
    half = np.zeros(paths.shape[1:])
    half[:, 1:] = step
    np.maximum(half[:, :-1], step, out=half[:, :-1])
    points = paths.transpose(1, 2, 0) + pos_ned_m[:, None]
    return np.asarray(
        (obstacle_distance_lower_bound(points, vehicle_indices) >= p.obstacle_m + 0.5 * half).all(
            axis=-1
        )
    )


def _down_velocity_to_avoidance_height_mps(
    pos_ned_m: Floats, avoidance_height_down_m: Floats, p: SeparationParams
) -> Floats:
    """Return the vertical speed towards a vehicle's own layer, with a stop there; (a,)."""
    off = avoidance_height_down_m - pos_ned_m[:, 2]
    most = np.sqrt(p.climb_accel_mps2 * np.abs(off))
    return np.sign(off) * np.minimum(most, p.max_climb_mps)


def _candidate_velocities(
    vel: Floats, desired_velocity: Floats, down_velocity_to_layer: Floats, p: SeparationParams
) -> Floats:
    """Return candidate velocities reachable in one tick, desired first, braking last; (3, a, C).

    Between them, with the climb of `down_velocity_to_layer`: the desired velocity, two rings around
    the current one, the current one and braking. Then without a climb: desired, braking and current
    velocity.
    """
    brake, first = (
        velocity_after_one_tick(vel, np.zeros_like(vel), p),
        velocity_after_one_tick(vel, desired_velocity, p),
    )
    angle = (
        np.arctan2(desired_velocity[1] - vel[1], desired_velocity[0] - vel[0])[:, None]
        + RING_ANGLES_RAD
    )
    ring = np.stack([np.cos(angle), np.sin(angle)]) * (p.accel_mps2 * p.tick_s)
    near, far = 2 + DIRECTIONS, 2 + 2 * DIRECTIONS
    candidates = np.empty((3, vel.shape[1], far + 6))
    candidates[:, :, 0] = first
    candidates[:2, :, 1] = first[:2]
    candidates[:2, :, 2:near] = vel[:2, :, None] + ring
    candidates[:2, :, near:far] = vel[:2, :, None] + 0.5 * ring
    for column, flat in enumerate((vel, brake, first, brake, vel), start=far):
        candidates[:2, :, column] = flat[:2]
    candidates[2, :, 1 : far + 2] = down_velocity_to_layer[:, None]
    candidates[2, :, far + 2 :] = 0.0
    candidates[:, :, -1] = brake
    return velocity_after_one_tick(vel[..., None], candidates, p)


def _candidate_velocity_costs(
    candidates: Floats, desired_velocity: Floats, down_velocity_to_layer: Floats
) -> Floats:
    """Return the deviation from the desired velocity and `down_velocity_to_layer`; (a, C)."""
    bias = RIGHT_BIAS_MPS / np.maximum(horizontal_norm(desired_velocity), 1e-9)
    north = candidates[0] - (desired_velocity[0] - bias * desired_velocity[1])[:, None]
    east = candidates[1] - (desired_velocity[1] + bias * desired_velocity[0])[:, None]
    off = np.sqrt(north * north + east * east)
    return off + DODGE_WEIGHT * np.abs(candidates[2] - down_velocity_to_layer[:, None])
